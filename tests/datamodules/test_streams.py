from __future__ import annotations

import ast
from itertools import product
from pathlib import Path
from zlib import crc32

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from datamodules.streams import (
    MOST_EPISODES,
    EpisodeStream,
    Stream,
    episode_generator,
    episode_seed,
    generator,
    start_generator,
)

ROOT = Path(__file__).parents[2]
NUMBERS = st.integers(0, 4) | st.integers(0, 2**32 - 1)
SEEDS_OF_THEIR_OWN = {"plp_lightning/envs/synthetic.py", "plp_lightning/envs/experts/plane.py"}
"""Maps of synthetic domains and the training of a gait: they belong to no run and no episode."""


@st.composite
def keys(draw: st.DrawFn) -> tuple[Stream, tuple[int, ...]]:
    stream = draw(st.sampled_from(Stream))
    return stream, tuple(draw(NUMBERS) for _ in stream.parts)


def first(rng: np.random.Generator) -> list[int]:
    found: list[int] = rng.integers(2**63, size=2).tolist()
    return found


@given(keys(), keys())
def test_no_two_keys_of_any_streams_give_the_same_numbers(
    one: tuple[Stream, tuple], other: tuple[Stream, tuple]
) -> None:
    assert (first(generator(one[0], *one[1])) == first(generator(other[0], *other[1]))) == (one == other)


def test_streams_have_numbers_of_their_own_and_keys_that_numpy_does_not_pad_into_each_other() -> None:
    assert len({stream.value[0] for stream in Stream}) == len(Stream)
    # What it is all for: numpy takes these two for the same key.
    assert first(np.random.default_rng([1, 5, 2])) == first(np.random.default_rng([1, 5, 2, 0]))
    assert first(generator(Stream.BATCH_TASKS, 5, 2)) != first(generator(Stream.ALIGNMENT_ROWS, 5, 2, 0))


@pytest.mark.parametrize("key", [(), (1,), (1, 2), (1, 2, 3, 4)])
def test_a_key_of_another_length_is_refused(key: tuple[int, ...]) -> None:
    with pytest.raises(AssertionError, match="ALIGNMENT_ROWS is keyed by"):
        generator(Stream.ALIGNMENT_ROWS, *key)


@pytest.mark.parametrize("part", [-1, 2**32])
def test_a_number_that_numpy_would_cut_in_two_is_refused(part: int) -> None:
    with pytest.raises(AssertionError, match="32 bits"):
        generator(Stream.MIX, 0, part)


def test_streams_give_the_numbers_that_kept_runs_were_made_with() -> None:
    kept = {
        (0, 40): generator(Stream.VAL_SPLIT, 40),
        (1, 5, 2, 1): generator(Stream.ALIGNMENT_ROWS, 5, 2, 1),
        (2, 5, 2, 7): generator(Stream.PAIRS, 5, 2, 7),
        (3, 5, 2): generator(Stream.MIX, 5, 2),
        (7, 1): generator(Stream.SCORED_STATES, 1),
        (11,): generator(Stream.PROXY_GOALS),
    }
    for key, rng in kept.items():
        assert first(rng) == first(np.random.default_rng(np.random.SeedSequence(key)))


@pytest.mark.parametrize("seed", [0, 7, 2**32 + 5, 40721742896824323])
def test_episodes_have_the_numbers_that_kept_demonstrations_were_made_with(seed: int) -> None:
    assert first(start_generator(seed)) == first(np.random.default_rng(seed))
    for name in ("Sawyer x0y0h0", "reach front"):
        assert first(start_generator(seed, name)) == first(np.random.default_rng([seed, crc32(name.encode())]))
    for number, stream in ((1, EpisodeStream.ACTION_NOISE), (2, EpisodeStream.RANDOM_START)):
        assert first(episode_generator(seed, stream)) == first(np.random.default_rng([seed, number]))


def test_no_two_purposes_of_an_episode_give_the_same_numbers() -> None:
    names = ["", *(f"{robot} x{x}y{y}h{h}" for robot in ("Sawyer", "UR5e") for x, y, h in product(range(3), repeat=3))]
    names += [f"V2V-{kind} {view}" for kind, view in product(("Reach", "Open"), ("rear", "front", "left", "right"))]
    seed = episode_seed("collect", 0, "flat", "goal_0", 3)
    made = [start_generator(seed, name) for name in names] + [episode_generator(seed, s) for s in EpisodeStream]
    assert len({tuple(first(rng)) for rng in made}) == len(made)


def test_no_random_numbers_are_drawn_from_elsewhere() -> None:
    found = set()
    for path in [*(ROOT / "datamodules").rglob("*.py"), *(ROOT / "plp_lightning").rglob("*.py")]:
        names = {node.attr for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.Attribute)}
        if names & {"default_rng", "SeedSequence", "RandomState"}:
            found.add(str(path.relative_to(ROOT)))
    assert found - SEEDS_OF_THEIR_OWN == {"datamodules/streams.py"}


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
