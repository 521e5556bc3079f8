"""The verbs that need torch: fit, collect, validate, test, predict. Arguments in, calls out, nothing more."""

from __future__ import annotations

import argparse
import platform
import shlex
import sys
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console

from datamodules.errors import ConfigError
from plp_lightning.cli.config import help_parser, option_values, parse
from plp_lightning.cli.options import OptionParser, positive
from plp_lightning.cli.training import train_expert
from plp_lightning.runs.assessment import Assessment, held_out_losses, predict_actions
from plp_lightning.runs.directory import RunDirectory
from plp_lightning.runs.experiment import Experiment
from plp_lightning.runs.fit import check_method, fit
from plp_lightning.runs.results import print_results, print_success
from plp_lightning.runs.trainer import check_trainer
from plp_lightning.runs.versions import versions

EXPERT_STEPS = 3_000_000  # Enough for a gait that falls over in few episodes; a quarter of an hour on one core


def run_fit(arguments: Sequence[str]) -> None:
    """``plp fit``: a new run, a phase of it, or the rest of an interrupted one."""
    if _helped(arguments, _fit_options()):
        return
    options, rest = _fit_options().parse_known_args(list(arguments))
    if options.print_config:
        print(parse(rest).config, end="")
    elif options.resume is not None:
        _resume(Path(options.resume), rest, options.phase or options.origin)
    else:
        _begin(parse(rest), options.phase, options.origin)


def _begin(experiment: Experiment, phase: str | None, origin: str | None) -> None:
    wanted = _wanted(experiment, phase, origin)
    if origin is not None:
        _check_origin(experiment, Path(origin))
    check_trainer(experiment)
    check_method(experiment)
    # Absolute, so that the run can be resumed from anywhere.
    plan = {"wanted": wanted, "origin": None if origin is None else str(Path(origin).resolve())}
    _fit(experiment, RunDirectory.create(experiment.run_path, experiment.config, _environment(), plan))


def _resume(path: Path, rest: list[str], others: str | None) -> None:
    run = RunDirectory.open(path)
    trusted = _trusted(rest)
    if others or len(rest) > 2 * len(trusted):
        remedy = "drop all options but --allow_imports"
        raise ConfigError(f"--resume goes on with the configuration in {run.config}; {remedy}")
    if run.status()["state"] == "done" and run.results.exists():
        print_results(run.read_results(), run)
        print(f"{path}: done already; nothing was changed")
        return
    run.check_begun()
    _fit(parse(["--config", str(run.config), *trusted]), run)


def _trusted(rest: Sequence[str]) -> list[str]:
    """Packages of the user's: a run's own configuration cannot vouch for them."""
    return [f"--allow_imports={name}" for name in option_values(rest, "allow_imports")]


def _fit(experiment: Experiment, run: RunDirectory) -> None:
    with run.locked(), run.failures_noted():
        status = run.status()
        origin = RunDirectory.open(Path(status["origin"])) if status.get("origin") else None
        wanted = status.get("wanted") or list(experiment.method.phases)
        if unknown := [name for name in wanted if name not in experiment.method.phases]:
            told = f"{run.path / 'status.json'}: wants phase {unknown[0]!r}"
            raise ConfigError(f"{told}; the phases of {run.config} are {', '.join(experiment.method.phases)}")
        fit(experiment, run, wanted, origin)


def _wanted(experiment: Experiment, phase: str | None, origin: str | None) -> list[str]:
    names = list(experiment.method.phases)
    if phase is None and origin is None:
        return names
    if phase is None or (phase in names[:1] and origin is not None):
        later = ", ".join(names[1:])
        raise ConfigError(f"--from {origin} stands in for the phases before --phase; name one of {later}")
    if phase not in names:
        raise ConfigError(
            f"--phase is {phase!r}; the phases of method {experiment.method.name!r} are {', '.join(names)}"
        )
    if phase != names[0] and origin is None:
        remedy = "name the run that holds it with --from RUN_DIR"
        raise ConfigError(f"--phase {phase} goes on from an earlier phase; {remedy}")
    return [phase]


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


