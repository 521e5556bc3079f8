from __future__ import annotations

from types import SimpleNamespace

import pytest
from command import checkpoint, plp, same, smoke_run, tiny_smoke

from plp_lightning.callbacks import evaluation
from plp_lightning.callbacks.evaluation import SimulatorEvaluation
from plp_lightning.runs.curves import read_rows


def run_epochs(
    callback: SimulatorEvaluation, monkeypatch: pytest.MonkeyPatch, seconds: float, cost: float, epochs: int = 60
) -> list[int]:
    """Epochs after which ``callback`` evaluated, on a clock where both durations are exact."""
    clock, turns = SimpleNamespace(now=0.0), []

    def evaluate(trainer: object, phase: object) -> None:
        turns.append(epoch)
        clock.now += cost

    monkeypatch.setattr(evaluation.time, "monotonic", lambda: clock.now)
    monkeypatch.setattr(evaluation, "Phase", object)
    monkeypatch.setattr(callback, "_evaluate", evaluate)
    callback.on_train_start(None, None)
    alone = SimpleNamespace(broadcast=lambda found: found)
    for epoch in range(1, epochs + 1):
        clock.now += seconds
        trainer = SimpleNamespace(current_epoch=epoch - 1, max_epochs=epochs, strategy=alone)
        callback.on_train_epoch_end(trainer, object())
    return turns


def test_evaluates_every_n_epochs(monkeypatch):
    callback = SimulatorEvaluation({}, {}, 1, every_n_epochs=20, seed=0)
    assert run_epochs(callback, monkeypatch, seconds=1, cost=100) == [20, 40, 60]


def test_zero_leaves_it_to_the_end(monkeypatch):
    callback = SimulatorEvaluation({}, {}, 1, every_n_epochs=0, seed=0)
    assert run_epochs(callback, monkeypatch, seconds=100, cost=0.1) == []


def test_every_epoch_where_it_costs_under_a_tenth(monkeypatch):
    callback = SimulatorEvaluation({}, {}, 1, every_n_epochs=None, seed=0)
    assert run_epochs(callback, monkeypatch, seconds=11, cost=1) == list(range(1, 61))


def test_dear_evaluations_take_a_tenth_of_the_time_and_at_tenths_of_the_epochs_a_fifth(monkeypatch):
    callback = SimulatorEvaluation({}, {}, 1, every_n_epochs=None, seed=0)
    assert run_epochs(callback, monkeypatch, seconds=10, cost=20) == [1, 12, 24, 36, 42, 54]
    assert callback.spent <= 0.2 * 60 * 10


@pytest.mark.parametrize("cost", [0.01, 0.5])
@pytest.mark.parametrize(("epochs", "expected"), [(4, 4), (10, 10), (19, 19), (25, 12), (100, 10)])
def test_cheap_evaluations_in_short_epochs_give_ten_points(epochs: int, expected: int, cost: float, monkeypatch):
    callback = SimulatorEvaluation({}, {}, 1, every_n_epochs=None, seed=0)
    turns = run_epochs(callback, monkeypatch, seconds=0.01, cost=cost, epochs=epochs)
    step = max(1, epochs // 10)
    assert {*range(step, epochs + 1, step)} <= {*turns}
    assert len(turns) >= expected


def test_an_evaluation_that_takes_longer_than_all_training_comes_once(monkeypatch):
    callback = SimulatorEvaluation({}, {}, 1, every_n_epochs=None, seed=0)
    assert run_epochs(callback, monkeypatch, seconds=1, cost=1000) == [6]


def test_curves_of_success_have_ten_points_in_both_domains_and_phases_and_cost_no_weight(tmp_path):
    epochs = ["--alignment.epochs", "11", "--adaptation.epochs", "11", "--score", "[]"]
    for name, often in {"default": "{}", "never": "0"}.items():
        answer = plp("fit", *tiny_smoke(tmp_path / name), *epochs, "--evaluation.every_n_epochs", often)
        assert answer.code == 0, answer
    one, other = smoke_run(tmp_path / "default"), smoke_run(tmp_path / "never")
    for phase in ("alignment", "adaptation"):
        metrics = [name for _, name, _ in read_rows(one.phase(phase) / "metrics.csv")]
        assert metrics.count("eval/target_success") == metrics.count("eval/source_success") == 11
        assert same(checkpoint(one, phase)["state_dict"], checkpoint(other, phase)["state_dict"])
