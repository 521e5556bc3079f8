"""Demonstrations that are not those that were written, or that no writer would accept, are never trained on."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from command import complaint, data_root, plp, smoke_run, tiny_smoke
from forgery import flip, forge

ARRAYS = [
    *(f"domains/{domain}/{name}" for domain in ("flat", "tall") for name in ("actions", "obs/position")),
    *(f"domains/tall/episodes/{name}" for name in ("offset", "task_id", "seed", "success", "last")),
]


@pytest.fixture
def file(tmp_path: Path) -> Path:
    """A copy of the smoke experiment's demonstrations."""
    shutil.copytree(data_root(), tmp_path / "data")
    return tmp_path / "data" / "smoke.hdf5"


@pytest.mark.parametrize("array", ARRAYS)
@pytest.mark.parametrize("share", [0.0, 0.4, 1.0])
def test_no_run_trains_on_a_flipped_bit(file: Path, array: str, share: float, tmp_path: Path) -> None:
    flip(file, array, share)
    told = complaint("fit", *tiny_smoke(tmp_path), "--data.root", file.parent)
    assert "smoke.hdf5: " in told
    assert not smoke_run(tmp_path).checkpoint("alignment").exists()


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("array", ["actions", "obs/position"])
def test_values_that_are_not_finite_are_found_before_training(
    array: str, value: float, file: Path, tmp_path: Path
) -> None:
    forge(file, f"domains/tall/{array}", (7, 0), value)
    told = complaint("fit", *tiny_smoke(tmp_path), "--data.root", file.parent)
    assert "in domain 'tall' " in told
    assert "hold values that are not finite; expected what a writer accepts: see plp data validate" in told
    assert "not finite" in plp("data", "validate", file).out
    assert smoke_run(tmp_path).status()["state"] == "failed"


@pytest.mark.parametrize("value", [7.0, -1.001, 3e38])
def test_actions_beyond_their_limits_are_found_before_training(value: float, file: Path, tmp_path: Path) -> None:
    forge(file, "domains/flat/actions", (7, 0), value)
    told = complaint("fit", *tiny_smoke(tmp_path), "--data.root", file.parent)
    assert "in domain 'flat' actions lie outside [-1, 1]" in told
    assert not smoke_run(tmp_path).checkpoint("alignment").exists()


@pytest.mark.parametrize("change", [partial(flip, share=0.5), partial(forge, rows=(7, 0), value=7.0)])
def test_whatever_reads_demonstrations_later_looks_too(change: Callable[..., None], file: Path, tmp_path: Path) -> None:
    assert plp("fit", *tiny_smoke(tmp_path), "--data.root", file.parent).code == 0
    run = smoke_run(tmp_path)
    change(file, "domains/flat/actions")
    for command in (["validate", run.path], ["predict", run.path]):
        assert "smoke.hdf5: " in complaint(*command)
    shutil.rmtree(run.phase("adaptation"))
    run.results.unlink()
    status = run.status()
    run.write_json("status.json", status | {"state": "running", "phases": {"alignment": status["phases"]["alignment"]}})
    assert "smoke.hdf5: " in complaint("fit", "--resume", run.path)
    assert not run.checkpoint("adaptation").exists()
