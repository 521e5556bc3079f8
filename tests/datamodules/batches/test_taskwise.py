from __future__ import annotations

from collections import Counter

import numpy as np
import pytest

from datamodules.batches.orders import AlignmentOrder, TaskwiseOrder

ROWS = {"a": np.arange(100, 160), "b": np.arange(30)}
TASKS = {"a": np.repeat([0, 1, 2, 5], [30, 10, 10, 10]), "b": np.repeat([0, 1, 2, 5], [15, 5, 5, 5])}


def order(tasks_per_batch: int = 2, batch_size: int = 12, seed: int = 0) -> TaskwiseOrder:
    return TaskwiseOrder(ROWS, TASKS, tasks_per_batch, batch_size, seed)


def tasks_of(rows: np.ndarray, domain: str) -> list[int]:
    return [int(TASKS[domain][row - ROWS[domain][0]]) for row in rows]


@pytest.mark.parametrize("tasks_per_batch", [1, 2, 3, 4, 9])
def test_domains_meet_in_the_same_tasks(tasks_per_batch: int) -> None:
    for step in order(tasks_per_batch).epoch(3):
        first, second = tasks_of(step["a"], "a"), tasks_of(step["b"], "b")
        assert first == second  # as many samples of each task, too
        assert len(set(first)) == min(tasks_per_batch, 4)
        assert len(first) == 6


def test_an_epoch_is_as_long_as_with_all_tasks_in_a_batch() -> None:
    assert order().steps == AlignmentOrder(ROWS, 12, 0).steps == len(order().epoch(0))


def test_tasks_come_as_often_as_in_the_demonstrations() -> None:
    counts = Counter(t for epoch in range(400) for step in order(1).epoch(epoch) for t in tasks_of(step["a"], "a"))
    shares = {task: count / counts.total() for task, count in counts.items()}
    assert shares == pytest.approx({0: 1 / 2, 1: 1 / 6, 2: 1 / 6, 5: 1 / 6}, abs=0.02)


def test_each_row_of_a_task_comes_once_before_any_comes_again() -> None:
    drawn = np.concatenate([step["b"] for step in order(4, 120).epoch(0)])
    uses = Counter(drawn.tolist())
    for task in (0, 1, 2, 5):
        own = [uses[row] for row in ROWS["b"] if tasks_of(np.array([row]), "b") == [task]]
        assert max(own) - min(own) <= 1


def test_batches_depend_on_seed_and_epoch_alone() -> None:
    def plain(made: TaskwiseOrder, epoch: int) -> list[list[int]]:
        return [[*step["a"], *step["b"]] for step in made.epoch(epoch)]

    made = order(seed=3)
    made.epoch(0)
    assert plain(made, 4) == plain(order(seed=3), 4)
    assert plain(made, 4) != plain(made, 5)
    assert plain(made, 4) != plain(order(seed=4), 4)


def test_a_domain_without_a_task_gives_others_of_its_rows() -> None:
    tasks = TASKS | {"b": np.repeat([0, 1, 2], [15, 5, 10])}
    for step in TaskwiseOrder(ROWS, tasks, 4, 16, 0).epoch(0):
        assert sorted(set(tasks_of(step["a"], "a"))) == [0, 1, 2, 5]
        assert set(step["b"].tolist()) <= set(ROWS["b"].tolist())
        assert len(step["b"]) == 8
