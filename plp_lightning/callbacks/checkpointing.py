"""Checkpoints that are complete or absent, are what was saved, hold plain data only and can be gone on from exactly."""

from __future__ import annotations

import contextlib
import hashlib
import io
import os
import random
import warnings
from collections.abc import Callable, Mapping
from difflib import get_close_matches
from pathlib import Path
from typing import Any

import numpy as np
import torch
from lightning.fabric.plugins.io import TorchCheckpointIO
from lightning.pytorch import Callback, LightningModule, Trainer
from lightning.pytorch.callbacks import ModelCheckpoint

from datamodules.errors import CheckpointError
from datamodules.store.atomic import locked_folder, replacing

HASH = "content_sha256"
LAST = "last.ckpt"
PLAIN = bool | int | float | complex | str | bytes | torch.dtype | torch.device | None


class AtomicCheckpointIO(TorchCheckpointIO):
    """Writes beside the final place, syncs, then moves; Lightning's own copy can be seen half written.

    A checkpoint holds the hash of its content, for neither torch nor the disk notices a flipped bit.
    """

    def save_checkpoint(
        self, checkpoint: dict[str, Any], path: str | os.PathLike[str], storage_options: Any = None
    ) -> None:
        """Write ``checkpoint`` to ``path`` in one visible step.

        Raises:
            CheckpointError: If it cannot be written, to a full disk for instance, or holds something that
                :func:`read_checkpoint` would refuse; an older one stays.
        """
        final, content = Path(path), io.BytesIO()
        try:
            own = content_hash(checkpoint)
        except CheckpointError as error:
            raise CheckpointError(f"{final}: can't be written: {error}; save no such state in callbacks") from None
        torch.save({**checkpoint, HASH: own}, content)  # torch's own writer to disk hides why a disk refuses
        try:
            final.parent.mkdir(parents=True, exist_ok=True)
            with locked_folder(final.parent), replacing(final) as temporary:
                temporary.write_bytes(content.getbuffer())
                if final.name == LAST and final.exists():
                    _keep(final)
        except OSError as error:
            raise CheckpointError(
                f"{final}: can't be written ({error.strerror}); expected room for {content.tell()} bytes: "
                "free some, then go on with plp fit --resume RUN_DIR"
            ) from None

    def load_checkpoint(
        self, path: str | os.PathLike[str], map_location: Any = None, weights_only: bool | None = None
    ) -> dict[str, Any]:
        """Read a checkpoint onto the processor, as :func:`read_checkpoint` does."""
        return read_checkpoint(Path(path))


def previous_checkpoint(last: Path) -> Path:
    """Place of the checkpoint before the last one of a phase that is not done: it takes over if that is damaged."""
    return last.with_name(f"{last.name}.previous")


def _keep(last: Path) -> None:
    """Let the last checkpoint be the one before: a second name, so that nothing is copied."""
    previous = previous_checkpoint(last)
    previous.unlink(missing_ok=True)
    with contextlib.suppress(OSError):  # a file system without such links keeps none
        os.link(last, previous)


def content_hash(value: Any) -> str:
    """SHA-256 of plain data: tensors, by dtype, shape and bytes, and all else as Python writes it down.

    Raises:
        CheckpointError: If there is something else in it, or it holds itself. A damaged file may load as either.
    """
    digest = hashlib.sha256()
    try:
        _feed(digest.update, value)
    except RecursionError:
        raise CheckpointError("something in it holds itself; expected tensors and plain data") from None
    return digest.hexdigest()


def _feed(update: Callable[[bytes | memoryview], None], value: Any) -> None:
    if isinstance(value, torch.Tensor):
        if value.numel() * value.element_size() > value.untyped_storage().nbytes():
            raise CheckpointError(f"a tensor of shape {tuple(value.shape)} is larger than what is stored of it")
        update(f"tensor {value.dtype} {tuple(value.shape)};".encode())
        update(value.detach().cpu().contiguous().reshape(-1).view(torch.uint8).numpy().data)
    elif isinstance(value, Mapping):
        update(f"mapping {len(value)};".encode())
        for pair in value.items():
            _feed(update, pair)
    elif isinstance(value, list | tuple):
        update(f"{'list' if isinstance(value, list) else 'tuple'} {len(value)};".encode())
        for item in value:
            _feed(update, item)
    elif isinstance(value, set | frozenset):  # in no order of its own from one process to the next
        _feed(update, ("set", sorted(map(content_hash, value))))
    elif isinstance(value, PLAIN):
        update(f"{value!r};".encode())
    else:
        raise CheckpointError(f"there is a {type(value).__name__} in it; expected tensors and plain data")


def read_checkpoint(path: Path) -> dict[str, Any]:
    """Load a checkpoint that holds nothing but tensors and plain data.

    Raises:
        CheckpointError: If it is missing, damaged, no checkpoint of this project, or would run code. Damage to a
            checkpoint of an earlier version, which holds no hash, may go unnoticed.
    """
    if not path.is_file():
        raise CheckpointError(f"{path}: no such checkpoint; name a run directory with checkpoints/last.ckpt in a phase")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of torch, on what it is about to refuse
            checkpoint: dict[str, Any] = torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:  # torch raises many kinds for a damaged or hostile file
        reason = str(error).replace("\n", " ").split(". ")[0][:160]
        raise CheckpointError(f"{path}: not a plain checkpoint ({reason}); use one written by plp fit") from None
    if not isinstance(checkpoint, dict) or not {"policy", "state_dict"} <= checkpoint.keys():
        raise CheckpointError(f"{path}: has no 'policy' and 'state_dict'; use a checkpoint written by plp fit")
    saved, remedy = checkpoint.pop(HASH, None), "restore the file, or begin a new run"
    try:
        # An older one has no hash, and no key of almost that name either, which a single flipped bit would leave.
        matching = saved in (None, content_hash(checkpoint)) and not get_close_matches(HASH, map(str, checkpoint))
    except CheckpointError as error:
        raise CheckpointError(f"{path}: {error}; {remedy}") from None
    if not matching:
        raise CheckpointError(f"{path}: its content does not match its hash, so the file is damaged; {remedy}")
    return checkpoint


