"""Simulators that fail: what one raises is told once, and the run goes on without what it was asked for."""

from __future__ import annotations

import sys
import traceback
from collections.abc import Hashable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from datamodules.errors import UserError
from datamodules.types import DomainSpec, Observation
from plp_lightning.envs.base import Step


class SimulatorError(UserError):
    """A simulator raised; nothing that the settings say was to blame."""

    def __init__(self, simulator: object, error: BaseException, consequence: str = "") -> None:
        innermost = traceback.extract_tb(error.__traceback__)[-1]
        self.simulator = simulator
        self.place = f"{type(error).__name__} at {Path(innermost.filename).name}:{innermost.lineno}"
        words = " ".join(str(error).split())[:200]
        said = f"{type(simulator).__name__} raised {self.place}{f': {words}' if words else ''}"
        super().__init__(said + consequence)


@contextmanager
def blaming(simulator: object) -> Iterator[None]:
    """Call a simulator: what it raises becomes a :class:`SimulatorError`.

    What the user can mend, memory that is full and being asked to stop pass as they are.
    """
    try:
        yield
    except (UserError, MemoryError):
        raise
    except (Exception, SystemExit) as error:
        raise SimulatorError(simulator, error) from error


@contextmanager
def forgiving(consequence: str) -> Iterator[None]:
    """Go on after the block if a simulator fails in it, and say so, with the consequence."""
    try:
        yield
    except SimulatorError as fault:
        tell_once(fault, consequence)


def tell_once(fault: SimulatorError, consequence: str) -> None:
    """Write a line to standard error, once for each place in which a simulator raises and each consequence."""
    say_once(fault.simulator, f"plp: {fault}; {consequence}", (fault.place, consequence))


def say_once(simulator: object, line: str, about: Hashable = None) -> None:
    """Write a line about a simulator to standard error, unless it, or another about the same, was written before."""
    told: set[Hashable] = vars(simulator).setdefault("told_faults", set())
    if (about or line) not in told:
        told.add(about or line)
        print(line, file=sys.stderr)


def check_observation(simulator: object, found: Observation[np.ndarray], spec: DomainSpec, count: int) -> None:
    """Refuse observations that are not ``count`` of the spec: states ``(n, O)`` float32, images ``(n, H, W, C)`` uint8.

    Raises:
        UserError: Naming the simulator, what it gave and what its spec promises.
    """
    if not isinstance(found, Observation):
        raise UserError(f"{type(simulator).__name__} shows {type(found).__name__}; expected an Observation: mend it")
    _expect(simulator, "state", found.state, (count, spec.state_size), np.float32)
    cameras = {key.name: key.shape for key in spec.image_keys}
    if not isinstance(found.images, Mapping):
        told = f"{type(simulator).__name__} gives images of type {type(found.images).__name__}"
        raise UserError(f"{told}; expected arrays by name: {', '.join(cameras) or 'none'}: mend the simulator")
    if found.images.keys() != cameras.keys():
        given, expected = (", ".join(names) or "none" for names in (found.images, cameras))
        raise UserError(f"{type(simulator).__name__} gives images of {given}; expected {expected}: mend the simulator")
    for camera, shape in cameras.items():
        _expect(simulator, camera, found.images[camera], (count, *shape), np.uint8)


def check_step(simulator: object, found: Step, spec: DomainSpec, count: int) -> Step:
    """Refuse a step that is none of ``count`` episodes, as :func:`check_observation` does.

    Returns:
        The step; episodes whose state ``(n, O)`` is not finite are invalid.
    """
    if not isinstance(found, Step):
        raise UserError(f"{type(simulator).__name__}.step gives {type(found).__name__}; expected a Step: mend it")
    check_observation(simulator, found.observation, spec, count)
    for name in ("success", "invalid") if found.over is None else ("success", "invalid", "over"):
        _expect(simulator, name, getattr(found, name), (count,), np.bool_)
    finite = np.isfinite(found.observation.state)
    return found if finite.all() else found._replace(invalid=found.invalid | ~finite.all(axis=1))


def unseen(spec: DomainSpec, count: int) -> Observation[np.ndarray]:
    """Observations of episodes that could not begin: states ``(E, O)`` that are no numbers, black images."""
    images = {key.name: np.zeros((count, *key.shape), np.uint8) for key in spec.image_keys}
    return Observation(np.full((count, spec.state_size), np.nan, np.float32), images)


def _expect(simulator: object, name: str, found: object, shape: tuple[int, ...], dtype: type[np.generic]) -> None:
    if not isinstance(found, np.ndarray) or found.shape != shape or found.dtype != dtype:
        given = f"shape {found.shape}, type {found.dtype}" if isinstance(found, np.ndarray) else type(found).__name__
        expected = f"shape {shape}, type {np.dtype(dtype)}"
        raise UserError(f"{type(simulator).__name__} gives {name} of {given}; expected {expected}: mend the simulator")
