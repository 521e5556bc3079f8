"""Verbs of ``plp``: what each does, and where; they are imported when they are asked for."""

from __future__ import annotations

import difflib
import importlib
from collections.abc import Callable, Sequence

from datamodules.errors import ConfigError

VERBS = {
    "fit": ("plp_lightning.cli.experiments:run_fit", "train every phase of a method, evaluate, report"),
    "sweep": ("plp_lightning.cli.sweep:run_sweep", "many runs: experiments × methods × target tasks × seeds"),
    "collect": ("plp_lightning.cli.experiments:run_collect", "collect the demonstrations that an experiment lacks"),
    "validate": ("plp_lightning.cli.assessing:run_validate", "held-out losses and alignment scores of a run"),
    "test": ("plp_lightning.cli.assessing:run_test", "success rates of a run in the simulators"),
    "predict": ("plp_lightning.cli.assessing:run_predict", "actions of a run's policy on held-out trajectories"),
    "rollout": ("plp_lightning.cli.rollout:run_rollout", "films of a run's policy, failures first"),
    "export": ("plp_lightning.cli.export:run_export", "a run's policy in a file of its own: ONNX, torch, safetensors"),
    "report": ("plp_lightning.cli.report:run_report", "tables and figures of many runs, beside the paper's values"),
    "data": ("plp_lightning.cli.data:run_data", "inspect, validate or import trajectory files"),
    "list": ("plp_lightning.cli.listing:run_list", "experiments, methods, simulators, tasks, a line each"),
    "schema": ("plp_lightning.cli.schema:run_schema", "a JSON Schema of pages, by which editors complete and check"),
    "completion": ("plp_lightning.cli.completion:run_completion", "a script by which a shell completes all of this"),
    "doctor": ("plp_lightning.cli.doctor:run_doctor", "what works on this machine: packages, renderers, cores"),
}


def find_verb(name: str) -> Callable[[Sequence[str]], None]:
    """The function behind a verb; a :class:`ConfigError` names the nearest if there is no such verb."""
    if name not in VERBS:
        near = difflib.get_close_matches(name, VERBS, n=1)
        raise ConfigError(f"unknown verb {name!r}; " + (f"did you mean {near[0]!r}?" if near else "see plp --help"))
    module, function = VERBS[name][0].split(":")
    verb: Callable[[Sequence[str]], None] = getattr(importlib.import_module(module), function)
    return verb
