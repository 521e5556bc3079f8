"""Views beside observations, for pictures and scores alone: a simulator has one if it has the method."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol, runtime_checkable

import numpy as np

from datamodules.errors import UserError

if TYPE_CHECKING:
    from plp_lightning.envs.base import Simulator


@dataclass(frozen=True)
class FloorPlan:
    """A domain from above, in the frame of shared positions: the first axis down, the second right."""

    walls: np.ndarray  # centres (W, 2) of the square blocks that walls are made of
    side: float  # side of a block
    goals: Mapping[str, tuple[float, float]]  # end of each task
    radius: float  # distance from its goal at which a task is solved


@runtime_checkable
class Located(Protocol):
    """A simulator whose states are somewhere in a frame that all domains of an experiment share."""

    def shared_position(self, state: np.ndarray) -> np.ndarray:
        """Places ``(N, P)`` of raw states ``(N, O)``: two domains' states correspond if they are at one place."""


@runtime_checkable
class Planned(Located, Protocol):
    """A simulator that can be drawn from above."""

    def floor_plan(self) -> FloorPlan:
        """Walls ``(W, 2)`` and goals, in the frame of :meth:`shared_position`."""


@runtime_checkable
class Reaching(Protocol):
    """A simulator whose tasks are solved by coming near a place."""

    success_radius: float
    """Distance from it that counts as success, m."""

    def within(self, radius: float) -> Simulator:
        """The same episodes with another ``radius``, m; used one after the other, as both share their physics."""


@runtime_checkable
class Arranged(Protocol):
    """A simulator whose episodes of a task differ by more than continuous amounts."""

    def arrangement(self, task: str, seed: int) -> str:
        """A word for the places of things in the episode of ``task`` with ``seed``."""


@runtime_checkable
class Rendered(Protocol):
    """A simulator that people can watch, whether its observations have images or not."""

    def render(self, episodes: np.ndarray, size: tuple[int, int]) -> np.ndarray:
        """Pictures ``(n, H, W, 3)`` uint8 of the episodes ``(n,)`` as they stand, ended ones too.

        ``size`` is the height and width that is asked for, pixels; pictures of another size are taken as well, such as
        those of Gymnasium's ``render()``.

        Raises:
            UserError: If pictures cannot be drawn on this machine.
        """


def put_away(simulator: object) -> None:
    """Let go of a simulator's studio, ``_studio`` by name: hundreds of MB. The next picture makes it anew."""
    vars(simulator).pop("_studio", None)


def located(simulator: object) -> Located:
    """The simulator, if it knows a position that domains share.

    Raises:
        UserError: If it does not.
    """
    if isinstance(simulator, Located):
        return simulator
    raise UserError(
        f"{type(simulator).__name__} knows no position that domains share; give it shared_position(state), "
        "or choose another --score"
    )
