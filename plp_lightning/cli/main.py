"""``plp``: the verbs. Light ones never import torch, so that help and file inspection answer at once."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Sequence
from typing import NoReturn

from datamodules.words import one_line
from plp_lightning.cli.failures import answer_to, tell_of_threads
from plp_lightning.cli.screen import loss, steady_screen
from plp_lightning.cli.surroundings import settle_surroundings
from plp_lightning.cli.verbs import VERBS, find_verb
from plp_lightning.cli.words import read_words
from plp_lightning.placement import is_first, stand_alone
from plp_lightning.stopping import stoppable

USAGE = """usage: plp VERB [options]

Cross-domain policy transfer by representation alignment.

verbs:
{verbs}

The main job: plp fit --config configs/r2r.yaml
Options of a verb: plp VERB --help"""


def main(arguments: Sequence[str] | None = None) -> None:
    """Run a verb; a user's mistake is one line on standard error and exit code 2."""
    words = list(sys.argv[1:] if arguments is None else arguments)
    settle_surroundings()
    if words[:1] != ["fit"]:
        stand_alone()
    steady_screen()
    tell_of_threads()
    way_on = "plp fit --resume RUN_DIR" if words[:1] == ["fit"] else "the same command"
    try:
        with stoppable():
            _answer(read_words(words))
    except BaseException as error:  # being asked to stop is no Exception
        found = answer_to(error, way_on)
        if found is None:
            raise
        _leave(*found)
    _tell_loss(words)


def _answer(words: Sequence[str]) -> None:
    if not words or words[0] in ("-h", "--help"):
        print(USAGE.format(verbs="\n".join(f"  {name:10} {verb.told}" for name, verb in VERBS.items())))
    elif words[0] == "--version":
        print(f"plp {_installed_version()}")
    else:
        find_verb(words[0])(words[1:])


def _tell_loss(words: Sequence[str]) -> None:
    """Say that the output is lost; that is a failure where nothing else is left of the work."""
    reason = loss()
    if reason is not None:
        kept = any(VERBS[word].keeps for word in words[:1] if word in VERBS)
        kept = kept or any(word.partition("=")[0] == "--out" for word in words)
        _leave(f"standard output: {reason}; expected a place that can be written: name another", 0 if kept else 2)


def _leave(message: str, code: int) -> NoReturn:
    if is_first():
        print(f"plp: {one_line(message)}", file=sys.stderr)
    sys.exit(code)


def _installed_version() -> str:
    metadata = importlib.import_module("importlib.metadata")
    try:
        return str(metadata.version("plp-lightning"))
    except metadata.PackageNotFoundError:
        return "from a checkout that is not installed; run pip install -e ."


if __name__ == "__main__":
    main()
