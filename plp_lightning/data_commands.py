"""``plp data``: options of inspect and validate."""

from __future__ import annotations

import argparse
from collections.abc import Sequence

from datamodules.errors import ConfigError
from plp_lightning.data_verbs import inspect_file, validate


def run_data(arguments: Sequence[str]) -> None:
    """``plp data inspect FILE`` and ``plp data validate FILE``."""
    parser = argparse.ArgumentParser("plp data", description="Look at a trajectory file.", exit_on_error=False)
    verbs = parser.add_subparsers(dest="verb", required=True)
    inspecting = verbs.add_parser("inspect", help="domains, keys, tasks, lengths, provenance", exit_on_error=False)
    inspecting.add_argument("file")
    inspecting.add_argument("--json", action="store_true", help="print JSON instead of tables")
    validating = verbs.add_parser("validate", help="check every rule of the format", exit_on_error=False)
    validating.add_argument("file")
    try:
        options = parser.parse_args(list(arguments))
    except argparse.ArgumentError as error:
        raise ConfigError(f"{error}; see plp data --help") from None
    if options.verb == "inspect":
        inspect_file(options.file, options.json)
    else:
        validate(options.file)