def run_test(arguments: Sequence[str]) -> None:
    """``plp test``: success rates of a run's policy in the simulators."""
    parser = _subject_options("test", "Success rates of a trained policy in the simulators.")
    parser.add_argument("--episodes", type=positive, help="episodes of each trial; the configuration's if not given")
    parser.add_argument("--episode_seed", type=int, help="seed of the initial states; the run's if not given")
    parser.add_argument("--output", type=Path, help="JSON file to write; test.json in the run directory if not given")
    options, rest = parser.parse_known_args(list(arguments))
    assessment = _assessment(options, rest)
    outcomes = assessment.success(options.episodes, options.episode_seed)
    print_success(outcomes, f"{assessment.experiment.name} · {assessment.checkpoint}")
    assessment.write(options.output or assessment.folder / "test.json", {"trials": outcomes})


def run_validate(arguments: Sequence[str]) -> None:
    """``plp validate``: held-out losses of a run's policy."""
    parser = _subject_options("validate", "Held-out losses and alignment scores of a trained policy.")
    options, rest = parser.parse_known_args(list(arguments))
    assessment = _assessment(options, rest)
    for name, value in (held_out_losses(assessment) | assessment.scores()).items():
        Console().print(f"{name}: {value:.4f}", highlight=False)


def run_predict(arguments: Sequence[str]) -> None:
    """``plp predict``: the policy's actions on held-out trajectories, beside the expert's."""
    parser = _subject_options("predict", "Actions of a trained policy on held-out trajectories, as .npz.")
    parser.add_argument("--output", type=Path, help="file to write; predictions.npz in the run directory if not given")
    options, rest = parser.parse_known_args(list(arguments))
    assessment = _assessment(options, rest)
    print(predict_actions(assessment, options.output or assessment.folder / "predictions.npz"))


def _assessment(options: argparse.Namespace, rest: list[str]) -> Assessment:
    if rest and not rest[0].startswith("-"):
        return _of_run(Path(rest[0]), rest[1:], options)
    if options.checkpoint is None:
        raise ConfigError("nothing to look at; name a run directory first, or --config FILE with --checkpoint FILE")
    return Assessment(parse(rest), options.checkpoint, Path())


def _of_run(path: Path, rest: list[str], options: argparse.Namespace) -> Assessment:
    trusted = _trusted(rest)
    if len(rest) > 2 * len(trusted):
        raise ConfigError(f"{rest[0]!r} is not accepted with a run directory, whose own configuration is used")
    run = RunDirectory.open(path)
    run.check_begun()
    experiment = parse(["--config", str(run.config), *trusted])
    if options.phase not in (None, *experiment.method.phases):
        raise ConfigError(
            f"--phase is {options.phase!r}; the phases of {path} are {', '.join(experiment.method.phases)}"
        )
    done = [name for name in experiment.method.phases if run.checkpoint(name).exists()]
    if not done:
        raise ConfigError(f"{run.path}: has no checkpoint yet; finish a phase with plp fit --resume {run.path}")
    return Assessment(experiment, run.checkpoint(options.phase or done[-1], options.which), run.path)


def _subject_options(verb: str, description: str) -> OptionParser:
    usage = f"plp {verb} RUN_DIR [options]\n       plp {verb} --config FILE … --checkpoint FILE [options]"
    parser = OptionParser(f"plp {verb}", usage=usage, description=description, allow_abbrev=False)
    told = "checkpoint, to be used with --config instead of a run directory"
    parser.add_argument("--checkpoint", type=Path, help=told)
    parser.add_argument("--phase", help="phase whose checkpoint to use; the last one if not given")
    parser.add_argument("--which", choices=["last", "best"], default="last", help="which checkpoint of the phase")
    return parser


def _fit_options() -> OptionParser:
    description = "Train every phase of a method, evaluate and report."
    parser = OptionParser("plp fit", description=description, add_help=False, allow_abbrev=False)
    parser.add_argument("--resume", metavar="RUN_DIR", help="go on where this run stopped; takes no other option")
    parser.add_argument("--phase", help="run this phase alone")
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
    asked = not {"-h", "--help"}.isdisjoint(arguments)
    for parser in (options, help_parser(arguments)) if asked else ():
        parser.print_help()
    return asked


def _environment() -> dict[str, object]:
    command = shlex.join(["plp", *sys.argv[1:]])
    return {"command": command, "platform": platform.platform(), "versions": versions()}
