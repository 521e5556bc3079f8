from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import tiny
import torch

from datamodules.errors import MissingTrajectoriesError
from datamodules.store.writer import TrajectoryFile, write_trajectories
from datamodules.transfer import TransferDataModule
from datamodules.types import Batch, BatchSpec, Observation, Trajectory
from plp_lightning.envs.synthetic import LinearPoint

TARGET_ID = tiny.TASKS.index(tiny.TARGET)
DEMANDS = {"proxy_tasks": BatchSpec(), "pairs": BatchSpec(pairs="thinned"), "mix": BatchSpec("mix")}


def write(path: Path, trajectories: list[Trajectory]) -> None:
    specs = [domain.simulator.spec(name) for name, domain in tiny.domains().items()]
    write_trajectories(path, specs, tiny.TASKS, trajectories, {})


def states_of_target_in_target_domain() -> np.ndarray:
    made = [t for t in tiny.demonstrations(4) if (t.domain, t.task) == ("tall", tiny.TARGET)]
    return np.concatenate([t.observation.state for t in made])


def batches(data: TransferDataModule) -> list[Batch]:
    return [b for batch_spec in DEMANDS.values() for _ in range(2) for b in data.loader(batch_spec)]


# -- the target task in the target domain ------------------------------------------------------------


def test_the_file_does_hold_the_target_in_the_target_domain(trajectory_file: Path) -> None:
    with TrajectoryFile.open(trajectory_file) as file:
        assert file.counts()["tall"][tiny.TARGET] == 4


def test_tables_never_hold_the_target_in_the_target_domain(trajectory_file: Path) -> None:
    data = tiny.data_module(trajectory_file, trajectories=1000)
    secret = {tuple(state) for state in states_of_target_in_target_domain().tolist()}
    assert TARGET_ID not in data.datasets["tall"].task
    assert TARGET_ID not in data.datasets["tall"].episode_task
    assert not secret & {tuple(state) for state in data.datasets["tall"].observation.state.tolist()}
    assert (data.datasets["flat"].episode_task == TARGET_ID).sum() == 4


def test_no_batch_holds_the_target_in_the_target_domain(trajectory_file: Path) -> None:
    data = tiny.data_module(trajectory_file)
    secret = {tuple(state) for state in states_of_target_in_target_domain().tolist()}
    for batch in batches(data):
        parts = [part["tall"] for part in (batch.steps, batch.pairs) if "tall" in part]
        assert not secret & {tuple(row) for part in parts for row in part.observation.state.tolist()}
    held_out = [batch.steps["tall"] for batch in data.val_dataloader() if "tall" in batch.steps]
    assert held_out
    assert all(TARGET_ID not in steps.task for steps in held_out)


def test_alignment_batches_and_statistics_hold_no_target_at_all(trajectory_file: Path) -> None:
    data = tiny.data_module(trajectory_file)
    for batch_spec in ("proxy_tasks", "pairs"):
        for batch in data.loader(DEMANDS[batch_spec]):
            assert all(TARGET_ID not in steps.task for steps in batch.steps.values())
    for domain, found in data.statistics().items():
        rows = np.isin(data.datasets[domain].episode_task, [TARGET_ID])
        train = [e for e in data.episodes(domain, tiny.PROXIES, "train") if not rows[e]]
        offset = data.datasets[domain].offset
        state = np.concatenate([data.datasets[domain].observation.state[offset[e] : offset[e + 1]] for e in train])
        np.testing.assert_allclose(found.mean, state.mean(axis=0, dtype=np.float64))
        np.testing.assert_allclose(found.std, state.std(axis=0, dtype=np.float64))


def test_pairs_never_show_the_target(trajectory_file: Path) -> None:
    data = tiny.data_module(trajectory_file)
    dataset = data.datasets["flat"]
    target = {tuple(row) for row in dataset.observation.state[: len(dataset)][dataset.task == TARGET_ID].tolist()}
    for batch in data.loader(BatchSpec(pairs="thinned")):
        assert not target & {tuple(row) for row in batch.pairs["flat"].observation.state.tolist()}


# -- batch_spec ------------------------------------------------------------------------------------------


def test_trajectories_are_shared_out_among_tasks_rounding_up(trajectory_file: Path) -> None:
    data = tiny.data_module(trajectory_file, trajectories=15, target_trajectories=4)
    proxy_tasks = dict.fromkeys(tiny.PROXIES, 3)
    assert data.needed() == {"flat": proxy_tasks | {tiny.TARGET: 4}, "tall": proxy_tasks}


