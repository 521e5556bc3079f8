"""Simulators that raise end their own episodes and are told once; what they give in the wrong shape is told at once."""

from __future__ import annotations

import pickle
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import strange
from command import complaint, plp, results, smoke_run, tiny_smoke

from datamodules.errors import UserError
from datamodules.types import Actor, Observation
from plp_lightning.envs import LinearPoint
from plp_lightning.envs.faults import SimulatorError, unseen
from plp_lightning.envs.rollout import Episodes, rollout
from plp_lightning.envs.synthetic import SeenPoint
from plp_lightning.envs.views import FloorPlan
from plp_lightning.evaluation.behaviour import BehaviourMetric
from plp_lightning.evaluation.simulation import EvalSetting, Outcome, evaluate
from plp_lightning.pictures.films import FilmRecorder, film_figure, film_frames
from plp_lightning.pictures.paths import Panel, PathRecorder, path_figure, path_recorders
from plp_lightning.stopping import PreemptedError

TRIAL, COUNT = EvalSetting("tall", ("goal_0", "goal_1")), 6


class Still:
    """Stays where it is."""

    def actor(self, domain: str, tasks: Sequence[str]) -> Actor:
        return lambda observation, running: np.zeros((len(running), 2), np.float32)


class Heard(BehaviourMetric):
    """Counts what it hears; it knows nothing before episodes begin."""

    name = "heard"

    def begin(self, tasks: Sequence[str], seeds: Sequence[int], observation: Observation[np.ndarray]) -> None:
        self.heard = len(observation.state)

    def step(self, actions: np.ndarray, step: object, episodes: np.ndarray) -> None:
        self.heard += len(episodes)

    def value(self, outcome: Episodes) -> float:
        return float(self.heard)


def evaluated(kind: str, nth: int) -> Outcome:
    return evaluate(Still(), strange.Solving(2, kind, nth), TRIAL, COUNT, seed=0, metrics=[Heard()])


@pytest.mark.parametrize("nth", [2, 4])
@pytest.mark.parametrize("kind", strange.Failing.RAISED)
def test_episodes_of_a_simulator_that_raises_are_invalid(
    kind: str, nth: int, capsys: pytest.CaptureFixture[str]
) -> None:
    found = evaluated(kind, nth)
    solved = nth - 1
    assert (found.success, found.episodes, found.invalid) == (pytest.approx(solved / COUNT), COUNT, COUNT - solved)
    told = capsys.readouterr().err
    name = strange.Failing.RAISED[kind].__name__
    assert told.startswith(f"plp: Solving raised {name} at strange.py:")
    assert told.endswith(": mj_step: stack overflow; its episodes in domain 'tall' that still ran are invalid\n")
    assert told.count("\n") == 1


@pytest.mark.parametrize("nth", [0, 1, 3])
@pytest.mark.parametrize("kind", strange.Failing.RAISED)
def test_no_episode_that_ended_is_no_success_rate(kind: str, nth: int, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SimulatorError, match="no episode in domain 'tall' came to an end: mend the simulator"):
        evaluate(Still(), strange.Failing(2, kind, nth), TRIAL, COUNT, seed=0)
    assert not capsys.readouterr().err


def test_a_fault_is_told_once_for_each_place(capsys: pytest.CaptureFixture[str]) -> None:
    simulator = strange.Solving(2, "raises")
    for _ in range(3):
        evaluate(Still(), simulator, TRIAL, COUNT, seed=0)
    assert capsys.readouterr().err.count("\n") == 1
    simulator.kind = "asserts"
    evaluate(Still(), simulator, TRIAL, COUNT, seed=0)
    evaluate(Still(), simulator, EvalSetting("flat", TRIAL.tasks), COUNT, seed=0)
    assert capsys.readouterr().err.count("\n") == 2
    pickle.loads(pickle.dumps(simulator))


def test_what_was_solved_before_stays_solved() -> None:
    class Late(LinearPoint):
        """Solves episode 0 in its first step, and raises in the second."""

        def step(self, actions: np.ndarray, episodes: np.ndarray) -> Any:
            if 0 not in episodes:
                raise ValueError
            return super().step(actions, episodes)._replace(success=episodes == 0)

    found = evaluate(Still(), Late(2), TRIAL, COUNT, seed=0)
    assert (found.success, found.invalid) == (pytest.approx(1 / COUNT), COUNT - 1)


