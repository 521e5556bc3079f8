from __future__ import annotations

import pickle

import pytest

from datamodules.errors import ConfigError
from plp_lightning.envs import Lift, LinearPoint, PointMaze, Reach, WalkerMaze, Window
from plp_lightning.envs.lift.tasks import TASKS as LIFT
from plp_lightning.envs.maze.layout import LAYOUTS
from plp_lightning.envs.tasks import Tasks

COLOURS = Tasks("colours", ("red", "green", "blue"))
ROOMS = Tasks(
    "rooms",
    ("a_door", "b_door", "a_bed", "b_bed", "a_desk"),
    targets={"door": ("a_door", "b_door"), "bed": ("a_bed", "b_bed"), "desk": ("a_desk",)},
    is_proxy=lambda task, target: task[2:] != target[2:],
)
FAMILIES = {
    "plain": COLOURS,
    "rooms": ROOMS,
    "lift": LIFT,
    "umaze": LAYOUTS["umaze"].tasks,
    "medium": LAYOUTS["medium"].tasks,
    "reach": Reach.tasks,
    "window": Window.tasks,
    "linear": LinearPoint.tasks,
}


def test_in_a_plain_family_every_task_is_a_target_and_all_others_are_its_proxies() -> None:
    assert COLOURS.of("green") == ("green",)
    assert COLOURS.target_of("green") == "green"
    assert COLOURS.proxies("green") == ("red", "blue")


def test_a_target_may_be_several_tasks() -> None:
    assert ROOMS.of("door") == ("a_door", "b_door")
    assert ROOMS.of("b_bed") == ("b_bed",)
    assert ROOMS.target_of("b_bed") == "bed"
    assert ROOMS.proxies("door") == ROOMS.proxies("b_door") == ("a_bed", "b_bed", "a_desk")


@pytest.mark.parametrize("tasks", FAMILIES.values(), ids=FAMILIES)
def test_no_target_is_its_own_proxy_and_every_task_has_some(tasks: Tasks) -> None:
    for target in [*tasks.names, *tasks.targets]:
        proxies = tasks.proxies(target)
        assert proxies
        assert {*proxies} < {*tasks.names}
        assert not {*proxies} & {*tasks.of(target)}
    for task in tasks.names:
        assert task in tasks.of(tasks.target_of(task))


def test_fewer_targets_are_among_more_with_all_their_tasks() -> None:
    one, two = (ROOMS.proxies("door", goals) for goals in (1, 2))
    assert {*one} < {*two}
    assert {*two} == {*ROOMS.proxies("door")}
    assert one in (ROOMS.of("bed"), ROOMS.of("desk"))
    for wrong in (0, 3):
        with pytest.raises(ConfigError, match=f"--data.proxy_goals is {wrong}; expected 1 to 2, as many as proxies"):
            ROOMS.proxies("door", wrong)


def test_unknown_names_are_answered_with_the_nearest() -> None:
    with pytest.raises(ConfigError, match=r"^no task 'grean' in colours; expected one of: red, .* mean 'green'\?$"):
        COLOURS.check(["red", "grean"])
    with pytest.raises(ConfigError, match=r"^no target 'dor' in rooms; expected one of: door, bed, .* mean 'door'\?$"):
        ROOMS.of("dor")
    with pytest.raises(ConfigError, match="no target 'dor' in rooms"):
        ROOMS.proxies("dor")
    with pytest.raises(ConfigError, match="no task 'door' in rooms"):
        ROOMS.check(["door"])  # a target, but none that an episode can be of
    with pytest.raises(ConfigError, match="no task 'x0y0h9' in R2R-Lift; expected one of the 27 from x0y0h0 to x2y2h2"):
        LIFT.check(["x0y0h9"])


@pytest.mark.parametrize("simulator", [Lift("Sawyer"), PointMaze("medium"), WalkerMaze("umaze"), Reach("front")])
def test_tasks_travel_to_other_processes(simulator: Lift | PointMaze | WalkerMaze | Reach) -> None:
    copy = pickle.loads(pickle.dumps(simulator)).tasks
    target = copy.names[0]
    assert copy.names == simulator.tasks.names
    assert copy.proxies(target) == simulator.tasks.proxies(target)
