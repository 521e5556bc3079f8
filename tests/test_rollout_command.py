"""``plp rollout``: films of a run's episodes, failures first, and the success that they come from."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
import strange
from command import finished_smoke, plp, results, tiny_smoke
from PIL import Image, ImageSequence

from datamodules.types import Actor
from plp_lightning.cli import rollout as verb
from plp_lightning.envs import LinearPoint, LinearPointExpert
from plp_lightning.evaluation.simulation import EvalSetting
from plp_lightning.runs import rollouts
from plp_lightning.runs.directory import RunDirectory
from plp_lightning.runs.rollouts import Scene

FEW = ["--episodes", "1", "--among", "2", "--size", "16", "16"]


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> RunDirectory:
    return finished_smoke(tmp_path_factory.mktemp("rollout"))


class Skilled:
    """Acts as the expert, but stands still in some episodes."""

    acts_in, tasks = ("tall",), LinearPoint(2).tasks.names

    def __init__(self, simulator: LinearPoint, still: Sequence[int]) -> None:
        self.simulator, self.still = simulator, still

    def actor(self, domain: str, tasks: Sequence[str]) -> Actor:
        expert = LinearPointExpert()
        expert.begin(self.simulator, tasks, [0] * len(tasks))
        return lambda seen, running: expert.act(seen, running) * ~np.isin(running, self.still)[:, None]


def scene(simulator: LinearPoint, size: tuple[int, int] = (32, 32)) -> Scene:
    return Scene(simulator, EvalSetting("tall", ("goal_0", "goal_1")), "both", 3, size)


def test_failures_come_first_and_their_films_are_of_what_was_run(tmp_path: Path) -> None:
    told = scene(LinearPoint(2, state_size=7))
    outcome, taken = told.run(Skilled(told.simulator, (1, 4)), 6)  # type: ignore[arg-type]
    assert (outcome.success, outcome.episodes) == (pytest.approx(4 / 6), 6)
    found = [(episode.number, episode.end, episode.task) for episode in taken]
    assert found[:3] == [(1, "failed", "goal_1"), (4, "failed", "goal_0"), (0, "solved", "goal_0")]
    failed, solved = told.film(taken[0], tmp_path), told.film(taken[2], tmp_path)
    assert failed["files"] == [f"tall_both_seed_3_failed_001{form}" for form in (".mp4", ".gif")]
    assert solved["files"] == [f"tall_both_seed_3_solved_000{form}" for form in (".mp4", ".gif")]
    assert sorted(file.name for file in tmp_path.iterdir()) == sorted([*failed["files"], *solved["files"]])
    for record, corner in ((failed, (213, 94, 0)), (solved, (0, 114, 178))):
        with Image.open(tmp_path / record["files"][1]) as film:
            shown = [
                (frame.info["duration"], np.asarray(frame.convert("RGB"))) for frame in ImageSequence.Iterator(film)
            ]
        times, frames = zip(*shown, strict=True)
        assert sum(times) == 100 * record["steps"] + 1000  # alike frames are one, which stays as long
        assert np.abs(frames[0][-1, -1].astype(int) - corner).max() < 10
        assert (frames[0][:32] < 128).any()  # there is text above


def test_a_film_of_the_same_episode_from_another_time_is_not_left(tmp_path: Path) -> None:
    told = scene(LinearPoint(2, state_size=7))
    for still, end in (((0,), "failed"), ((), "solved")):
        _, taken = told.run(Skilled(told.simulator, still), 1)  # type: ignore[arg-type]
        told.film(taken[0], tmp_path)
        assert {file.stem for file in tmp_path.iterdir()} == {f"tall_both_seed_3_{end}_000"}


def test_episodes_in_which_the_simulator_raised_are_filmed_as_far_as_they_went(tmp_path: Path) -> None:
    told = scene(strange.Solving(2, "raises", 4))
    outcome, taken = told.run(Skilled(told.simulator, ()), 6)  # type: ignore[arg-type]
    assert outcome.invalid == 3
    told.simulator.kind = "nan"  # type: ignore[attr-defined]
    told.simulator.nth = 99  # type: ignore[attr-defined]
    record = told.film(taken[0]._replace(end="diverged"), tmp_path)
    assert (taken[0].end, record["steps"]) == ("diverged", 3)


def test_a_simulator_whose_episodes_do_not_follow_from_their_seed_is_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    told = scene(LinearPoint(2, state_size=7))
    _, taken = told.run(Skilled(told.simulator, ()), 1)  # type: ignore[arg-type]
    record = told.film(taken[0]._replace(seed=taken[0].seed + 1, actions=0 * taken[0].actions), tmp_path)
    assert record["end"] == "failed"
    assert capsys.readouterr().err.startswith("plp: LinearPoint: episode 0 was solved, and is failed when it is run ag")


def test_films_of_a_run_lie_in_it_with_the_success_that_it_had(run: RunDirectory) -> None:
    answer = plp("rollout", run.path, "--episodes", "2", "--size", "20", "30")
    assert answer.code == 0, answer
    target, folder = results(run)["target"], run.path / "rollouts"
    assert f"goal_3 in tall: success {target['success']:.2f} " in answer.out
    record = json.loads((folder / "tall_goal_3_seed_0.json").read_text())
    assert [record[name] for name in ("success", "interval", "episodes")] == [
        target[name] for name in ("success", "interval", "episodes")
    ]
    assert record["checkpoint"] == str(run.checkpoint("adaptation"))
    assert len(record["films"]) == 2
    for film in record["films"]:
        assert all((folder / name).is_file() for name in film["files"])
        assert str(folder / film["files"][0]) in answer.out
        with Image.open(folder / film["files"][1]) as image:
            assert image.size == (9 * 30 + 8, 32 + 9 * 20 + 8)


def test_domain_task_seed_and_place_are_free(run: RunDirectory, tmp_path: Path) -> None:
    options = ["--domain", "flat", "--task", "goal_5", "--seed", "9", "--out", tmp_path / "new" / "films"]
    answer = plp("rollout", run.path, *FEW, *options)
    assert answer.code == 0, answer
    record = json.loads((tmp_path / "new" / "films" / "flat_goal_5_seed_9.json").read_text())
    assert [record[name] for name in ("domain", "task", "seed", "episodes")] == ["flat", "goal_5", 9, 2]


def test_a_checkpoint_and_files_will_do(run: RunDirectory, tmp_path: Path) -> None:
    words = [*tiny_smoke(tmp_path), "--checkpoint", run.checkpoint("alignment"), "--out", tmp_path]
    answer = plp("rollout", *words, *FEW)
    assert answer.code == 0, answer
    assert (tmp_path / "tall_goal_3_seed_0.json").is_file()


def test_without_the_package_for_mp4_a_line_says_how_to_get_it(
    run: RunDirectory, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for module in (rollouts, verb):
        monkeypatch.setattr(module, "makes_mp4", lambda: False)
    answer = plp("rollout", run.path, *FEW, "--out", tmp_path)
    assert answer.code == 0, answer
    assert answer.err == "plp: films are GIF alone; for mp4 as well: pip install 'plp-lightning[video]'\n"
    assert {file.suffix for file in tmp_path.iterdir()} == {".gif", ".json"}
