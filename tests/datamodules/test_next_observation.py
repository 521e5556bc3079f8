"""What is seen next: which steps the DataModule gives to phases that need it, and how it counts for the fingerprint."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
import pytest
import tiny
import torch

from datamodules.batches.dataset import DomainDataset, check_values
from datamodules.errors import TrajectoryFileError
from datamodules.store.writer import write_trajectories
from datamodules.transfer import TransferDataModule
from datamodules.types import BatchSpec, Trajectory


def write(path: Path, trajectories: list[Trajectory]) -> None:
    specs = [domain.simulator.spec(name) for name, domain in tiny.domains().items()]
    write_trajectories(path, specs, tiny.TASKS, trajectories, {})


def cut(path: Path, every: int) -> TransferDataModule:
    """Demonstrations of which one of ``every`` ends without a last observation."""
    made = tiny.demonstrations(4)
    ends = [len(t) + (i % every > 0) for i, t in enumerate(made)]
    write(path, [replace(t, observation=t.observation.take(slice(n))) for t, n in zip(made, ends, strict=True)])
    return tiny.data_module(path)


@pytest.mark.parametrize("steps", ["proxy_tasks", "all", "mix"])
@pytest.mark.parametrize("every", [1, 2])
def test_where_nothing_is_known_of_what_is_seen_next_steps_are_left_out_if_a_phase_needs_it(
    tmp_path: Path, steps: Literal["proxy_tasks", "all", "mix"], every: int
) -> None:
    data = cut(tmp_path / "cut.hdf5", every)
    tasks = {"proxy_tasks": [tiny.PROXIES], "all": [tiny.TASKS], "mix": [tiny.PROXIES, (tiny.TARGET,)]}[steps]
    for needed in (False, True):
        drawn: dict[str, set[int]] = {}
        loader = data.loader(BatchSpec(steps, next_observation=needed))
        for _ in range(4):
            for batch in loader:
                for domain, found in batch.steps.items():
                    drawn.setdefault(domain, set()).update(found.row.tolist())
        for domain, dataset in data.datasets.items():
            rows = {row for names in tasks for row in data.rows(names, "train").get(domain, np.array([])).tolist()}
            ends = {row for row in rows if dataset.next_row[row] < 0}
            assert 0 < len(ends) < len(dataset.offset)
            assert ends <= {stop - 1 for stop in dataset.offset.tolist()}
            assert drawn[domain] <= rows
            assert bool(drawn[domain] & ends) == (not needed)
            assert not needed or steps == "mix" or drawn[domain] == rows - ends  # a mix draws few


def test_held_out_steps_are_left_out_likewise(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    data = cut(tmp_path / "cut.hdf5", 2)
    for needed in (False, True):
        monkeypatch.setattr(data, "_phase_spec", lambda needed=needed: BatchSpec(next_observation=needed))
        found = {
            d: [r for b in data.val_dataloader() if d in b.steps for r in b.steps[d].row.tolist()] for d in data.domains
        }
        for domain, dataset in data.datasets.items():
            rows = data.rows(tiny.PROXIES, "val")[domain].tolist()
            kept = [row for row in rows if dataset.next_row[row] >= 0]
            assert len(kept) < len(rows)
            assert found[domain] == (kept if needed else rows)


def test_known_last_observations_change_no_draw_of_steps(trajectory_file: Path, tmp_path: Path) -> None:
    known, unknown = tiny.data_module(trajectory_file), cut(tmp_path / "cut.hdf5", 1)
    for batch_spec in (BatchSpec(), BatchSpec(pairs="thinned"), BatchSpec("mix")):
        for one, other in zip(known.loader(batch_spec), unknown.loader(batch_spec), strict=True):
            assert all(torch.equal(one.steps[d].row, other.steps[d].row) for d in one.steps)
            assert all(torch.equal(s.observation.state, other.steps[d].observation.state) for d, s in one.steps.items())
    for one, other in zip(
        known.loader(BatchSpec("mix")), known.loader(BatchSpec("mix", next_observation=True)), strict=True
    ):
        assert all(torch.equal(one.steps[d].row, other.steps[d].row) for d in one.steps)


def test_the_fingerprint_tells_apart_which_demonstrations_end_as_seen(tmp_path: Path) -> None:
    """The same values in the same rows, but the one last observation that is known ends another demonstration."""
    (one, *others) = [t for t in tiny.demonstrations(4) if (t.domain, t.task) == ("flat", tiny.TARGET)]
    rest = [t for t in tiny.demonstrations(4) if (t.domain, t.task) != ("flat", tiny.TARGET)]
    still = replace(one, observation=one.observation.take(slice(len(one))), seed=one.seed - 2)
    ended = replace(one, seed=one.seed - 1)
    prints = set()
    for pair in ([still, ended], [replace(ended, seed=ended.seed - 1), replace(still, seed=still.seed + 1)]):
        write(tmp_path / f"{len(prints)}.hdf5", [*pair, *others, *rest])
        prints.add(tiny.data_module(tmp_path / f"{len(prints)}.hdf5", target_trajectories=2).fingerprint)
    assert len(prints) == 2


def test_of_every_step_that_experts_showed_it_is_known_what_was_seen_next(trajectory_file: Path) -> None:
    data = tiny.data_module(trajectory_file)
    for dataset in data.datasets.values():
        assert torch.equal(dataset.next_row.sort().values, torch.arange(len(dataset.observation))[~firsts(dataset)])
    for tasks in (tiny.PROXIES, (tiny.TARGET,)):
        everything, known = (data.rows(tasks, "train", needed) for needed in (False, True))
        assert all(np.array_equal(rows, known[domain]) for domain, rows in everything.items())


def firsts(dataset: DomainDataset) -> torch.Tensor:
    """Which observations follow no action."""
    return torch.isin(torch.arange(len(dataset.observation)), torch.from_numpy(dataset.offset[:-1]))


def test_a_last_observation_that_is_not_finite_is_refused(trajectory_file: Path) -> None:
    dataset = tiny.data_module(trajectory_file).datasets["tall"]
    check_values(trajectory_file, "tall", dataset)
    dataset.observation.state[dataset.next_row.max(), 2] = torch.nan
    with pytest.raises(TrajectoryFileError, match="in domain 'tall' observations hold values that are not finite"):
        check_values(trajectory_file, "tall", dataset)
