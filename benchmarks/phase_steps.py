"""Steps of any phase: under the Trainer as ``plp fit`` has it, in a bare loop, and as a CUDA graph.

Demonstrations are random numbers in the shapes of the experiment, so nothing is collected.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np
import torch
from lightning.pytorch import seed_everything

from benchmarks.measuring import Options, Row, at_most, in_turn, ratio
from benchmarks.synthetic import random_trajectory
from benchmarks.training import bare_loop, clock, fit
from datamodules.batches.fixed import FixedLoader
from datamodules.store.writer import write_trajectories
from datamodules.types import Batch
from plp_lightning.cli.config import parse
from plp_lightning.losses import behavioural_cloning
from plp_lightning.methods.phase import Phase
from plp_lightning.methods.plp.losses import mmd
from plp_lightning.methods.plp.policy import PortablePolicy
from plp_lightning.runs.experiment import Experiment

CONFIGS = Path(__file__).parents[1] / "configs"
UNDER, BARE, WRITTEN = "under the Trainer", "bare loop", "loop without a phase"
GRAPHS, GRAPH = "as graphs", "graph alone"


class Case(NamedTuple):
    """A phase of a method on an experiment, and what is invented for it."""

    files: tuple[str, ...]
    phase: str
    options: tuple[str, ...] = ()
    length: int = 100  # Steps of a demonstration
    per_task: int = 40  # Demonstrations of a task in each domain


P2P, P2A, R2R = "p2p_medium.yaml", "p2a_medium.yaml", "r2r.yaml"
CASES = {
    "p2p_alignment": Case((P2P,), "alignment"),
    "p2p_adaptation": Case((P2P,), "adaptation", per_task=120),
    "p2a_plp_t_alignment": Case((P2A, "methods/plp_t.yaml"), "alignment", length=200, per_task=12),
    "p2a_plp_t_adaptation": Case((P2A, "methods/plp_t.yaml"), "adaptation", length=200, per_task=40),
    "r2r_alignment": Case((R2R,), "alignment", length=40, per_task=40),
    "p2p_alignment_4096": Case((P2P,), "alignment", ("--data.batch_size", "4096")),
    "p2p_disc_alignment": Case((P2P, "methods/plp_disc.yaml"), "alignment"),
    "p2p_bc_alignment": Case((P2P, "methods/bc.yaml"), "alignment"),
    "p2p_bc_adaptation": Case((P2P, "methods/bc.yaml"), "adaptation", per_task=120),
    "p2p_gama_pretraining": Case((P2P, "methods/gama.yaml"), "pretraining"),
    "p2p_gama_alignment": Case((P2P, "methods/gama.yaml"), "alignment"),
    "p2p_gama_adaptation": Case((P2P, "methods/gama.yaml"), "adaptation", per_task=120),
    "p2p_cdil_positions": Case((P2P, "methods/cdil.yaml"), "positions"),
    "p2p_cdil_alignment": Case((P2P, "methods/cdil.yaml"), "alignment"),
    "p2p_cdil_dynamics": Case((P2P, "methods/cdil.yaml"), "dynamics"),
    "p2p_cdil_adaptation": Case((P2P, "methods/cdil.yaml"), "adaptation", per_task=120),
    "p2p_contextual": Case((P2P, "methods/contextual.yaml"), "alignment"),
    "v2v_reach_alignment": Case(("v2v_reach.yaml",), "alignment", length=40, per_task=16),
}


class Steps:
    """Ways to take so many steps of a case on a device, each from the weights that the seed gives."""

    def __init__(self, case: Case, folder: Path, device: str, steps: int) -> None:
        self.case, self.folder, self.device, self.steps = case, folder, device, steps
        self.experiment = experiment_of(case, folder)
        self.settings = {key: self.experiment.trainer[key] for key in ("precision", "log_every_n_steps")}
        self.settings["gradient_clip_val"] = self.experiment.trainer["gradient_clip_val"]

    def new_phase(self) -> Phase[Any]:
        """The phase with the weights that its seed gives."""
        seed_everything(self.experiment.seed, verbose=False)
        return self.experiment.method.phases[self.case.phase](self.experiment.build_policy())

    def fitted(self, graphs: bool, steps: int, epochs: int) -> tuple[float, Phase[Any]]:
        """Seconds a step under the Trainer, and the phase that took them."""
        phase = self.new_phase()
        data, place = self.experiment.data, self.folder
        return fit(phase, data, place, steps, epochs, self.device, graphs, **self.settings), phase

    def trainer(self, graphs: bool) -> float:
        """Seconds a step as ``plp fit`` takes them."""
        return self.fitted(graphs, self.steps, epochs=2)[0]

    def bare(self) -> float:
        """Seconds a step of a plain loop over the same batches."""
        _, phase = self.fitted(False, 2, epochs=1)  # what it caches before the first step
        data, device = self.experiment.data, phase.trainer.strategy.root_device
        phase.to(device).train()
        loader = data.loader(phase.batch_spec)

        def loss(batch: Batch) -> torch.Tensor:
            moved = data.transfer_batch_to_device(batch, device, 0)
            with torch.autocast(device.type, torch.bfloat16, enabled=self.settings["precision"] == "bf16-mixed"):
                found: torch.Tensor = phase.training_step(moved, 0)
            return found

        return bare_loop(loss, phase.parameters(), partial(iter, loader), self.steps, device)

    def replays(self) -> float:
        """Seconds of a step's graph alone."""
        _, phase = self.fitted(True, 2, epochs=1)
        graphs, loader = phase.trainer.fit_loop.epoch_loop.automatic_optimization.graphs, phase.trainer.train_dataloader
        assert isinstance(loader, FixedLoader)
        assert graphs is not None
        graph, now = next(iter(graphs.steps.values())).graph, clock(phase.trainer.strategy.root_device)
        began = now()
        for _ in range(self.steps):
            graph.replay()
        return (now() - began) / self.steps


