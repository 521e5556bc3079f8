from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from datamodules.batches.orders import AlignmentOrder, MixOrder, PairOrder, TaskwiseOrder, shuffled
from datamodules.streams import Stream, generator

ROWS = {"small": np.arange(100, 110), "large": np.arange(35)}
TARGET = {"source": np.arange(1000, 1021)}
POOL = {"source": np.arange(0, 60), "other": np.arange(0, 40)}


def drawn(epoch: Sequence[dict[str, np.ndarray]], domain: str) -> list[int]:
    return [int(row) for step in epoch for row in step.get(domain, [])]


def equal(one: Sequence[dict[str, np.ndarray]], other: Sequence[dict[str, np.ndarray]]) -> bool:
    plain = [[{d: r.tolist() for d, r in step.items()} for step in order] for order in (one, other)]
    return plain[0] == plain[1]


def mix_order(ratio: float = 2.0, batch_size: int = 16, seed: int = 0) -> MixOrder:
    return MixOrder(TARGET, POOL, ratio, batch_size, seed)


def test_generators_depend_on_all_of_their_key() -> None:
    def first(stream: Stream, *key: int) -> int:
        return int(generator(stream, *key).integers(2**62))

    rows, tasks = Stream.ALIGNMENT_ROWS, Stream.BATCH_TASKS
    keys = [(rows, 0, 0, 0), (rows, 0, 0, 1), (rows, 0, 1, 0), (rows, 1, 0, 0), (tasks, 0, 0), (Stream.MIX, 0, 0)]
    assert len({first(*key) for key in keys}) == len(keys)
    assert first(rows, 1, 2, 3) == first(rows, 1, 2, 3)


@given(st.integers(1, 30), st.integers(0, 100), st.integers(0, 5))
def test_each_row_comes_once_before_any_comes_again(size: int, count: int, seed: int) -> None:
    rows = np.arange(size) * 3
    chosen = shuffled(rows, count, generator(Stream.MIX, seed, 0))
    assert len(chosen) == count
    for start in range(0, count, size):
        part = chosen[start : start + size]
        assert len(set(part.tolist())) == len(part)
        assert set(part.tolist()) <= set(rows.tolist())


