"""Bounds that simulators, experts and scores state in their constructors hold in Python too, and survive copies."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Callable
from typing import Any

import pytest

from datamodules.errors import ConfigError
from datamodules.settings import Configured
from plp_lightning.envs import Lift, LinearPoint, LinearPointExpert, PointMaze, Reach, WalkerMaze
from plp_lightning.envs.experts import WalkerExpert, WaypointExpert
from plp_lightning.envs.synthetic import SeenPoint
from plp_lightning.evaluation.scores import ClosenessScore, PairAccuracy

WHOLE, NUMBER = "expected a whole number, at least {}", "expected a number{}"


@pytest.mark.parametrize(
    ("build", "arguments", "told"),
    [
        (LinearPoint, {"map_seed": 1, "state_size": 0}, f"LinearPoint.state_size is 0; {WHOLE.format(1)}"),
        (SeenPoint, {"map_seed": 1, "image_size": 2.5}, f"SeenPoint.image_size is 2.5; {WHOLE.format(1)}"),
        (PointMaze, {"layout": "umaze", "radius": -1.0}, f"PointMaze.radius is -1.0; {NUMBER.format(', at least 0')}"),
        (PointMaze, {"layout": "umaze", "horizon": 0}, f"PointMaze.horizon is 0; {WHOLE.format(1)}"),
        (WalkerMaze, {"layout": "umaze", "threads": -1}, f"WalkerMaze.threads is -1; {WHOLE.format(0)}"),
        (
            WalkerMaze,
            {"layout": "umaze", "jitter": -0.1},
            f"WalkerMaze.jitter is -0.1; {NUMBER.format(', at least 0')}",
        ),
        (WaypointExpert, {"width": 0.0}, f"WaypointExpert.width is 0.0; {NUMBER.format(' above 0')}"),
        (WalkerExpert, {"width": -1.0}, f"WalkerExpert.width is -1.0; {NUMBER.format(' above 0')}"),
        (LinearPointExpert, {"gain": -2.0}, f"LinearPointExpert.gain is -2.0; {NUMBER.format(', at least 0')}"),
        (ClosenessScore, {"samples": 0}, f"ClosenessScore.samples is 0; {WHOLE.format(1)}"),
        (PairAccuracy, {"samples": -3}, f"PairAccuracy.samples is -3; {WHOLE.format(1)}"),
    ],
)
def test_arguments_outside_of_their_bounds_are_named(
    build: Callable[..., Any], arguments: dict[str, Any], told: str
) -> None:
    with pytest.raises(ConfigError) as error:
        build(**arguments)
    assert str(error.value) == f"{told}; change it"


@pytest.mark.parametrize("twin", [copy.copy, copy.deepcopy, lambda made: pickle.loads(pickle.dumps(made))])
@pytest.mark.parametrize(
    "made",
    [
        Lift("UR5e", joint_noise=0.1),
        LinearPoint(3, state_size=5),
        PointMaze("medium", mirror=True),
        WalkerMaze("umaze", legs=6),
        Reach("rear", image_size=32),
        WaypointExpert(damping=0.5),
        ClosenessScore(guide=LinearPointExpert(gain=3.0)),
    ],
    ids=lambda made: type(made).__name__,
)
def test_copies_and_unpickled_objects_remember_their_arguments(
    made: Configured, twin: Callable[[Configured], Configured]
) -> None:
    found = twin(made)
    assert type(found) is type(made)
    assert found.arguments.keys() == made.arguments.keys()
    plain = {name: value for name, value in made.arguments.items() if not isinstance(value, Configured)}
    assert {name: found.arguments[name] for name in plain} == plain


def test_a_copy_of_a_simulator_steps_as_the_original_does() -> None:
    maze = PointMaze("umaze", horizon=7, threads=1)
    twin = pickle.loads(pickle.dumps(maze))
    (task, *_), seeds = maze.tasks.names, [4]
    first, again = maze.reset([task], seeds), twin.reset([task], seeds)
    assert (first.state == again.state).all()
    assert twin.horizon == 7
