"""The words of the house: domains, observations, trajectories, batches.

Axes, here and everywhere: ``B`` batch, ``E`` episodes stepped together, ``T`` time, ``O`` state
size of a domain, ``A`` action size of a domain, ``Z`` latent size, ``K`` tasks.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, dataclass
from itertools import accumulate
from typing import TYPE_CHECKING, Any, Generic, Literal, NamedTuple, Protocol, TypeVar

import numpy as np

from datamodules.errors import UserError
from datamodules.limits import Limits, check_limits, to_owner

if TYPE_CHECKING:
    from pathlib import Path

    from torch import Tensor

ArrayT = TypeVar("ArrayT", np.ndarray, "Tensor")
NO_IMAGES: Mapping[str, Any] = {}  # Of a domain without a camera, or of one whose images nobody looks at


class Observation(NamedTuple, Generic[ArrayT]):
    """A policy's raw view of one domain: numpy arrays in simulators and files, tensors in training."""

    state: ArrayT  # Float32 of shape ``(..., O)``: the domain's state keys, concatenated in the order of its spec
    images: Mapping[str, ArrayT] = NO_IMAGES
    """By image key, uint8 of shape ``(..., H, W, C)``, each of its own size; empty in a domain without a camera."""

    def take(self: Observation[ArrayT], rows: Any) -> Observation[ArrayT]:  # type: ignore[misc]  # a generic NamedTuple
        """The observation at ``rows``, an index, a slice or an index array ``(n,)``, of the first axis."""
        return self.map(lambda x: x[rows])

    def map(self: Observation[ArrayT], change: Callable[[ArrayT], Any]) -> Observation[Any]:  # type: ignore[misc]
        """The observation with ``change`` applied to its state ``(..., O)`` and its images ``(..., H, W, C)``."""
        images = {name: change(image) for name, image in self.images.items()} if self.images else NO_IMAGES
        return Observation(change(self.state), images)


@dataclass(frozen=True)
class ObservationKey:
    """One named part of an observation, such as the position of the end effector."""

    name: str  # Name in the file, letters, digits, ``_``, ``.`` and ``-``
    shape: tuple[int, ...]  # Shape of one sample: ``(3,)`` for a vector, ``(H, W, C)`` for an image
    kind: Literal["state", "image"] = "state"
    unit: str = ""  # Unit of the raw values: ``m``, ``rad``, ``m/s``, …


@dataclass(frozen=True)
class DomainSpec:
    """A robot and its observation and action space; actions lie in [-1, 1], whatever its owner's units are."""

    name: str
    observation: tuple[ObservationKey, ...]
    action_size: int
    control_hz: float
    env: str = ""  # What simulates it, for the record: robot, simulator, version-independent settings
    action_low: tuple[float, ...] | None = None
    """``(A,)``: what -1 stands for in the owner's units; None, as for ``action_high``, if actions need no scaling."""
    action_high: tuple[float, ...] | None = None  # ``(A,)``: what 1 stands for

    def __post_init__(self) -> None:
        if not self.observation:
            raise UserError(f"domain {self.name!r} has neither a state key nor a camera; at least one key is needed")
        if self.action_low is not None or self.action_high is not None:
            check_limits(self.name, self.action_size, (self.action_low or (), self.action_high or ()))

    @property
    def state_keys(self) -> tuple[ObservationKey, ...]:
        """The keys that make up the state vector ``(O,)``, in order."""
        return tuple(key for key in self.observation if key.kind == "state")

    @property
    def image_keys(self) -> tuple[ObservationKey, ...]:
        """Keys of the cameras' images ``(H, W, C)``, each of its own size, in order; none without a camera."""
        return tuple(key for key in self.observation if key.kind == "image")

    @property
    def state_size(self) -> int:
        """Length O of the state vector ``(O,)``; 0 in a domain that shows images alone."""
        return sum(key.shape[0] for key in self.state_keys)

    def columns(self, names: Iterable[str]) -> list[int]:
        """Columns of the state vector ``(O,)`` that hold the named keys, in the order of ``names``.

        Raises:
            UserError: If the domain has no state key of that name.
        """
        stops = accumulate(key.shape[0] for key in self.state_keys)
        spans = {key.name: range(n - key.shape[0], n) for key, n in zip(self.state_keys, stops, strict=True)}
        for name in (names := list(names)):
            if name not in spans:
                raise UserError(f"domain {self.name!r} has no state key {name!r}; it has: {', '.join(spans) or 'none'}")
        return [column for name in names for column in spans[name]]

    @property
    def action_limits(self) -> Limits:
        """Values of -1 and 1 in the owner's units, ``(A,)`` each."""
        return self.action_low or (-1.0,) * self.action_size, self.action_high or (1.0,) * self.action_size

    def owner_actions(self, actions: np.ndarray) -> np.ndarray:
        """Actions ``(…, A)`` in [-1, 1] → float64 in the owner's units; without limits, as they are."""
        return actions if self.action_low is None else to_owner(actions, self.action_limits)

    def to_dict(self) -> dict[str, Any]:
        """Plain lists, strings and numbers, for JSON and checkpoints; without limits of actions if there are none."""
        plain = {name: value for name, value in asdict(self).items() if value is not None}
        plain |= {name: [*plain[name]] for name in ("action_low", "action_high") if name in plain}
        plain["observation"] = [{**asdict(key), "shape": list(key.shape)} for key in self.observation]
        return plain

    @classmethod
    def from_dict(cls, plain: Mapping[str, Any]) -> DomainSpec:
        """Inverse of :meth:`to_dict`."""
        found = [
            (k["name"], tuple(k["shape"]), k.get("kind", "state"), k.get("unit", "")) for k in plain["observation"]
        ]
        keys = tuple(ObservationKey(*key) for key in found)
        limits = (tuple(plain[name]) if name in plain else None for name in ("action_low", "action_high"))
        return cls(plain["name"], keys, plain["action_size"], plain["control_hz"], plain.get("env", ""), *limits)


