"""PackedTrajectories end to end: nothing is lost, nothing is mixed."""

from __future__ import annotations

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from plp_lightning.methods.contextual.frames import Packing, group


def packing(lengths: list[int], order: torch.Tensor | None = None) -> Packing:
    """Frames end to end, or in the given order."""
    mask = torch.arange(max(lengths)) < torch.tensor(lengths)[:, None]
    frame = torch.where(mask, mask.flatten().cumsum(0).view_as(mask) - 1, 0)
    return Packing(frame if order is None else order[frame], mask, sum(lengths))


def test_padding_by_hand() -> None:
    x = torch.tensor([[1.0], [2.0], [3.0]])
    assert packing([1, 2]).pad(x).squeeze(-1).tolist() == [[1, 0], [2, 3]]
    assert packing([1, 2]).time.tolist() == [0, 0, 1]


def test_frames_may_lie_in_any_order() -> None:
    # Sequence 0 is frame 2, sequence 1 is frames 0 and 1.
    shuffled = packing([1, 2], torch.tensor([2, 0, 1]))
    assert shuffled.pad(torch.tensor([[10.0], [11.0], [12.0]])).squeeze(-1).tolist() == [[12, 0], [10, 11]]
    assert shuffled.time.tolist() == [0, 1, 0]


@given(st.lists(st.integers(1, 5), min_size=1, max_size=5))
def test_packing_undoes_padding_and_gradients_reach_every_frame_once(lengths: list[int]) -> None:
    x = torch.randn(sum(lengths), 3, requires_grad=True)
    packed = packing(lengths)
    back = packed.pack(packed.pad(x))
    assert torch.equal(back, x)
    back.sum().backward()
    assert x.grad is not None
    assert torch.equal(x.grad, torch.ones_like(x))


def test_frames_may_lie_in_any_order_where_no_place_is_empty() -> None:
    assert packing([1, 1], torch.tensor([1, 0])).pad(torch.tensor([[10.0], [11.0]])).squeeze(-1).tolist() == [
        [11],
        [10],
    ]


def test_places_that_were_filled_up_keep_their_frames() -> None:
    packed = Packing(torch.arange(4).view(2, 2), torch.tensor([[True, False], [True, True]]), 4)
    x = torch.arange(4.0)[:, None]
    assert torch.equal(packed.pack(packed.pad(x)), x)
    assert packed.lengths is None


@pytest.mark.parametrize(("order", "known"), [(None, [1, 2]), (torch.tensor([2, 0, 1]), None)])
def test_lengths_are_known_where_frames_lie_end_to_end(order: torch.Tensor | None, known: list[int] | None) -> None:
    assert packing([1, 2], order).lengths == known
    assert packing([2, 2]).lengths is None  # they may as well have been filled up


@given(st.lists(st.integers(0, 3), min_size=1, max_size=9))
def test_frames_are_grouped_by_number(which: list[int]) -> None:
    numbers = torch.tensor(which)
    packed = group(numbers, 4)
    assert packed.mask.sum(dim=1).tolist() == [which.count(number) for number in range(4)]
    shown = packed.pad(numbers[:, None].float())
    assert all((shown[number][packed.mask[number]] == number).all() for number in range(4))
    assert torch.equal(packed.pack(shown).flatten(), numbers.float())
