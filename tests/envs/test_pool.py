"""Shares of episodes in several processes: the same bits in any number, and nothing left of a failure or of a kill."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import gym_worlds
import gymnasium
import numpy as np
import pytest
from counting import Counting
from gymnasium.wrappers import ClipAction, TimeLimit
from processes import gone, soon

from datamodules.errors import UserError
from plp_lightning.envs import Gymnasium
from plp_lightning.envs.gym.share import _bare
from plp_lightning.envs.pool import Pool
from plp_lightning.envs.rollout import rollout

TESTS = Path(__file__).parents[1]


def one(action: float, count: int) -> np.ndarray:
    return np.full((count, 1), action)


@pytest.mark.parametrize("count", [1, 2, 3])
def test_rows_are_in_the_order_of_the_episodes_that_are_asked_for(count: int) -> None:
    pool, episodes = Pool(Counting(), count), np.array([6, 1, 4])
    assert pool.reset(["t"] * 7, range(7)).state[:, 0].tolist() == [*range(7)]
    for actions in ([1, 2, 3], [0, 1, 6]):
        step = pool.step(np.array(actions, np.float32)[:, None], episodes)
    assert step.observation.state.tolist() == [[6, 1], [1, 3], [4, 9]]
    assert step.success.tolist() == [False, True, True]
    assert step.over is not None
    assert step.over.tolist() == [False, False, True]
    assert pool.rows("seeds", episodes, 2)[:, 0].tolist() == [12, 2, 8]


def test_images_of_any_names_come_where_there_is_no_state() -> None:
    pool = Pool(Counting(camera=True), 2)
    pool.reset(["t"] * 3, range(3))
    shown = pool.step(np.array([[4.0], [5.0]]), np.array([2, 1])).observation
    assert shown.state.shape == (2, 0)
    assert {name: (image.dtype, image.shape) for name, image in shown.images.items()} == dict.fromkeys(
        ("left eye", "state"), (np.uint8, (2, 2, 3, 1))
    )
    assert shown.images["state"][:, 0, 0, 0].tolist() == [5, 6]


def test_fewer_or_more_episodes_begin_in_the_same_processes() -> None:
    pool = Pool(Counting(), 2)
    for count in (5, 1, 40):
        pool.reset(["t"] * count, range(count))
        for total in (1, 2):
            step = pool.step(one(1, count), np.arange(count))
            assert step.observation.state[:, 1].tolist() == [total] * count


@pytest.mark.parametrize("failing", [[0, 1], [1, 0], [1, 2], [0, 1, 2, 3]])
def test_after_a_failure_no_answer_is_left_that_the_next_question_would_get(failing: list[int]) -> None:
    pool = Pool(Counting(), 3)
    pool.reset(["t"] * 4, range(4))
    actions = one(1, 4)
    actions[failing] = 7
    with pytest.raises(ZeroDivisionError if 0 in failing else RuntimeError, match="seven"):
        pool.step(actions, np.arange(4))
    assert pool.reset(["t"] * 4, range(4)).state.shape == (4, 2)
    assert pool.step(one(2, 4), np.arange(4)).observation.state[:, 1].tolist() == [2] * 4


@pytest.mark.parametrize("episode", [0, 1])
def test_what_is_of_another_shape_than_at_the_reset_is_refused_in_a_line(episode: int) -> None:
    pool = Pool(Counting(), 2)
    pool.reset(["t"] * 2, range(2))
    with pytest.raises(UserError, match=r"^an environment shows a state of shape \(1,\), .*expected shape \(2,\)"):
        pool.step(one(8, 1), np.array([episode]))


@pytest.mark.parametrize("threads", [2, 3])
def test_episodes_are_the_same_bits_in_any_number_of_processes(threads: int) -> None:
    def states(count: int) -> np.ndarray:
        simulator, rng = Gymnasium("Reacher-v5", {"t": {}}, threads=count), np.random.default_rng(0)
        found = [simulator.reset(["t"] * 5, range(5)).state]
        return np.array([*found, *(simulator.step(rng.normal(size=(5, 2)), np.arange(5))[0].state for _ in range(9))])

    np.testing.assert_array_equal(states(threads), states(1))


def test_a_limit_of_time_ends_an_episode_as_gymnasium_would() -> None:
    tasks = {"east": {"reset": {"goal": "east"}}}
    simulator = Gymnasium("gym_worlds:Plate-v0", tasks, threads=1, keys=["place"], horizon=100)
    found = rollout(simulator, lambda seen, running: np.full((len(running), 2), 1 / 3), ["east"] * 2, [0, 1])
    assert found.steps.tolist() == [30, 30]


def test_only_gymnasiums_own_limit_and_check_are_left_out() -> None:
    plain = gymnasium.make("Plate-v0", disable_env_checker=True)
    assert _bare(plain) == (plain.unwrapped.step, 30)
    assert _bare(TimeLimit(plain, 7)) == (plain.unwrapped.step, 7)
    unlimited = gymnasium.make("Plate-v0", disable_env_checker=True, max_episode_steps=-1)
    assert _bare(unlimited) == (unlimited.unwrapped.step, np.inf)
    wrapped = ClipAction(plain)
    assert _bare(wrapped) == (wrapped.step, np.inf)
    assert _bare(TimeLimit(wrapped, 40)) == (wrapped.step, 40)
    unnamed = TimeLimit(gym_worlds.Plate(), 7)
    assert _bare(unnamed) == (unnamed.step, np.inf)


ALONE = """
import multiprocessing, os
import numpy as np
from counting import Counting
from plp_lightning.envs.pool import Pool

if __name__ == "__main__":
    pool = Pool(Counting(), 3)
    pool.reset(["t"] * 4, range(4))
    pool.step(np.ones((4, 1)), np.arange(4))
    print(*(child.pid for child in multiprocessing.active_children()), flush=True)
    os.read(0, 1)
"""


def named_memory() -> set[str]:
    return {*os.listdir("/dev/shm")} if os.path.isdir("/dev/shm") else set()


def test_a_killed_process_leaves_neither_processes_nor_memory(tmp_path: Path) -> None:
    script, before = tmp_path / "alone.py", named_memory()
    script.write_text(ALONE)
    environment = os.environ | {"PYTHONPATH": f"{TESTS.parent}{os.pathsep}{TESTS}", "TMPDIR": str(tmp_path)}
    command, pipe = [sys.executable, str(script)], subprocess.PIPE
    with subprocess.Popen(command, env=environment, text=True, stdin=pipe, stdout=pipe) as parent:
        assert parent.stdout is not None
        others = [*map(int, parent.stdout.readline().split())]
        parent.send_signal(signal.SIGKILL)
    assert len(others) == 2
    assert soon(lambda: all(map(gone, others)))
    assert named_memory() <= before
    assert [*tmp_path.iterdir()] == [script]
