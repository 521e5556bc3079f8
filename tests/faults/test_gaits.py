"""Gait files that are none: one line that names the file, before any process is started."""

from __future__ import annotations

import pickle
import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
from command import ROOT, complaint
from safetensors.numpy import load_file, save_file

from datamodules.errors import CheckpointError, ConfigError, UserError
from plp_lightning.envs.experts.gait import Gait, gait_path, provenance
from plp_lightning.envs.experts.waypoint import WalkerExpert
from plp_lightning.envs.maze.simulator import PointMaze, WalkerMaze
from plp_lightning.runs import collection

GOOD = gait_path(4).read_bytes()
HEADER = struct.unpack("<Q", GOOD[:8])[0]
ARRAYS = load_file(gait_path(4))

FILES: dict[str, bytes] = {
    "truncated": GOOD[: len(GOOD) // 2],
    "empty": b"",
    "a header of 2^63 bytes": struct.pack("<Q", 2**63) + GOOD[8:],
    "a header of 100 MB": struct.pack("<Q", 100_000_000) + GOOD[8:],
    "a header that is no JSON": GOOD[:8] + b"x" * HEADER + GOOD[8 + HEADER :],
    "offsets outside": GOOD.replace(b'"data_offsets":[0,', b'"data_offsets":[9,', 1),
    "an unknown type": GOOD.replace(b'"dtype":"F32"', b'"dtype":"F99"', 1),
    "a pickle": pickle.dumps({"mean": 1}),
    "text": b"weights\n",
}
CHANGES: dict[str, Callable[[dict[str, np.ndarray]], dict[str, np.ndarray]]] = {
    "nothing of a gait": lambda found: {"x": np.zeros(1, np.float32)},
    "not a number": lambda found: {**found, "1.bias": np.full_like(found["1.bias"], np.nan)},
    "an infinite scale": lambda found: {**found, "scale": np.full_like(found["scale"], np.inf)},
    "one column": lambda found: {name: array[..., :1].copy() for name, array in found.items()},
    "a bias of another size": lambda found: {**found, "1.bias": found["1.bias"][:-1].copy()},
    "a mean of another body": lambda found: {**found, "mean": np.zeros(37, np.float32)},
    "whole numbers": lambda found: {name: array.astype(np.int32) for name, array in found.items()},
    "double precision": lambda found: {name: array.astype(np.float64) for name, array in found.items()},
    "half precision": lambda found: {name: array.astype(np.float16) for name, array in found.items()},
    "one array missing": lambda found: {name: array for name, array in found.items() if name != "0.weight"},
    "no rows": lambda found: {name: array[:0].copy() for name, array in found.items()},
    "three axes": lambda found: {**found, "0.weight": found["0.weight"][None].copy()},
    "an odd number of torques": lambda found: {
        **found,
        "2.weight": found["2.weight"][:-1].copy(),
        "2.bias": found["2.bias"][:-1].copy(),
    },
}


def refused(file: Path) -> None:
    with pytest.raises(CheckpointError) as found:
        Gait.load(file)
    assert str(file) in str(found.value)
    assert len(str(found.value).splitlines()) == 1


@pytest.mark.parametrize("content", FILES.values(), ids=FILES)
def test_what_is_no_safetensors_file_is_told_in_one_line(content: bytes, tmp_path: Path) -> None:
    assert content != GOOD
    (tmp_path / "gait.safetensors").write_bytes(content)
    refused(tmp_path / "gait.safetensors")


@pytest.mark.parametrize("change", CHANGES.values(), ids=CHANGES)
def test_arrays_that_are_no_gait_are_told_in_one_line(
    change: Callable[[dict[str, np.ndarray]], dict[str, np.ndarray]], tmp_path: Path
) -> None:
    save_file(change(ARRAYS), tmp_path / "gait.safetensors")
    refused(tmp_path / "gait.safetensors")


def test_files_of_torch_and_folders_are_told_too(tmp_path: Path) -> None:
    torch.save({"mean": torch.zeros(29)}, tmp_path / "gait.safetensors")
    refused(tmp_path / "gait.safetensors")
    (tmp_path / "folder.safetensors").mkdir()
    refused(tmp_path / "folder.safetensors")


def test_the_gaits_that_come_along_are_none_of_these() -> None:
    assert [Gait.load(gait_path(legs)).legs for legs in (4, 6)] == [4, 6]


@pytest.mark.parametrize("card", [None, b"{", b"[]", b"1", b"\xff\xfe", b"[" * 100_000])
def test_a_card_that_is_none_is_told_in_one_line(card: bytes | None, tmp_path: Path) -> None:
    if card is not None:
        (tmp_path / "gait.json").write_bytes(card)
    with pytest.raises(CheckpointError, match=r"gait\.json: .*expected JSON"):
        provenance(tmp_path / "gait.safetensors")


@pytest.mark.parametrize(
    ("card", "told"), [("{", "cannot be read"), ("[]", "no record"), ('{"legs": 9}', "9 legs"), ("{}", "None legs")]
)
def test_a_gait_beside_a_card_of_something_else_is_refused(card: str, told: str, tmp_path: Path) -> None:
    file = tmp_path / "gait.safetensors"
    file.write_bytes(GOOD)
    file.with_suffix(".json").write_text(card)
    with pytest.raises(CheckpointError, match=rf"gait\.json: .*{told}"):
        Gait.load(file)
    file.with_suffix(".json").unlink()
    with pytest.raises(CheckpointError, match=r"gait\.json: "):
        Gait.load(file)
    file.with_suffix(".json").write_text('{"legs": 4}')
    assert Gait.load(file).legs == 4


def test_an_expert_says_before_it_begins_what_it_cannot_move(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="moves 6 legs, this walker has 4"):
        WalkerExpert(gait_path(6)).check(WalkerMaze("umaze"))
    with pytest.raises(ConfigError, match="demonstrates in WalkerMaze, not in PointMaze"):
        WalkerExpert().check(PointMaze("umaze"))
    with pytest.raises(UserError, match="no gait at"):
        WalkerExpert(tmp_path / "none").check(WalkerMaze("umaze"))
    WalkerExpert().check(WalkerMaze("umaze"))


def test_no_process_is_started_for_a_gait_that_is_none(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def never(*_: object, **__: object) -> None:
        raise AssertionError("a process was started")

    monkeypatch.setattr(collection, "Workers", never)
    (tmp_path / "gait.safetensors").write_bytes(GOOD[:1000])
    page = ROOT / "configs" / "p2a_umaze.yaml"
    gait = ["--domains.ant.expert.weights", tmp_path / "gait.safetensors"]
    told = complaint("collect", "--config", page, "--data.root", tmp_path, *gait)
    assert "gait.safetensors: not a safetensors file" in told
