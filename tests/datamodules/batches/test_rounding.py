"""Batches that are filled up to numbers of rows that come again."""

from __future__ import annotations

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from datamodules.batches.rounding import SHAPES, rows_to_fill, with_rows_that_recur
from datamodules.types import Observation, PackedTrajectories


def sequences(lengths: list[int], value: float = 0.0) -> PackedTrajectories:
    mask = torch.arange(max(lengths)) < torch.tensor(lengths)[:, None]
    frame = torch.where(mask, mask.flatten().cumsum(0).view_as(mask) - 1, 0)
    state = value + torch.arange(float(sum(lengths)))[:, None]
    images = {"camera": torch.zeros(len(state), 2, 2, 3, dtype=torch.uint8)}
    return PackedTrajectories(Observation(state, images), frame, mask, -state)


@given(st.integers(1, 10**6), st.none() | st.integers(1, 10**4))
def test_few_rows_are_filled_up(rows: int, most: int | None) -> None:
    found = rows_to_fill(rows, most)
    assert 1 <= found <= max(1, rows / SHAPES)
    assert most is None or found <= most


@pytest.mark.parametrize("power", [5, 10, 12])
def test_few_numbers_of_rows_come_about(power: int) -> None:
    assert len({rows + rows_to_fill(rows) for rows in range(2**power, 2 ** (power + 1))}) == SHAPES


@given(st.lists(st.integers(1, 40), min_size=2, max_size=5), st.lists(st.integers(1, 40), min_size=2, max_size=5))
def test_what_was_there_stays_and_one_trajectory_more_is_behind_it(one: list[int], other: list[int]) -> None:
    before = [sequences(lengths) for lengths in (one, other)]
    with torch.autocast("cpu", torch.bfloat16):
        after = with_rows_that_recur(*before)
    for old, new in zip(before, after, strict=True):
        rows, count = len(old.action), len(old.mask)
        if any(len({*lengths}) == 1 for lengths in (one, other)):  # as if they had been filled up
            assert new is old
            continue
        assert torch.equal(new.frame[:count], old.frame)
        assert torch.equal(new.mask[:count], old.mask)
        assert torch.equal(new.action[:rows], old.action)
        assert torch.equal(new.observation.state[:rows], old.observation.state)
        assert len(new.mask) == count + 1
        assert new.frame[new.mask].tolist() == list(range(len(new.action)))
        assert len(new.observation.images["camera"]) == len(new.action) == rows + rows_to_fill(rows, old.mask.shape[1])


def test_on_a_gpu_and_in_single_precision_nothing_is_filled_up() -> None:
    here = sequences([3, 2])
    meta = here._replace(mask=here.mask.to("meta"), frame=here.frame.to("meta"))
    assert with_rows_that_recur(here)[0] is here
    with torch.autocast("cpu", torch.bfloat16):
        assert with_rows_that_recur(meta)[0] is meta
        assert with_rows_that_recur(here)[0] is not here
