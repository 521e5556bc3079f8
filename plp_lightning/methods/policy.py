"""POLICY: the base of every method's policy, so that data, evaluation and runs need not know the method."""

from __future__ import annotations

import copy
from abc import ABC, abstractmethod
from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import TypeVar

import numpy as np
import torch
from torch import Tensor, nn

from datamodules.errors import ConfigError
from datamodules.named import fit_images, gather
from datamodules.problem import TransferProblem
from datamodules.settings import Configured
from datamodules.types import Actor, Observation
from plp_lightning.networks import Vision

A = TypeVar("A")
Parts = Mapping[str, Tensor]
"""One tensor by domain, with as many rows as the domain has in the batch."""
Raw = Observation[np.ndarray] | Mapping[str, np.ndarray]
"""What a robot gives: an observation, or its arrays by name."""
Observations = Mapping[str, Observation[Tensor]]
"""Observations of B_d rows each, by domain."""


class Policy(Configured, nn.Module, ABC):
    """Network that acts in the domains, on any of the tasks.

    Args:
        problem: Domains and tasks.
    """

    def __init__(self, problem: TransferProblem) -> None:
        super().__init__()
        self.problem = problem
        self.domains = {spec.name: spec for spec in problem.domains}
        self.tasks = {name: i for i, name in enumerate(problem.tasks)}

    @property
    def cameras(self) -> tuple[str, ...]:
        """Domains that have a camera, or several."""
        return tuple(name for name, spec in self.domains.items() if spec.image_keys)

    @property
    def frozen(self) -> dict[str, nn.Module]:
        """Image encoders whose weights are to stay as they are, whatever the phase, by name."""
        return {name: part for name, part in self.named_modules() if isinstance(part, Vision) and part.freeze}

    @property
    def acts_in(self) -> tuple[str, ...]:
        """Domains in which its actions mean something; in the others it is not evaluated."""
        return tuple(self.domains)

    @property
    def acts_on(self) -> torch.device:
        """Device that it acts fastest on: without images the way to a GPU and back costs more than a step here."""
        return next(self.parameters()).device if self.cameras else torch.device("cpu")

    @abstractmethod
    def predict_actions(self, observation: Observations, task: Parts) -> dict[str, Tensor]:
        """Actions ``(B_d, A_d)`` by domain.

        Args:
            observation: States ``(B_d, O)`` and, by camera, images ``(B_d, H, W, C)``, by domain.
            task: Indices of the tasks ``(B_d,)`` int64, by domain.
        """

    def act(self, observation: Raw, domain: str, task: str | Sequence[str]) -> np.ndarray:
        """Actions ``(B, A)``, or ``(…, A)``, in the owner's units; in [-1, 1] if the domain states no limits.

        Args:
            observation: Raw: state ``(B, O)`` and images ``(B, H, W, C)`` uint8 by camera, or those of the only one;
                or all arrays ``(…, n)`` by name.
            domain: Name of the domain.
            task: Name of the task of all rows, or of each.

        Raises:
            UserError: If the policy knows no such domain or task, or the domain shows arrays of another shape.
        """
        check_known("domain", [domain], self.acts_in)
        spec, lead = self.domains[domain], None
        if not isinstance(observation, Observation):
            observation, lead = gather(spec, observation)
        else:
            observation = fit_images(spec, observation)
        names = [task] * len(observation.state) if isinstance(task, str) else task
        actions = self._act(observation, domain, self._task_ids(names))
        if spec.action_low is not None:
            actions = spec.owner_actions(np.clip(actions, -1, 1)).astype(np.float32)
        return actions if lead is None else actions.reshape(*lead, spec.action_size)

    def actor(self, domain: str, tasks: Sequence[str]) -> Actor:
        """Gives a function that acts in new episodes of ``tasks``, maybe with a memory: ``(n, O)`` → ``(n, A)``.

        Its actions are in [-1, 1], as simulators want them.
        """
        known, ids = np.arange(len(tasks)), self._task_ids(tasks)

        def act(observation: Observation[np.ndarray], running: np.ndarray) -> np.ndarray:
            nonlocal known, ids
            if not np.array_equal(running, known):  # seldom, so that most steps take observations alone to the device
                known, ids = running, self._task_ids([tasks[i] for i in running])
            return self._act(observation, domain, ids)

        return act

    def _task_ids(self, names: Sequence[str]) -> Tensor:
        check_known("task", names, self.tasks)
        return torch.tensor([self.tasks[name] for name in names], device=next(self.parameters()).device)

    @torch.inference_mode()
    def _act(self, observation: Observation[np.ndarray], domain: str, ids: Tensor) -> np.ndarray:
        check_known("domain", [domain], self.acts_in)
        if observation.state.shape[1:] != (size := self.domains[domain].state_size,):
            found = f"states of shape {observation.state.shape} in domain {domain!r}"
            raise ConfigError(f"found {found}; expected (n, {size}): act on what the policy was trained on")
        seen = {domain: observation.map(lambda x: torch.as_tensor(x, device=ids.device))}
        return np.asarray(self.predict_actions(seen, {domain: ids})[domain].cpu())


def where_it_acts(actor: A) -> A:
    """Gives a policy, or a copy of it on the device that it acts fastest on; whatever else acts is where it is."""
    if not isinstance(actor, Policy) or next(actor.parameters()).device == actor.acts_on:
        return actor
    return copy.deepcopy(actor).to(actor.acts_on)


class AligningPolicy(Policy):
    """A policy that brings the states of all domains into one space, in which alignment can be scored."""

    @abstractmethod
    def encode(self, observation: Observations) -> dict[str, Tensor]:
        """States ``(B_d, Z)`` of that space, by domain."""


def check_known(what: str, names: Iterable[str], known: Collection[str]) -> None:
    """Refuse, by a :class:`ConfigError`, the first of ``names`` that is not ``known``."""
    for name in names:
        if name not in known:
            raise ConfigError(f"found {what} {name!r}; expected one of: {', '.join(known)}")
