"""Every configuration that is shipped can be read, printed and run."""

from __future__ import annotations

import itertools
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from command import METHODS, ROOT, TINY, complaint, plp

from datamodules.store.writer import write_trajectories
from datamodules.types import Observation, Trajectory
from plp_lightning.cli.config import BASE, parse
from plp_lightning.envs.tabletop.simulator import Tabletop
from plp_lightning.runs.experiment import Experiment

EXPERIMENTS = sorted(path for path in (ROOT / "configs").glob("*.yaml") if path.name != "base.yaml")
BY_NAME = {path.stem: path for path in EXPERIMENTS}


def pairs() -> Iterator[Any]:
    """Method and experiment of each test; all methods on one experiment and PLP on all always run."""
    for method, experiment in itertools.product(METHODS, EXPERIMENTS):
        marks = [] if method.stem == "plp" or experiment.stem == "p2p_umaze" else [pytest.mark.matrix]
        yield pytest.param(method, experiment, id=f"{method.stem}-{experiment.stem}", marks=marks)


@pytest.mark.parametrize(("method", "experiment"), list(pairs()))
def test_every_method_on_every_experiment_is_printed_as_it_reruns(
    experiment: Path, method: Path, tmp_path: Path
) -> None:
    first = parse(["--config", str(experiment), *TINY, "--config", str(method)])
    assert (first.name, first.method) == (experiment.stem, method.stem)
    assert first.data.source_domain != first.data.target_domain
    assert not set(first.data.proxy_tasks) & set(first.data.target_tasks)
    (tmp_path / "printed.yaml").write_text(first.config)
    again = parse(["--config", str(tmp_path / "printed.yaml")])
    assert again.config == first.config
    assert again.run_path == first.run_path


def test_flags_beat_files_and_later_files_beat_earlier_ones(tmp_path: Path) -> None:
    late = {
        "data": {"batch_size": 7, "pairs": 3},
        "alignment": {"init_args": {"optimizer": {"init_args": {"lr": 0.5}}}},
    }
    (tmp_path / "late.yaml").write_text(yaml.safe_dump(late))
    words = ["--config", str(BY_NAME["smoke"]), "--config", str(tmp_path / "late.yaml"), "--data.pairs", "5"]
    printed = yaml.safe_load(plp("fit", *words, "--print_config").out)
    assert (printed["data"]["batch_size"], printed["data"]["pairs"], printed["data"]["stride"]) == (7, 5, 4)
    alignment = printed["alignment"]["init_args"]
    assert (alignment["optimizer"]["init_args"]["lr"], alignment["epochs"]) == (0.5, 10)


def test_printing_a_config_writes_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert plp("fit", "--config", BY_NAME["smoke"], "--print_config").code == 0
    assert not list(tmp_path.iterdir())


def test_base_config_alone_is_no_experiment() -> None:
    assert "give an experiment" in complaint("fit", "--config", BASE)


def invent_demonstrations(experiment: Experiment) -> None:
    """Random states and actions of the right shapes: what a miniature run needs, without an expert."""
    rng, made = np.random.default_rng(0), []
    specs = [domain.simulator.spec(name) for name, domain in experiment.domains.items()]
    for spec in specs:
        for task, count in experiment.data.needed()[spec.name].items():
            for seed in range(count):
                states = rng.normal(size=(20, spec.state_size)).astype(np.float32)
                actions = rng.uniform(-1, 1, (20, spec.action_size)).astype(np.float32)
                camera = spec.image_key
                images = None if camera is None else rng.integers(0, 256, (20, *camera.shape), np.uint8)
                made.append(Trajectory(spec.name, task, Observation(states, images), actions, seed, success=True))
    write_trajectories(experiment.data.path, specs, experiment.data.tasks, made, {"command": "tests"})


@pytest.mark.parametrize("path", EXPERIMENTS, ids=lambda path: path.stem)
def test_every_experiment_runs_in_miniature(path: Path, tmp_path: Path) -> None:
    words = ["--config", str(path), *TINY, "--data.root", str(tmp_path), "--run_root", str(tmp_path)]
    words += ["--policy.image_encoder.channels", "[4, 8]", "--policy.image_encoder.features", "16"]
    for name, domain in parse(words).domains.items():
        words += [f"--domains.{name}.simulator.horizon", "5"]
        if isinstance(domain.simulator, Tabletop):
            words += [f"--domains.{name}.simulator.image_size", "16"]
    experiment = parse(words)
    invent_demonstrations(experiment)
    answer = plp("fit", *words)
    assert answer.code == 0, answer
    results = json.loads((experiment.run_path / "results.json").read_text())
    assert results["experiment"] == path.stem
    for trial in ("target", "source", "proxy", "proxy_source"):
        assert (results[trial]["episodes"], results[trial]["invalid"]) == (4, 0)
