"""Running out of memory is one line, whoever notices it, and the run can be gone on with."""

from __future__ import annotations

from pathlib import Path
from typing import NoReturn

import numpy as np
import pytest
import torch
from command import complaint, plp, smoke_run, tiny_smoke

from plp_lightning.methods.plp.alignment import Alignment


def _of_numpy() -> NoReturn:
    np.empty(2**50)
    raise AssertionError


def _of_torch() -> NoReturn:
    torch.empty(2**50)
    raise AssertionError


def _of_cuda() -> NoReturn:
    raise torch.OutOfMemoryError("CUDA out of memory. Tried to allocate 20.00 GiB. GPU 0 has a total capacity …")


def _of_python() -> NoReturn:
    raise MemoryError


@pytest.mark.parametrize("allocate", [_of_numpy, _of_torch, _of_cuda, _of_python])
def test_it_is_told_in_one_line(allocate: object, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with monkeypatch.context() as patch:
        patch.setattr(Alignment, "training_step", lambda *_: allocate())  # type: ignore[operator]
        told = complaint("fit", *tiny_smoke(tmp_path))
    assert told.startswith("plp: out of memory (")
    assert "then plp fit --resume RUN_DIR" in told
    run = smoke_run(tmp_path)
    assert run.status()["state"] == "failed"
    assert plp("fit", "--resume", run.path).code == 0


def test_other_faults_of_the_program_are_not_hidden(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_: object) -> NoReturn:
        raise RuntimeError("shapes cannot be multiplied")

    monkeypatch.setattr(Alignment, "training_step", broken)
    with pytest.raises(RuntimeError, match="shapes cannot be multiplied"):
        plp("fit", *tiny_smoke(tmp_path))
