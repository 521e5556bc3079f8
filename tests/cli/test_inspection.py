from __future__ import annotations

import json
import subprocess
import sys

import h5py
import numpy as np
import pytest

from datamodules.errors import TrajectoryFileError
from datamodules.store.writer import write_trajectories
from datamodules.types import DomainSpec, Observation, ObservationKey, Trajectory
from plp_lightning.cli.data import inspect_file, validate

POINT = DomainSpec(
    "point", (ObservationKey("pos", (2,), unit="m"), ObservationKey("vel", (2,), unit="m/s")), 2, 50.0, "[maze]"
)
ANT = DomainSpec("ant", (ObservationKey("q", (1,), unit="rad"),), 1, 12.5)


def walk(task: str, seed: int, steps: int, last: bool = False) -> Trajectory:
    state = np.random.default_rng(seed).standard_normal((steps + last, 4)).astype(np.float32)
    return Trajectory("point", task, Observation(state), np.zeros((steps, 2), np.float32), seed, True)


@pytest.fixture
def path(tmp_path):
    walks = [walk("east", 0, 3), walk("east", 1, 5, last=True), walk("west", 0, 4, last=True)]
    write_trajectories(tmp_path / "x.hdf5", [POINT, ANT], ["west", "east", "up"], walks, {"command": "plp collect"})
    return str(tmp_path / "x.hdf5")


def test_inspect_as_json(path, capsys):
    inspect_file(path, json=True)
    found = json.loads(capsys.readouterr().out)
    point, ant = found["domains"]
    assert found["format"] == "plp-trajectories 1.1"
    assert found["tasks"] == ["west", "east", "up"]
    assert found["provenance"] == {"command": "plp collect"}
    assert point["length"] == {"min": 3, "mean": 4.0, "max": 5}
    assert (point["episodes"], point["steps"], point["successes"], point["last_known"]) == (3, 12, 3, 2)
    assert point["counts"] == {"west": 1, "east": 2, "up": 0}
    assert DomainSpec.from_dict(point) == POINT
    assert (ant["episodes"], ant["length"]) == (0, None)


def test_inspect_as_tables(path, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    inspect_file(path)
    lines = capsys.readouterr().out.splitlines()
    rows = [[cell.strip() for cell in line.strip("│ ").split("│")] for line in lines if line.startswith("│")]
    assert ["point", "2", "50", "[maze]"] in rows
    assert ["ant", "1", "12.5"] in rows  # by nothing that is known
    assert ["point", "3", "3", "2", "12", "3 / 4.0 / 5"] in rows
    assert ["ant", "0", "0", "0", "0", "–"] in rows
    assert not any("…" in line for line in lines)
    assert ["point", "vel", "state", "2", "m/s"] in rows
    assert ["east", "2", "0"] in rows
    assert not any(row[0] == "up" for row in rows)
    assert path in lines[0]
    assert any('"command": "plp collect"' in line for line in lines)


def test_validate_prints_findings(path, capsys):
    validate(path)
    lines = capsys.readouterr().out.splitlines()
    assert "warning ant, west: no demonstration here, but in point: it cannot align the two" in lines
    assert "info    point, east: 2 demonstrations of 3 to 5 steps" in lines
    assert any(line.startswith("info    point, east: 1 of 2 demonstrations end without a last obs") for line in lines)
    assert lines[-1].startswith(f"{path}: fit for training")


def test_validate_raises_after_printing_all(path, capsys):
    with h5py.File(path, "a") as file:
        file["/domains/point/actions"][3] = 7
    with pytest.raises(
        TrajectoryFileError, match=r"x.hdf5: 2 errors, first: /domains/point/actions: values do not match"
    ):
        validate(path)
    assert "error   point, actions: 1 steps outside [-1, 1], first in episode 0, step 3" in capsys.readouterr().out


@pytest.mark.parametrize("verb", [inspect_file, validate])
def test_a_missing_file(verb, tmp_path):
    with pytest.raises(TrajectoryFileError, match=r"nothing: .*no such file"):
        verb(str(tmp_path / "nothing"))


def test_neither_torch_nor_a_simulator_is_imported(path):
    heavy = "{'torch', 'lightning', 'mujoco', 'robosuite', 'gymnasium', 'sklearn'}"
    code = f"from plp_lightning.cli.data import *; inspect_file({path!r}, True); validate({path!r}); import sys"
    code += f"; assert not {heavy} & set(sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True, capture_output=True)
