"""Everything that can be wrong is told in one line that names it, with exit code 2, and nothing is lost."""

from __future__ import annotations

import os
import resource
import shutil
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
import torch
from command import SMOKE, complaint, data_root, finished_smoke, plp, smoke_run, tiny_smoke

from datamodules.errors import UserError
from datamodules.store.writer import write_trajectories
from datamodules.types import Observation, Trajectory
from plp_lightning.callbacks.checkpointing import read_checkpoint
from plp_lightning.envs.synthetic import LinearPoint
from plp_lightning.runs.directory import RunDirectory


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> RunDirectory:
    return finished_smoke(tmp_path_factory.mktemp("finished"))


@pytest.fixture
def interrupted(finished: RunDirectory, tmp_path: Path) -> RunDirectory:
    """A copy of a run that has aligned and is about to adapt."""
    run = RunDirectory(tmp_path / "run")
    shutil.copytree(finished.path, run.path, ignore=shutil.ignore_patterns("adaptation"))
    run.results.unlink()
    status = run.status()
    del status["phases"]["adaptation"]
    run.write_json("status.json", {**status, "state": "running"})
    return run


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ("--data.target_task gaol_3", "no target 'gaol_3' in LinearPoint; expected one of: goal_0, "),
        ("--data.source_domain flatt", "'flatt'; the domains of this experiment are flat, tall"),
        ("--data.source_domain tall", "source and target domain are both 'tall'; set two different ones"),
        ("--data.batch_sise 3", "unknown key 'data.batch_sise'; did you mean 'data.batch_size'?"),
        ("--alignment.epocs 3", "unknown key 'alignment.epocs'; did you mean 'alignment.epochs'?"),
        ("--policy.hiden 3", "unknown key 'policy.hiden'; did you mean 'policy.hidden'?"),
        ("--domains.flat.simulator.map_sed 3", "did you mean 'domains.simulator.map_seed'?"),
        ("--score+ Closeness", "unknown class 'Closeness'; did you mean 'ClosenessScore'?"),
        ("--alignment Alignmnt", "alignment: unknown class 'Alignmnt'; did you mean 'Alignment'?"),
        ("--alignment.epochs three", "alignment.epochs is three; expected a whole number, at least 1; change it"),
        ("--alignment.terms [mdm]", "alignment.terms names 'mdm'; expected some of mmd, adversarial, tcc"),
        ("--alignment.terms.mmd MMMD", "alignment.terms: unknown class 'MMMD'; did you mean 'MMD'?"),
        ("--alignment.epochs 0", "alignment.epochs is 0; expected a whole number, at least 1; change it"),
        ("--alignment.optimizer.lr -1", "alignment.optimizer.lr is -1; expected a number, at least 0; change it"),
        ("--alignment.optimizer.lr .nan", "alignment.optimizer.lr is .nan; expected a number, at least 0; change it"),
        ("--phases [alignmnt]", "phases names 'alignmnt', which nothing sets up; set alignmnt.class_path, or name: "),
        ("--phases [a", "phases is '[a'; expected a list of names"),
        ("--seed -1", "seed is -1; expected a whole number from 0 to 4294967295; change it"),
        ("--threads 0", "threads is 0; expected a whole number from 1 to 1024; change it"),
        ("--data.batch_size 0", "data.batch_size is 0; expected a whole number, at least 1; change it"),
        ("--data.val_fraction 1", "data.val_fraction is 1; expected a share from 0 to below 1; change it"),
        (
            "--evaluation.final_episodes 0",
            "evaluation.final_episodes is 0; expected a whole number, at least 1",
        ),
        ("--trainer.accelerator warp", "trainer: "),
        ("--policy.encoder_state [colour]", "encoder_state names 'colour'; expected state keys: "),
        ("--alignment.terms.mmd.bandwidths [0.5,-1]", "bandwidths is -1; expected a number above 0; change it"),
        ("--method ../../elsewhere", "method is '../../elsewhere'; expected up to 64 letters"),
        ("--experiment ..", "experiment is '..'; expected up to 64 letters"),
    ],
)
def test_wrong_settings_are_named(words: str, told: str, tmp_path: Path) -> None:
    assert told in complaint("fit", *tiny_smoke(tmp_path / "runs"), *words.split())
    assert not (tmp_path / "runs").exists()


