"""Environments of Gymnasium as simulators: the same episodes in any company, and one line for what can't be."""

from __future__ import annotations

import json
import multiprocessing
import pickle
from pathlib import Path
from typing import Any

import gym_worlds
import numpy as np
import pytest
import yaml
from command import ROOT, SMOKE, complaint, plp

from datamodules.errors import UserError
from datamodules.types import Observation
from plp_lightning.envs import Gymnasium
from plp_lightning.envs.faults import SimulatorError, blaming
from plp_lightning.envs.rollout import Episodes, Observer, rollout
from plp_lightning.recording import Recorder

TASKS: dict[str, Any] = {goal: {"reset": {"goal": goal}} for goal in gym_worlds.GOALS}
NAMES = [*TASKS, "east", "north", "east"]
SEEDS = [3, 1, 4, 1, 5, 9, 3]


def plate(threads: int = 1, **settings: Any) -> Gymnasium:
    words = {"env": "gym_worlds:Plate-v0", "tasks": TASKS, "keys": ["place"], "threads": threads, **settings}
    return Gymnasium(**words)


class Kept(Observer):
    """All states of a rollout, by episode."""

    def begin(self, tasks: Any, seeds: Any, observation: Observation[np.ndarray]) -> None:
        self.seen = [[state] for state in observation.state]

    def step(self, actions: np.ndarray, step: Any, episodes: np.ndarray) -> None:
        for episode, state in zip(episodes, step.observation.state, strict=True):
            self.seen[episode].append(state)


def straight(observation: Observation[np.ndarray], running: np.ndarray, names: list[str]) -> np.ndarray:
    """Actions in [-1, 1] that lead to goals: the plate's own run from -0.4 to 0.2."""
    angles = np.array([gym_worlds.GOALS[names[i]] for i in running])
    way = np.stack([np.cos(angles), np.sin(angles)], axis=1) - observation.state[:, :2]
    wanted = 0.15 * way / np.maximum(np.linalg.norm(way, axis=1, keepdims=True), 0.15)
    actions: np.ndarray = (wanted + 0.1) / 0.3
    return actions


def play(simulator: Gymnasium, names: list[str], seeds: list[int]) -> tuple[Episodes, list[Any]]:
    kept = Kept()
    found = rollout(simulator, lambda seen, running: straight(seen, running, names), names, seeds, observers=[kept])
    return found, [np.array(states) for states in kept.seen]


def test_an_episode_is_the_same_alone_and_in_any_company() -> None:
    together, seen = play(plate(threads=2), NAMES, SEEDS)
    assert together.success.all()
    one = plate()
    for i, (name, seed) in enumerate(zip(NAMES, SEEDS, strict=True)):
        alone, states = play(one, [name], [seed])  # in an environment that was used before
        np.testing.assert_array_equal(states[0], seen[i])
        assert alone.steps[0] == together.steps[i]
    assert not np.array_equal(seen[0], seen[4])
    np.testing.assert_array_equal(seen[0], seen[6])


def test_the_domain_is_described_as_the_environment_says() -> None:
    spec = plate(keys=None, make={"camera": True}).spec("plate")
    assert [(key.name, key.shape, key.kind) for key in spec.observation] == [
        ("clock", (1,), "state"),
        ("eye", (8, 8, 3), "image"),
        ("place", (2,), "state"),
    ]
    assert (spec.action_size, spec.control_hz) == (2, 10.0)
    np.testing.assert_allclose(spec.action_limits, [[-0.4, -0.4], [0.2, 0.2]])
    assert [key.name for key in plate(keys=["clock", "place"]).spec("plate").observation] == ["clock", "place"]
    assert plate(control_hz=4.0).spec("plate").control_hz == 4.0


def test_images_come_beside_states_in_the_order_of_episodes() -> None:
    simulator = plate(threads=2, keys=["eye", "place"], make={"camera": True})
    first = simulator.reset(["east"] * 5, [0] * 5)
    assert first.images["eye"].shape == (5, 8, 8, 3)
    for clock, episodes in enumerate(([0, 1, 2, 3, 4], [1, 3, 4], [4, 3]), 1):
        step = simulator.step(np.full((len(episodes), 2), 1 / 3), np.array(episodes))
        assert (step.observation.images["eye"] == clock).all()


