from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
import tiny
from lightning.pytorch import Trainer

from plp_lightning.methods.plp import Alignment
from plp_lightning.runs.directory import RunDirectory
from plp_lightning.runs.stopwatch import Stopwatch


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Callable[[float], None]:
    """Sets the clock."""

    def put(now: float) -> None:
        monkeypatch.setattr("plp_lightning.runs.stopwatch.time.monotonic", lambda: now)

    return put


@pytest.fixture
def run(tmp_path: Path) -> RunDirectory:
    made = RunDirectory.create(tmp_path / "run", "", {})
    made.write_json("status.json", made.status() | {"data_sha256": ""})  # which a run has before its first phase
    return made


def test_time_goes_on_over_interruptions_however_the_block_is_left(
    run: RunDirectory, clock: Callable[[float], None]
) -> None:
    clock(100.0)
    first = Stopwatch(run, "alignment")
    clock(107.0)
    with pytest.raises(KeyError, match="stop"), first.running():
        raise KeyError("stop")
    assert run.phase_record("alignment") == {"seconds": 7.0}
    clock(500.0)
    second = Stopwatch(run, "alignment")
    with second.running():
        clock(503.0)
    assert run.phase_record("alignment") == {"seconds": 10.0}


def test_time_is_written_after_every_epoch(
    run: RunDirectory,
    trajectory_file: Path,
    make_trainer: Callable[..., Trainer],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    seen: list[float] = []
    monkeypatch.setattr(
        RunDirectory, "update_status", lambda self, state, phase, record: seen.append(record["seconds"])
    )
    data = tiny.data_module(trajectory_file, batch_size=1024)
    make_trainer(Stopwatch(run, "alignment"), epochs=3).fit(Alignment(tiny.policy(data), tiny.terms()), datamodule=data)
    assert len(seen) == 3
    assert seen == sorted(seen)
