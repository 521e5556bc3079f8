from __future__ import annotations

import numpy as np
import pytest
import tiny
import torch

from datamodules.batches.dataset import build_dataset

SPEC = tiny.spec("arm", 3, 2)
TABLE = tiny.dataset(SPEC, lengths=[2, 1, 3], tasks=[7, 4, 7])


def test_take_gathers_the_asked_rows() -> None:
    steps = TABLE.take(torch.tensor([5, 0, 2]))
    assert steps.observation.state[:, 0].tolist() == [5, 0, 2]
    assert steps.task.tolist() == [7, 7, 4]
    assert steps.row.tolist() == [5, 0, 2]
    assert torch.equal(steps.action, TABLE.action[[5, 0, 2]])


def test_each_step_has_the_task_of_its_trajectory() -> None:
    assert TABLE.task.tolist() == [7, 7, 4, 7, 7, 7]
    assert len(TABLE) == 6


def test_rows_of_trajectories_lie_end_to_end_in_the_asked_order() -> None:
    assert TABLE.rows_of(np.array([2, 0])).tolist() == [3, 4, 5, 0, 1]
    assert TABLE.rows_of(np.array([], dtype=np.int64)).tolist() == []


def test_trajectories_are_found_by_task() -> None:
    assert TABLE.episodes_of(np.array([7])).tolist() == [0, 2]
    assert TABLE.episodes_of(np.array([4, 7])).tolist() == [0, 1, 2]
    assert TABLE.episodes_of(np.array([1])).tolist() == []


def test_tensors_share_the_memory_of_the_arrays() -> None:
    state, image = np.zeros((4, 3), dtype=np.float32), torch.zeros(4, 2, 2, 3, dtype=torch.uint8)
    arrays = np.zeros((4, 2), np.float32), np.array([0, 4]), np.array([0]), np.array([7]), np.array([-1])
    dataset = build_dataset(SPEC, state, {"camera": image}, *arrays)
    state[1, 2], image[3, 0, 0, 0] = 8, 9
    taken = dataset.take(torch.tensor([1, 3])).observation
    assert taken.state[0, 2] == 8
    assert taken.images["camera"][1, 0, 0, 0] == 9


MIXED = tiny.dataset(SPEC, [4, 1, 3], [0, 0, 1], known=[0, 2])


def test_next_rows_lead_to_the_next_step_or_to_what_was_seen_last_or_nowhere() -> None:
    assert MIXED.next_row.tolist() == [1, 2, 3, 8, -1, 6, 7, 9]
    assert (len(MIXED), len(MIXED.observation), len(MIXED.action)) == (8, 10, 8)
    assert tiny.dataset(SPEC, [2, 1], [0, 0]).next_row.tolist() == [1, -1, -1]


def test_what_is_seen_next_is_told_if_asked_for() -> None:
    rows = torch.tensor([6, 3, 0, 1, 7, 5])
    plain, told = MIXED.take(rows), MIXED.take(rows, next_observation=True)
    assert plain.next_observation is None
    assert told.next_observation is not None
    assert told.next_observation.state[:, 0].tolist() == [7, 8, 1, 2, 9, 6]
    assert torch.equal(told.observation.state, plain.observation.state)
    assert told.row.tolist() == rows.tolist()


def test_steps_of_which_nobody_knows_what_is_seen_next_are_not_taken_for_it() -> None:
    assert MIXED.take(torch.tensor([3, 4])).row.tolist() == [3, 4]
    with pytest.raises(AssertionError, match="what is seen next is known of every step"):
        MIXED.take(torch.tensor([3, 4]), next_observation=True)


def test_progress_is_the_share_that_lies_behind_whether_the_last_observation_is_known_or_not() -> None:
    rows = torch.tensor([6, 3, 0, 4, 1, 7, 5])
    assert MIXED.take(rows).progress is None
    progress = MIXED.take(rows, progress=True).progress
    assert progress is not None
    assert progress.dtype is torch.float32
    torch.testing.assert_close(progress, torch.tensor([1 / 2, 1, 0, 1, 1 / 3, 1, 0]))


def test_each_row_knows_its_trajectory() -> None:
    assert TABLE.episode_of(np.arange(6)).tolist() == [0, 0, 1, 2, 2, 2]
