"""A checkpoint whose content is not what was saved is never used."""

from __future__ import annotations

import os
import random
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import torch
from command import complaint, plp, results, same, smoke_run, tiny_smoke
from forgery import flip_a_weight

from datamodules.errors import CheckpointError
from plp_lightning.callbacks.checkpointing import AtomicCheckpointIO, content_hash, read_checkpoint
from plp_lightning.runs.directory import RunDirectory

METHODS = ["plp_t", "cdil", "contextual"]


@pytest.fixture(scope="module", params=METHODS)
def finished(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> RunDirectory:
    """A run of a method, with checkpoints after training steps of all kinds."""
    root = tmp_path_factory.mktemp("finished")
    overlay = Path(__file__).parents[2] / "configs" / "methods" / f"{request.param}.yaml"
    blocks = ("--policy.encoder_blocks", "1", "--policy.decoder_blocks", "1")
    small = blocks if request.param == "contextual" else ()
    answer = plp("fit", *tiny_smoke(root), "--config", overlay, "--trainer.max_epochs", "2", *small)
    assert answer.code == 0, answer
    return smoke_run(root, request.param)


def test_any_flipped_bit_is_refused_or_changes_nothing(finished: RunDirectory, tmp_path: Path) -> None:
    file = finished.checkpoint("alignment")
    saved, whole = read_checkpoint(file), file.read_bytes()
    draw, refused = random.Random(0), 0
    for _ in range(150):
        damaged = bytearray(whole)
        damaged[draw.randrange(len(whole))] ^= 1 << draw.randrange(8)
        copy = tmp_path / "last.ckpt"
        copy.write_bytes(damaged)
        try:
            found = read_checkpoint(copy)
        except CheckpointError as error:
            assert "\n" not in str(error)  # noqa: PT017
            refused += 1
        else:
            assert same(found, saved)
    assert refused > 100


def test_every_tensor_and_number_counts(finished: RunDirectory) -> None:
    saved = read_checkpoint(finished.checkpoint("alignment"))
    own = content_hash(saved)
    assert content_hash(saved | {"global_step": saved["global_step"] + 1}) != own
    name, weight = next(iter(saved["state_dict"].items()))
    nudged = weight.clone()
    nudged.view(-1)[0] = torch.nextafter(nudged.view(-1)[0], torch.tensor(torch.inf))
    assert content_hash(saved | {"state_dict": {**saved["state_dict"], name: nudged}}) != own
    assert content_hash(saved | {"state_dict": {**saved["state_dict"], name: weight.double()}}) != own


@pytest.mark.parametrize("verb", ["fit", "test", "validate", "predict"])
def test_no_command_uses_a_damaged_checkpoint(verb: str, finished: RunDirectory, tmp_path: Path) -> None:
    run = RunDirectory(tmp_path / "run")
    shutil.copytree(finished.path, run.path)
    last = [*run.status()["phases"]][-1]
    run.results.unlink()
    status = run.status()
    phases = status["phases"] | {last: status["phases"][last] | {"state": "running"}}
    run.write_json("status.json", status | {"state": "running", "phases": phases})
    flip_a_weight(run.checkpoint(last))
    told = complaint(verb, *(["--resume"] if verb == "fit" else []), run.path)
    assert f"{last}/checkpoints/last.ckpt: its content does not match its hash" in told
    assert not run.results.exists()


def test_a_hash_whose_name_is_damaged_is_missed(tmp_path: Path) -> None:
    AtomicCheckpointIO().save_checkpoint({"policy": {}, "state_dict": {"w": torch.arange(3.0)}}, tmp_path / "x.ckpt")
    whole = (tmp_path / "x.ckpt").read_bytes()
    (tmp_path / "x.ckpt").write_bytes(whole.replace(b"content_sha256", b"content_sha246"))
    with pytest.raises(CheckpointError, match="does not match its hash"):
        read_checkpoint(tmp_path / "x.ckpt")


def test_checkpoints_of_earlier_versions_have_no_hash_and_are_read(tmp_path: Path) -> None:
    content = {"policy": {}, "state_dict": {"w": torch.arange(3.0)}}
    torch.save(content, tmp_path / "old.ckpt")
    assert same(read_checkpoint(tmp_path / "old.ckpt"), content)


def test_all_dtypes_have_hashes() -> None:
    values = [torch.ones(3, dtype=dtype) for dtype in (torch.bfloat16, torch.float16, torch.bool, torch.int64)]
    scalars = [torch.tensor(1.5), torch.zeros(0, 4), torch.ones(4, 6).T]
    assert len({content_hash(value) for value in (*values, *scalars)}) == 7
    assert content_hash([1, 2]) != content_hash((1, 2)) != content_hash([12])


def _holding_itself() -> list[Any]:
    ring: list[Any] = []
    ring.append(ring)
    return ring


# Both were made by one flipped bit of a pickle, the first in one of 8 000.
@pytest.mark.parametrize(
    ("odd", "found"),
    [
        (torch.storage.TypedStorage(2, dtype=torch.float32, _internal=True), "a TypedStorage in it"),
        (_holding_itself(), "something in it holds itself"),
    ],
)
def test_what_no_checkpoint_holds_is_refused_both_ways(odd: Any, found: str, tmp_path: Path) -> None:
    content = {"policy": {}, "state_dict": {"w": torch.arange(3.0)}, "callbacks": {"mine": odd}}
    with pytest.raises(CheckpointError, match=f"{found}; expected tensors and plain data"):
        AtomicCheckpointIO().save_checkpoint(content, tmp_path / "last.ckpt")
    assert not (tmp_path / "last.ckpt").exists()
    torch.save(content, tmp_path / "damaged.ckpt")
    with pytest.raises(CheckpointError, match=f"damaged.ckpt: .*{found}.*; restore the file") as refusal:
        read_checkpoint(tmp_path / "damaged.ckpt")
    assert "\n" not in str(refusal.value)


def test_a_set_has_one_hash_in_every_process() -> None:
    code = "from plp_lightning.callbacks.checkpointing import content_hash; print(content_hash({'a', 'b', 'c', 1}))"
    seeds = ({"PYTHONHASHSEED": seed} for seed in "01")
    told = [subprocess.check_output([sys.executable, "-c", code], env=os.environ | seed) for seed in seeds]
    assert told[0] == told[1]


def test_what_is_loaded_to_go_on_is_checked_too(tmp_path: Path) -> None:
    content = {"policy": {}, "state_dict": {"w": torch.arange(100.0)}}
    AtomicCheckpointIO().save_checkpoint(content, tmp_path / "last.ckpt")
    assert same(AtomicCheckpointIO().load_checkpoint(tmp_path / "last.ckpt"), content)
    flip_a_weight(tmp_path / "last.ckpt")
    with pytest.raises(CheckpointError, match="does not match its hash"):
        AtomicCheckpointIO().load_checkpoint(tmp_path / "last.ckpt")


def test_a_finished_run_is_what_it_was(finished: RunDirectory, tmp_path: Path) -> None:
    run = RunDirectory(tmp_path / "run")
    shutil.copytree(finished.path, run.path)
    run.results.unlink()
    assert plp("fit", "--resume", run.path).code == 0
    assert results(run) == results(finished)
