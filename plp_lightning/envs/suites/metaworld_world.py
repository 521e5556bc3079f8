"""Meta-World's environments as worlds: its reset, its observation, its check and its scripted policies.

Importing this module imports Meta-World.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from metaworld.env_dict import ALL_V3_ENVIRONMENTS
from metaworld.policies import ENV_POLICY_MAP
from metaworld.utils import reward_utils

from plp_lightning.envs.suites.metaworld_senses import Senses
from plp_lightning.envs.suites.share import WorldFactory
from plp_lightning.envs.suites.variant import Variant
from plp_lightning.envs.suites.world import World

NAMES = tuple(ALL_V3_ENVIRONMENTS)
QUATERNIONS = {*range(7, 11), *range(14, 18), *range(25, 29), *range(32, 36)}
"""Columns of the library's observation that hold objects' orientations."""
FORWARD = 1.0, 0.0, 1.0, 0.0  # orientation of the point that the hand follows, as a quaternion


@dataclass(frozen=True)
class MetaWorldFactory(WorldFactory):
    """Worlds of Meta-World that show these columns of its observation ``(39,)``."""

    columns: tuple[int, ...]

    def build(self, name: str) -> World:
        return MetaWorldWorld(name, self.columns)


class MetaWorldWorld(World):
    """An environment of Meta-World, whose observations show the goal.

    Args:
        name: The library's.
        columns: Columns of the library's observation ``(39,)`` that are seen.
    """

    def __init__(self, name: str, columns: tuple[int, ...]) -> None:
        env: Any = ALL_V3_ENVIRONMENTS[name]()
        env._set_task_called = env.seeded_rand_vec = True
        env._freeze_rand_vec = env._partially_observable = False
        vars(env).pop("sawyer_observation_space", None)  # is made anew, with a goal
        env._gripper_caging_reward = lambda *args, **kwargs: 0.0
        policies: dict[str, Any] = {**ENV_POLICY_MAP}
        if not QUATERNIONS & {*columns}:
            unseen = np.zeros_like(env._get_quat_objects())  # decide nothing but rewards, and take as long as physics
            env._get_quat_objects = lambda: unseen
        self.env, self.columns, self.policy = env, [*columns], policies[name]()
        space = env.sawyer_observation_space
        self.low, self.high, self.places = space.low, space.high, env._random_reset_space
        Senses(env)
        super().__init__(env.model, env.data, (env,))

    def begin(self, variant: Variant, stream: np.random.Generator) -> None:
        env, low, high = self.env, self.places.low.copy(), self.places.high.copy()
        for axis in range(2):
            low[axis], high[axis] = variant.narrow(axis, low[axis], high[axis])
        env._random_reset_space, env.np_random = type(self.places)(low, high, dtype=np.float64), stream
        mujoco.mj_resetData(env.model, env.data)
        env.reset_model()
        # Meta-World leaves out this call, and shows where things stood before.
        mujoco.mj_forward(env.model, env.data)
        env._prev_obs = env._get_curr_obs_combined_no_goal()
        self._look()

    def act(self, action: np.ndarray) -> None:
        env, data = self.env, self.data
        # The library's set_xyz_action, for actions in [-1, 1].
        aim = data.mocap_pos[0] + action[:3] * env.action_scale
        data.mocap_pos[0], data.mocap_quat[0] = np.minimum(np.maximum(aim, env.mocap_low), env.mocap_high), FORWARD
        data.ctrl[:] = action[3], -action[3]
        mujoco.mj_step(self.model, data, nstep=env.frame_skip)
        mujoco.mj_forward(self.model, data)
        env.curr_path_length += 1
        env.last_action = action
        self._look()

    def observe(self) -> np.ndarray:
        seen: np.ndarray = self.env._last_stable_obs[self.columns]
        return seen

    def solved(self) -> bool:
        env = self.env
        with _without_rewards:
            return bool(env.evaluate_state(env._last_stable_obs, env.last_action)[1]["success"])

    def scene(self) -> mujoco.MjSpec:
        return mujoco.MjSpec.from_file(self.env.fullpath)

    def demonstrate(self) -> np.ndarray:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # that actions are clipped
            wanted = self.policy.get_action(self.env._last_stable_obs.copy())  # which it writes to
        clipped: np.ndarray = np.clip(wanted, -1.0, 1.0)
        return clipped.astype(np.float32)

    def _look(self) -> None:
        self.env._last_stable_obs = np.minimum(np.maximum(self.env._get_obs(), self.low), self.high)


class _WithoutRewards:
    """Leaves out, within a block, what only rewards are made of: success does not depend on it."""

    def __enter__(self) -> None:
        self.kept = reward_utils.tolerance, reward_utils.hamacher_product
        reward_utils.tolerance = reward_utils.hamacher_product = _nothing

    def __exit__(self, *_: object) -> None:
        reward_utils.tolerance, reward_utils.hamacher_product = self.kept


def _nothing(*arguments: Any, **named: Any) -> Any:
    return 0.0


_without_rewards = _WithoutRewards()
