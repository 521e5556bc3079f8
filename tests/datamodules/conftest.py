from __future__ import annotations

from pathlib import Path

import pytest
from demonstrations import SPECS, TASKS, WHY, demonstrations

from datamodules.store.writer import write_trajectories


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """A small trajectory file."""
    target = tmp_path / "data" / "demos.hdf5"
    write_trajectories(target, SPECS, TASKS, demonstrations(), WHY)
    return target
