"""A sweep on this machine: the same results however often it is killed, and no process that outlives it."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from command import ROOT, TINY, data_root, plp, results, tiny_smoke

from datamodules.plain_yaml import dump_yaml
from plp_lightning.runs.directory import RunDirectory
from plp_lightning.sweeps import local
from plp_lightning.sweeps.local import LocalEngine, places, places_side_by_side
from plp_lightning.sweeps.manifest import Job
from plp_lightning.sweeps.memory import free_bytes, peak_bytes
from plp_lightning.sweeps.processes import JobProcess, last_words
from plp_lightning.sweeps.table import SweepProgress

PROXIES = "[goal_0,goal_1]"
SWEEP = [sys.executable, "-m", "plp_lightning", "sweep"]


def command(folder: Path, *flags: str) -> list[str]:
    """Words of a sweep of two runs that share their alignment."""
    page = {"experiments": [["smoke", TINY[1]]], "targets": ["goal_3", "goal_6"]}
    (folder / "page.yaml").write_text(dump_yaml(page))
    settings = ["--data.root", str(data_root()), "--data.proxy_tasks", PROXIES, "--score.samples", "50"]
    return [*SWEEP, "--config", str(folder / "page.yaml"), "--root", str(folder / "runs"), *settings, *flags]


def start(words: list[str]) -> subprocess.Popen[str]:
    paths = os.pathsep.join([str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])])
    environment = {**os.environ, "PYTHONPATH": paths, "OMP_NUM_THREADS": "1"}
    return subprocess.Popen(words, env=environment, stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True)


def run_of(folder: Path, target: str) -> RunDirectory:
    return RunDirectory(folder / "runs" / "smoke" / "plp" / target / "seed_0")


def wait_for(what: Callable[[], object]) -> None:
    until = time.monotonic() + 60
    while not what():
        assert time.monotonic() < until
        time.sleep(0.05)


def processes_of(folder: Path) -> list[int]:
    """Processes that live and name the folder in their words."""
    found = []
    for place in Path("/proc").glob("[0-9]*"):
        try:
            if str(folder).encode() in (place / "cmdline").read_bytes() and int(place.name) != os.getpid():
                found.append(int(place.name))
        except OSError:
            continue
    return found


@pytest.mark.slow
def test_a_sweep_that_is_killed_goes_on_to_the_same_results(tmp_path: Path) -> None:
    first, words = run_of(tmp_path, "goal_3"), command(tmp_path)
    killed = start(words)
    wait_for(first.checkpoint("alignment").exists)
    killed.kill()
    killed.communicate()
    wait_for(lambda: not processes_of(tmp_path))
    again = start(words)
    told = again.communicate(timeout=120)[1]
    assert again.returncode == 0, told
    assert "4 done of 4" in told  # collections are jobs as well
    lines = (tmp_path / "runs" / "page.jsonl").read_text().splitlines()
    assert [json.loads(line)["name"].split("/")[-2] for line in lines[-2:]] == ["goal_3", "goal_6"]
    for target in ("goal_3", "goal_6"):
        settings = ["--data.target_task", target, "--data.proxy_tasks", PROXIES]
        assert plp("fit", *tiny_smoke(tmp_path / "alone"), *settings).code == 0
        alone = results(RunDirectory(tmp_path / "alone" / "smoke" / "plp" / target / "seed_0"))
        shared = {"phases": alone["phases"][target == "goal_6" :], "sweep": "page"}
        assert results(run_of(tmp_path, target)) == alone | shared
    log = first.path.with_name("seed_0.log").read_text()
    assert [line.split()[1:3] for line in log.splitlines() if line.startswith("$")] == [["plp", "fit"]] * 2
    assert "--resume" in log


@pytest.mark.slow
def test_a_sweep_that_is_asked_to_stop_lets_its_runs_save(tmp_path: Path) -> None:
    first = run_of(tmp_path, "goal_3")
    stopped = start(command(tmp_path, "--alignment.epochs", "2000"))
    wait_for(first.checkpoint("alignment").exists)
    stopped.send_signal(signal.SIGINT)
    told = stopped.communicate(timeout=60)[1]
    assert stopped.returncode == 128 + signal.SIGINT
    assert "stopped by SIGINT; go on with the same command" in told
    assert not processes_of(tmp_path)
    assert first.status()["state"] == "preempted"


@pytest.fixture
def shell(monkeypatch: pytest.MonkeyPatch) -> None:
    """Words of jobs are commands of a shell."""

    def begin(self: JobProcess, job: Job, environment: dict[str, str]) -> None:
        self.job, self.began, self.log = job, time.monotonic(), Path(job.log)
        with self.log.open("ab") as log:
            self.process = subprocess.Popen(
                ["bash", "-c", *job.words], stdout=log, env={**os.environ, **environment}, start_new_session=True
            )

    monkeypatch.setattr(JobProcess, "__init__", begin)


def work(folder: Path, jobs: dict[str, Any], retries: int = 0, count: int = 2) -> SweepProgress:
    return work_at(folder, jobs, [{"PLACE": str(i)} for i in range(count)], retries)


def work_at(folder: Path, jobs: dict[str, Any], places: list[dict[str, str]], retries: int = 0) -> SweepProgress:
    made = [
        Job(name, [words], str(folder / f"{name}.log"), after=dict.fromkeys(after))
        for name, (words, *after) in jobs.items()
    ]
    with SweepProgress(made, len(places)) as progress:
        LocalEngine(made, places, retries).run(progress)
    return progress


@pytest.mark.usefixtures("shell")
def test_failures_are_tried_again_and_block_what_needs_them(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    once = f"echo 'plp: not yet' ; mkdir {tmp_path}/made 2>&1 && exit 2 || exit 0"
    jobs = {"once": [once], "never": ["echo plp: why; exit 3"], "after": ["true", "never"], "last": ["true", "after"]}
    progress = work(tmp_path, jobs, retries=1)
    assert progress.states == {"once": "done", "never": "failed", "after": "blocked", "last": "blocked"}
    assert progress.reasons["never"].startswith("exit code 3, why; its log: ")
    assert (tmp_path / "never.log").read_text() == "plp: why\n" * 2
    told = capfd.readouterr().err
    assert "once: waiting: exit code 2, not yet" in told
    assert "1 done, 1 failed, 2 blocked of 4" in told


@pytest.mark.usefixtures("shell")
def test_each_place_has_its_own_environment_and_one_job_at_a_time(tmp_path: Path) -> None:
    words = f"mkdir {tmp_path}/$PLACE && sleep 0.3 && rmdir {tmp_path}/$PLACE"
    assert {*work(tmp_path, {f"job{i}": [words] for i in range(4)}).states.values()} == {"done"}


@pytest.mark.usefixtures("shell")
def test_jobs_side_by_side_share_the_processes_that_step_environments(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(local, "available_processes", lambda: 9)
    words = [f"echo $PLP_PROCESSES >>{tmp_path}/told; sleep 0.5"]
    work(tmp_path, {f"job{i}": words for i in range(2)} | {"last": [*words, "job0", "job1"]}, count=8)
    assert (tmp_path / "told").read_text().split() == ["4", "4", "9"]
    work(tmp_path, {f"job{i}": words for i in range(12)}, count=12)
    assert (tmp_path / "told").read_text().split()[3:] == ["1"] * 12


@pytest.mark.usefixtures("shell")
def test_no_further_run_is_started_without_memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(local, "peak_bytes", lambda process: 1000)
    monkeypatch.setattr(local, "free_bytes", lambda: 999)
    jobs = {"short": ["sleep 0.3"], "long": [f"sleep 1.2; touch {tmp_path}/over"], "later": [f"[ -e {tmp_path}/over ]"]}
    assert {*work(tmp_path, jobs).states.values()} == {"done"}


def test_memory_is_measured() -> None:
    assert 0 < peak_bytes(os.getpid()) < free_bytes() * 100
    assert peak_bytes(2**30) == 0


def test_what_a_run_s_own_processes_take_is_its_memory() -> None:
    inner = "own = bytearray(2**26); print('there', flush=True); input()"
    outer = f"import subprocess, sys; subprocess.run([sys.executable, '-c', {inner!r}])"
    with subprocess.Popen([sys.executable, "-c", outer], stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == b"there\n"
        assert peak_bytes(process.pid) > 2**26
        process.communicate(b"\n")


def test_pages_that_runs_share_are_nobody_s_memory(tmp_path: Path) -> None:
    (tmp_path / "images").write_bytes(bytes(2**26))
    code = (
        "import numpy, os, sys; from plp_lightning.sweeps.memory import peak_bytes; before = peak_bytes(os.getpid())\n"
        "images = numpy.memmap(sys.argv[1], numpy.uint8, 'c'); images.sum(); print(peak_bytes(os.getpid()) - before)\n"
        "own = numpy.ones(2**26, numpy.uint8); print(peak_bytes(os.getpid()) - before)"
    )
    call = [sys.executable, "-c", code, str(tmp_path / "images")]
    told = subprocess.run(call, capture_output=True, text=True, check=True, cwd=ROOT).stdout
    shared, own = map(int, told.split())
    assert shared < 2**25 < own


def test_places(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "")
    assert len(places(None, None)) == len(os.sched_getaffinity(0))
    assert places(3, None) == [{}] * 3
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "0,GPU-1")
    gpu = [{"CUDA_VISIBLE_DEVICES": name} for name in ("0", "GPU-1")]
    assert places(None, None) == gpu
    assert places(3, 2) == [*gpu, gpu[0]]
    assert places_side_by_side(3) == [*gpu, gpu[0]]


def test_last_words(tmp_path: Path) -> None:
    log = tmp_path / "a.log"
    assert last_words(log) == "it never began"
    log.write_text("plp: first\nplp: what is wrong\n\nand more\n")
    assert last_words(log) == "what is wrong"
    log.write_bytes(b"x" * 5000 + b"\nValueError: \xff\n")
    assert last_words(log) == "ValueError: \N{REPLACEMENT CHARACTER}"


def test_the_time_that_is_left(tmp_path: Path) -> None:
    jobs = [Job(f"a/plp/t/seed_{i}", [], "log") for i in range(5)]
    progress = SweepProgress(jobs, 2)
    assert progress.seconds_left() is None
    progress.set("a/plp/t/seed_0", "running")
    progress.began["a/plp/t/seed_0"] -= 100
    progress.set("a/plp/t/seed_0", "done")
    assert progress.seconds_left() == pytest.approx(200, abs=1)
    progress.set("a/plp/t/seed_1", "running")
    progress.began["a/plp/t/seed_1"] -= 60
    assert progress.seconds_left() == pytest.approx(170, abs=1)
    assert progress.summary() == "1 done, 1 running, 3 waiting of 5; about 3 min left"
