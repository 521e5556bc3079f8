"""MuJoCo's models are compiled once a process, and environments are what they are without that."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from plp_lightning.envs.gym import models
from plp_lightning.envs.gym.models import KEPT, compiled_once
from plp_lightning.envs.gym.share import GymFactory, Share

STEPS, SEEDS = 12, (5, 7)
SWING = "<mujoco><worldbody><body><joint name='{name}'/><geom size='{size}'/></body></worldbody></mujoco>"


@pytest.fixture(autouse=True)
def none_are_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(models, "_models", {})


def seen(env: Any, seed: int) -> list[np.ndarray]:
    """All numbers that an episode of random actions shows."""
    rng, found = np.random.default_rng(seed), [env.reset(seed=seed)[0]]
    for _ in range(STEPS):
        action = rng.uniform(env.action_space.low, env.action_space.high).astype(np.float32)
        observation, reward, *_ = env.step(action)
        found += [observation, reward]
    parts = [[*part.values()] if isinstance(part, dict) else [part] for part in found]
    return [np.asarray(value) for part in parts for value in part]


@pytest.mark.parametrize(
    "name", ["Reacher-v5", "HalfCheetah-v5", "gymnasium_robotics:FetchReach-v4", "gymnasium_robotics:AdroitHandDoor-v1"]
)
def test_episodes_are_the_same_with_a_copied_model_and_in_used_environments(name: str) -> None:
    factory = GymFactory(name, {}, {"task": {}}, None, None)
    fresh = [seen(factory.build("task"), seed) for seed in SEEDS]
    with compiled_once():
        factory.build("task")
        copied = factory.build("task")
    for _ in range(2):
        for seed, wanted in zip(SEEDS, fresh, strict=True):
            for ours, theirs in zip(seen(copied, seed), wanted, strict=True):
                np.testing.assert_array_equal(ours, theirs)


def test_a_share_compiles_a_model_once(monkeypatch: pytest.MonkeyPatch) -> None:
    compiled, compiling = [], mujoco.MjModel.from_xml_path
    counted = staticmethod(lambda path: compiled.append(path) or compiling(path))
    monkeypatch.setattr(mujoco.MjModel, "from_xml_path", counted)
    Share(GymFactory("Reacher-v5", {}, {"a": {}, "b": {}}, None, None)).reset(["a", "b", "a"], [0, 1, 2])
    assert len(compiled) == 1


def test_what_an_environment_does_to_its_model_is_its_own() -> None:
    with compiled_once():
        one, other = (GymFactory("Reacher-v5", {}, {"t": {}}, None, None).build("t").unwrapped for _ in range(2))
    one.model.opt.timestep = 9.0
    assert other.model.opt.timestep < 1.0
    assert one.model is not other.model


def test_a_file_that_has_changed_is_compiled_again(tmp_path: Path) -> None:
    file = tmp_path / "swing.xml"
    with compiled_once():
        for name, size in (("a", 0.5), ("b", 0.25)):
            file.write_text(SWING.format(name=name, size=size))
            model = mujoco.MjModel.from_xml_path(str(file))
            assert model.joint(0).name == name
            assert model.geom_size[0, 0] == size


def test_after_the_block_files_are_compiled_as_ever() -> None:
    compiling = mujoco.MjModel.from_xml_path
    with pytest.raises(KeyError), compiled_once():
        raise KeyError(mujoco.MjModel.from_xml_path is not compiling)
    assert mujoco.MjModel.from_xml_path is compiling


def test_few_models_are_kept(tmp_path: Path) -> None:
    with compiled_once():
        for i in range(KEPT + 3):
            (tmp_path / f"{i}.xml").write_text(SWING.format(name=f"joint_{i}", size=1))
            mujoco.MjModel.from_xml_path(str(tmp_path / f"{i}.xml"))
    assert len(models._models) == KEPT


def test_a_file_with_assets_beside_it_is_compiled_as_ever(tmp_path: Path) -> None:
    (tmp_path / "swing.xml").write_text(SWING.format(name="a", size=1))
    with compiled_once():
        for _ in range(2):
            mujoco.MjModel.from_xml_path(str(tmp_path / "swing.xml"), {"a.txt": b"a"})
        with pytest.raises(ValueError, match="nowhere"):
            mujoco.MjModel.from_xml_path(str(tmp_path / "nowhere.xml"))
    assert not models._models