def test_a_state_that_is_no_number_is_invalid_at_once() -> None:
    found = evaluate(Still(), strange.Failing(2, "nan", 3), TRIAL, COUNT, seed=0, metrics=[Heard()])
    assert (found.success, found.invalid, found.behaviour["heard"]) == (0.0, COUNT, COUNT * 4)


WRONG = [(kind, nth) for kind in strange.OBSERVATIONS if kind != "nan" for nth in (0, 2)]


@pytest.mark.parametrize(("kind", "nth"), [*WRONG, *((kind, 2) for kind in strange.STEPS)])
def test_wrong_shapes_and_types_stop_with_a_line(kind: str, nth: int) -> None:
    with pytest.raises(UserError, match=r"Failing.* expected ") as found:
        evaluate(Still(), strange.Failing(2, kind, nth), TRIAL, COUNT, seed=0)
    assert not isinstance(found.value, SimulatorError)
    assert "\n" not in str(found.value)


@pytest.mark.parametrize(
    ("images", "told"),
    [
        ({}, "images of none; expected camera"),
        (np.zeros((2, 16, 16, 3), np.uint8), "images of type ndarray; expected arrays by name: camera"),
        ({"eye": np.zeros((2, 16, 16, 3), np.uint8)}, "images of eye; expected camera"),
        ({"camera": np.zeros((2, 8, 8, 3), np.uint8)}, r"camera of .*expected shape \(2, 16, 16, 3\), type uint8"),
        ({"camera": np.zeros((2, 16, 16, 3))}, r"camera of .*expected shape \(2, 16, 16, 3\), type uint8"),
    ],
)
def test_wrong_images_stop_with_a_line(images: Any, told: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        SeenPoint, "_observe", lambda self, episodes: Observation(np.zeros((len(episodes), 4), np.float32), images)
    )
    with pytest.raises(UserError, match=rf"SeenPoint gives {told}"):
        evaluate(Still(), SeenPoint(1), EvalSetting("seen", ("red",)), 2, seed=0)


@pytest.mark.parametrize("error", [UserError("mend me"), PreemptedError(15), KeyboardInterrupt(), MemoryError()])
def test_what_is_not_the_simulators_fault_passes(error: BaseException, monkeypatch: pytest.MonkeyPatch) -> None:
    def stop(*_: object) -> None:
        raise error

    monkeypatch.setattr(LinearPoint, "step", stop)
    with pytest.raises(type(error)):
        evaluate(Still(), LinearPoint(2), TRIAL, COUNT, seed=0)


def test_without_anybody_to_tell_a_fault_ends_the_rollout_in_a_line() -> None:
    with pytest.raises(
        SimulatorError, match=r"Failing raised RuntimeError at strange\.py:\d+: mj_step: stack overflow"
    ):
        rollout(strange.Failing(2, "raises"), Still().actor("", ()), ["goal_0"], [0])


@pytest.mark.parametrize("nth", [0, 1, 2])
def test_pictures_survive(nth: int) -> None:
    simulator = strange.Failing(2, "raises", nth)
    plan = FloorPlan(np.zeros((1, 2)), 1.0, {"goal_0": (0.0, 0.0)}, 0.1)
    paths, films = PathRecorder(simulator, plan), FilmRecorder(2)
    rollout(simulator, Still().actor("", ()), ["goal_0"] * 3, [0, 1, 2], 0, [paths], lambda fault: None)
    assert [len(path) for path in paths.paths.positions] == [max(1, nth)] * 3
    path_figure([Panel("title", plan, paths.paths)])
    films.begin(["red"] * 2, [0, 1], unseen(SeenPoint(1).spec("seen"), 2))
    reels = {"title": films.films(2)}
    film_figure(reels)
    assert len(film_frames(reels)) == 1


