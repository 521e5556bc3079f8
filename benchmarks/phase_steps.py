"""Costs of a step of a phase: under the Trainer as `plp fit` has it, without CUDA graphs, in a bare loop, as a graph.

    python benchmarks/phase_steps.py [p2p_alignment p2p_adaptation …] [--accelerator cpu] [--steps 400] [--turns 3]
                                     [--json FILE]

Demonstrations are random numbers in the shapes of the experiment, so nothing is collected. The ways take turns, and
each is timed over the second epoch of so many steps, by the clock on a GPU and by processor time elsewhere. Ratios are
to the bare loop: median, least and most of all turns. With `--compare` weights after so many steps with and without
graphs are compared instead.
"""

from __future__ import annotations

import argparse
import json
import logging
import statistics
import time
import traceback
import warnings
from collections.abc import Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np
import torch
from lightning.pytorch import Callback, LightningModule, Trainer, seed_everything

from datamodules.batches.fixed import FixedLoader
from datamodules.store.writer import write_trajectories
from datamodules.types import Observation, Trajectory
from plp_lightning.callbacks.checkpointing import RandomState
from plp_lightning.callbacks.freezing import FreezeGuard
from plp_lightning.callbacks.guard import FiniteGuard
from plp_lightning.callbacks.preemption import Preemption
from plp_lightning.cli.config import parse
from plp_lightning.methods.phase import Phase
from plp_lightning.runs.experiment import Experiment
from plp_lightning.runs.metrics_file import MetricsFile
from plp_lightning.steps.loop import step_quickly

CONFIGS = Path(__file__).parents[1] / "configs"


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
    "p2a_plp_t_alignment_fp32": Case(
        (P2A, "methods/plp_t.yaml"), "alignment", ("--trainer.precision", "32-true"), length=200, per_task=12
    ),
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


def experiment_of(case: Case, folder: Path) -> Experiment:
    """The experiment of a case, with random demonstrations."""
    words = [word for file in case.files for word in ("--config", str(CONFIGS / file))]
    file = folder / "random.hdf5"
    experiment = parse([*words, *case.options, "--data.file", str(file)])
    experiment.data.collector, experiment.data.missing = None, dict  # type: ignore[method-assign]
    invent(experiment, case, file)
    return experiment


def invent(experiment: Experiment, case: Case, path: Path) -> None:
    """Write random demonstrations in the shapes of the experiment's domains."""
    rng, specs, made = np.random.default_rng(0), experiment.specs, []
    for spec in specs:
        for task in experiment.data.tasks:
            for i in range(case.per_task):
                images = {
                    key.name: rng.integers(0, 256, (case.length, *key.shape), dtype=np.uint8) for key in spec.image_keys
                }
                state = rng.normal(size=(case.length, spec.state_size)).astype(np.float32)
                action = rng.uniform(-1, 1, (case.length, spec.action_size)).astype(np.float32)
                made.append(Trajectory(spec.name, task, Observation(state, images), action, seed=i, success=True))
    write_trajectories(path, specs, experiment.data.tasks, made, {})


class Clock(Callback):
    """Seconds that the last epoch has taken."""

    seconds = float("nan")

    def on_train_epoch_start(self, trainer: Trainer, pl_module: LightningModule) -> None:
        self.began = now()

    def on_train_epoch_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        self.seconds = now() - self.began


def now() -> float:
    """Seconds when the GPU has come to an end; without one the processor's, which other jobs change little."""
    if not torch.cuda.is_available():
        return time.process_time()
    torch.cuda.synchronize()
    return time.perf_counter()


def new_phase(experiment: Experiment, name: str) -> Phase[Any]:
    """The phase with the weights that its seed gives."""
    seed_everything(experiment.seed, verbose=False)
    experiment.data.trainer = None
    return experiment.method.phases[name](experiment.build_policy())


def fit(
    experiment: Experiment, name: str, accelerator: str, folder: Path, steps: int, epochs: int, graphs: bool
) -> tuple[float, Phase[Any]]:
    """Seconds a step of the last epoch of a phase that is trained as `plp fit` does, and the phase."""
    phase, clock = new_phase(experiment, name), Clock()
    trainer = Trainer(
        accelerator=accelerator,
        devices=1,
        precision=experiment.trainer["precision"],
        log_every_n_steps=experiment.trainer["log_every_n_steps"],
        gradient_clip_val=experiment.trainer["gradient_clip_val"],
        max_epochs=epochs,
        limit_train_batches=steps,
        limit_val_batches=0,
        logger=[MetricsFile(folder)],
        callbacks=[FreezeGuard(), FiniteGuard(), RandomState(), clock, Preemption(folder / "last.ckpt")],
        enable_checkpointing=False,
        enable_progress_bar=False,
        enable_model_summary=False,
    )
    step_quickly(trainer, graphs)
    trainer.fit(phase, datamodule=experiment.data)
    return clock.seconds / steps, phase