@dataclass(frozen=True)
class Trajectory:
    """One demonstration of a task in a domain."""

    domain: str
    task: str
    observation: Observation[np.ndarray]
    """State ``(T + 1, O)``, images ``(T + 1, H, W, C)``: what the expert saw before each action and after the last one;
    T rows if nobody knows what was seen last."""
    actions: np.ndarray  # Float32 ``(T, A)`` in [-1, 1]
    seed: int  # Seed of the initial state; the simulator and this number give the first observation again
    success: bool

    def __post_init__(self) -> None:
        if len(self.observation.state) - len(self.actions) not in (0, 1) or len(self.actions) == 0:
            found = f"{len(self.observation.state)} observations and {len(self.actions)} actions"
            expected = "at least one action, and as many observations or one more, of what was seen last"
            place = f"trajectory of task {self.task!r} in domain {self.domain!r}"
            raise UserError(f"{place} has {found}; expected {expected}")

    def __len__(self) -> int:
        return len(self.actions)

    @property
    def last_known(self) -> bool:
        """True if the observation after the last action is there: T + 1 rows of state ``(T + 1, O)``."""
        return len(self.observation.state) > len(self)


class Steps(NamedTuple):
    """Single steps of one domain, drawn from many trajectories; transitions, if they hold what is seen next."""

    observation: Observation[Tensor]  # State ``(B, O)``, images ``(B, H, W, C)``
    action: Tensor  # ``(B, A)``
    task: Tensor  # ``(B,)`` int64, index into the experiment's task names
    row: Tensor  # ``(B,)`` int64, position of the step in its domain's dataset (see ``datamodules.batches.dataset``)
    next_observation: Observation[Tensor] | None = None
    """State ``(B, O)``, images ``(B, H, W, C)``: what is seen after the action, if the phase asks for it."""
    progress: Tensor | None = None
    """``(B,)`` float32: share of the trajectory that lies behind, 0 at its first step and 1 at its last, if the phase
    asks for it."""
    weight: Tensor | None = None  # ``(B,)``: 0 for rows that only fill up a batch of fixed shape, 1 for others; None: 1


class PackedTrajectories(NamedTuple):
    """Trajectories of one domain, thinned out, their frames laid end to end."""

    observation: Observation[Tensor]  # State ``(F, O)``, images ``(F, H, W, C)``: the frames of all P trajectories
    frame: Tensor  # ``(P, T)`` int64: which frame is step t of trajectory p; 0 where ``mask`` is False
    mask: Tensor  # ``(P, T)`` bool: False behind the end of a trajectory
    action: Tensor  # ``(F, A)``: the expert's


@dataclass(frozen=True)
class BatchSpec:
    """Contents of a phase's batches.

    Args:
        steps: Single steps: of proxy tasks in every domain; of ``all`` tasks that there are demonstrations of, in
            equal shares of every domain; of the target task with a ``mix`` of proxies; or ``none``.
        pairs: Trajectories of one task in two domains: ``thinned`` out, ``whole``, or ``none``.
        images: Whether images are looked at, where there are cameras.
        next_observation: Whether steps hold what is seen next; only steps of which that is known are drawn then.
        progress: Whether steps hold how far their trajectories are.
    """

    steps: Literal["proxy_tasks", "all", "mix", "none"] = "proxy_tasks"
    pairs: Literal["none", "thinned", "whole"] = "none"
    images: bool = True
    next_observation: bool = False
    progress: bool = False

    def __post_init__(self) -> None:
        assert self.steps != "none" or self.pairs != "none", "a phase trains on steps, on pairs or on both"


class Batch(NamedTuple):
    """One training step's data."""

    steps: dict[str, Steps]
    """By domain; a domain without steps in this batch is left out. Empty where a loss asks for pairs alone."""
    pairs: dict[str, PackedTrajectories]
    """Two domains; row p of both demonstrates the same task. Empty where no loss asks for pairs."""


Actor = Callable[[Observation[np.ndarray], np.ndarray], np.ndarray]
"""Acts in episodes: observations ``(n, …)`` of those ``(n,)`` that still run → actions ``(n, A)``."""


class Collector(Protocol):
    """Makes demonstrations: how the DataModule asks for what a file lacks without knowing any simulator."""

    def __call__(self, path: Path, missing: Mapping[str, Mapping[str, int]]) -> None:
        """Add ``missing[domain][task]`` successful demonstrations to the file at ``path``, atomically."""

    def makes(self, domain: str) -> bool:
        """Tell whether it can make demonstrations of a domain."""

    def check(self, path: Path) -> None:
        """Refuse, by a :class:`UserError`, a file whose demonstrations this collector would have made otherwise."""