def test_a_plan_or_place_that_a_simulator_fails_to_give_is_left_away(capsys: pytest.CaptureFixture[str]) -> None:
    class Lost(LinearPoint):
        def floor_plan(self) -> FloorPlan:
            raise LookupError("no plan")

        def shared_position(self, state: np.ndarray) -> np.ndarray:
            raise LookupError("nowhere")

    assert path_recorders({"tall": Lost(2)}, {"target": TRIAL}) == {}
    recorder = PathRecorder(Lost(2), FloorPlan(np.zeros((1, 2)), 1.0, {"goal_0": (0.0, 0.0)}, 0.1))
    rollout(recorder.simulator, Still().actor("", ()), ["goal_0"], [0], 0, [recorder])  # type: ignore[arg-type]
    assert np.isnan(recorder.paths.positions[0]).all()
    assert [line.rsplit(": ", 1)[1] for line in capsys.readouterr().err.splitlines()] == [
        "no plan; its paths are not drawn",
        "nowhere; its paths are not drawn",
    ]


FAILING = ["--allow_imports", "strange", "--domains.tall.simulator", "strange.Failing"]
FAILING += ["--domains.tall.simulator.map_seed", "2", "--domains.tall.simulator.state_size", "7"]


OFTEN = ["--evaluation.every_n_epochs.alignment", 1, "--evaluation.every_n_epochs.adaptation", 1]


def test_a_run_goes_on_when_a_simulator_raises(tmp_path: Path) -> None:
    solving = [word.replace("Failing", "Solving") for word in FAILING]
    answer = plp("fit", *tiny_smoke(tmp_path), *solving, "--domains.tall.simulator.kind", "raises", *OFTEN)
    assert answer.code == 0, answer
    found = results(smoke_run(tmp_path))
    assert [(found[name]["success"], found[name]["invalid"]) for name in ("target", "proxy")] == [(0.5, 2)] * 2
    assert found["source"]["invalid"] == 0
    told = [line for line in answer.out.splitlines() if "episodes are invalid and count as failed" in line]
    assert [line.split(": ")[:2] for line in told] == [
        [f"{tasks} in target domain", "2 of 4 episodes are invalid and count as failed"]
        for tasks in ("target task", "proxy tasks")
    ]
    assert answer.err.count("Solving raised RuntimeError") == 1
    assert "Traceback" not in answer.err


def test_a_run_whose_simulator_always_raises_has_no_result(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    words = [*tiny_smoke(tmp_path), *FAILING, "--domains.tall.simulator.kind", "raises"]
    assert "came to an end: mend the simulator, then go on" in complaint("fit", *words)
    run = smoke_run(tmp_path)
    assert run.status()["state"] == "failed"
    monkeypatch.setattr(strange.Failing, "step", LinearPoint.step)  # mended
    answer = plp("fit", "--resume", run.path, "--allow_imports", "strange")
    assert answer.code == 0, answer


def test_evaluations_in_between_are_left_away(tmp_path: Path) -> None:
    answer = plp("fit", *tiny_smoke(tmp_path), *FAILING, "--domains.tall.simulator.kind", "raises", *OFTEN)
    assert answer.code == 2
    assert answer.err.count("this evaluation is left away") == 1


def test_a_run_stops_when_a_simulator_gives_wrong_shapes(tmp_path: Path) -> None:
    told = complaint("fit", *tiny_smoke(tmp_path), *FAILING, "--domains.tall.simulator.kind", "wide states")
    assert "Failing gives state of shape (4, 14), type float32; expected shape (4, 7), type float32" in told


def test_scores_that_a_simulator_fails_to_support_are_left_away(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def lost(self: LinearPoint, state: np.ndarray) -> np.ndarray:
        raise LookupError("nowhere")

    monkeypatch.setattr(LinearPoint, "shared_position", lost)
    answer = plp("fit", *tiny_smoke(tmp_path), "--evaluation.latent_states", 10)
    assert answer.code == 0, answer
    run = smoke_run(tmp_path)
    assert results(run)["alignment"] == {}
    assert (run.phase("alignment") / "latents.png").exists()
    told = [line for line in answer.err.splitlines() if "nowhere" in line]
    assert len(told) == len({*told})
    assert any("alignment scores that need it are left away" in line for line in told)
    assert any("latent states are not joined" in line for line in told)