def experiment_of(case: Case, folder: Path) -> Experiment:
    """The experiment of a case, with random demonstrations, which are written unless they are there."""
    words = [word for file in case.files for word in ("--config", str(CONFIGS / file))]
    file, rng = folder / "random.hdf5", np.random.default_rng(0)
    graphs = () if "--cuda_graphs" in case.options else ("--cuda_graphs", "true")
    experiment = parse([*words, *case.options, *graphs, "--data.file", str(file)])
    experiment.data.collector, experiment.data.missing = None, dict  # type: ignore[method-assign]
    if not file.exists():
        tasks, numbers = experiment.data.tasks, range(case.per_task)
        made = [random_trajectory(s, k, case.length, i, rng) for s in experiment.specs for k in tasks for i in numbers]
        write_trajectories(file, experiment.specs, tasks, made, {})
    return experiment


def trainer(options: Options, name: str) -> Iterator[Row]:
    """A case's steps under the Trainer against bare loops: of the phase, and of the same model without a phase."""
    with TemporaryDirectory() as folder:
        case = Steps(CASES[name], Path(folder), options.device, options.pick(150, 60))
        ways = {UNDER: partial(case.trainer, False), BARE: case.bare}
        if name == "p2p_alignment":
            ways[WRITTEN] = partial(written_loop, case)
        times = in_turn(ways, options.pick(4, 2))
    for other in [*ways][1:]:
        yield ratio(f"{name}: {UNDER} / {other}", times, UNDER, other, at_most(1.05))


def written_loop(case: Steps) -> float:
    """Seconds a step of a loop that has the policy's networks and the two losses, and nothing else of a phase."""
    policy, data = case.new_phase().policy, case.experiment.data
    assert isinstance(policy, PortablePolicy)
    loader = data.loader(case.new_phase().batch_spec)

    def loss(batch: Batch) -> torch.Tensor:
        seen = {domain: steps.observation for domain, steps in batch.steps.items()}
        out = policy(seen, {domain: steps.task for domain, steps in batch.steps.items()})
        cloning = behavioural_cloning(out.action, {domain: steps.action for domain, steps in batch.steps.items()})
        return cloning + 0.5 * mmd([*out.latent.values()], bandwidths=(1.0, 0.5, 0.25))

    return bare_loop(loss, policy.parameters(), partial(iter, loader), case.steps)


def on_device(options: Options, name: str, milliseconds: float) -> Iterator[Row]:
    """Milliseconds of a case's step, as ``plp fit`` takes it; on a GPU as graphs, and beside what is not."""
    gpu = options.device == "cuda"
    with TemporaryDirectory() as folder:
        case = Steps(CASES[name], Path(folder), options.device, options.pick(200, 20))
        own = in_turn({GRAPHS: lambda: case.trainer(gpu)}, options.pick(3, 1), warm=0)[GRAPHS]
        told = "" if gpu else "without graphs: not on a GPU"
        yield Row(f"{name}: a step of plp fit", [1e3 * s for s in own], "ms", options.on_gpu(milliseconds), note=told)
        times = in_turn({UNDER: lambda: case.trainer(False), BARE: case.bare}, options.pick(2, 1), warm=0)
        yield ratio(f"{name}: {UNDER}, no graphs / {BARE}", times, UNDER, BARE)
        if gpu:
            times = in_turn({GRAPHS: lambda: case.trainer(True), GRAPH: case.replays}, 2, warm=0)
            yield ratio(f"{name}: {GRAPHS} / {GRAPH}", times, GRAPHS, GRAPH)


def same_weights(options: Options, name: str) -> Iterator[Row]:
    """Largest differences of weights: of runs with graphs and without, and of two runs with graphs."""
    with TemporaryDirectory() as folder:
        case = Steps(CASES[name], Path(folder), options.device, options.pick(200, 10))
        first, again, eager = (
            case.fitted(graphs, case.steps, epochs=1)[1].cpu().state_dict() for graphs in (True, True, False)
        )
        moved = largest(first, case.new_phase().state_dict())
    told = f"training moved them by {moved:.2g}"
    yield Row(f"{name}: weights with graphs, twice", [largest(first, again)], "apart", at_most(0.0), note=told)
    yield Row(f"{name}: weights with graphs and without", [largest(first, eager)], "apart", note=told)


def largest(one: Mapping[str, torch.Tensor], other: Mapping[str, torch.Tensor]) -> float:
    """Largest absolute difference of two sets of weights."""
    return max(float((one[key].double() - other[key].double()).abs().max()) for key in one)
