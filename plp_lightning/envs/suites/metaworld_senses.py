"""Senses of Meta-World's environments after a step, bit for bit: neither names nor contacts are gone through.

See ``metaworld/sawyer_xyz_env.py``, https://github.com/Farama-Foundation/Metaworld. Its own take longer than physics.
"""

from __future__ import annotations

from typing import Any

import numpy as np

HANDS, ONE, PLACE = 4, 7, 3  # columns of the hand and the gripper, of an object, and of its place alone
OBSERVED = 18  # columns of an observation without the last one and the goal
GRIP = 0.1  # distance of fingers that are open, m


class Senses:
    """Of one environment, whose own it stands in for.

    Args:
        env: The library's environment.
    """

    def __init__(self, env: Any) -> None:
        self.env, self.data = env, env.data
        places = (env.data.xpos[env.data.body(name).id] for name in ("hand", "rightclaw", "leftclaw"))
        self.hand, self.right, self.left = places  # views of what physics writes
        self.pads = tuple(env.data.geom(f"{side}pad_geom").id for side in ("left", "right"))
        env._get_curr_obs_combined_no_goal, env.touching_object = self.observation, self.touching

    def observation(self) -> np.ndarray:
        """Hand, gripper and objects ``(18,)``."""
        seen, apart = np.zeros(OBSERVED), self.right - self.left
        seen[:PLACE], seen[PLACE] = self.hand, min(max(np.sqrt(apart.dot(apart)) / GRIP, 0.0), 1.0)
        places, turns = self.env._get_pos_objects().reshape(-1, 3), self.env._get_quat_objects().reshape(-1, 4)
        objects = seen[HANDS : HANDS + ONE * len(places)].reshape(-1, ONE)
        objects[:, :PLACE], objects[:, PLACE:] = places, turns
        return seen

    def touching(self, thing: int) -> bool:
        """Tell whether both fingers press on the geom of that number."""
        contact, force = self.data.contact, self.data.efc_force
        pairs = contact.geom
        near = (pairs == thing).any(axis=1)
        if not near.any():
            return False
        pressing = (force[contact.efc_address[near & (pairs == pad).any(axis=1)]] for pad in self.pads)
        return all(sum(forces) > 0 for forces in pressing)
