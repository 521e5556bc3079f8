"""``plp data import`` and ``plp data export``: demonstrations of other projects ↔ trajectory files of ours."""

from __future__ import annotations

import argparse
import shlex
import sys
from collections.abc import Sequence
from pathlib import Path

from datamodules.formats.importing import Imported, import_demonstrations
from datamodules.formats.mapping import ImportOptions
from datamodules.formats.registry import find_format, format_names
from datamodules.store.reader import TrajectoryFile
from plp_lightning.cli.options import OptionParser, add_options, chosen
from plp_lightning.runs.versions import versions

WRITTEN = ("self", "file", "domain", "out")  # What every format is asked to write; its other arguments are options


def run_import(arguments: Sequence[str]) -> None:
    """``plp data import FORMAT SOURCE… --domain NAME --out FILE``."""
    name, words = _named("import", arguments)
    form = find_format(name)
    parser = OptionParser(f"plp data import {name}", description=f"Add demonstrations from {form.title} to our file.")
    parser.add_argument("sources", type=Path, nargs="+", help="files or folders, all of one domain")
    parser.add_argument("--out", type=Path, required=True, help="our file; one that exists grows")
    add_options(parser, form)
    add_options(parser, ImportOptions)
    if name == "d4rl":
        _add_maze(parser)
    options = parser.parse_args(words)
    if name == "d4rl" and options.layout is not None:
        _import_maze(options)
        return
    record = {"command": shlex.join([Path(sys.argv[0]).name, *sys.argv[1:]]), "versions": versions()}
    chosen_form, settings = form(**chosen(options, form)), ImportOptions(**chosen(options, ImportOptions))
    _tell(import_demonstrations(chosen_form, options.sources, settings, options.out, record), options.out)


def run_export(arguments: Sequence[str]) -> None:
    """``plp data export FORMAT FILE --domain NAME --out PLACE``."""
    name, words = _named("export", arguments)
    form = find_format(name)
    parser = OptionParser(f"plp data export {name}", description=f"Write a domain's demonstrations as {form.title}.")
    parser.add_argument("file", type=Path, help="our file")
    parser.add_argument("--domain", required=True, help="the domain to write")
    parser.add_argument("--out", type=Path, required=True, help="a new file or folder")
    add_options(parser, form.write, WRITTEN)
    options = parser.parse_args(words)
    with TrajectoryFile.open(options.file) as file:
        count = len(file.episodes(options.domain).task)
        left = form().write(file, options.domain, options.out, **chosen(options, form.write, WRITTEN))
    print(f"{options.out}: {count} demonstrations of domain {options.domain!r} exported as {form.title}")
    for one in left:
        print(f"  has no place there: {one}")


def _named(verb: str, arguments: Sequence[str]) -> tuple[str, Sequence[str]]:
    parser = OptionParser(f"plp data {verb}", epilog=f"Options of a format: plp data {verb} FORMAT --help")
    parser.add_argument("format", help=", ".join(format_names()))
    first = [word for word in arguments[:1] if word in ("-h", "--help") or not word.startswith("-")]
    return str(parser.parse_args(first).format), arguments[1:]


def _add_maze(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--layout", choices=["umaze", "medium"], help="a maze2d file's maze: its walk is cut by goals")
    parser.add_argument("--swap_axes", action="store_true", help="with --layout: the domain sees y before x")
    parser.add_argument("--negate_actions", action="store_true", help="with --layout: actions have the opposite sign")


def _import_maze(options: argparse.Namespace) -> None:
    from plp_lightning.cli.maze2d import import_d4rl
    from plp_lightning.envs.maze.simulator import PointMaze

    maze = PointMaze(options.layout, options.swap_axes, options.negate_actions)
    for source in options.sources:
        import_d4rl(source, maze, options.domain, options.out)


def _tell(done: Imported, out: Path) -> None:
    spec, tasks = done.spec, len(done.tasks)
    print(f"{out}: {done.demonstrations} demonstrations of {tasks} tasks imported, {done.steps} steps")
    keys = ", ".join(f"{key.name} {' × '.join(map(str, key.shape))}" for key in spec.observation)
    print(f"  domain {spec.name!r}: {keys}; {spec.action_size} actions at {spec.control_hz:g} Hz")
    low, high = (", ".join(f"{value:g}" for value in limit) for limit in spec.action_limits)
    print(f"  actions from ({low}) to ({high}); limits: {done.limits}")
    for name, reason in done.dropped.items():
        print(f"  left out: {name} ({reason})")
    for warning in done.warnings:
        print(f"  beware: {warning}")