def test_an_episode_that_the_environment_ends_has_failed_and_is_stepped_no_more() -> None:
    found = rollout(plate(), lambda seen, running: np.full((len(running), 2), -1.0), ["east", "north"], [0, 1])
    assert not found.success.any()
    assert not found.invalid.any()
    assert (found.steps < 5).all()


@pytest.mark.parametrize(
    ("success", "solved"), [("is_success", True), (1.0, True), (1.5, False), ("terminated", False)]
)
def test_success_is_what_the_settings_say(success: str | float, solved: bool) -> None:
    found, _ = play(plate(success=success), ["east"], [0])
    assert found.success.tolist() == [solved]


def test_tasks_may_differ_in_the_constructor() -> None:
    tasks = {f"turn_{turn}": {"make": {"turn": turn}, "reset": {"goal": "north"}} for turn in (0.0, 1.0)}
    states = plate(tasks=tasks).reset([*tasks], [5, 5]).state
    turned = gym_worlds.Plate(1.0).turned
    np.testing.assert_allclose(states[0] @ turned.T, states[1], atol=1e-6)


def test_actions_that_are_no_numbers_make_an_episode_invalid() -> None:
    simulator = plate()
    first = simulator.reset(["east", "east"], [0, 0])
    step = simulator.step(np.array([[np.nan, 0], [0, 0]]), np.arange(2))
    assert step.invalid.tolist() == [True, False]
    np.testing.assert_array_equal(step.observation.state[0], first.state[0])


def test_pictures_are_the_environments() -> None:
    simulator = plate(threads=2)
    simulator.reset(["east"] * 3, [1, 2, 3])
    pictures = simulator.render(np.array([2, 0]), (99, 99))
    assert pictures.shape == (2, 20, 20, 3)
    assert not np.array_equal(pictures[0], pictures[1])


def test_before_its_first_reset_it_can_be_sent_to_other_processes() -> None:
    again = pickle.loads(pickle.dumps(plate()))
    np.testing.assert_array_equal(again.reset(["east"], [0]).state, plate().reset(["east"], [0]).state)


@pytest.mark.parametrize("threads", [1, 2])
def test_what_an_environment_raises_is_the_simulators_fault(threads: int) -> None:
    simulator = plate(threads, make={"breaks_at": 3})
    with pytest.raises(SimulatorError, match=r"FloatingPointError.*the plate is broken"):
        play(simulator, ["east"] * 2, [0, 1])


def test_a_process_that_dies_is_the_simulators_fault() -> None:
    simulator = plate(2)
    simulator.reset(["east"] * 2, [0, 1])
    for process in multiprocessing.active_children():
        process.kill()
    with pytest.raises(SimulatorError, match="a process that steps environments has died"), blaming(simulator):
        simulator.step(np.zeros((2, 2)), np.arange(2))


def test_its_processes_end_with_it() -> None:
    before = {*multiprocessing.active_children()}
    simulator = plate(3)  # this process has a share, too
    simulator.reset(["east"] * 3, [0, 1, 2])
    begun = {*multiprocessing.active_children()} - before
    assert len(begun) == 2
    del simulator
    for process in begun:
        process.join(20)
        assert process.exitcode == 0


@pytest.mark.parametrize(
    ("settings", "told"),
    [
        ({"env": "Plat-v0"}, "environment 'Plat-v0' can't be made"),
        ({"env": "gym_worlds:Plate-v7"}, "environment 'gym_worlds:Plate-v7' can't be made"),
        ({"env": "no_such_package:Plate-v0"}, "No module named 'no_such_package'"),
        ({"make": {"colour": "red"}}, "unexpected keyword argument 'colour'"),
        ({"keys": ["speed"]}, "Gymnasium.keys names 'speed'; the environment shows: clock, place"),
        ({"keys": []}, "expected boxes of numbers"),
        ({"env": "gym_worlds:Elsewhere", "keys": None}, "expected a box with finite limits"),
        ({"env": "InvertedDoublePendulum-v5", "control_hz": None, "keys": None, "success": "won"}, "info has"),
        ({"tasks": {}}, "Gymnasium.tasks is empty"),
        ({"tasks": {"east": {"options": {}}}}, "task 'east' is set up by 'options'; expected make or reset"),
    ],
)
def test_what_cannot_be_is_told_in_a_line(settings: dict[str, Any], told: str) -> None:
    with pytest.raises(UserError) as caught:
        first_steps(settings)
    assert told in str(caught.value)
    assert "\n" not in str(caught.value)


