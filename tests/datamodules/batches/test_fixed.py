"""Batches of fixed shape hold what other batches hold, filled up with what does not count."""

from __future__ import annotations

from itertools import islice
from pathlib import Path

import pytest
import tiny
import torch
from command import same
from torch import Tensor

from datamodules.batches.fixed import FixedLoader, by_trajectory
from datamodules.types import Batch, BatchSpec, PackedTrajectories, Steps
from plp_lightning.losses import behavioural_cloning

CPU = torch.device("cpu")
SPECS = [
    BatchSpec(),
    BatchSpec("all", next_observation=True, progress=True),
    BatchSpec(pairs="thinned"),
    BatchSpec("none", pairs="whole"),
    BatchSpec("mix"),
    BatchSpec("mix", next_observation=True, progress=True),
]


def counted(batch: Batch) -> dict[str, list[Tensor]]:
    """The steps that count, by domain; a domain without any is left out."""
    found = {domain: _counted(steps) for domain, steps in batch.steps.items()}
    return {domain: parts for domain, parts in found.items() if len(parts[0])}


def _counted(steps: Steps) -> list[Tensor]:
    parts = [steps.row, steps.observation.state, steps.action, steps.task, steps.progress]
    if steps.next_observation is not None:
        parts.append(steps.next_observation.state)
    chosen = slice(None) if steps.weight is None else steps.weight > 0
    return [part[chosen] for part in parts if part is not None]


def frames(pairs: PackedTrajectories) -> list[Tensor]:
    """The frames that count, trajectory after trajectory."""
    return [by_trajectory(pairs, values)[pairs.mask] for values in (pairs.observation.state, pairs.action)]


@pytest.mark.parametrize("batch_spec", SPECS, ids=str)
def test_the_same_steps_and_frames_come(batch_spec: BatchSpec, trajectory_file: Path) -> None:
    data = tiny.data_module(trajectory_file, domain_names=("flat", "tall"))
    loader, fixed = data.loader(batch_spec), data.fixed_loader(batch_spec, CPU)
    assert len(loader) == len(fixed)
    for batch, selection in zip(loader, fixed, strict=True):
        found = selection.gather()
        assert same(counted(batch), counted(found))
        assert batch.pairs.keys() == found.pairs.keys()
        for domain, pairs in batch.pairs.items():
            own, time = found.pairs[domain], pairs.mask.shape[1]
            assert torch.equal(own.mask[:, :time], pairs.mask)
            assert not own.mask[:, time:].any()
            assert same(frames(own), frames(pairs))


@pytest.mark.parametrize("batch_spec", SPECS, ids=str)
def test_shapes_are_those_of_the_layout_in_every_step(batch_spec: BatchSpec, trajectory_file: Path) -> None:
    fixed = tiny.data_module(trajectory_file).fixed_loader(batch_spec, CPU)
    layouts = {selection.layout for epoch in range(2) for selection in fixed}
    assert len(layouts) <= 2  # at most one an epoch
    lengths = {selection.layout: len(selection.numbers) for selection in fixed}
    assert all(sum(layout.sizes) == length for layout, length in lengths.items())


@pytest.mark.parametrize("first", [False, True])
def test_either_loader_goes_on_where_the_other_has_stopped(first: bool, trajectory_file: Path) -> None:
    data = tiny.data_module(trajectory_file)
    loaders = [data.loader(BatchSpec("mix")), data.fixed_loader(BatchSpec("mix"), CPU)]
    begun, going_on = loaders if first else loaders[::-1]
    assert len([*islice(begun, 3)]) == 3
    going_on.load_state_dict(begun.state_dict())
    batch = next(iter(going_on))
    found = batch if isinstance(batch, Batch) else batch.gather()
    rest = [*data.loader(BatchSpec("mix"))][3]
    assert same(counted(found), counted(rest))
    assert begun.state_dict() == {"epoch": 0, "step": 3}


def test_cloning_of_a_filled_batch_is_that_of_what_counts(trajectory_file: Path) -> None:
    data = tiny.data_module(trajectory_file)
    for batch, selection in zip(data.loader(BatchSpec("mix")), data.fixed_loader(BatchSpec("mix"), CPU), strict=True):
        found = selection.gather()
        predicted = [{d: s.observation.state[:, :1] * s.action for d, s in b.steps.items()} for b in (batch, found)]
        actions = [{d: s.action for d, s in b.steps.items()} for b in (batch, found)]
        weight = {d: s.weight for d, s in found.steps.items() if s.weight is not None}
        assert weight.keys() == found.steps.keys()
        plain = behavioural_cloning(predicted[0], actions[0])
        assert torch.allclose(behavioural_cloning(predicted[1], actions[1], weight=weight), plain)


def test_nothing_that_counts_costs_nothing() -> None:
    zero, one = {"a": torch.zeros(2, 1)}, {"a": torch.ones(2, 1, requires_grad=True)}
    loss = behavioural_cloning(one, zero, weight={"a": torch.zeros(2)})
    loss.backward()  # type: ignore[no-untyped-call]
    assert loss == 0
    assert one["a"].grad is not None
    assert not one["a"].grad.any()


def test_tables_stay_where_they_are_asked_to_be(trajectory_file: Path) -> None:
    fixed = tiny.data_module(trajectory_file).fixed_loader(BatchSpec(progress=True), torch.device("meta"))
    assert isinstance(fixed, FixedLoader)
    for dataset in fixed.datasets.values():
        parts = (dataset.observation.state, dataset.action, dataset.task, dataset.next_row, dataset.progress)
        assert {part.device.type for part in parts} == {"meta"}
