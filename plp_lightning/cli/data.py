"""``plp data``: options of inspect, validate and import."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from plp_lightning.cli.inspection import inspect_file, validate
from plp_lightning.cli.options import OptionParser


def run_data(arguments: Sequence[str]) -> None:
    """``plp data inspect FILE``, ``plp data validate FILE`` and ``plp data import FORMAT FILE``."""
    parser = OptionParser("plp data", description="Look at a trajectory file, or make one from another project's.")
    verbs = parser.add_subparsers(dest="verb", required=True)
    inspecting = verbs.add_parser("inspect", help="domains, keys, tasks, lengths, provenance")
    inspecting.add_argument("file")
    inspecting.add_argument("--json", action="store_true", help="print JSON instead of tables")
    validating = verbs.add_parser("validate", help="check every rule of the format")
    validating.add_argument("file")
    importing = verbs.add_parser("import", help="add the demonstrations of another project's file")
    _add_d4rl(importing.add_subparsers(dest="format", required=True))
    options = parser.parse_args(list(arguments))
    if options.verb == "inspect":
        inspect_file(options.file, options.json)
    elif options.verb == "validate":
        validate(options.file)
    else:
        _import_d4rl(options)


def _add_d4rl(formats: argparse._SubParsersAction[OptionParser]) -> None:
    parser = formats.add_parser("d4rl", help="D4RL's maze2d-*-v1 files: one walk, cut into a demonstration a goal")
    parser.add_argument("file", type=Path)
    parser.add_argument("--layout", choices=["umaze", "medium"], required=True, help="the file's maze")
    parser.add_argument("--domain", required=True, help="the domain's name in the experiment, such as point")
    parser.add_argument("--out", type=Path, required=True, help="our file; one that exists grows")
    parser.add_argument("--swap_axes", action="store_true", help="the domain sees y before x")
    parser.add_argument("--negate_actions", action="store_true", help="the domain's actions have the opposite sign")


def _import_d4rl(options: argparse.Namespace) -> None:
    from plp_lightning.cli.importing import import_d4rl
    from plp_lightning.envs.maze.simulator import PointMaze

    maze = PointMaze(options.layout, options.swap_axes, options.negate_actions)
    import_d4rl(options.file, maze, options.domain, options.out)