def test_missing_is_demand_without_what_the_file_holds(trajectory_file: Path, tmp_path: Path) -> None:
    assert tiny.data_module(trajectory_file).missing() == {}
    more = tiny.data_module(trajectory_file, target_trajectories=9)
    assert more.missing() == {"flat": {tiny.TARGET: 5}}
    nothing = tiny.data_module(tmp_path / "none.hdf5")
    assert nothing.missing() == nothing.needed()


class NotingCollector:
    """Collects everything at once and notes what it was asked."""

    def __init__(self) -> None:
        self.calls: list[Mapping[str, Mapping[str, int]]] = []
        self.checked: list[Path] = []

    def __call__(self, path: Path, missing: Mapping[str, Mapping[str, int]]) -> None:
        self.calls.append(missing)
        write(path, tiny.demonstrations(4))

    def check(self, path: Path) -> None:
        self.checked.append(path)


def test_prepare_data_asks_the_collector_for_what_is_missing_once(tmp_path: Path) -> None:
    data, collector = tiny.data_module(tmp_path / "new" / "data.hdf5"), NotingCollector()
    data.collector = collector
    data.prepare_data()
    data.prepare_data()
    assert (collector.calls, collector.checked) == ([data.needed()], [data.path])


def test_without_a_collector_missing_demonstrations_are_named(tmp_path: Path) -> None:
    data = tiny.data_module(tmp_path / "none.hdf5")
    message = r"none.hdf5: 60 demonstrations are missing \(first: 4 of task 'goal_0' in domain 'flat'\)"
    with pytest.raises(MissingTrajectoriesError, match=message) as caught:
        data.prepare_data()
    assert "\n" not in str(caught.value)


# -- which trajectories ------------------------------------------------------------------------------


def test_only_the_wanted_number_of_trajectories_is_used(trajectory_file: Path) -> None:
    data = tiny.data_module(trajectory_file, trajectories=14, target_trajectories=3)
    flat = data.datasets["flat"].episode_task
    assert [int((flat == k).sum()) for k in range(8)] == [2, 2, 2, 3, 2, 2, 2, 2]


def test_what_is_used_does_not_change_when_the_file_grows(trajectory_file: Path, tmp_path: Path) -> None:
    grown = tmp_path / "grown.hdf5"
    write(grown, list(reversed(tiny.demonstrations(6))))
    before = tiny.data_module(trajectory_file, trajectories=14, target_trajectories=3)
    after = tiny.data_module(grown, trajectories=14, target_trajectories=3)
    assert before.fingerprint == after.fingerprint
    for domain in ("flat", "tall"):
        held_out = before.episodes(domain, tiny.PROXIES, "val")
        assert held_out.tolist() == after.episodes(domain, tiny.PROXIES, "val").tolist()
    one, other = ([b.steps["flat"].row.tolist() for b in d.loader(BatchSpec("mix"))] for d in (before, after))
    assert one == other


def test_the_fingerprint_tells_other_data_apart(trajectory_file: Path) -> None:
    prints = {
        tiny.data_module(trajectory_file, trajectories=14).fingerprint,
        tiny.data_module(trajectory_file, trajectories=28).fingerprint,
        tiny.data_module(trajectory_file, trajectories=28, target_trajectories=3).fingerprint,
    }
    assert len(prints) == 3
    assert tiny.data_module(trajectory_file, seed=9).fingerprint in prints


@pytest.mark.parametrize("val_fraction", [0.0, 0.05, 0.2, 0.5])
@pytest.mark.parametrize("tasks", [tiny.PROXIES, (tiny.TARGET,)])
def test_held_out_and_training_trajectories_share_nothing(
    trajectory_file: Path, val_fraction: float, tasks: tuple[str, ...]
) -> None:
    data = tiny.data_module(trajectory_file, val_fraction=val_fraction)
    for domain, dataset in data.datasets.items():
        train, kept = (data.episodes(domain, tasks, part) for part in ("train", "val"))
        everything = dataset.episodes_of(np.array([data.tasks.index(task) for task in tasks]))
        assert sorted([*train, *kept]) == everything.tolist()
        assert len(kept) == (max(1, round(val_fraction * len(everything))) if val_fraction and len(everything) else 0)


def test_training_batches_hold_no_held_out_step(trajectory_file: Path) -> None:
    data = tiny.data_module(trajectory_file, val_fraction=0.3)
    for tasks, demands in ((tiny.PROXIES, ("proxy_tasks", "pairs", "mix")), ((tiny.TARGET,), ("mix",))):
        kept = {domain: set(rows.tolist()) for domain, rows in data.rows(tasks, "val").items()}
        assert kept["flat"]
        for batch_spec in demands:
            parts = [part for batch in data.loader(DEMANDS[batch_spec]) for part in batch.steps.items()]
            used = [(domain, row) for domain, steps in parts for row in steps.row.tolist()]
            assert not [(d, r) for d, r in used if r in kept.get(d, set())]


