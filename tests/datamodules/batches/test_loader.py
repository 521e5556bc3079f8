from __future__ import annotations

import itertools

import numpy as np
import pytest
import tiny
import torch
from hypothesis import given
from hypothesis import strategies as st

from datamodules.batches.dataset import thin_out
from datamodules.batches.loader import FixedBatches, Loader, PairSource
from datamodules.batches.orders import AlignmentOrder, MixOrder, PairOrder
from datamodules.types import Batch

TABLES = {
    "a": tiny.dataset(tiny.spec("a", 3, 2), [5, 9, 7], [0, 1, 0]),
    "b": tiny.dataset(tiny.spec("b", 4, 1), [6, 4], [0, 1]),
}
ROWS = {name: np.arange(len(table)) for name, table in TABLES.items()}
EPISODES = {name: {t: table.episodes_of(np.array([t])) for t in (0, 1)} for name, table in TABLES.items()}


def alignment_loader() -> Loader:
    pairs = PairSource(TABLES, PairOrder(EPISODES, 3, seed=1), stride=2)
    return Loader(TABLES, AlignmentOrder(ROWS, 8, seed=1), pairs)


def mix_loader() -> Loader:
    return Loader(TABLES, MixOrder({"a": np.arange(9)}, {"b": ROWS["b"]}, 1.5, 4, seed=1))


FIELDS = ("action", "task", "row")


def flat(batch: Batch) -> list[tuple[str, list[float]]]:
    """Everything that a batch holds, as plain numbers."""
    steps = [(f"{d} {name}", getattr(s, name).tolist()) for d, s in batch.steps.items() for name in FIELDS]
    states = [(f"{d} state", s.observation.state.tolist()) for d, s in batch.steps.items()]
    pairs = [(d, [s.observation.state.tolist(), s.frame.tolist(), s.mask.tolist()]) for d, s in batch.pairs.items()]
    return [*steps, *states, *pairs]


def endless(loader: Loader) -> itertools.chain[Batch]:
    return itertools.chain.from_iterable(iter(loader) for _ in itertools.count())


@pytest.mark.parametrize("make", [alignment_loader, mix_loader])
@given(st.integers(0, 30))
def test_a_new_loader_goes_on_with_exactly_the_batches_that_are_left(make: type[Loader], k: int) -> None:
    unbroken = [flat(batch) for batch in itertools.islice(endless(make()), 40)]
    stopped = make()
    for _ in itertools.islice(endless(stopped), k):
        pass
    fresh = make()
    fresh.load_state_dict(stopped.state_dict())
    assert [flat(batch) for batch in itertools.islice(endless(fresh), 40 - k)] == unbroken[k:]


def test_the_cursor_points_behind_the_batch_that_is_being_trained_on() -> None:
    loader = alignment_loader()
    steps = len(loader)
    assert steps == -(-sum(map(len, ROWS.values())) // 8)
    places = [loader.state_dict() for _ in loader]
    assert places == [{"epoch": 0, "step": s} for s in range(1, steps)] + [{"epoch": 1, "step": 0}]


def test_epochs_differ_and_have_the_announced_length() -> None:
    for loader in (alignment_loader(), mix_loader()):
        epochs = [[flat(batch) for batch in loader] for _ in range(3)]
        assert [len(epoch) for epoch in epochs] == [len(loader)] * 3
        assert epochs[0] != epochs[1] != epochs[2]


def test_batches_hold_the_rows_of_the_order() -> None:
    order = AlignmentOrder(ROWS, 8, seed=1)
    for batch, rows in zip(alignment_loader(), order.epoch(0), strict=True):
        for domain, steps in batch.steps.items():
            assert steps.row.tolist() == rows[domain].tolist()
            assert torch.equal(steps.action, TABLES[domain].action[steps.row])
            assert steps.observation.state[:, 0].tolist() == rows[domain].tolist()


def test_pairs_of_a_step_are_those_of_the_order() -> None:
    order = PairOrder(EPISODES, 3, seed=1)
    for step, batch in enumerate(alignment_loader()):
        draw = order.step(0, step)
        assert list(batch.pairs) == list(draw.domains)
        for i, domain in enumerate(draw.domains):
            expected = thin_out(TABLES[domain], draw.episodes[i], draw.phase, 2)
            assert torch.equal(batch.pairs[domain].observation.state, expected.observation.state)
            assert torch.equal(batch.pairs[domain].mask, expected.mask)


def test_without_a_pair_source_there_are_no_pairs() -> None:
    assert all(batch.pairs == {} for batch in mix_loader())


def test_held_out_steps_come_once_in_order_one_domain_at_a_time() -> None:
    batches = FixedBatches(TABLES, {"a": np.arange(5), "b": np.array([8, 2, 4])}, batch_size=2)
    seen = [[(d, s.row.tolist()) for d, s in batch.steps.items()] for batch in batches]
    expected = [[("a", [0, 1])], [("a", [2, 3])], [("a", [4])], [("b", [8, 2])], [("b", [4])]]
    assert seen == expected
    assert len(batches) == 5
    assert [[(d, s.row.tolist()) for d, s in batch.steps.items()] for batch in batches] == expected
