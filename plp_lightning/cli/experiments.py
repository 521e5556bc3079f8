"""The verbs that make runs and demonstrations: fit and collect. Arguments in, calls out, nothing more."""

from __future__ import annotations

import argparse
import platform
import shlex
import sys
from collections.abc import Sequence
from pathlib import Path

from datamodules.errors import ConfigError
from plp_lightning.cli.brief_help import brief_help
from plp_lightning.cli.config import help_parser, option_values, parse, read, tell, trusted
from plp_lightning.cli.options import OptionParser, positive
from plp_lightning.cli.training import train_expert
from plp_lightning.cli.yaml_files import read_yaml
from plp_lightning.placement import stand_alone
from plp_lightning.runs.crew import Crew
from plp_lightning.runs.directory import RunDirectory
from plp_lightning.runs.experiment import Experiment
from plp_lightning.runs.fit import fit
from plp_lightning.runs.following import follow
from plp_lightning.runs.rehearsal import check_demonstrations, check_method
from plp_lightning.runs.results import print_results
from plp_lightning.runs.trainer import check_devices, check_trainer, device_count
from plp_lightning.runs.versions import versions

EXPERT_STEPS = 3_000_000  # Enough for a gait that falls over in few episodes; a quarter of an hour on one core


def run_fit(arguments: Sequence[str]) -> None:
    """``plp fit``: a new run, a phase of it, or the rest of an interrupted one."""
    words = list(arguments)
    if words in (["-h"], ["--help"]):
        print(brief_help(_fit_options()))
        return
    if _helped(arguments, _fit_options()):
        return
    options, rest = _fit_options().parse_known_args(words)
    if options.print_config:
        if options.resume or options.phase or options.origin:
            raise ConfigError(
                "--print_config prints the configuration of files and flags; drop --resume, --phase, --from"
            )
        print(parse(rest).config, end="")
    elif options.resume is not None:
        _resume(Path(options.resume), rest, options.phase or options.origin)
    else:
        _begin(rest, options.phase, options.origin)


def _begin(arguments: Sequence[str], phase: str | None, origin: str | None) -> None:
    experiment, changes = read(arguments)
    with _crew(experiment, experiment.run_path, option_values(arguments, "allow_imports")) as crew:
        wanted = _wanted(experiment, phase, origin)
        if origin is not None:
            _check_origin(experiment, Path(origin))
        check_trainer(experiment)
        check_method(experiment)
        check_demonstrations(experiment)
        tell(changes)
        # Absolute, so that the run can be resumed from anywhere.
        plan = {"wanted": wanted, "origin": None if origin is None else str(Path(origin).resolve())}
        _fit(experiment, RunDirectory.create(experiment.run_path, experiment.config, _environment(), plan), crew)


def _resume(path: Path, rest: list[str], others: str | None) -> None:
    run = RunDirectory.open(path)
    trusting = OptionParser(add_help=False, allow_abbrev=False)
    trusting.add_argument("--allow_imports", action="append", default=[])
    trusting.add_argument("--trainer.devices", dest="devices")
    options, more = trusting.parse_known_args(rest)
    if others or more:
        remedy = "drop all options but --allow_imports and --trainer.devices"
        raise ConfigError(f"--resume goes on with the configuration in {run.config}; {remedy}")
    if run.status()["state"] == "done" and run.results.exists():
        print_results(run.read_results(), run)
        print(f"{path}: done already; nothing was changed")
        return
    run.check_begun()
    devices = [] if options.devices is None else ["--trainer.devices", options.devices]
    experiment = parse([*_kept_words(run), *devices, *trusted(options.allow_imports)])
    with _crew(experiment, path, options.allow_imports) as crew:
        check_devices(experiment)
        _fit(experiment, run, crew)


def _crew(experiment: Experiment, path: Path, packages: Sequence[str]) -> Crew:
    """Give the ranks of a run into the hands of the first, from which alone this returns; all others follow it."""
    devices = device_count(experiment.trainer)
    crew = Crew(devices, ["--resume", str(path), "--trainer.devices", str(devices), *trusted(packages)])
    if crew.place is None:
        stand_alone()
    elif crew.place.rank > 0:
        follow(experiment, crew.place)
    return crew


def _kept_words(run: RunDirectory) -> list[str]:
    """Words that read a kept configuration; one that is older than a setting goes on as it was without it."""
    data = read_yaml(run.config).get("data")
    older = isinstance(data, dict) and "epoch_steps" not in data
    return ["--config", str(run.config), *(["--data.epoch_steps", "1"] if older else [])]


