"""Domains, tasks and the parts that they play in a transfer: all that a policy is built for."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from datamodules.batches.normalization import Statistics
from datamodules.types import DomainSpec


@dataclass(frozen=True)
class TransferRoles:
    """Domains and tasks by the parts that they play in a transfer.

    Args:
        domains: Names of the domains, in order.
        source_domain: Domain whose demonstrations of the target task adapt the policy.
        target_domain: Domain that the policy is transferred to.
        tasks: Names of all tasks, in canonical order; their positions are the task indices.
        proxy_tasks: Tasks that align the domains.
        target_task: Name of the target task.
        target_tasks: Tasks that make up the target (one, or a goal from several start zones).
    """

    domains: tuple[str, ...]
    source_domain: str
    target_domain: str
    tasks: tuple[str, ...]
    proxy_tasks: tuple[str, ...]
    target_task: str
    target_tasks: tuple[str, ...]


@dataclass(frozen=True)
class TransferProblem:
    """Domains and tasks that a policy is built for.

    Args:
        domains: Specs of the domains; their order is the domain id.
        tasks: Names of all tasks, the target's included; their order is the task id.
        source_domain: Domain whose demonstrations of the target task adapt the policy.
        target_domain: Domain that the policy is transferred to.
        statistics: Statistics ``(O,)`` of raw states, by domain; without them a checkpoint has to bring the scaling.
    """

    domains: Sequence[DomainSpec]
    tasks: Sequence[str]
    source_domain: str
    target_domain: str
    statistics: Mapping[str, Statistics] | None = None

    def to_dict(self) -> dict[str, Any]:
        """Plain lists, strings and numbers, for checkpoints; the statistics stay behind."""
        return {
            "domains": [spec.to_dict() for spec in self.domains],
            "tasks": list(self.tasks),
            "source_domain": self.source_domain,
            "target_domain": self.target_domain,
        }

    @classmethod
    def from_dict(cls, plain: Mapping[str, Any]) -> TransferProblem:
        """Inverse of :meth:`to_dict`."""
        domains = [DomainSpec.from_dict(spec) for spec in plain["domains"]]
        return cls(domains, plain["tasks"], plain["source_domain"], plain["target_domain"])
