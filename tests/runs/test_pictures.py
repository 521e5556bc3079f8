"""Pictures of a maze run: in every phase's folder, and in TensorBoard."""

from __future__ import annotations

import pytest
from command import ROOT, TINY, plp
from matplotlib.image import imread
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
from test_configs import invent_demonstrations

from plp_lightning.cli.config import parse
from plp_lightning.runs.directory import RunDirectory


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> RunDirectory:
    """Both phases of a miniature P2P-umaze, with a callback of the user's."""
    root = str(tmp_path_factory.mktemp("mazes"))
    words = ["--config", str(ROOT / "configs" / "p2p_umaze.yaml"), *TINY, "--data.root", root, "--run_root", root]
    words += [word for name in ("mirrored", "point") for word in (f"--domains.{name}.simulator.horizon", "3")]
    words += ["--evaluation.latent_states", "20", "--evaluation.latent_pairs", "4"]
    words += ["--callbacks", "[{class_path: lightning.pytorch.callbacks.LearningRateMonitor}]"]
    experiment = parse(words)
    invent_demonstrations(experiment)
    answer = plp("fit", *words)
    assert answer.code == 0, answer
    return RunDirectory(experiment.run_path)


@pytest.mark.parametrize("phase", ["alignment", "adaptation"])
def test_every_phase_leaves_its_pictures(phase: str, run: RunDirectory) -> None:
    events = EventAccumulator(str(run.phase(phase)))
    events.Reload()
    assert set(events.Tags()["images"]) == {f"{phase}/latents", f"{phase}/paths"}
    for name in ("latents", "paths"):
        (shown,) = events.Images(f"{phase}/{name}")
        assert imread(run.phase(phase) / f"{name}.png").shape[:2] == (shown.height, shown.width)


def test_callbacks_of_the_user_run_beside_them(run: RunDirectory) -> None:
    events = EventAccumulator(str(run.phase("alignment")))
    events.Reload()
    assert "lr-FusedAdamW" in events.Tags()["scalars"]
