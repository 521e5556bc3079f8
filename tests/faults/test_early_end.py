"""Training that ended before its last epoch has ended: who is killed before the evaluation trains no step more."""

from __future__ import annotations

import signal
from pathlib import Path

import pytest
from command import checkpoint, dies, plp, results, same, smoke_run, tiny_smoke

STOPPING = ["--callbacks", "[{class_path: EarlyStopping, init_args: {monitor: val/bc, patience: 1, min_delta: 1.0}}]"]
EARLY = {
    "early stopping": [*STOPPING, "--alignment.epochs", "8"],
    "so many steps": ["--trainer.max_steps", "3", "--alignment.epochs", "8"],
}


@pytest.mark.filterwarnings("ignore:.*could not find the monitored key")  # no epoch is whole
@pytest.mark.parametrize("options", EARLY.values(), ids=EARLY)
def test_no_step_more(options: list[str], tmp_path: Path) -> None:
    whole = ["fit", *tiny_smoke(tmp_path / "whole"), *options]
    assert plp(*whole).code == 0
    unbroken = smoke_run(tmp_path / "whole")
    assert checkpoint(unbroken, "alignment")["epoch"] < 7

    broken = ["fit", *tiny_smoke(tmp_path / "broken"), *options]
    assert dies(broken, "plp_lightning.runs.fit:assess", 1, signal.SIGKILL) == -signal.SIGKILL
    run = smoke_run(tmp_path / "broken")
    answer = plp("fit", "--resume", run.path)
    assert answer.code == 0, answer
    for phase in ("alignment", "adaptation"):
        mine, other = checkpoint(run, phase), checkpoint(unbroken, phase)
        assert mine["global_step"] == other["global_step"]
        assert same(mine["state_dict"], other["state_dict"])
    assert results(run) == results(unbroken)
