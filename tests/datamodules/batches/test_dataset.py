from __future__ import annotations

import numpy as np
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
    arrays = np.zeros((4, 2), np.float32), np.array([0, 4]), np.array([0]), np.array([7])
    dataset = build_dataset(SPEC, state, image, *arrays)
    state[1, 2], image[3, 0, 0, 0] = 8, 9
    taken = dataset.take(torch.tensor([1, 3])).observation
    assert taken.image is not None
    assert taken.state[0, 2] == 8
    assert taken.image[1, 0, 0, 0] == 9


def test_course_tells_what_follows_and_how_far_a_step_is() -> None:
    dataset = tiny.dataset(tiny.spec("flat", 3, 2), [4, 1, 3], [0, 0, 1])
    rows = torch.tensor([6, 3, 0, 4, 1, 7, 5])
    plain, told = dataset.take(rows), dataset.take(rows, course=True)
    assert plain.course is None
    course = told.course
    assert course is not None
    assert course.following.state[:, 0].tolist() == [7, 3, 1, 4, 2, 7, 6]
    assert course.last.tolist() == [False, True, False, True, False, True, False]
    torch.testing.assert_close(course.progress, torch.tensor([1 / 2, 1, 0, 1, 1 / 3, 1, 0]))


def test_each_row_knows_its_trajectory() -> None:
    assert TABLE.episode_of(np.arange(6)).tolist() == [0, 0, 1, 2, 2, 2]
