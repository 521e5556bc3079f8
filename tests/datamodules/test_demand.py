"""What phases may ask the DataModule for."""

from __future__ import annotations

from pathlib import Path

import tiny

from datamodules.types import BatchSpec


def test_all_steps_are_proxies_everywhere_and_the_target_in_the_source_domain(trajectory_file: Path) -> None:
    data = tiny.data_module(trajectory_file)
    seen: dict[str, set[int]] = {}
    for batch in data.loader(BatchSpec("all")):
        for domain, steps in batch.steps.items():
            seen.setdefault(domain, set()).update(steps.row.tolist())
    tasks = {"flat": [*tiny.PROXIES, tiny.TARGET], "tall": [*tiny.PROXIES]}
    for domain, names in tasks.items():
        rows = set(data.rows(names, "train")[domain].tolist())
        assert seen[domain] <= rows
        assert data.tasks.index(tiny.TARGET) in data.datasets[domain].task[list(seen[domain])] or domain == "tall"


def test_whole_pairs_alone_are_full_trajectories_with_their_actions(trajectory_file: Path) -> None:
    data = tiny.data_module(trajectory_file)
    loader = data.loader(BatchSpec("none", pairs="whole"))
    assert len(loader) == -(-len(data.episodes("tall", tiny.PROXIES, "train")) // data.batching.pairs)
    for batch in loader:
        assert batch.steps == {}
        assert list(batch.pairs) == ["flat", "tall"]
        for domain, sequences in batch.pairs.items():
            dataset = data.datasets[domain]
            known = {
                tuple(dataset.action[rows].flatten().tolist())
                for rows in map(slice, dataset.offset, dataset.offset[1:])
            }
            for frame, mask in zip(sequences.frame, sequences.mask, strict=True):
                assert tuple(sequences.action[frame[mask]].flatten().tolist()) in known


def test_steps_hold_what_is_seen_next_and_their_progress_only_if_asked(trajectory_file: Path) -> None:
    data = tiny.data_module(trajectory_file)
    for asked in ({}, {"next_observation": True}, {"progress": True}, {"next_observation": True, "progress": True}):
        for batch in data.loader(BatchSpec("mix", **asked)):
            for steps in batch.steps.values():
                held = {name for name in ("next_observation", "progress") if getattr(steps, name) is not None}
                assert held == set(asked)
