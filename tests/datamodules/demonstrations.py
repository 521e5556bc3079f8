"""Small domains and demonstrations for the tests of the trajectory format."""

from __future__ import annotations

import numpy as np

from datamodules.types import DomainSpec, Observation, ObservationKey, Trajectory

TASKS = ("reach", "push", "lift")
ARM = DomainSpec("arm", (ObservationKey("pos", (3,), unit="m"), ObservationKey("grip", (1,))), 4, 20.0, "an arm")
CAMERA = DomainSpec(
    "camera", (ObservationKey("image", (4, 5, 3), "image"), ObservationKey("joints", (2,), unit="rad")), 2, 10.0
)
SPECS = (ARM, CAMERA)
WHY = {"command": "plp collect", "seed": 3}


def demonstration(spec: DomainSpec, task: str, seed: int, steps: int = 5, last: bool = False) -> Trajectory:
    """A demonstration whose values are a function of its arguments; with ``last``, what was seen last is known."""
    rng = np.random.default_rng([len(spec.name), TASKS.index(task), seed, steps])
    seen = steps + last
    state = rng.standard_normal((seen, spec.state_size)).astype(np.float32)
    images = {key.name: rng.integers(0, 256, (seen, *key.shape), dtype=np.uint8) for key in spec.image_keys}
    actions = rng.uniform(-1, 1, (steps, spec.action_size)).astype(np.float32)
    return Trajectory(spec.name, task, Observation(state, images), actions, seed, bool(seed % 2))


def demonstrations(seeds: int = 2) -> list[Trajectory]:
    """``seeds`` demonstrations of each task in both domains, of different lengths; every second ends as seen."""
    made = [(spec, task, seed) for spec in (ARM, CAMERA) for task in TASKS for seed in range(seeds)]
    return [demonstration(spec, task, seed, 4 + seed, last=seed % 2 == 1) for spec, task, seed in made]


def assert_equal(one: Trajectory, other: Trajectory) -> None:
    """Both hold the same values of the same types."""
    assert (one.domain, one.task, one.seed, one.success) == (other.domain, other.task, other.seed, other.success)
    assert one.actions.dtype == other.actions.dtype
    np.testing.assert_array_equal(one.actions, other.actions)
    np.testing.assert_array_equal(one.observation.state, other.observation.state)
    assert one.observation.images.keys() == other.observation.images.keys()
    for name, images in one.observation.images.items():
        np.testing.assert_array_equal(images, other.observation.images[name])