@pytest.mark.parametrize("batch_size", [2, 8, 9, 70, 1000])
def test_domains_have_equal_shares_and_an_epoch_is_all_of_their_samples(batch_size: int) -> None:
    order = AlignmentOrder(ROWS, batch_size, seed=0)
    epoch = order.epoch(0)
    assert len(epoch) == order.steps == -(-(35 + 10) // (batch_size // 2 * 2))
    assert all(len(step[domain]) == batch_size // 2 for step in epoch for domain in ROWS)
    for domain, rows in ROWS.items():
        uses = Counter(drawn(epoch, domain))
        assert set(uses) <= set(rows.tolist())
        assert max(uses.values()) - min(uses.get(row, 0) for row in rows.tolist()) <= 1


def test_alignment_order_is_a_pure_function_of_seed_and_epoch() -> None:
    one, again = AlignmentOrder(ROWS, 8, seed=3), AlignmentOrder(ROWS, 8, seed=3)
    later = one.epoch(4)
    one.epoch(0)
    assert equal(later, again.epoch(4))
    assert equal(later, one.epoch(4))
    assert not equal(later, one.epoch(5))
    assert not equal(later, AlignmentOrder(ROWS, 8, seed=4).epoch(4))


def test_domains_of_the_same_size_are_not_drawn_in_lockstep() -> None:
    epoch = AlignmentOrder({"a": np.arange(50), "b": np.arange(50)}, 100, seed=0).epoch(0)
    assert drawn(epoch, "a") != drawn(epoch, "b")


@pytest.mark.parametrize(("ratio", "mixed"), [(0.0, 0), (1.0, 21), (2.0, 42), (0.5, 10), (6.0, 126)])
def test_an_epoch_mixes_so_many_alignment_steps_to_each_target_step(ratio: float, mixed: int) -> None:
    order = mix_order(ratio)
    epoch = order.epoch(0)
    source, other = drawn(epoch, "source"), drawn(epoch, "other")
    target = [row for row in source if row >= 1000]
    assert sorted(target) == list(range(1000, 1021))
    assert len(source) - len(target) + len(other) == mixed
    assert len(epoch) == order.steps == -(-(21 + mixed) // 16)


def test_all_batches_of_the_mix_but_the_last_are_full() -> None:
    sizes = [sum(len(rows) for rows in step.values()) for step in mix_order().epoch(0)]
    assert sizes == [16, 16, 16, 15]


def test_the_mix_is_drawn_anew_each_epoch_from_both_domains() -> None:
    order = mix_order()
    mixes = [{*drawn(epoch, "other")} for epoch in map(order.epoch, range(4))]
    assert len({tuple(sorted(mix)) for mix in mixes}) == 4
    assert all(mixes)
    assert {row for mix in mixes for row in mix} <= set(range(40))


def test_alignment_rows_are_mixed_in_once_before_any_again() -> None:
    epoch = mix_order(ratio=6.0).epoch(0)  # 126 of 100 rows
    uses = Counter([("source", r) for r in drawn(epoch, "source") if r < 1000])
    uses.update(("other", r) for r in drawn(epoch, "other"))
    assert sorted(Counter(uses.values()).items()) == [(1, 74), (2, 26)]


def test_target_steps_are_spread_over_the_epoch() -> None:
    parts = [sum(int((rows >= 1000).sum()) for rows in step.values()) for step in mix_order().epoch(0)]
    assert all(parts)


def test_mix_order_is_a_pure_function_of_seed_and_epoch() -> None:
    one = mix_order(seed=3)
    later = one.epoch(4)
    one.epoch(0)
    assert equal(later, mix_order(seed=3).epoch(4))
    assert not equal(later, one.epoch(5))
    assert not equal(later, mix_order(seed=4).epoch(4))


def test_without_alignment_data_only_the_target_is_drawn() -> None:
    order = MixOrder(TARGET, {}, 2.0, 16, 0)
    assert sorted(drawn(order.epoch(0), "source")) == list(range(1000, 1021))
    assert order.steps == 2


EPISODES = {
    "a": {0: np.array([0, 1]), 1: np.array([2, 3, 4]), 2: np.array([5])},
    "b": {0: np.array([7]), 1: np.array([8, 9]), 3: np.array([10])},
    "c": {1: np.array([11]), 0: np.array([12])},
}


def test_pairs_show_the_same_task_in_two_domains() -> None:
    order = PairOrder(EPISODES, 200, seed=0)
    for step in range(6):
        draw = order.step(0, step)
        task_of = [{int(e): t for t, ids in EPISODES[d].items() for e in ids} for d in draw.domains]
        tasks = [[task_of[i][int(e)] for e in draw.episodes[i]] for i in range(2)]
        assert tasks[0] == tasks[1]
        assert set(tasks[0]) == {0, 1}
        assert draw.phase.shape == (200,)
        assert ((draw.phase >= 0) & (draw.phase < 1)).all()


def test_every_trajectory_of_a_common_task_gets_its_turn() -> None:
    draw = PairOrder(EPISODES, 200, seed=0).step(0, 0)
    assert set(draw.episodes[0].tolist()) == {0, 1, 2, 3, 4}
    assert set(draw.episodes[1].tolist()) == {7, 8, 9}


def test_pairs_of_domains_take_turns() -> None:
    order = PairOrder(EPISODES, 2, seed=0)
    assert [order.step(0, s).domains for s in range(4)] == [("a", "b"), ("a", "c"), ("b", "c"), ("a", "b")]


def test_tasks_are_drawn_uniformly_however_many_demonstrations_they_have() -> None:
    episodes = {d: {0: np.arange(1), 1: np.arange(1, 100)} for d in ("a", "b")}
    draw = PairOrder(episodes, 4000, seed=0).step(0, 0)
    assert (draw.episodes[0] == 0).mean() == pytest.approx(0.5, abs=0.04)


def test_pairs_are_a_pure_function_of_seed_epoch_and_step() -> None:
    def drawn_pairs(seed: int, epoch: int, step: int) -> list[list[int]]:
        pairs: list[list[int]] = PairOrder(EPISODES, 50, seed).step(epoch, step).episodes.tolist()
        return pairs

    assert drawn_pairs(1, 2, 3) == drawn_pairs(1, 2, 3)
    assert len({str(drawn_pairs(*key)) for key in [(1, 2, 3), (0, 2, 3), (1, 1, 3), (1, 2, 6)]}) == 4


def test_an_epoch_of_little_data_has_the_least_steps() -> None:
    order = AlignmentOrder(ROWS, 10, seed=0, least_steps=20)
    assert len(order.epoch(0)) == order.steps == 20
    assert all(len(step[domain]) == 5 for step in order.epoch(0) for domain in ROWS)
    uses = Counter(drawn(order.epoch(0), "small"))
    assert set(uses.values()) == {10}  # 100 draws of 10 rows, each once before any comes again
    assert equal(AlignmentOrder(ROWS, 10, seed=0, least_steps=3).epoch(1), AlignmentOrder(ROWS, 10, seed=0).epoch(1))


@pytest.mark.parametrize(("least", "times"), [(1, 1), (8, 3), (50, 13)])
def test_the_target_task_comes_as_often_as_the_least_steps_take(least: int, times: int) -> None:
    order = MixOrder(TARGET, POOL, 2.0, 16, 0, least)
    epoch = order.epoch(0)
    assert len(epoch) == order.steps >= least
    uses = Counter(row for row in drawn(epoch, "source") if row >= 1000)
    assert uses == dict.fromkeys(range(1000, 1021), times)
    assert sum(len(rows) for step in epoch for rows in step.values()) == 3 * 21 * times
    if times == 1:
        assert equal(epoch, mix_order().epoch(0))


def test_half_of_the_tasks_are_in_a_batch() -> None:
    rows = {"small": np.arange(100, 110), "large": np.arange(50)}
    tasks = {"small": np.arange(10) % 5, "large": np.arange(50) % 5}
    for step in TaskwiseOrder(rows, tasks, "half", 12, seed=0).epoch(0):
        seen = [{int(tasks[domain][row - rows[domain][0]]) for row in step[domain]} for domain in rows]
        assert seen[0] == seen[1]
        assert len(seen[0]) == 3
