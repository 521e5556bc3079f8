"""``plp data``: options of inspect and validate."""

from __future__ import annotations

from collections.abc import Sequence

from plp_lightning.verbs.inspection import inspect_file, validate
from plp_lightning.verbs.options import OptionParser


def run_data(arguments: Sequence[str]) -> None:
    """``plp data inspect FILE`` and ``plp data validate FILE``."""
    parser = OptionParser("plp data", description="Look at a trajectory file.")
    verbs = parser.add_subparsers(dest="verb", required=True)
    inspecting = verbs.add_parser("inspect", help="domains, keys, tasks, lengths, provenance")
    inspecting.add_argument("file")
    inspecting.add_argument("--json", action="store_true", help="print JSON instead of tables")
    validating = verbs.add_parser("validate", help="check every rule of the format")
    validating.add_argument("file")
    options = parser.parse_args(list(arguments))
    if options.verb == "inspect":
        inspect_file(options.file, options.json)
    else:
        validate(options.file)
