from __future__ import annotations

from types import SimpleNamespace

import pytest

from plp_lightning.callbacks import evaluation
from plp_lightning.callbacks.evaluation import SimulatorEvaluation


def run_epochs(
    callback: SimulatorEvaluation, monkeypatch: pytest.MonkeyPatch, seconds: float, cost: float
) -> list[int]:
    """Epochs (of 60) after which ``callback`` evaluated, on a clock where both durations are exact."""
    clock, turns = SimpleNamespace(now=0.0), []

    def evaluate(trainer: object, phase: object) -> None:
        turns.append(epoch)
        clock.now += cost

    monkeypatch.setattr(evaluation.time, "monotonic", lambda: clock.now)
    monkeypatch.setattr(evaluation, "Phase", object)
    monkeypatch.setattr(callback, "_evaluate", evaluate)
    callback.on_train_start(None, None)
    for epoch in range(1, 61):
        clock.now += seconds
        callback.on_train_epoch_end(SimpleNamespace(current_epoch=epoch - 1), object())
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


def test_dear_evaluations_take_a_tenth_of_the_time(monkeypatch):
    callback = SimulatorEvaluation({}, {}, 1, every_n_epochs=None, seed=0)
    assert run_epochs(callback, monkeypatch, seconds=10, cost=20) == [1, 21, 41]
