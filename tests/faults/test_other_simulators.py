"""A domain that differs between file, simulator and checkpoint is told in one line, before anything slow."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import strange
import tiny
import torch
from command import SMOKE, TINY, checkpoint, complaint, data_root, finished_smoke, plp, smoke_run, tiny_smoke

import plp_lightning
from datamodules.errors import CheckpointError, ConfigError, TrajectoryFileError
from datamodules.store.reader import TrajectoryFile
from datamodules.store.writer import write_trajectories
from datamodules.types import DomainSpec, Observation, ObservationKey, Trajectory
from plp_lightning.envs import LinearPoint, PointMaze, Reach, Simulator, WalkerMaze, Window
from plp_lightning.envs.lift.simulator import Lift
from plp_lightning.envs.synthetic import SeenPoint
from plp_lightning.evaluation.scores import places_of
from plp_lightning.evaluation.simulation import EvalSetting, evaluate
from plp_lightning.runs import collection
from plp_lightning.runs.directory import RunDirectory
from plp_lightning.runs.policies import load_policy
from plp_lightning.runs.specs import check_checkpoint, check_file

A, B = ObservationKey("a", (1,), unit="m"), ObservationKey("b", (2,))
EYE = ObservationKey("eye", (8, 8, 3), kind="image")
ARM = DomainSpec("arm", (A, B, EYE), 2, 10.0, "arm, noise 1")
CHANGES: dict[str, tuple[DomainSpec, str]] = {
    "order": (replace(ARM, observation=(B, A, EYE)), "keys b, a, eye .*expected a, b, eye"),
    "names": (replace(ARM, observation=(A, replace(B, name="c"), EYE)), "keys a, c, eye .*expected a, b, eye"),
    "fewer": (replace(ARM, observation=(A, B)), "keys a, b .*expected a, b, eye"),
    "shape": (replace(ARM, observation=(A, replace(B, shape=(3,)), EYE)), r"'b' with shape \[3\].*expected \[2\]"),
    "pixels": (
        replace(ARM, observation=(A, B, replace(EYE, shape=(9, 9, 3)))),
        r"'eye' with shape \[9, 9, 3\] .*expected \[8, 8, 3\]",
    ),
    "unit": (replace(ARM, observation=(replace(A, unit="cm"), B, EYE)), "'a' with unit 'cm' .*expected 'm'"),
    "actions": (replace(ARM, action_size=3), "action_size 3 .*expected 2"),
    "rate": (replace(ARM, control_hz=20.0), "control_hz 20.0 .*expected 10.0"),
    "simulator": (replace(ARM, env="arm, noise 2"), "env 'arm, noise 2' .*expected 'arm, noise 1'"),
}
COLLECTED = {"experts": {"arm": "Expert"}, "recipe": {}}
IMPORTED = {"source": {"format": "D4RL maze2d"}, "imported": 3}


def written(path: Path, spec: DomainSpec, provenance: dict[str, Any]) -> Path:
    write_trajectories(path, [spec], ("reach",), [], provenance)
    return path


@pytest.mark.parametrize("provenance", [COLLECTED, {"command": "", "earlier": [COLLECTED]}, IMPORTED])
@pytest.mark.parametrize("change", CHANGES)
def test_a_file_of_another_domain_is_refused(change: str, provenance: dict[str, Any], tmp_path: Path) -> None:
    found, told = CHANGES[change]
    path = written(tmp_path / "arm.hdf5", found, provenance)
    with pytest.raises(TrajectoryFileError, match=f"arm.hdf5: domain 'arm' has .*{told}.* restore the setting or name"):
        check_file(path, [ARM])
    check_file(path, [found])


def test_others_may_call_their_simulator_what_they_like(tmp_path: Path) -> None:
    for number, record in enumerate(
        [{"command": "lab"}, {"experts": {"leg": ""}, "recipe": {}}, {"earlier": [1, None]}]
    ):
        path = written(tmp_path / f"{number}.hdf5", replace(ARM, env="an arm in our lab"), record)
        check_file(path, [ARM])
        with pytest.raises(TrajectoryFileError, match=r"control_hz 10\.0 in the file; expected 5\.0"):
            check_file(path, [replace(ARM, control_hz=5.0)])


def test_a_file_that_is_not_there_or_lacks_a_domain_is_fine(tmp_path: Path) -> None:
    check_file(tmp_path / "none.hdf5", [ARM])
    check_file(written(tmp_path / "arm.hdf5", ARM, COLLECTED), [ARM, tiny.spec("leg", 3, 1)])


def saved(path: Path, problem: dict[str, Any]) -> Path:
    torch.save({"policy": {"problem": problem}, "state_dict": {}}, path)
    return path


@pytest.mark.parametrize("change", CHANGES)
def test_a_checkpoint_of_another_domain_is_refused(change: str, tmp_path: Path) -> None:
    found, told = CHANGES[change]
    leg, tasks = tiny.spec("leg", 3, 1), ("reach", "push")
    path = saved(tmp_path / "last.ckpt", tiny.problem([found, leg], tasks).to_dict())
    with pytest.raises(CheckpointError, match=f"last.ckpt: has domain 'arm' with .*{told}"):
        check_checkpoint(path, tiny.problem([ARM, leg], tasks))
    check_checkpoint(path, tiny.problem([found, leg], tasks))


def test_a_checkpoint_of_other_tasks_or_domains_in_another_order_is_refused(tmp_path: Path) -> None:
    leg = tiny.spec("leg", 3, 1)
    path = saved(tmp_path / "last.ckpt", tiny.problem([leg, ARM], ("reach", "push")).to_dict())
    with pytest.raises(CheckpointError, match="domains leg, arm; expected arm, leg"):
        check_checkpoint(path, tiny.problem([ARM, leg], ("reach", "push")))
    with pytest.raises(CheckpointError, match="tasks reach, push; expected push, reach"):
        check_checkpoint(path, tiny.problem([leg, ARM], ("push", "reach")))


@pytest.mark.parametrize("lacking", ["env", "unit", "kind", "control_hz", "tasks", "domains"])
def test_a_checkpoint_that_says_less_is_taken(lacking: str, tmp_path: Path) -> None:
    problem = tiny.problem([replace(ARM, observation=(replace(A, unit=""), B)), tiny.spec("leg", 3, 1)], ("reach",))
    plain = json.loads(json.dumps(problem.to_dict()))
    for part in (plain, *plain["domains"], *(key for spec in plain["domains"] for key in spec["observation"])):
        part.pop(lacking, None)
    check_checkpoint(saved(tmp_path / "last.ckpt", plain), problem)


@pytest.mark.parametrize("problem", [1, [], {"domains": 3}, {"domains": [{"observation": 2}]}, {"tasks": 1}])
def test_a_checkpoint_whose_domains_cannot_be_read_is_told(problem: object, tmp_path: Path) -> None:
    with pytest.raises(CheckpointError, match="no domains and tasks that can be read"):
        check_checkpoint(
            saved(tmp_path / "last.ckpt", problem), tiny.problem([ARM, tiny.spec("leg", 3, 1)], ("reach",))
        )  # type: ignore[arg-type]


TALL = "--domains.tall.simulator"
OTHERS = {
    "map_seed": ([f"{TALL}.map_seed", "9"], "domain 'tall' has env 'LinearPoint(2)' in the file"),
    "size": ([f"{TALL}.state_size", "9"], "domain 'tall' has key 'position' with shape [7] in the file; expected [9]"),
    "class": (
        [TALL, "strange.Keyed", f"{TALL}.map_seed", "2", "--allow_imports", "strange"],
        "keys position in the file",
    ),
}


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> RunDirectory:
    return finished_smoke(tmp_path_factory.mktemp("runs"))


def never(*_: object, **__: object) -> None:
    raise AssertionError("demonstrations were collected")


@pytest.mark.parametrize("other", OTHERS)
@pytest.mark.parametrize("verb", ["fit", "collect"])
def test_demonstrations_of_another_simulator_are_not_trained_on(verb: str, other: str, tmp_path: Path) -> None:
    words, told = OTHERS[other]
    assert told in complaint(verb, *tiny_smoke(tmp_path), *words)
    assert not any(tmp_path.iterdir())


@pytest.mark.parametrize("other", OTHERS)
@pytest.mark.parametrize("verb", ["test", "validate", "predict"])
def test_a_checkpoint_is_not_looked_at_in_another_simulator(
    verb: str, other: str, run: RunDirectory, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(collection.ExpertCollector, "__call__", never)
    words = [*SMOKE, *TINY, "--data.root", str(tmp_path), *OTHERS[other][0]]
    told = complaint(verb, "--checkpoint", run.checkpoint("adaptation"), *words)
    assert "last.ckpt: has domain 'tall' with " in told
    assert not any(tmp_path.iterdir())


def test_a_phase_does_not_go_on_from_another_simulator(
    run: RunDirectory, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(collection.ExpertCollector, "__call__", never)
    words = [*SMOKE, *TINY, "--data.root", tmp_path / "data", "--run_root", tmp_path / "runs", *OTHERS["map_seed"][0]]
    told = complaint("fit", *words, "--phase", "adaptation", "--from", run.path)
    assert "has domain 'tall' with env 'LinearPoint(2)' in the checkpoint; expected 'LinearPoint(9)'" in told


def test_a_run_is_not_resumed_in_a_simulator_that_has_changed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert plp("fit", *tiny_smoke(tmp_path), "--phase", "alignment").code == 0
    stopped = smoke_run(tmp_path)
    stopped.update_status("running", "alignment", {"state": "running"})
    before = stopped.checkpoint("alignment").read_bytes()
    real = LinearPoint.spec
    monkeypatch.setattr(LinearPoint, "spec", lambda self, name: replace(real(self, name), control_hz=20.0))
    assert "control_hz 10.0 in the checkpoint; expected 20.0" in complaint("fit", "--resume", stopped.path)
    assert stopped.checkpoint("alignment").read_bytes() == before


def test_keys_in_another_order_are_noticed(tmp_path: Path) -> None:
    path, specs = tmp_path / "keyed.hdf5", [strange.Keyed(1).spec("flat"), LinearPoint(2, 7).spec("tall")]
    write_trajectories(path, specs, tiny.TASKS, demonstrations_of(data_root() / "smoke.hdf5"), {"command": "lab"})
    keyed = ["--allow_imports", "strange", "--domains.flat.simulator", "strange.Keyed"]
    words = [*tiny_smoke(tmp_path / "runs"), "--data.file", path, *keyed, "--domains.flat.simulator.map_seed", 1]
    assert plp("collect", *words).code == 0
    told = complaint("fit", *words, "--domains.flat.simulator.keys", "[right,left]")
    assert "domain 'flat' has keys left, right in the file; expected right, left" in told


def test_a_run_on_a_strangers_file_is_tested_in_our_simulator(tmp_path: Path) -> None:
    specs = [replace(LinearPoint(n, size).spec(d), env="lab") for d, n, size in (("flat", 1, 4), ("tall", 2, 7))]
    made = demonstrations_of(data_root() / "smoke.hdf5")
    write_trajectories(tmp_path / "lab.hdf5", specs, tiny.TASKS, made, {"command": "lab"})
    words = [*tiny_smoke(tmp_path), "--data.file", tmp_path / "lab.hdf5"]
    assert plp("fit", *words).code == 0
    own = smoke_run(tmp_path)
    assert [spec["env"] for spec in checkpoint(own, "adaptation")["policy"]["problem"]["domains"]] == [
        "LinearPoint(1)",
        "LinearPoint(2)",
    ]
    assert plp("test", own.path, "--episodes", 2).code == 0


def demonstrations_of(path: Path) -> list[Trajectory]:
    with TrajectoryFile.open(path) as file:
        return [file.trajectory(s.name, e) for s in file.domains for e in range(len(file.episodes(s.name).task))]


def test_a_loaded_policy_acts_in_its_own_simulator_alone(run: RunDirectory) -> None:
    policy, trial = load_policy(run.path), EvalSetting("tall", ("goal_3",))
    assert evaluate(policy, LinearPoint(2, 7), trial, 2, seed=0).episodes == 2
    for other, told in ((LinearPoint(9, 7), "env 'LinearPoint\\(2\\)' in the policy"), (LinearPoint(2, 9), "shape")):
        with pytest.raises(ConfigError, match=f"domain 'tall' has .*{told}"):
            evaluate(policy, other, trial, 2, seed=0)
    with pytest.raises(ConfigError, match=r"states of shape \(3, 9\) in domain 'tall'; expected \(n, 7\)"):
        policy.act(plp_lightning.Observation(np.zeros((3, 9), np.float32)), domain="tall", task="goal_3")


def test_states_are_scored_by_the_simulator_that_they_come_from() -> None:
    with pytest.raises(ConfigError, match="states of 9 numbers, but LinearPoint shows 7"):
        places_of(LinearPoint(2, 7), Observation(torch.zeros(3, 9)))


PLAIN: list[tuple[Callable[..., Simulator], dict[str, Any], str]] = [
    (LinearPoint, {"map_seed": 2}, "LinearPoint(2)"),
    (SeenPoint, {"map_seed": 2}, "SeenPoint(2)"),
    (Lift, {"robot": "UR5e"}, "robosuite Lift, UR5e, OSC position, fingers down, joint noise 0.05 rad"),
    (
        PointMaze,
        {"layout": "umaze"},
        "MuJoCo point in maze umaze, frame d4rl, swap_axes False, negate_actions False",
    ),
    (WalkerMaze, {"layout": "medium", "legs": 6}, "MuJoCo walker with 6 legs in maze medium, frame d4rl"),
    (Reach, {"view": "rear"}, "Meta-World V2V-Reach, rear"),
    (Window, {"view": "front"}, "Meta-World V2V-Open, front"),
]
UNTOLD = {"threads", "horizon"}  # What no step of an episode depends on
OTHER: dict[str, Any] = {
    **{"map_seed": 5, "state_size": 6, "horizon": 33, "image_size": 24, "robot": "Sawyer", "joint_noise": 0.1},
    **{"layout": "medium", "swap_axes": True, "negate_actions": True, "mirror": True, "quarter_turns": 1, "metre": 2.0},
    **{"frame": "gymnasium", "radius": 0.4, "jitter": 0.1, "legs": 4, "view": "front_left", "wrist_size": 8},
}


@pytest.mark.parametrize(("kind", "given", "env"), PLAIN)
def test_every_setting_of_a_simulator_is_told_but_files_of_defaults_say_what_they_said(
    kind: Callable[..., Simulator], given: dict[str, Any], env: str
) -> None:
    plain = kind(**given)
    assert plain.spec("it").env == env
    assert kind(**given, horizon=plain.horizon).spec("it") == plain.spec("it")
    for name in plain.arguments.keys() - UNTOLD:
        other = {"umaze": "medium", "medium": "umaze"}[given["layout"]] if name == "layout" else OTHER[name]
        assert kind(**{**given, name: other}).spec("it") != plain.spec("it"), name


def test_strange_simulators_are_what_they_say() -> None:
    assert strange.Keyed(2).spec("it").state_size == 4