def bare(experiment: Experiment, name: str, accelerator: str, folder: Path, steps: int) -> float:
    """Seconds a step of a plain loop: gather, move, losses, backward, optimizer."""
    _, phase = fit(experiment, name, accelerator, folder, 2, 1, graphs=False)  # what it caches before the first step
    device = phase.trainer.strategy.root_device
    phase.to(device).train()
    optimizer = torch.optim.AdamW(phase.parameters(), lr=1e-4, fused=True)
    half = experiment.trainer["precision"] == "bf16-mixed"
    loader, took = experiment.data.loader(phase.batch_spec), 0.0
    for _ in range(2):
        began = now()
        for _, batch in zip(range(steps), loader, strict=False):
            moved = experiment.data.transfer_batch_to_device(batch, device, 0)
            with torch.autocast(device.type, torch.bfloat16, enabled=half):
                loss = phase.training_step(moved, 0)
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
        took = now() - began
        loader.load_state_dict({"epoch": 1, "step": 0})
    return took / steps


def replays(experiment: Experiment, name: str, accelerator: str, folder: Path, steps: int) -> float:
    """Seconds of a step's graph alone."""
    _, phase = fit(experiment, name, accelerator, folder, 2, 1, graphs=True)
    steps_of, loader = phase.trainer.fit_loop.epoch_loop.automatic_optimization, phase.trainer.train_dataloader
    assert isinstance(loader, FixedLoader)
    assert steps_of.graphs is not None
    layout = next(iter(steps_of.graphs.steps))
    graph = steps_of.graphs.steps[layout].graph
    began = now()
    for _ in range(steps):
        graph.replay()
    return (now() - began) / steps


def measure(case: Case, accelerator: str, steps: int, turns: int, folder: Path) -> dict[str, Any]:
    """Milliseconds a step in each way, and ratios to the bare loop."""
    experiment = experiment_of(case, folder)
    ways = {
        "trainer": lambda: fit(experiment, case.phase, accelerator, folder, steps, 2, True)[0],
        "bare": lambda: bare(experiment, case.phase, accelerator, folder, steps),
    }
    if accelerator != "cpu" and torch.cuda.is_available():
        ways["without_graphs"] = lambda: fit(experiment, case.phase, accelerator, folder, steps, 2, False)[0]
        ways["graph"] = lambda: replays(experiment, case.phase, accelerator, folder, steps)
    found: dict[str, list[float]] = {name: [] for name in ways}
    errors: dict[str, str] = {}
    for _ in range(turns):
        for name, way in ways.items():
            try:
                found[name].append(1e3 * way())
            except Exception as error:  # one way that fails leaves the others
                errors[name] = f"{type(error).__name__}: {str(error)[:300]}"
                traceback.print_exc()
    row: dict[str, Any] = {f"{name}_ms": statistics.median(times) for name, times in found.items() if times}
    for name, times in found.items():
        ratios = [time / plain for time, plain in zip(times, found["bare"], strict=False)]
        if ratios and name != "bare":
            row[f"{name}_ratio"] = [statistics.median(ratios), min(ratios), max(ratios)]
    return row | ({"errors": errors} if errors else {})


def compare(case: Case, accelerator: str, steps: int, folder: Path) -> dict[str, Any]:
    """Largest difference of weights after so many steps with graphs and without, and of two runs with graphs."""
    experiment = experiment_of(case, folder)
    states = [
        fit(experiment, case.phase, accelerator, folder, steps, 1, graphs)[1].cpu().state_dict()
        for graphs in (True, True, False)
    ]
    begun = new_phase(experiment, case.phase).state_dict()
    first, again, eager = states
    return {
        "graphs_and_without": largest(first, eager),
        "graphs_twice": largest(first, again),
        "training_moved": largest(first, begun),
    }


def largest(one: Mapping[str, torch.Tensor], other: Mapping[str, torch.Tensor]) -> float:
    """Largest absolute difference of two sets of weights."""
    return max(float((one[key].double() - other[key].double()).abs().max()) for key in one)


def main() -> None:
    """Print a line for each case."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("cases", nargs="*", default=["p2p_alignment", "p2p_adaptation"], help=", ".join(CASES))
    parser.add_argument("--accelerator", default="auto")
    parser.add_argument("--steps", type=int, default=400)
    parser.add_argument("--turns", type=int, default=3)
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--compare", action="store_true")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    torch.set_num_threads(options.threads)
    logging.getLogger("lightning.pytorch").setLevel(logging.ERROR)
    warnings.filterwarnings("ignore")
    rows = {}
    device = torch.cuda.get_device_name() if options.accelerator != "cpu" and torch.cuda.is_available() else "cpu"
    for name in options.cases:
        with TemporaryDirectory() as folder:
            place = Path(folder)
            if options.compare:
                row = compare(CASES[name], options.accelerator, options.steps, place)
            else:
                row = measure(CASES[name], options.accelerator, options.steps, options.turns, place)
        rows[name] = {"device": device, **row}
        print(name, json.dumps(rows[name], default=str), flush=True)
        if options.json:
            options.json.write_text(json.dumps(rows, indent=1))


if __name__ == "__main__":
    main()
