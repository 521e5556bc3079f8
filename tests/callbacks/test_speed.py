"""Steps a second: of training alone, whatever else an epoch holds."""

from __future__ import annotations

from types import SimpleNamespace

import pytest
from command import plp, smoke_run, tiny_smoke
from lightning.pytorch import Trainer

from plp_lightning.callbacks import speed
from plp_lightning.callbacks.speed import Speed
from plp_lightning.runs.curves import read_rows
from plp_lightning.steps.loop import ENDS, STARTS, _overrides


class Heard:
    """A logger that keeps what it is told."""

    def __init__(self) -> None:
        self.told: list[tuple[dict[str, float], int]] = []

    def log_metrics(self, metrics: dict[str, float], step: int) -> None:
        self.told.append((metrics, step))


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> SimpleNamespace:
    found = SimpleNamespace(now=100.0)
    monkeypatch.setattr(speed.time, "monotonic", lambda: found.now)
    return found


def trainer_at(step: int) -> Trainer:
    return SimpleNamespace(fit_loop=SimpleNamespace(epoch_loop=SimpleNamespace(_batches_that_stepped=step)))  # type: ignore[return-value]


def validate(callback: Speed, clock: SimpleNamespace) -> None:
    callback.on_validation_start(None, None)
    clock.now += 50
    callback.on_validation_end(None, None)


def test_held_out_losses_and_what_is_between_epochs_are_left_out(clock: SimpleNamespace) -> None:
    heard = Heard()
    callback = Speed([heard])
    validate(callback, clock)  # Lightning's sanity check
    callback.on_train_start(trainer_at(0), None)
    for epoch in (0, 1):
        clock.now += 30
        callback.on_train_epoch_start(trainer_at(20 * epoch), None)
        clock.now += 4
        validate(callback, clock)
        clock.now += 1 + 5 * epoch
        validate(callback, clock)
        callback.on_train_epoch_end(trainer_at(20 * epoch + 20), None)
    assert heard.told == [({"speed/steps_per_second": 4.0}, 19), ({"speed/steps_per_second": 2.0}, 39)]


def test_an_epoch_that_is_resumed_counts_what_it_still_does(clock: SimpleNamespace) -> None:
    heard = Heard()
    callback = Speed([heard])
    callback.on_train_start(trainer_at(15), None)
    clock.now += 2
    callback.on_train_epoch_end(trainer_at(20), None)
    assert heard.told == [({"speed/steps_per_second": 2.5}, 19)]


def test_an_epoch_without_a_step_has_no_speed(clock: SimpleNamespace) -> None:
    heard = Heard()
    callback = Speed([heard])
    callback.on_train_start(trainer_at(20), None)
    callback.on_train_epoch_end(trainer_at(20), None)
    assert heard.told == []


def test_nothing_is_called_around_steps_and_a_runs_own_file_and_results_know_of_no_speed(tmp_path) -> None:
    assert not any(_overrides(Speed([]), name) for name in (STARTS, ENDS))
    assert plp("fit", *tiny_smoke(tmp_path), "--trainer.logger", "CSVLogger").code == 0
    run = smoke_run(tmp_path)
    for phase in run.done_phases():
        assert not [name for _, name, _ in read_rows(run.phase(phase) / "metrics.csv") if "speed" in name]
        (further,) = run.phase(phase).glob("*/version_0/metrics.csv")
        assert "speed/steps_per_second" in further.read_text()
    assert "speed" not in run.results.read_text()