class RandomState(Callback):
    """Carries the random state over an interruption.

    It is put back at the first batch after loading, because building loaders draws random numbers too. Other ranks
    take that of rank 0 at the first batch of every epoch: rank 0 alone may have drawn in between.
    """

    def __init__(self) -> None:
        self.loaded: dict[str, Any] | None = None

    def state_dict(self) -> dict[str, Any]:
        name, keys, *rest = np.random.get_state(legacy=True)
        state = {"torch": torch.get_rng_state(), "python": random.getstate(), "numpy": (name, keys.tolist(), *rest)}  # type: ignore[union-attr]
        return state | ({"cuda": torch.cuda.get_rng_state()} if torch.cuda.is_initialized() else {})

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        self.loaded = state_dict

    def on_train_batch_start(self, trainer: Trainer, pl_module: LightningModule, batch: Any, batch_idx: int) -> None:
        if self.loaded is None and batch_idx == 0 and trainer.world_size > 1:
            state = trainer.strategy.broadcast(self.state_dict())
            self.loaded = None if trainer.is_global_zero else state
        if self.loaded is None:
            return
        torch.set_rng_state(self.loaded["torch"])
        if "cuda" in self.loaded and torch.cuda.is_initialized():
            torch.cuda.set_rng_state(self.loaded["cuda"])
        version, internal, gauss = self.loaded["python"]
        random.setstate((version, tuple(internal), gauss))
        name, keys, position, has_gauss, cached = self.loaded["numpy"]
        np.random.set_state((name, np.array(keys, dtype=np.uint32), position, has_gauss, cached))
        self.loaded = None


class Owner(Callback):
    """Writes into a phase's checkpoints whose they are, and takes those of no other run or phase to go on from.

    Args:
        path: The phase's last checkpoint, for messages.
        run: Hash of the run's configuration; None if the run is older than that record.
        phase: Name of the phase.
    """

    def __init__(self, path: Path, run: str | None, phase: str) -> None:
        self.path, self.run, self.phase = path, run, phase

    def on_save_checkpoint(self, trainer: Trainer, pl_module: LightningModule, checkpoint: dict[str, Any]) -> None:
        checkpoint["owner"] = {"run": self.run, "phase": self.phase}
        # What has ended before its last epoch, by a callback or a time limit, must not go on when it is resumed.
        checkpoint["stopped"] = trainer.should_stop and trainer.fit_loop._can_stop_early

    def on_load_checkpoint(self, trainer: Trainer, pl_module: LightningModule, checkpoint: dict[str, Any]) -> None:
        check_owner(checkpoint, self.path, self.run, self.phase)


def check_owner(checkpoint: Mapping[str, Any], path: Path, run: str | None, phase: str) -> None:
    """Refuse, by a :class:`CheckpointError`, a checkpoint that says that it is of another run or phase."""
    owner: Mapping[str, str | None] = checkpoint.get("owner") or {}
    for what, found, own in (("run", owner.get("run"), run), ("phase", owner.get("phase"), phase)):
        if found not in (None, own):
            expected = own[:12] if own else "one that is known by no hash"
            raise CheckpointError(f"{path}: is of another {what} ({found[:12]}, expected {expected}); restore the file")


class BestCheckpoint(ModelCheckpoint):
    """Writes ``best.ckpt`` into a folder, by the held-out loss that is named."""

    state_key = (
        "ModelCheckpoint{'monitor': 'val/bc', 'mode': 'min', 'every_n_train_steps': 0, 'every_n_epochs': 1, "
        "'train_time_interval': None}"
    )
    """The same whatever the loss is called: Lightning's own holds the name, and names have changed since some runs
    began, which would forget their best when they are resumed."""

    def __init__(self, folder: Path, monitor: str, after_validation: bool = True) -> None:
        when: dict[str, Any] = {} if after_validation else {"save_on_train_epoch_end": True}
        super().__init__(folder, "best", monitor=monitor, save_top_k=1, enable_version_counter=False, **when)


def best_and_last(folder: Path, monitor: str | None, after_validation: bool = True) -> list[ModelCheckpoint]:
    """``best.ckpt`` by held-out loss and ``last.ckpt``; one callback for both would let "last" fall behind.

    If nothing is held out, there is no loss to ``monitor`` and no best. It is known ``after_validation``, or at the end
    of an epoch.
    """
    always: dict[str, Any] = {"every_n_epochs": 1, "save_on_train_epoch_end": True, "enable_version_counter": False}
    last = ModelCheckpoint(folder, "last", monitor=None, save_top_k=1, **always)
    return [last] if monitor is None else [BestCheckpoint(folder, monitor, after_validation), last]
