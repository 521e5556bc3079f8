"""What all tests share: one thread, no screen, and one small trajectory file for the whole session."""

from __future__ import annotations

import gc
import os

# Before any library starts its threads or its plots.
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("MPLBACKEND", "Agg")

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import seen
import tiny
import torch
from hypothesis import settings
from lightning.pytorch import Callback, Trainer

from datamodules.store.writer import write_trajectories
from plp_lightning.callbacks.checkpointing import AtomicCheckpointIO
from plp_lightning.runs.trainer import quiet_lightning

torch.set_num_threads(1)
settings.register_profile("plp", deadline=None, derandomize=True, database=None)
settings.load_profile("plp")


@pytest.fixture(scope="session", autouse=True)
def _in_a_hurry() -> Iterator[None]:
    """What was imported stays, so it is not searched for garbage; no test cuts the power, so none waits for a disk."""
    gc.collect()
    gc.freeze()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "fsync", lambda descriptor: None)
        yield


@pytest.fixture(scope="session")
def trajectory_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four demonstrations of each task in both synthetic domains: of the target in the target domain too."""
    path = tmp_path_factory.mktemp("data") / "synthetic.hdf5"
    specs = [domain.simulator.spec(name) for name, domain in tiny.domains().items()]
    write_trajectories(path, specs, tiny.TASKS, tiny.demonstrations(4), {"command": "tests"})
    return path


@pytest.fixture(scope="session")
def seen_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Demonstrations of each task in both synthetic domains with cameras."""
    path = tmp_path_factory.mktemp("data") / "seen.hdf5"
    seen.write(path)
    return path


@pytest.fixture
def format_1_0() -> Path:
    """A file of format 1.0: four demonstrations of each task in both synthetic domains with cameras."""
    return Path(__file__).parent / "datamodules" / "golden" / "format_1_0.hdf5"


@pytest.fixture
def make_trainer(tmp_path: Path) -> Callable[..., Trainer]:
    """Lightning's Trainer as runs have it, without loggers unless they are given."""

    def make(*callbacks: Callback, epochs: int = 2, logger: object = False) -> Trainer:
        quiet_lightning()
        return Trainer(
            accelerator="cpu",
            max_epochs=epochs,
            default_root_dir=tmp_path,
            logger=logger,
            callbacks=list(callbacks),
            plugins=[AtomicCheckpointIO()],
            enable_checkpointing=any(type(c).__name__ == "ModelCheckpoint" for c in callbacks),
            enable_progress_bar=False,
            enable_model_summary=False,
            log_every_n_steps=1,
        )

    return make
