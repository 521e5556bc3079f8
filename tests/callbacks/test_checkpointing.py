from __future__ import annotations

import os
import pickle
import random
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch

from datamodules.errors import CheckpointError
from plp_lightning.callbacks.checkpointing import AtomicCheckpointIO, RandomState, read_checkpoint

PLAIN = {"policy": {"tasks": ["a"]}, "state_dict": {"w": torch.arange(3.0)}, "global_step": 7}


class Payload:
    """Unpickling it makes a folder."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple[Any, tuple[str]]:
        return os.mkdir, (str(self.path),)


def fails(*_: Any) -> None:
    raise OSError("no space left")


def refusal(path: Path) -> str:
    with pytest.raises(CheckpointError) as caught:
        read_checkpoint(path)
    message = str(caught.value)
    assert message.startswith(f"{path}: ")
    assert "\n" not in message
    return message


def test_what_is_saved_is_what_is_read(tmp_path: Path) -> None:
    AtomicCheckpointIO().save_checkpoint(PLAIN, tmp_path / "new" / "last.ckpt")
    found = read_checkpoint(tmp_path / "new" / "last.ckpt")
    assert torch.equal(found["state_dict"]["w"], torch.arange(3.0))
    assert found["global_step"] == 7
    assert [file.name for file in (tmp_path / "new").iterdir()] == ["last.ckpt"]


def test_a_failed_save_leaves_the_old_checkpoint_and_no_litter(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "last.ckpt"
    AtomicCheckpointIO().save_checkpoint(PLAIN, path)
    before = path.read_bytes()
    with pytest.raises(CheckpointError, match=r"last\.ckpt: can't be written: there is a Payload in it"):
        AtomicCheckpointIO().save_checkpoint({**PLAIN, "bad": Payload(tmp_path / "made")}, path)
    monkeypatch.setattr(torch, "save", fails)
    with pytest.raises(OSError, match="no space left"):
        AtomicCheckpointIO().save_checkpoint(PLAIN, path)
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


def test_the_payload_of_these_tests_would_run(tmp_path: Path) -> None:
    pickle.loads(pickle.dumps(Payload(tmp_path / "made")))
    assert (tmp_path / "made").is_dir()


@pytest.mark.parametrize("how", ["torch", "legacy", "pickle"])
def test_a_checkpoint_never_runs_code(tmp_path: Path, how: str) -> None:
    path, hostile = tmp_path / "evil.ckpt", {**PLAIN, "extra": Payload(tmp_path / "made")}
    if how == "pickle":
        path.write_bytes(pickle.dumps(hostile))
    else:
        torch.save(hostile, path, _use_new_zipfile_serialization=how == "torch")
    assert "not a plain checkpoint" in refusal(path)
    assert not (tmp_path / "made").exists()


@pytest.mark.parametrize("share", [0.0, 0.1, 0.5, 0.99])
def test_a_truncated_checkpoint_is_refused(tmp_path: Path, share: float) -> None:
    path = tmp_path / "last.ckpt"
    AtomicCheckpointIO().save_checkpoint({**PLAIN, "large": torch.zeros(10_000)}, path)
    path.write_bytes(path.read_bytes()[: int(share * path.stat().st_size)])
    assert refusal(path).endswith("use one written by plp fit")


def test_a_foreign_file_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "notes.ckpt"
    path.write_text("dear diary,\n\ntoday nothing happened\n")
    assert "not a plain checkpoint" in refusal(path)


@pytest.mark.parametrize("content", [{"state_dict": {}}, {"policy": {}}, [1, 2], torch.zeros(3)])
def test_a_checkpoint_of_another_project_is_refused(tmp_path: Path, content: object) -> None:
    path = tmp_path / "other.ckpt"
    torch.save(content, path)
    assert refusal(path).endswith("has no 'policy' and 'state_dict'; use a checkpoint written by plp fit")


@pytest.mark.parametrize("name", ["absent.ckpt", "."])
def test_a_missing_checkpoint_is_named(tmp_path: Path, name: str) -> None:
    assert "no such checkpoint; name a run directory" in refusal(tmp_path / name)


def draw() -> list[float]:
    return [random.random(), random.gauss(0, 1), np.random.rand(), np.random.randn(), float(torch.rand(()))]


def test_random_states_pass_through_a_plain_checkpoint(tmp_path: Path) -> None:
    draw()  # leaves half of a pair of Gaussian numbers behind in Python and numpy
    torch.save({**PLAIN, "random": RandomState().state_dict()}, tmp_path / "a.ckpt")
    expected = [draw(), draw()]
    resumed = RandomState()
    resumed.load_state_dict(read_checkpoint(tmp_path / "a.ckpt")["random"])
    draw()  # as building loaders might
    resumed.on_train_batch_start(None, None, None, 0)  # type: ignore[arg-type]
    assert draw() == expected[0]
    resumed.on_train_batch_start(None, None, None, 1)  # type: ignore[arg-type]
    assert draw() == expected[1]


def test_without_a_loaded_state_random_numbers_run_on() -> None:
    state = torch.get_rng_state()
    RandomState().on_train_batch_start(SimpleNamespace(world_size=1), None, None, 0)  # type: ignore[arg-type]
    assert torch.equal(state, torch.get_rng_state())


def test_the_random_state_of_a_gpu_is_carried_over(monkeypatch: pytest.MonkeyPatch) -> None:
    """Dropout and noise on a GPU draw from its own generator; here a processor's stands in for it."""
    gpu = torch.Generator().manual_seed(3)
    monkeypatch.setattr(torch.cuda, "is_initialized", lambda: True)
    monkeypatch.setattr(torch.cuda, "get_rng_state", gpu.get_state)
    monkeypatch.setattr(torch.cuda, "set_rng_state", gpu.set_state)
    resumed = RandomState()
    resumed.load_state_dict(RandomState().state_dict())
    drawn = torch.rand(4, generator=gpu)
    resumed.on_train_batch_start(None, None, None, 0)  # type: ignore[arg-type]
    assert torch.equal(torch.rand(4, generator=gpu), drawn)


def test_a_run_that_began_on_a_gpu_goes_on_without_one() -> None:
    resumed = RandomState()
    resumed.load_state_dict(RandomState().state_dict() | {"cuda": torch.get_rng_state()})
    resumed.on_train_batch_start(None, None, None, 0)  # type: ignore[arg-type]
    assert resumed.loaded is None
