from __future__ import annotations

import re

import pytest

from plp_lightning.runs import progress
from plp_lightning.runs.progress import JobProgress


def test_a_log_gets_one_closing_line(capsys: pytest.CaptureFixture[str]) -> None:
    with JobProgress("collecting", 3, "demonstrations") as job:
        job.advance(2, "arm reach")
        job.advance()
    assert re.fullmatch(r"collecting: 3/3 demonstrations, \d+ s done\n", capsys.readouterr().out)


def test_a_log_gets_a_line_now_and_then(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(progress, "SECONDS_BETWEEN_LINES", -1.0)
    with JobProgress("alignment", 4, "epochs") as job:
        job.advance(1, "held-out loss 0.5")
        job.advance(2)
    lines = re.sub(r"\d+ s", "S s", capsys.readouterr().out).splitlines()
    assert lines == [
        "alignment: 1/4 epochs, S s held-out loss 0.5",
        "alignment: 3/4 epochs, S s",
        "alignment: 3/4 epochs, S s done",
    ]


def test_a_job_that_fails_is_not_called_done(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(ValueError, match="no"), JobProgress("collecting", 3, "demonstrations"):
        raise ValueError("no")
    assert capsys.readouterr().out == ""
