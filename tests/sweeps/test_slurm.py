"""The SLURM engine on a real SLURM: ``script/slurm start FOLDER``, ``export SLURM_CONF=FOLDER/slurm.conf``."""

from __future__ import annotations

import shutil
import subprocess
from importlib.util import find_spec
from pathlib import Path

import pytest
from command import plp, results, tiny_smoke
from test_local import PROXIES, command, run_of, start, wait_for

from plp_lightning.runs.directory import RunDirectory


def absence() -> str:
    """Reason why there is no SLURM to try; empty if there is one."""
    if find_spec("submitit") is None:
        return "submitit is not installed; pip install -e '.[cluster]'"
    if shutil.which("sinfo") is None:
        return "SLURM is not installed; script/slurm start FOLDER"
    asked = subprocess.run(["sinfo", "-h", "-o", "%t"], capture_output=True, text=True, timeout=30, check=False)
    return "" if "idle" in asked.stdout else f"SLURM has no idle node: {asked.stdout}{asked.stderr}"


pytestmark = pytest.mark.slurm


@pytest.fixture(scope="module", autouse=True)
def _slurm() -> None:
    if reason := absence():
        pytest.skip(reason)


def scontrol(*words: str) -> str:
    return subprocess.run(["scontrol", *words], capture_output=True, text=True, check=True).stdout


def first_job() -> str:
    return subprocess.run(
        ["squeue", "--me", "-h", "-t", "R", "-o", "%i"], capture_output=True, text=True
    ).stdout.strip()


@pytest.mark.parametrize("how", ["requeue", "USR1"])
def test_a_job_that_is_requeued_goes_on_to_the_same_results(how: str, tmp_path: Path) -> None:
    first = run_of(tmp_path, "goal_3")
    epochs = ["--alignment.epochs", "60"]
    sweep = start(command(tmp_path, *epochs, "--engine", "slurm", "--slurm", "time=10"))
    wait_for(first.checkpoint("alignment").exists)
    if how == "requeue":
        scontrol("requeue", first_job())
    else:  # as SLURM sends it before a job's time is over
        subprocess.run(["scancel", "--signal=USR1", first_job()], check=True)
    wait_for(lambda: first.status()["state"] == "preempted")
    told = sweep.communicate(timeout=280)[1]
    assert sweep.returncode == 0, told
    assert "4 done of 4" in told
    assert "--resume" in first.path.with_name("seed_0.log").read_text()
    for target in ("goal_3", "goal_6"):
        settings = ["--data.target_task", target, "--data.proxy_tasks", PROXIES, *epochs]
        assert plp("fit", *tiny_smoke(tmp_path / "alone"), *settings).code == 0
        alone = results(RunDirectory(tmp_path / "alone" / "smoke" / "plp" / target / "seed_0"))
        assert results(run_of(tmp_path, target)) == {**alone, "phases": alone["phases"][target == "goal_6" :]}


def test_failures_are_told_with_their_reason(tmp_path: Path) -> None:
    run_of(tmp_path, "goal_3").path.mkdir(parents=True)
    (run_of(tmp_path, "goal_3").path / "alignment").write_text("in the way")
    flags = ["--engine", "slurm", "--per_job", "2", "--retries", "0", "--slurm", "time=10", "partition=debug"]
    failed = start(command(tmp_path, *flags))
    told = failed.communicate(timeout=200)[1]
    assert failed.returncode == 2
    assert "plp: 2 of 4 are not done, the first is smoke/plp/goal_3/seed_0: " in told
    assert "alignment" in told.splitlines()[-1]


def test_an_option_that_submitit_does_not_know(tmp_path: Path) -> None:
    refused = start(command(tmp_path, "--engine", "slurm", "--slurm", "partitoin=debug"))
    told = refused.communicate(timeout=60)[1]
    assert refused.returncode == 2
    assert "unknown option 'partitoin'" in told.splitlines()[-1]