def test_paired_trajectories_are_training_trajectories(trajectory_file: Path) -> None:
    data = tiny.data_module(trajectory_file, val_fraction=0.3)
    for domain in data.domains:
        kept = set(data.episodes(domain, tiny.PROXIES, "val").tolist())
        by_task = data.episodes_by_task(domain)
        assert {tiny.TASKS[task] for task in by_task} == set(tiny.PROXIES)
        assert all((data.datasets[domain].episode_task[ids] == task).all() for task, ids in by_task.items())
        paired = [e for ids in by_task.values() for e in ids.tolist()]
        assert sorted(paired) == data.episodes(domain, tiny.PROXIES, "train").tolist()
        assert not kept & set(paired)


def test_the_split_does_not_depend_on_the_seed_of_the_run(trajectory_file: Path) -> None:
    one, other = (tiny.data_module(trajectory_file, seed=seed) for seed in (0, 1))
    assert (
        one.episodes("tall", tiny.PROXIES, "train").tolist() == other.episodes("tall", tiny.PROXIES, "train").tolist()
    )


# -- batches -----------------------------------------------------------------------------------------


def test_tables_hold_the_demonstrations_as_they_were_made(trajectory_file: Path) -> None:
    dataset = tiny.data_module(trajectory_file).datasets["flat"]
    made = sorted((t for t in tiny.demonstrations(4) if t.domain == "flat"), key=lambda t: tiny.TASKS.index(t.task))
    assert len(dataset.offset) == len(made) + 1
    for trajectory, (start, stop) in zip(made, pairwise(dataset.offset), strict=True):
        seen = [*range(start, stop), int(dataset.next_row[stop - 1])]
        np.testing.assert_array_equal(dataset.observation.state[seen], trajectory.observation.state)
        np.testing.assert_array_equal(dataset.action[start:stop], trajectory.actions)
        assert set(dataset.task[start:stop].tolist()) == {tiny.TASKS.index(trajectory.task)}


def test_a_third_domain_gets_its_share(tmp_path: Path) -> None:
    third = LinearPoint(5, state_size=2)
    extra = [
        Trajectory("third", t.task, Observation(t.observation.state[:, :2]), t.actions, t.seed, True)
        for t in tiny.demonstrations(4)
        if t.domain == "flat"
    ]
    specs = [*(d.simulator.spec(name) for name, d in tiny.domains().items()), third.spec("third")]
    write_trajectories(tmp_path / "three.hdf5", specs, tiny.TASKS, [*tiny.demonstrations(4), *extra], {})
    data = tiny.data_module(tmp_path / "three.hdf5", batch_size=30, domain_names=("flat", "tall", "third"))
    assert TARGET_ID not in data.datasets["third"].task
    first = next(iter(data.loader(BatchSpec(pairs="thinned"))))
    assert [(d, len(s.action)) for d, s in first.steps.items()] == [("flat", 10), ("tall", 10), ("third", 10)]
    turns = {tuple(batch.pairs) for batch in data.loader(DEMANDS["pairs"])}
    assert turns == {("flat", "tall"), ("flat", "third"), ("tall", "third")}


def test_a_resumed_data_module_goes_on_with_the_next_batch(trajectory_file: Path) -> None:
    data = tiny.data_module(trajectory_file)
    iterator = iter(data.train_dataloader())
    for _ in range(3):
        next(iterator)
    state = data.state_dict()
    rest = [batch.steps["tall"].row.tolist() for batch in iterator]
    resumed = tiny.data_module(trajectory_file)
    resumed.load_state_dict(state)
    assert [batch.steps["tall"].row.tolist() for batch in resumed.train_dataloader()] == rest
    assert next(iter(resumed.train_dataloader())).steps["tall"].row.tolist() != rest[0]


def test_the_state_is_empty_before_training_and_may_be_loaded(trajectory_file: Path) -> None:
    data = tiny.data_module(trajectory_file)
    assert data.state_dict() == {}
    data.load_state_dict({})
    assert data.train_dataloader().state_dict() == {"epoch": 0, "step": 0}


def test_batches_stay_where_they_are_on_a_cpu(trajectory_file: Path) -> None:
    data = tiny.data_module(trajectory_file)
    batch = next(iter(data.train_dataloader()))
    assert data.transfer_batch_to_device(batch, torch.device("cpu"), 0) is batch


def test_parts_without_trajectories_are_left_out(trajectory_file: Path) -> None:
    assert tiny.data_module(trajectory_file, val_fraction=0.2).parts == ("train", "val")
    assert tiny.data_module(trajectory_file, val_fraction=0.0).parts == ("train",)
    assert len(tiny.data_module(trajectory_file, val_fraction=0.0).val_dataloader()) == 0
