"""Verbs of ``plp``: what each does, and where; they are imported when they are asked for."""

from __future__ import annotations

import difflib
import importlib
from collections.abc import Callable, Sequence
from typing import NamedTuple

from datamodules.errors import ConfigError


class Verb(NamedTuple):
    """A verb of the command line."""

    module: str  # of this package, that has its function, run_VERB
    told: str  # in a line of help
    keeps: bool = False  # its results are in files, and not lost with the screen


VERBS = {
    "fit": Verb("experiments", "train every phase of a method, evaluate, report", keeps=True),
    "sweep": Verb("sweep", "many runs: experiments × methods × target tasks × seeds", keeps=True),
    "collect": Verb("experiments", "collect the demonstrations that an experiment lacks", keeps=True),
    "validate": Verb("assessing", "held-out losses and alignment scores of a run"),
    "test": Verb("assessing", "success rates of a run in the simulators", keeps=True),
    "predict": Verb("assessing", "actions of a run's policy on held-out trajectories", keeps=True),
    "rollout": Verb("rollout", "films of a run's policy, failures first", keeps=True),
    "export": Verb("export", "a run's policy in a file of its own: ONNX, torch, safetensors", keeps=True),
    "report": Verb("report", "tables and figures of many runs, beside the paper's values"),
    "data": Verb("data", "inspect, validate, import or export trajectory files"),
    "list": Verb("listing", "experiments, methods, simulators, tasks, a line each"),
    "schema": Verb("schema", "a JSON Schema of pages, by which editors complete and check"),
    "completion": Verb("completion", "a script by which a shell completes all of this"),
    "doctor": Verb("doctor", "what works on this machine: packages, renderers, cores"),
}


def find_verb(name: str) -> Callable[[Sequence[str]], None]:
    """The function behind a verb; a :class:`ConfigError` names the nearest if there is no such verb."""
    if name not in VERBS:
        near = difflib.get_close_matches(name, VERBS, n=1)
        raise ConfigError(f"unknown verb {name!r}; " + (f"did you mean {near[0]!r}?" if near else "see plp --help"))
    module = importlib.import_module(f"plp_lightning.cli.{VERBS[name].module}")
    verb: Callable[[Sequence[str]], None] = getattr(module, f"run_{name}")
    return verb
