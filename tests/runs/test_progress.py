from __future__ import annotations

import re
from pathlib import Path

import pytest
from command import plp, tiny_smoke

from plp_lightning.callbacks import evaluation
from plp_lightning.envs.faults import blaming
from plp_lightning.evaluation.simulation import Outcome
from plp_lightning.runs import progress
from plp_lightning.runs.progress import JobProgress


def test_a_log_gets_one_closing_line(capsys: pytest.CaptureFixture[str]) -> None:
    with JobProgress("collecting", 3, "demonstrations") as job:
        job.advance(2, "arm reach")
        job.advance()
    assert re.fullmatch(r"collecting: 3/3 demonstrations, \d+ s, done\n", capsys.readouterr().out)


def test_a_log_gets_a_line_now_and_then(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(progress, "SECONDS_BETWEEN_LINES", -1.0)
    with JobProgress("alignment", 4, "epochs") as job:
        job.advance(1, "held-out loss 0.5")
        job.advance(2)
    lines = re.sub(r"\d+ s", "S s", capsys.readouterr().out).splitlines()
    assert lines == [
        "alignment: 1/4 epochs, S s, held-out loss 0.5",
        "alignment: 3/4 epochs, S s",
        "alignment: 3/4 epochs, S s, done",
    ]


def test_a_job_that_fails_is_not_called_done(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(ValueError, match="no"), JobProgress("collecting", 3, "demonstrations"):
        raise ValueError("no")
    assert capsys.readouterr().out == ""


def test_a_phase_with_nothing_held_out_says_so(tmp_path: Path) -> None:
    answer = plp("fit", *tiny_smoke(tmp_path), "--data.target_trajectories", "1", "--score", "null")
    assert (answer.code, answer.err) == (0, "")
    assert answer.out.count("adaptation: nothing is held out, as none of its tasks has two demonstrations") == 1
    assert "alignment: nothing is held out" not in answer.out
    assert "alignment: \n" not in answer.out


def test_success_of_an_earlier_epoch_says_of_which(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    notes: list[str] = []
    monkeypatch.setattr(JobProgress, "advance", lambda self, count=1, note="": notes.append(note))
    words = ["--phase", "alignment", "--alignment.epochs", "4", "--evaluation.every_n_epochs", "{alignment: 2}"]
    assert plp("fit", *tiny_smoke(tmp_path), *words).code == 0
    told = [re.sub(r"[\d.]+", "N", note.partition(", ")[2]) for note in notes if note.startswith("held-out loss")]
    assert told == ["", "target success N", "target success N (epoch N)", "target success N"]
    assert sum(note.endswith(" (epoch 2)") for note in notes) == 1


def test_an_evaluation_that_fails_is_not_taken_for_the_newest(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    notes, outcomes = list[str](), iter([Outcome(0.5, 2, 0, (0.0, 1.0))])

    def evaluated_once(*_: object) -> dict[str, Outcome]:
        with blaming(evaluated_once):
            return {"target": next(outcomes)}

    monkeypatch.setattr(evaluation, "evaluate_quickly", evaluated_once)
    monkeypatch.setattr(JobProgress, "advance", lambda self, count=1, note="": notes.append(note))
    words = ["--phase", "alignment", "--alignment.epochs", "3", "--evaluation.every_n_epochs", "{alignment: 1}"]
    assert plp("fit", *tiny_smoke(tmp_path), *words).code == 0
    told = [note.partition(", ")[2] for note in notes if note.startswith("held-out loss")]
    assert told == ["target success 0.50", *["target success 0.50 (epoch 1)"] * 2]
