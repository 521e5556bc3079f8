from __future__ import annotations

from itertools import product

from hypothesis import given
from hypothesis import strategies as st

from datamodules.streams import MOST_EPISODES, episode_seed


@given(st.integers(0, 2**31), st.integers(0, MOST_EPISODES - 2))
def test_seeds_rise_with_the_index(seed: int, index: int) -> None:
    one, following = (episode_seed("collect", seed, "arm", "reach", i) for i in (index, index + 1))
    assert following == one + 1
    assert 0 <= one < 2**63


def test_every_use_has_seeds_of_its_own() -> None:
    uses = list(product(("collect", "evaluate"), (0, 1), ("arm", "leg"), ("reach", "push")))
    seeds = [episode_seed(*use, index) for use in uses for index in range(50)]
    assert len(set(seeds)) == len(uses) * 50


def test_seeds_are_the_same_in_every_process_and_release() -> None:
    # Trajectory files and results refer to them.
    assert episode_seed("collect", 0, "flat", "goal_0", 3) == 40721742896824323
