"""``plp``: the verbs. Light ones never import torch, so that help and file inspection answer at once."""

from __future__ import annotations

import difflib
import importlib
import os
import re
import sys
from collections.abc import Callable, Sequence
from typing import NoReturn

from datamodules.errors import ConfigError, UserError
from plp_lightning.stopping import PreemptedError, stoppable

VERBS = {
    "fit": ("plp_lightning.cli.experiments:run_fit", "train every phase of a method, evaluate, report"),
    "collect": ("plp_lightning.cli.experiments:run_collect", "collect the demonstrations that an experiment lacks"),
    "validate": ("plp_lightning.cli.experiments:run_validate", "held-out losses and alignment scores of a run"),
    "test": ("plp_lightning.cli.experiments:run_test", "success rates of a run in the simulators"),
    "predict": ("plp_lightning.cli.experiments:run_predict", "actions of a run's policy on held-out trajectories"),
    "report": ("plp_lightning.cli.report:run_report", "success rates of many runs beside the paper's"),
    "data": ("plp_lightning.cli.data:run_data", "inspect, validate or import trajectory files"),
    "doctor": ("plp_lightning.cli.doctor:run_doctor", "what works on this machine: packages, renderers, cores"),
}

USAGE = """usage: plp VERB [options]

Cross-domain policy transfer by representation alignment.

verbs:
{verbs}

The main job: plp fit --config configs/r2r.yaml
Options of a verb: plp VERB --help"""


def main(arguments: Sequence[str] | None = None) -> None:
    """Run a verb; a user's mistake is one line on standard error and exit code 2."""
    words = list(sys.argv[1:] if arguments is None else arguments)
    if not words or words[0] in ("-h", "--help"):
        print(USAGE.format(verbs="\n".join(f"  {name:9} {text}" for name, (_, text) in VERBS.items())))
        return
    if words[0] == "--version":
        print(f"plp {_installed_version()}")
        return
    way_on = "plp fit --resume RUN_DIR" if words[0] == "fit" else "the same command"
    # Several runs at once must not fight for cores; set before any library starts its threads.
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    try:
        with stoppable():
            find_verb(words[0])(words[1:])
    except UserError as error:
        _leave(" ".join(str(error).split()), 2)
    except OSError as error:
        # What the file system refused, and where: a full disk, say, or a folder that may not be written.
        place, reason = f"{error.filename}: " if error.filename else "", error.strerror or error
        _leave(f"{place}{reason}; expected a place that can be read and written: free or name another", 2)
    except PreemptedError as error:
        _leave(f"{error}; go on with {way_on}", error.exit_code)
    except Exception as error:
        if not _out_of_memory(error):
            raise
        _leave(f"out of memory ({_first_line(error)}); expected less: try smaller batches or sizes, then {way_on}", 2)


def _out_of_memory(error: Exception) -> bool:
    """Python, numpy, torch and CUDA each have their own way to say it."""
    said = isinstance(error, MemoryError) or type(error).__name__ == "OutOfMemoryError"
    return said or re.search("can't allocate memory|not enough memory|bad_alloc|out of memory", str(error)) is not None


def _first_line(error: Exception) -> str:
    return " ".join(str(error).split())[:160] or type(error).__name__


def _leave(message: str, code: int) -> NoReturn:
    print(f"plp: {message}", file=sys.stderr)
    sys.exit(code)


def find_verb(name: str) -> Callable[[Sequence[str]], None]:
    """The function behind a verb; a :class:`ConfigError` names the nearest if there is no such verb."""
    if name not in VERBS:
        near = difflib.get_close_matches(name, VERBS, n=1)
        raise ConfigError(f"unknown verb {name!r}; " + (f"did you mean {near[0]!r}?" if near else "see plp --help"))
    module, function = VERBS[name][0].split(":")
    verb: Callable[[Sequence[str]], None] = getattr(importlib.import_module(module), function)
    return verb


def _installed_version() -> str:
    metadata = importlib.import_module("importlib.metadata")
    try:
        return str(metadata.version("plp-lightning"))
    except metadata.PackageNotFoundError:
        return "from a checkout that is not installed; run pip install -e ."


if __name__ == "__main__":
    main()
