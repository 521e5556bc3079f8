"""Every method on every experiment, in miniature, through the command line: fit, stop, resume, test.

By default each method runs on the point maze and each experiment with PLP; ``-m matrix`` runs all others.
"""

from __future__ import annotations

import functools
import itertools
import json
import os
import signal
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from command import METHODS, TINY, plp
from test_configs import EXPERIMENTS, invent_demonstrations

from plp_lightning.callbacks.preemption import Preemption
from plp_lightning.cli.config import parse
from plp_lightning.envs.suites.simulator import Suite
from plp_lightning.envs.tabletop.simulator import Tabletop

SMALL_EYES = "policy: {init_args: {image_encoder: {channels: [4, 8], features: 16}}}\n"
SMALL_POINTS = "policy: {init_args: {image_channels: [4, 8]}}\n"
CUT = [*((m, "p2p_umaze") for m in (path.stem for path in METHODS)), *(("plp", path.stem) for path in EXPERIMENTS)]


def pairs() -> Iterator[Any]:
    """Method and experiment of each test; those beyond the cut are marked."""
    for method, experiment in itertools.product(METHODS, EXPERIMENTS):
        names = method.stem, experiment.stem
        marks = [] if names in CUT else [pytest.mark.matrix]
        yield pytest.param(method, experiment, id="-".join(names), marks=marks)


@functools.cache
def data_of(experiment: Path) -> tempfile.TemporaryDirectory[str]:
    """Folder with made-up demonstrations; the same for every method."""
    folder = tempfile.TemporaryDirectory()
    invent_demonstrations(parse(["--config", str(experiment), *TINY, "--data.root", folder.name]))
    return folder


def miniature(method: Path, experiment: Path, root: Path) -> list[str]:
    """Options of a run of one epoch a phase, with short episodes and small images."""
    (root / "eyes.yaml").write_text(SMALL_POINTS if method.stem.startswith(("gama", "cdil")) else SMALL_EYES)
    words = ["--config", str(experiment), *TINY, "--config", str(method), "--config", str(root / "eyes.yaml")]
    words += ["--run_root", str(root), "--trainer.max_epochs", "1", "--evaluation.final_episodes", "1"]
    for name, domain in parse(["--config", str(experiment)]).domains.items():
        words += [f"--domains.{name}.simulator.horizon", "3"]
        if isinstance(domain.simulator, Suite):  # whose processes would take seconds to begin
            words += [f"--domains.{name}.simulator.threads", "1"]
        if isinstance(domain.simulator, Tabletop):
            words += [f"--domains.{name}.simulator.image_size", "16"]
    return words


def with_data(words: list[str], experiment: Path, root: Path) -> list[str]:
    """The same with made-up demonstrations; images of another size need a file of their own."""
    if "16" not in words:
        return [*words, "--data.root", data_of(experiment).name]
    invent_demonstrations(parse([*words, "--data.root", str(root)]))
    return [*words, "--data.root", str(root)]


def stop_after_the_first_step(patch: pytest.MonkeyPatch) -> None:
    """Let this process be asked to stop, as a cluster asks."""
    at_step, calls = Preemption.on_train_batch_end, itertools.count()

    def stopping(self: Preemption, *words: Any) -> None:
        if next(calls) == 0:
            os.kill(os.getpid(), signal.SIGTERM)
        at_step(self, *words)

    patch.setattr(Preemption, "on_train_batch_end", stopping)


@pytest.mark.parametrize(("method", "experiment"), [*pairs()])
def test_every_method_runs_stops_resumes_and_is_tested_on_every_experiment(
    method: Path, experiment: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    words = with_data(miniature(method, experiment, tmp_path), experiment, tmp_path)
    run = parse(words).run_path
    with monkeypatch.context() as patch:
        stop_after_the_first_step(patch)
        assert plp("fit", *words).code == 128 + signal.SIGTERM
    assert json.loads((run / "status.json").read_text())["state"] == "preempted"
    answer = plp("fit", "--resume", run)
    assert answer.code == 0, answer
    results = json.loads((run / "results.json").read_text())
    assert (results["experiment"], results["method"]) == (experiment.stem, method.stem)
    trials = {name: results[name] for name in ("target", "source", "proxy", "proxy_source") if name in results}
    assert {"target", "proxy"} <= trials.keys()
    assert len(trials) == 4 or method.stem != "plp"
    assert {(found["episodes"], found["invalid"]) for found in trials.values()} == {(1, 0)}
    assert "done already" in plp("fit", "--resume", run).out
    answer = plp("test", run, "--output", tmp_path / "test.json")
    assert answer.code == 0, answer
    told = json.loads((tmp_path / "test.json").read_text())["trials"]
    assert {name: found["success"] for name, found in told.items()} == {n: f["success"] for n, f in trials.items()}