@pytest.mark.parametrize(
    ("text", "told"),
    [
        (None, "extra.yaml: can't be read (No such file or directory)"),
        ("data: [1,\nb: }", "extra.yaml: is no YAML (while parsing"),
        ("- 1", "extra.yaml: holds a list; expected keys and values"),
        ("evaluatoin: {episodes: 3}", "unknown key 'evaluatoin'; did you mean 'evaluation'?"),
        ("data: {batch_sise: 3}", "unknown key 'data.batch_sise'; did you mean 'data.batch_size'?"),
        ("adaptation: {init_args: {epocs: 3}}", "did you mean 'adaptation.epochs'?"),
        ("collection: {noise: [1]}", "collection.noise is [1]; expected a number, at least 0; change it"),
        ("data: !!python/object/apply:os.mkdir [pwned]", "extra.yaml: is no YAML (could not determine a constructor"),
    ],
)
def test_wrong_files_are_named(text: str | None, told: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    if text is not None:
        Path("extra.yaml").write_text(text)
    assert told in complaint("fit", *tiny_smoke(tmp_path / "runs"), "--config", "extra.yaml")
    assert not {"runs", "pwned"} & {path.name for path in tmp_path.iterdir()}


SLOTS = {
    "callbacks": "callbacks: [{class_path: NAME, init_args: {args: touch}}]",
    "callback's argument": "callbacks: [{class_path: LambdaCallback, init_args: {on_fit_start: NAME}}]",
    "policy": "policy: {class_path: NAME}",
    "policy's argument": "policy: {init_args: {decoder_state: {class_path: NAME}}}",
    "phase": "alignment: {class_path: NAME, init_args: {args: touch}}",
    "phase as a function": "alignment: NAME",
    "score": "score: [{class_path: NAME}]",
    "term": "alignment: {init_args: {terms: {mmd: {class_path: NAME}}}}",
    "optimizer": "alignment: {init_args: {optimizer: {class_path: NAME}}}",
    "schedule": "alignment: {init_args: {lr_scheduler: {class_path: NAME}}}",
    "simulator": "domains: {flat: {simulator: {class_path: NAME}}}",
    "expert": "domains: {flat: {expert: NAME}}",
    "strategy": "trainer: {strategy: {class_path: NAME}}",
    "profiler": "trainer: {profiler: {class_path: NAME}}",
    "plain value": "data: {source_domain: {class_path: NAME}}",
    "its own permission": "allow_imports: MODULE\nscore: [{class_path: NAME}]",
}


@pytest.mark.parametrize("slot", SLOTS)
def test_configs_run_no_foreign_code(slot: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # A module that would leave a trace when it is imported, beside the usual suspects.
    (tmp_path / "payload.py").write_text("from pathlib import Path\nPath('pwned').touch()\nclass Payload: ...\n")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.chdir(tmp_path)
    for name in ("payload.Payload", "subprocess.Popen", "os.system", "builtins.eval"):
        Path("hostile.yaml").write_text(SLOTS[slot].replace("NAME", name).replace("MODULE", name.split(".")[0]))
        told = complaint("fit", *tiny_smoke(tmp_path / "runs"), "--config", "hostile.yaml")
        assert name in told
        assert "is not allowed" in told or "expected" in told
    assert "payload" not in sys.modules
    assert {path.name for path in tmp_path.iterdir()} == {"payload.py", "hostile.yaml"}


def test_own_packages_can_be_allowed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    lines = "from plp_lightning.evaluation.scores import ClosenessScore\nclass OwnScore(ClosenessScore): ...\n"
    (tmp_path / "own_package.py").write_text(lines)
    monkeypatch.syspath_prepend(tmp_path)
    options = ["fit", *tiny_smoke(tmp_path), "--score", "[own_package.OwnScore]"]
    assert "add --allow_imports own_package" in complaint(*options)
    allowed = plp(*options, "--allow_imports", "own_package")
    assert allowed.code == 0, allowed
    smoke_run(tmp_path).results.unlink()
    again = plp("fit", "--resume", smoke_run(tmp_path).path, "--allow_imports", "own_package")
    assert again.code == 0, again


def copy_of_data(folder: Path) -> Path:
    shutil.copytree(data_root(), folder)
    return folder / "smoke.hdf5"


def test_half_a_trajectory_file_is_refused(tmp_path: Path) -> None:
    file = copy_of_data(tmp_path / "data")
    os.truncate(file, file.stat().st_size // 2)
    size = file.stat().st_size
    for command in (["fit", *tiny_smoke(tmp_path), "--data.root", file.parent], ["data", "inspect", file]):
        assert "smoke.hdf5" in complaint(*command)
    assert file.stat().st_size == size


def test_values_that_are_not_finite_are_not_written(tmp_path: Path) -> None:
    spec = LinearPoint(1).spec("flat")
    actions = np.full((3, 2), np.nan, dtype=np.float32)
    bad = Trajectory("flat", "goal_0", Observation(np.zeros((3, 4), np.float32)), actions, seed=0, success=True)
    with pytest.raises(UserError, match="expected finite values in"):
        write_trajectories(tmp_path / "new.hdf5", [spec], ["goal_0"], [bad], {})
    assert not list(tmp_path.glob("*.hdf5"))


def test_missing_demonstrations_without_an_expert_are_named(tmp_path: Path) -> None:
    options = ["--data.root", tmp_path, "--run_root", tmp_path / "runs", "--domains.tall.expert", "null"]
    assert "domain 'tall' has no expert; add one or import" in complaint("fit", *SMOKE, *options)
    assert not (tmp_path / "runs").exists()


class Payload:
    def __reduce__(self) -> tuple[object, tuple[str]]:
        return os.mkdir, ("pwned",)


@pytest.mark.parametrize("verb", ["fit", "test", "validate", "predict"])
def test_pickles_are_not_run(verb: str, interrupted: RunDirectory, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(interrupted.path)
    torch.save({"policy": {}, "state_dict": {}, "extra": Payload()}, interrupted.checkpoint("alignment"))
    told = complaint(verb, *(["--resume"] if verb == "fit" else []), interrupted.path)
    assert "alignment/checkpoints/last.ckpt: not a plain checkpoint" in told
    assert not Path("pwned").exists()


def test_damaged_checkpoints_are_named(interrupted: RunDirectory) -> None:
    file = interrupted.checkpoint("alignment")
    content = read_checkpoint(file)
    os.truncate(file, file.stat().st_size // 2)
    assert "last.ckpt: not a plain checkpoint" in complaint("fit", "--resume", interrupted.path)
    torch.save({"weights": 1}, file)
    assert "has no 'policy' and 'state_dict'" in complaint("fit", "--resume", interrupted.path)
    torch.save({**content, "state_dict": {}}, file)
    assert "is not what phase alignment left" in complaint("fit", "--resume", interrupted.path)
    assert "is of another policy (" in complaint("test", "--config", interrupted.config, "--checkpoint", file)
    interrupted.update_status("running", "alignment", {"state": "running"})
    torch.save({"policy": {}, "state_dict": {}}, file)
    assert "holds weights alone" in complaint("fit", "--resume", interrupted.path)
    file.unlink()
    assert "has no checkpoint yet; finish a phase with plp fit --resume" in complaint("test", interrupted.path)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("{", "status.json: is no JSON ("),
        ("[]", "status.json: holds a list; expected an object"),
        ('{"phases": 3}', "status.json: phases is 3; expected what plp fit writes ("),
        ('{"phases": {"alignment": 3}}', "status.json: phases.alignment is 3; expected what plp fit writes ("),
    ],
)
def test_damaged_status_is_named_and_kept(text: str, told: str, interrupted: RunDirectory) -> None:
    file = interrupted.path / "status.json"
    file.write_text(text)
    assert told in complaint("fit", "--resume", interrupted.path)
    assert file.read_text() == text


def test_other_policies_are_not_adapted(finished: RunDirectory, tmp_path: Path) -> None:
    options = ["fit", *tiny_smoke(tmp_path), "--phase", "adaptation", "--from", finished.path]
    assert "is of another policy (" in complaint(*options, "--policy.latent", "9")
    # Aligned for goal_3, the policy has seen goal_2 in the target domain.
    told = complaint(*options, "--data.target_task", "goal_2")
    assert "(for target 'goal_3'), but target 'goal_2' asks for goal_0, goal_1, goal_3" in told


def test_divergence_is_told_in_one_line(tmp_path: Path) -> None:
    told = complaint("fit", *tiny_smoke(tmp_path), "--alignment.optimizer.lr", "1e30")
    assert "not finite; lower the learning rate" in told
    run = smoke_run(tmp_path)
    assert run.status()["state"] == "failed"
    assert not run.checkpoint("alignment").exists()


def test_run_root_that_is_no_folder_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    assert f"{tmp_path / 'file'}" in complaint("fit", *tiny_smoke(tmp_path / "file"))
    assert "/proc/runs: " in complaint("fit", *tiny_smoke(Path("/proc/runs")))


@contextmanager
def small_files_only() -> Iterator[None]:
    """No file may grow beyond 20 kB: a full disk, as far as a process can tell."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def test_full_disk_is_told_and_leaves_no_half_checkpoint(interrupted: RunDirectory) -> None:
    before = interrupted.checkpoint("alignment").read_bytes()
    with small_files_only():
        told = complaint("fit", "--resume", interrupted.path)
    assert "File too large" in told
    assert interrupted.checkpoint("alignment").read_bytes() == before
    assert not list(interrupted.path.rglob("adaptation/*/*.ckpt"))
    assert not list(interrupted.path.rglob("*.tmp"))
    answer = plp("fit", "--resume", interrupted.path)
    assert answer.code == 0, answer