def first_steps(settings: dict[str, Any]) -> None:
    simulator = plate(**settings)
    size, tasks = simulator.spec("plate").action_size, simulator.tasks.names[:1]
    rollout(simulator, lambda seen, running: np.zeros((len(running), size)), tasks, [0])


def test_a_configuration_imports_no_package_that_is_not_allowed(tmp_path: Path) -> None:
    page = tmp_path / "page.yaml"
    setup = "class_path: Gymnasium, init_args: {env: 'gym_worlds:Plate-v0', tasks: {east: {}, west: {}}}"
    page.write_text(f"domains: {{flat: &plate {{simulator: {{{setup}}}}}, tall: *plate}}\n")
    told = complaint("fit", *SMOKE, "--config", page, "--data.target_task", "east")
    assert "the simulator of domain 'flat' imports gym_worlds" in told
    assert "--allow_imports gym_worlds" in told


def test_tasks_by_name_alone_are_an_option_of_the_reset() -> None:
    assert plate(tasks=["east", "west"]).factory.tasks == {
        "east": {"reset": {"task": "east"}},
        "west": {"reset": {"task": "west"}},
    }


SETUP = {
    "env": "gym_worlds:Plate-v0",
    "threads": 1,
    "tasks": {goal: {"reset": {"goal": goal, "task": goal}} for goal in gym_worlds.GOALS},
}
TURNS = {"flat": 0.0, "turned": 2.0}


def record(env: Recorder, name: str, seed: int) -> None:
    """A demonstration of a goal, to its end."""
    env.reset(seed=seed, options={"goal": name, "task": name})
    plate, over = env.unwrapped, False
    assert isinstance(plate, gym_worlds.Plate)
    while not over:
        way = plate.goal * 1.3 - plate.point
        action = (0.15 * way / max(float(np.linalg.norm(way)), 0.15)) @ plate.turned.T
        over = any(env.step(action.astype(np.float32))[2:4])


def recorded(folder: Path) -> Path:
    """Demonstrations of both plates, recorded and imported."""
    file = folder / "plates.hdf5"
    for domain, turn in TURNS.items():
        env = Recorder(gym_worlds.Plate(turn), folder / domain)
        for i, name in enumerate([*TASKS] * 2):
            record(env, name, i)
        assert plp("data", "import", "gymnasium", folder / domain, "--domain", domain, "--out", file).code == 0
    return file


def test_two_environments_are_trained_on_and_filmed_by_a_page_alone(tmp_path: Path) -> None:
    worlds = {
        name: {"simulator": {"class_path": "Gymnasium", "init_args": {**SETUP, "make": {"turn": turn}}}}
        for name, turn in TURNS.items()
    }
    data = {"file": str(recorded(tmp_path)), "source_domain": "flat", "target_domain": "turned", "target_task": "north"}
    (tmp_path / "plates.yaml").write_text(yaml.safe_dump({"domains": worlds, "data": data}))
    little = ["--config", ROOT / "tests" / "conf" / "tiny.yaml", "--run_root", tmp_path, "--data.trajectories", "null"]
    few = ["--data.target_trajectories", "null", "--evaluation.final_episodes", "4", "--allow_imports", "gym_worlds"]
    answer = plp("fit", "--config", tmp_path / "plates.yaml", *little, *few)
    assert answer.code == 0, answer
    run = tmp_path / "plates" / "plp" / "north" / "seed_0"
    assert json.loads((run / "results.json").read_text())["target"]["episodes"] == 4
    filmed = plp("rollout", run, "--allow_imports", "gym_worlds", "--episodes", "1", "--among", "2")
    assert filmed.code == 0, filmed
    assert len(list((run / "rollouts").glob("*.mp4"))) == 1