def _fit(experiment: Experiment, run: RunDirectory, crew: Crew) -> None:
    with run.locked(), run.failures_noted():
        status = run.status()
        origin = RunDirectory.open(Path(status["origin"])) if status.get("origin") else None
        wanted = status.get("wanted") or list(experiment.method.phases)
        if unknown := [name for name in wanted if name not in experiment.method.phases]:
            told = f"{run.path / 'status.json'}: wants phase {unknown[0]!r}"
            raise ConfigError(f"{told}; the phases of {run.config} are {', '.join(experiment.method.phases)}")
        fit(experiment, run, wanted, origin, crew=crew)


def _wanted(experiment: Experiment, phase: str | None, origin: str | None) -> list[str]:
    names = list(experiment.method.phases)
    if phase is None and origin is None:
        return names
    wanted = [] if phase is None else phase.split(",")
    if not wanted or (wanted[0] in names[:1] and origin is not None):
        later = ", ".join(names[1:])
        raise ConfigError(f"--from {origin} stands in for the phases before --phase; name one of {later}")
    known = f"the phases of method {experiment.method.name!r} are {', '.join(names)}"
    if unknown := [name for name in wanted if name not in names]:
        raise ConfigError(f"--phase is {unknown[0]!r}; {known}")
    first = names.index(wanted[0])
    if wanted != names[first : first + len(wanted)]:
        raise ConfigError(f"--phase is {phase!r}; {known}: name some that follow one another")
    if first > 0 and origin is None:
        remedy = "name the run that holds it with --from RUN_DIR"
        raise ConfigError(f"--phase {phase} goes on from an earlier phase; {remedy}")
    return wanted


def _check_origin(experiment: Experiment, path: Path) -> None:
    """A policy that was aligned on other tasks may have seen the target task in the target domain."""
    origin = RunDirectory.open(path)
    origin.check_begun()
    found, wanted = parse(["--config", str(origin.config)]).data, experiment.data
    if found.proxy_tasks != wanted.proxy_tasks:
        told = f"is aligned on {', '.join(found.proxy_tasks)} (for target {found.target_task!r})"
        asked = f"target {wanted.target_task!r} asks for {', '.join(wanted.proxy_tasks)}"
        raise ConfigError(f"{path}: {told}, but {asked}; name a run with this target")


def run_collect(arguments: Sequence[str]) -> None:
    """``plp collect``: the demonstrations that an experiment lacks, or the training of an expert."""
    if _helped(arguments, _collect_options()):
        return
    options, rest = _collect_options().parse_known_args(list(arguments))
    experiment = parse(rest)
    if options.train_expert or options.weights or options.steps:
        _train_expert(experiment, options)
        return
    data = experiment.data
    data.prepare_data()
    print(f"{data.path}: {f'{data.collected} demonstrations collected' if data.collected else 'complete'}")


def _train_expert(experiment: Experiment, options: argparse.Namespace) -> None:
    if options.train_expert is None or options.weights is None:
        lacks = "--weights FILE" if options.train_expert else "--train_expert DOMAIN"
        raise ConfigError(f"training an expert lacks {lacks}; give both --train_expert DOMAIN and --weights FILE")
    train_expert(experiment, options.train_expert, options.weights, options.steps or EXPERT_STEPS)


def _fit_options() -> OptionParser:
    description = "Train every phase of a method, evaluate and report."
    parser = OptionParser("plp fit", description=description, add_help=False, allow_abbrev=False)
    parser.add_argument(
        "--resume", metavar="RUN_DIR", help="go on where this run stopped; of other options only --trainer.devices"
    )
    parser.add_argument("--phase", help="run this phase alone, or these, joined by commas")
    parser.add_argument("--from", dest="origin", metavar="RUN_DIR", help="run whose earlier phases --phase builds on")
    parser.add_argument("--print_config", action="store_true", help="print the resolved configuration and stop")
    return parser


def _collect_options() -> OptionParser:
    description = "Collect the demonstrations that an experiment lacks, or train the expert who demonstrates."
    parser = OptionParser("plp collect", description=description, add_help=False, allow_abbrev=False)
    told = "train this walker's expert instead of collecting"
    parser.add_argument("--train_expert", "--train-expert", metavar="DOMAIN", help=told)
    parser.add_argument("--weights", type=Path, metavar="FILE", help="where to write it, a .safetensors file")
    parser.add_argument("--steps", type=positive, help=f"control steps to train for; {EXPERT_STEPS} if not given")
    return parser


def _helped(arguments: Sequence[str], options: OptionParser) -> bool:
    """Print all help if it is asked for; tell whether it was."""
    asked = any(word in ("-h", "--help") or word.startswith("--help=") for word in arguments)
    for parser in (options, help_parser(arguments)) if asked else ():
        parser.prog = options.prog
        parser.print_help()
    return asked


def _environment() -> dict[str, object]:
    command = shlex.join(["plp", *sys.argv[1:]])
    return {"command": command, "platform": platform.platform(), "versions": versions()}
