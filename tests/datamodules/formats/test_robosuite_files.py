"""robomimic's files of robosuite's Stack and Can: read, stepped again by our simulator, and written as they were."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path

import h5py
import numpy as np
import pytest
from command import plp

from datamodules.specs import difference
from datamodules.store.reader import TrajectoryFile
from plp_lightning.envs import Robosuite

OBJECT = {"Stack": 23, "PickPlaceCan": 14}  # numbers that robomimic's files have
STATE = ["robot0_eef_pos", "robot0_eef_quat", "robot0_gripper_qpos", "object"]
SEEDS, STEPS = (3, 8), 4


@cache
def simulator(task: str) -> Robosuite:
    return Robosuite([task], "Panda", state=STATE, threads=1)


def stepped(task: str, actions: np.ndarray) -> np.ndarray:
    """States ``(E, T + 1, O)`` of episodes under actions ``(E, T, 7)``."""
    world, rows = simulator(task), np.arange(len(SEEDS))
    first = world.reset([task] * len(SEEDS), SEEDS)
    seen = [first, *(world.step(actions[:, i], rows).observation for i in range(STEPS))]
    return np.stack([observation.state for observation in seen], axis=1)


def write_robomimic(path: Path, task: str, states: np.ndarray, actions: np.ndarray) -> None:
    """Write a file in the layout of robomimic's own, whose numbers are float64."""
    kwargs = {
        "robots": ["Panda"],
        "control_freq": 20,
        "controller_configs": {"type": "OSC_POSE"},
        "has_renderer": False,
    }
    args = {"env_name": task, "env_version": "1.4.1", "type": 1, "env_kwargs": kwargs}
    spec = simulator(task).spec("panda")
    with h5py.File(path, "w") as file:
        data = file.create_group("data")
        data.attrs.update({"total": actions[..., 0].size, "env_args": json.dumps(args)})
        for i, (state, action) in enumerate(zip(states.astype(float), actions.astype(float), strict=True)):
            demo = data.create_group(f"demo_{i}")
            demo.attrs.update({"num_samples": len(action), "model_file": "<mujoco/>"})
            demo["actions"], demo["states"] = action, np.zeros((len(action), 45))
            demo["rewards"], demo["dones"] = np.zeros(len(action)), np.zeros(len(action), np.int64)
            for key in STATE:
                demo[f"obs/{key}"] = state[:-1, spec.columns([key])]
                demo[f"next_obs/{key}"] = state[1:, spec.columns([key])]
        file["mask/train"] = np.array(["demo_0"], "S")


@pytest.mark.parametrize("task", OBJECT)
def test_their_steps_are_our_simulators_and_go_out_as_they_came(task: str, tmp_path: Path) -> None:
    shape = (len(SEEDS), STEPS, simulator(task).spec("panda").action_size)
    actions = np.random.default_rng(0).uniform(-1, 1, shape).astype(np.float32)
    states = stepped(task, actions)
    theirs, ours, again = (tmp_path / name for name in ("theirs.hdf5", "ours.hdf5", "again.hdf5"))
    write_robomimic(theirs, task, states, actions)
    answer = plp("data", "import", "robomimic", theirs, "--domain", "panda", "--state", *STATE, "--out", ours)
    assert answer.code == 0, answer
    with TrajectoryFile.open(ours) as file:
        spec = file.spec("panda")
        assert not difference(spec.to_dict(), simulator(task).spec("panda").to_dict(), "file", env=False)
        assert (file.tasks, len(spec.columns(["object"]))) == ((task,), OBJECT[task])
        found = [file.trajectory("panda", i) for i in range(len(SEEDS))]
    np.testing.assert_array_equal([one.observation.state for one in found], states)
    np.testing.assert_array_equal(stepped(task, np.stack([one.actions for one in found])), states)
    answer = plp("data", "export", "robomimic", ours, "--domain", "panda", "--out", again)
    assert answer.code == 0, answer
    with h5py.File(theirs) as one, h5py.File(again) as other:
        names = list[str]()
        one.visit(lambda name: names.append(name) if "obs/" in name or name.endswith("actions") else None)
        assert len(names) == len(SEEDS) * (2 * len(STATE) + 1)
        for name in names:
            np.testing.assert_array_equal(other[name][()], one[name][()])
        args = [json.loads(file["data"].attrs["env_args"]) for file in (one, other)]
        assert len({(each["env_name"], each["env_kwargs"]["control_freq"]) for each in args}) == 1
