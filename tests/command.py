"""``plp`` as tests call it: in this process, or in one that dies at a chosen moment."""

from __future__ import annotations

import atexit
import contextlib
import functools
import importlib
import io
import itertools
import json
import multiprocessing
import os
import shutil
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import torch

from plp_lightning.cli.main import main
from plp_lightning.runs.directory import RunDirectory
from plp_lightning.runs.metrics_file import read_rows

ROOT = Path(__file__).parents[1]
SMOKE = ["--config", str(ROOT / "configs" / "smoke.yaml")]
TINY = ["--config", str(Path(__file__).parent / "conf" / "tiny.yaml"), "--score.samples", "50"]
METHODS = sorted((ROOT / "configs" / "methods").glob("*.yaml"))

processes = multiprocessing.get_context("forkserver")
# Imported once; every process that is to die is a fork of that one.
processes.set_forkserver_preload(["plp_lightning.cli.experiments"])


class Answer(NamedTuple):
    code: int
    out: str
    err: str


def plp(*arguments: object) -> Answer:
    """Run the command line; anything but SystemExit would be a traceback and is raised."""
    out, err, code = io.StringIO(), io.StringIO(), 0
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            main([str(argument) for argument in arguments])
        except SystemExit as leaving:
            code = int(leaving.code or 0)
    return Answer(code, out.getvalue(), err.getvalue())


def complaint(*arguments: object) -> str:
    """What a mistake is answered with: one line, exit code 2."""
    answer = plp(*arguments)
    assert answer.code == 2, answer
    assert answer.err.startswith("plp: ")
    assert answer.err.count("\n") == 1
    return answer.err


@functools.cache
def data_root() -> Path:
    """Folder with the smoke experiment's demonstrations, collected once; smaller runs read fewer of them."""
    folder = tempfile.mkdtemp()
    atexit.register(shutil.rmtree, folder)
    answer = plp("collect", *SMOKE, "--data.root", folder, "--collection.processes", "1")
    assert answer.code == 0, answer
    return Path(folder)


def tiny_smoke(run_root: Path) -> list[str]:
    """Options of a run that takes about a second."""
    return [*SMOKE, *TINY, "--data.root", str(data_root()), "--run_root", str(run_root)]


@functools.cache
def _finished_smoke() -> RunDirectory:
    root = Path(tempfile.mkdtemp())
    atexit.register(shutil.rmtree, root)
    answer = plp("fit", *tiny_smoke(root))
    assert (answer.code, answer.err) == (0, ""), answer
    return smoke_run(root)


def finished_smoke(run_root: Path) -> RunDirectory:
    """A run that is done, as :func:`tiny_smoke` makes it: a copy of the one that a process makes once."""
    run = smoke_run(run_root)
    shutil.copytree(_finished_smoke().path, run.path)
    return run


def smoke_run(run_root: Path, method: str = "plp", seed: int = 0) -> RunDirectory:
    return RunDirectory(run_root / "smoke" / method / "goal_3" / f"seed_{seed}")


def dies(arguments: Sequence[str], where: str, nth: int, signal: int) -> int:
    """Run ``plp`` in a process that sends itself ``signal`` at the ``nth`` call of ``where``; its exit code."""
    process = processes.Process(target=_run_until, args=(list(arguments), where, nth, signal))
    process.start()
    process.join(120)
    assert process.exitcode is not None, "it hangs"
    return process.exitcode


def _run_until(arguments: list[str], where: str, nth: int, signal: int) -> None:
    torch.set_num_threads(1)
    die_at(where, nth, signal)
    with open(os.devnull, "w") as nowhere, contextlib.redirect_stdout(nowhere), contextlib.redirect_stderr(nowhere):
        main(arguments)


def die_at(where: str, nth: int, cause: int | Exception) -> None:
    """Let this process send itself a signal, or raise, at the ``nth`` call of ``where``."""
    owner, name = _locate(where)
    original, calls = getattr(owner, name), itertools.count(1)

    def deadly(*args: Any, **kwargs: Any) -> Any:
        if next(calls) == nth:
            if isinstance(cause, Exception):
                raise cause
            os.kill(os.getpid(), cause)
        return original(*args, **kwargs)

    setattr(owner, name, deadly)


def _locate(where: str) -> tuple[Any, str]:
    module, path = where.split(":")
    *owners, name = path.split(".")
    return functools.reduce(getattr, owners, importlib.import_module(module)), name


def checkpoint(run: RunDirectory, phase: str, which: str = "last") -> dict[str, Any]:
    loaded: dict[str, Any] = torch.load(run.checkpoint(phase, which), weights_only=True)
    return loaded


def same(one: Any, other: Any) -> bool:
    """Equal bit for bit, through dicts, lists and tensors."""
    if isinstance(one, torch.Tensor):
        return torch.equal(one, other)
    if isinstance(one, dict):
        return one.keys() == other.keys() and all(same(one[key], other[key]) for key in one)
    if isinstance(one, list | tuple):
        return len(one) == len(other) and all(map(same, one, other))
    return bool(one == other)


def trained(run: RunDirectory) -> dict[str, Any]:
    """All that training has left: last checkpoints of every phase, without their places and times, and its curves."""
    found = {}
    for phase in run.done_phases():
        content = checkpoint(run, phase)
        found[phase] = [content[key] for key in ("state_dict", "optimizer_states", "lr_schedulers", "loops")]
        found[phase].append(read_rows(run.phase(phase) / "metrics.csv"))
    return found


def results(run: RunDirectory) -> dict[str, Any]:
    """``results.json`` without the times."""
    found: dict[str, Any] = json.loads(run.results.read_text())
    del found["seconds"]
    return found
