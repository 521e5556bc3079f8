"""Domains, tasks and the parts that they play in a transfer: all that a policy is built for."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from datamodules.batches.normalization import Statistics
from datamodules.types import DomainSpec


@dataclass(frozen=True)
class TransferRoles:
    """Names of domains and tasks by the parts that they play in a transfer."""

    domains: tuple[str, ...]  # in order
    source_domain: str  # its demonstrations of the target task adapt the policy
    target_domain: str  # the policy is transferred to it
    tasks: tuple[str, ...]  # all, in canonical order; their positions are the task indices
    proxy_tasks: tuple[str, ...]  # they align the domains
    target_task: str
    target_tasks: tuple[str, ...]  # they make up the target: one, or a goal from several start zones


@dataclass(frozen=True)
class TransferProblem:
    """Domains and tasks that a policy is built for."""

    domains: Sequence[DomainSpec]  # their order is the domain id
    tasks: Sequence[str]  # names of all, the target's included; their order is the task id
    source_domain: str  # its demonstrations of the target task adapt the policy
    target_domain: str  # the policy is transferred to it
    statistics: Mapping[str, Statistics] | None = None  # by domain; without them a checkpoint brings the scaling

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
