"""Held-out pairs: every trajectory of the target domain once, whole, beside one of its task."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import tiny
import torch

from datamodules.batches.loader import FixedPairs
from datamodules.transfer import TransferDataModule
from datamodules.types import Batch, PackedTrajectories

FLAT = tiny.dataset(tiny.spec("flat", 2, 1), [3, 2, 4], [0, 0, 1])
TALL = tiny.dataset(tiny.spec("tall", 3, 2), [2, 5, 1, 3], [0, 0, 0, 1])
TABLES = {"flat": FLAT, "tall": TALL}


def first_columns(sequences: PackedTrajectories) -> list[list[float]]:
    """First state column of each sequence: the rows that its frames come from."""
    rows = sequences.observation.state[:, 0][sequences.frame]
    return [row[mask].tolist() for row, mask in zip(rows, sequences.mask, strict=True)]


def test_pairs_by_hand() -> None:
    episodes = {
        "flat": {0: np.array([0, 1]), 1: np.array([2])},
        "tall": {0: np.array([0, 1, 2]), 1: np.array([3])},
    }
    batches = list(FixedPairs(TABLES, episodes, 3))
    assert [batch.steps for batch in batches] == [{}, {}]
    assert first_columns(batches[0].pairs["tall"]) == [[0, 1], [2, 3, 4, 5, 6], [7]]
    assert first_columns(batches[0].pairs["flat"]) == [[0, 1, 2], [3, 4], [0, 1, 2]]
    assert first_columns(batches[1].pairs["tall"]) == [[8, 9, 10]]
    assert first_columns(batches[1].pairs["flat"]) == [[5, 6, 7, 8]]


def test_tasks_that_the_first_domain_lacks_are_left_out() -> None:
    pairs = FixedPairs(TABLES, {"flat": {0: np.array([0])}, "tall": {0: np.array([1]), 1: np.array([3])}}, 3)
    assert [first_columns(batch.pairs["tall"]) for batch in pairs] == [[[2, 3, 4, 5, 6]]]
    assert len(pairs) == 1
    none = FixedPairs(TABLES, {"flat": {0: np.array([0])}, "tall": {1: np.array([3])}}, 3)
    assert (len(none), list(none)) == (0, [])


def held_out_pairs(data: TransferDataModule) -> list[Batch]:
    return list(data._held_out_pairs(data.datasets))


def known(data: TransferDataModule, domain: str, sequences: PackedTrajectories) -> list[int]:
    """Which trajectories the sequences are."""
    dataset = data.datasets[domain]
    actions = [dataset.action[a:b] for a, b in zip(dataset.offset, dataset.offset[1:], strict=False)]
    found = [sequences.action[frame[mask]] for frame, mask in zip(sequences.frame, sequences.mask, strict=True)]
    return [next(i for i, a in enumerate(actions) if torch.equal(a, one)) for one in found]


def test_validation_knows_every_held_out_trajectory_even_where_domains_hold_out_other_tasks(
    trajectory_file: Path,
) -> None:
    data = tiny.data_module(trajectory_file, val_fraction=0.08)
    held_out = {d: data.episodes(d, tiny.PROXIES, "val").tolist() for d in data.domains}
    task = {d: data.datasets[d].episode_task for d in data.domains}
    batches = held_out_pairs(data)
    tall = [e for batch in batches for e in known(data, "tall", batch.pairs["tall"])]
    flat = [e for batch in batches for e in known(data, "flat", batch.pairs["flat"])]
    assert sorted(tall) == held_out["tall"]
    assert task["tall"][tall].tolist() == task["flat"][flat].tolist()
    shared = set(task["flat"][held_out["flat"]])
    assert all((e in held_out["flat"]) == (task["flat"][e] in shared) for e in flat)
