"""The whole chain with images: collected, trained on from memory or disk, stopped, resumed, tested."""

from __future__ import annotations

import json
import signal
from pathlib import Path

import pytest
import yaml
from command import TINY, checkpoint, dies, plp, results, same

from datamodules.store.writer import TrajectoryFile
from plp_lightning.runs.directory import RunDirectory
from plp_lightning.runs.metrics_file import read_rows

SEEN = ["--config", str(Path(__file__).parent / "conf" / "seen.yaml")]
STEP = "plp_lightning.callbacks.preemption:Preemption.on_train_batch_end"
PHASES = ("alignment", "adaptation")


def options(run_root: Path, data: Path) -> list[str]:
    """A run of a few steps with every loss that a method may have."""
    return [*SEEN, *TINY, "--data.root", str(data), "--run_root", str(run_root), "--alignment.terms.tcc", "TCC"]


def run_of(run_root: Path) -> RunDirectory:
    return RunDirectory(run_root / "seen" / "plp" / "blue" / "seed_0")


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("data")
    answer = plp("collect", *options(folder, folder))
    assert answer.code == 0, answer
    return folder


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory, data: Path) -> RunDirectory:
    root = tmp_path_factory.mktemp("unbroken")
    answer = plp("fit", *options(root, data))
    assert answer.code == 0, answer
    assert answer.err == ""
    return run_of(root)


def test_images_are_collected(data: Path) -> None:
    with TrajectoryFile.open(data / "seen.hdf5") as file:
        image = file.trajectory("right", 0).observation.images["camera"]
    assert image is not None
    assert image.shape[1:] == (16, 16, 3)
    assert image.max() == 255


def test_a_run_with_images_has_all_that_a_run_has(run: RunDirectory) -> None:
    found = json.loads(run.results.read_text())
    assert {found[trial]["episodes"] for trial in ("target", "source", "proxy", "proxy_source")} == {4}
    logged = {metric for _, metric, _ in read_rows(run.phase("alignment") / "metrics.csv")}
    assert {"train/bc", "train/mmd", "train/tcc", "train/reconstruction", "val/bc"} <= logged
    weights = checkpoint(run, "adaptation")["state_dict"]
    assert [name for name in weights if name.startswith("policy.image_encoder.")]
    assert not [name for name in weights if "image_decoder" in name]


def test_a_run_from_disk_is_the_same_run(run: RunDirectory, data: Path, tmp_path: Path) -> None:
    answer = plp("fit", *options(tmp_path, data), "--data.image_memory", "0")
    assert answer.code == 0, answer
    found, expected = results(run_of(tmp_path)), results(run)
    assert found["settings"] == expected["settings"] | {"data.image_memory": 0}
    assert {**found, "settings": None, "config_sha256": None} == {**expected, "settings": None, "config_sha256": None}
    assert all(
        same(checkpoint(run_of(tmp_path), phase)["state_dict"], checkpoint(run, phase)["state_dict"])
        for phase in PHASES
    )


@pytest.mark.parametrize("step", [2, 7])
def test_a_stopped_run_with_images_resumes_exactly(step: int, run: RunDirectory, data: Path, tmp_path: Path) -> None:
    assert dies(["fit", *options(tmp_path, data)], STEP, step, signal.SIGKILL) == -signal.SIGKILL
    answer = plp("fit", "--resume", run_of(tmp_path).path)
    assert answer.code == 0, answer
    assert results(run_of(tmp_path)) == results(run)
    assert all(
        same(checkpoint(run_of(tmp_path), phase)["state_dict"], checkpoint(run, phase)["state_dict"])
        for phase in PHASES
    )


def test_a_trained_run_with_images_can_be_tested_and_rerun(run: RunDirectory, tmp_path: Path) -> None:
    answer = plp("test", run.path, "--output", tmp_path / "test.json")
    assert answer.code == 0, answer
    told, found = json.loads((tmp_path / "test.json").read_text()), json.loads(run.results.read_text())
    for trial in ("target", "source", "proxy", "proxy_source"):
        assert {**told["trials"][trial], "before": found[trial]["before"]} == found[trial]
    assert yaml.safe_load(run.config.read_text())["policy"]["init_args"]["image_encoder"]["init_args"]["channels"] == [
        *(8, 16, 16)
    ]
    assert "steps of left, right" in plp("predict", run.path, "--output", tmp_path / "p.npz").out


def test_half_precision_trains_every_term(data: Path, tmp_path: Path) -> None:
    answer = plp("fit", *options(tmp_path, data), "--trainer.precision", "bf16-mixed")
    assert answer.code == 0, answer
    values = {m: float(v) for _, m, v in read_rows(run_of(tmp_path).phase("alignment") / "metrics.csv")}
    assert all(abs(values[f"train/{term}"]) < 100 for term in ("bc", "mmd", "tcc", "reconstruction"))
