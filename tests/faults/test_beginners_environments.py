"""Environments of Gymnasium as beginners write them: what can't be used is told before anything is trained."""

from __future__ import annotations

import re
from typing import Any, ClassVar

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces

from datamodules.errors import ConfigError
from plp_lightning.envs import Gymnasium


class Walker(gymnasium.Env[Any, Any]):
    """A point on a line, as Gymnasium wants it."""

    metadata: ClassVar[dict[str, Any]] = {"render_modes": [], "render_fps": 10}
    observation_space: Any = spaces.Box(-9, 9, (2,), np.float64)
    action_space: Any = spaces.Box(-1, 1, (1,), np.float32)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        super().reset(seed=seed)
        self.point = np.zeros(2)
        return self.point, {}

    def step(self, action: Any) -> Any:
        self.point = self.point + action
        return self.point, 0.0, False, False, {}


class Old(Walker):
    def reset(self, **words: Any) -> Any:
        return super().reset(**words)[0]


class OldOfNames(Walker):
    observation_space = spaces.Dict({"place": spaces.Box(-9, 9, (2,))})

    def reset(self, **words: Any) -> Any:
        return {"place": super().reset(**words)[0]}


class NoOptions(Walker):
    def reset(self, *, seed: int | None = None) -> Any:  # type: ignore[override]
        return super().reset(seed=seed)


class FourValues(Walker):
    def step(self, action: Any) -> Any:
        return super().step(action)[:4]


class OtherShape(Walker):
    observation_space = spaces.Box(-9, 9, (3,), np.float64)


class OtherNames(Walker):
    observation_space = spaces.Dict({"place": spaces.Box(-9, 9, (2,))})

    def reset(self, **words: Any) -> Any:
        return {"palce": super().reset(**words)[0]}, {}


class OtherShapeLater(Walker):
    def step(self, action: Any) -> Any:
        return np.zeros(3), *super().step(action)[1:]


class NoSuchTask(Walker):
    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        return {"left": super().reset(seed=seed)}[(options or {})["task"]]


class Whole(Walker):
    action_space = spaces.Discrete(4)


class Endless(Walker):
    action_space = spaces.Box(-np.inf, np.inf, (1,), np.float32)


class NoRate(Walker):
    metadata: ClassVar[dict[str, Any]] = {}


KINDS = (Old, OldOfNames, NoOptions, FourValues, OtherShape, OtherNames, OtherShapeLater, NoSuchTask, Whole, Endless)
for kind in (Walker, *KINDS, NoRate):
    gymnasium.register(f"Beginners{kind.__name__}-v0", kind, max_episode_steps=9)


def spec(name: str, **settings: Any) -> Any:
    return Gymnasium(f"Beginners{name}-v0", tasks=["forward"], threads=1, **settings).spec("line")


@pytest.mark.parametrize(
    ("name", "told"),
    [
        (
            "Old",
            r"shows state of shape \(1,\), and its observation_space says \(2,\); expected a reset\(seed=…",
        ),
        ("OldOfNames", r"raised KeyError: 0; expected a reset\(.* that gives an observation and an info"),
        ("NoOptions", r"unexpected keyword argument 'options'; expected a reset\(seed=…, options=…\)"),
        ("FourValues", r"not enough values to unpack \(expected 5, got 4\); expected a step\(action\)"),
        ("OtherShape", r"shows state of shape \(2,\), and its observation_space says \(3,\)"),
        ("OtherNames", r"raised KeyError: 'place'; expected a reset"),
        ("OtherShapeLater", r"shows state of shape \(3,\), and its observation_space says \(2,\); expected a step"),
        ("NoSuchTask", r"raised KeyError: 'forward'; expected a reset"),
        ("Whole", r"actions are Discrete\(4\); expected a box with finite limits: wrap it"),
        ("Endless", r"actions are Box\(-inf, inf, .*; expected a box with finite limits: wrap it"),
        ("NoRate", r"neither dt nor render_fps; expected Gymnasium.control_hz: state it"),
        ("Wlaker", r"can't be made: .*doesn't exist.*; name the package that registers it, as in my_package:Beginners"),
    ],
)
def test_what_is_no_environment_for_us_is_told_when_it_is_first_looked_at(name: str, told: str) -> None:
    with pytest.raises(ConfigError) as caught:
        spec(name)
    assert re.search(told, str(caught.value)), caught.value
    assert "\n" not in str(caught.value)
    assert ".;" not in str(caught.value)


def test_the_way_out_of_endless_actions_is_one() -> None:
    env = gymnasium.wrappers.TransformAction(Endless(), lambda action: action, spaces.Box(-1, 1, (1,), np.float32))
    assert env.action_space == Walker.action_space


def test_what_an_environment_should_is_enough() -> None:
    assert [key.name for key in spec("Walker").observation] == ["observation"]


def test_gymnasiums_own_warnings_stay_with_it() -> None:
    assert spec("NoRate", control_hz=5.0).control_hz == 5.0  # without modes of rendering; warnings are errors here
