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
from plp_lightning.assess import Assessment, held_out_losses, predict_actions
from plp_lightning.config import build_parser, parse, phase_names
from plp_lightning.experiment import Experiment
from plp_lightning.fit import fit
from plp_lightning.results import print_success
from plp_lightning.run import RunDirectory
from plp_lightning.versions import versions


def run_fit(arguments: Sequence[str]) -> None:
    """``plp fit``: a new run, a phase of it, or the rest of an interrupted one."""
    if _asks_for_help(arguments):
        _fit_options().print_help()
        build_parser(phase_names(arguments)).print_help()
        return
    options, rest = _parse_known(_fit_options(), arguments)
    if "--print_config" in rest:
        print(parse([a for a in rest if a != "--print_config"]).config, end="")
        return
    if options.resume is not None:
        _resume(Path(options.resume), rest or options.phase or options.origin)
        return
    experiment = parse(rest)
    wanted = _wanted(experiment, options.phase, options.origin)
    run = RunDirectory.create(experiment.run_path, experiment.config, _environment())
    run.write_json("status.json", {"state": "new", "wanted": wanted, "origin": options.origin, "phases": {}})
    _fit(experiment, run)


def _resume(path: Path, others: object) -> None:
    if others:
        raise ConfigError(
            "--resume goes on with the run's own configuration; drop the other options or begin a new run"
        )
    run = RunDirectory.open(path)
    _fit(parse(["--config", str(run.config)]), run)


def _fit(experiment: Experiment, run: RunDirectory) -> None:
    status = run.status()
    origin = RunDirectory.open(Path(status["origin"])) if status.get("origin") else None
    with run.locked():
        fit(experiment, run, status.get("wanted") or list(experiment.phases), origin)


def _wanted(experiment: Experiment, phase: str | None, origin: str | None) -> list[str]:
    names = list(experiment.phases)
    if phase is None:
        return names
    if phase not in names:
        raise ConfigError(f"--phase is {phase!r}; the phases of method {experiment.method!r} are {', '.join(names)}")
    if names.index(phase) > 0 and origin is None:
        raise ConfigError(
            f"--phase {phase} goes on from an earlier phase; name the run that holds it with --from RUN_DIR"
        )
    return [phase]


def run_collect(arguments: Sequence[str]) -> None:
    """``plp collect``: the demonstrations that an experiment lacks, nothing else."""
    experiment = parse(arguments)
    missing = sum(sum(tasks.values()) for tasks in experiment.data.missing().values())
    experiment.data.prepare_data()
    print(
        f"{experiment.data.path}: {missing} demonstrations collected"
        if missing
        else f"{experiment.data.path}: complete"
    )


def run_test(arguments: Sequence[str]) -> None:
    """``plp test``: success rates of a run's policy in the simulators."""
    parser = _subject_options("test", "Success rates of a trained policy in the simulators.")
    parser.add_argument("--episodes", type=int, help="episodes of each trial; the configuration's if not given")
    parser.add_argument("--episode_seed", type=int, help="seed of the initial states; the run's if not given")
    parser.add_argument("--output", type=Path, help="JSON file to write; test.json in the run directory if not given")
    options, rest = _parse_known(parser, arguments)
    assessment = _assessment(options, rest)
    outcomes = assessment.success(options.episodes, options.episode_seed)
    print_success(outcomes, f"{assessment.experiment.name} · {assessment.checkpoint}")
    assessment.write(options.output or assessment.folder / "test.json", {"trials": outcomes})


def run_validate(arguments: Sequence[str]) -> None:
    """``plp validate``: held-out losses of a run's policy."""
    parser = _subject_options("validate", "Held-out losses and alignment scores of a trained policy.")
    options, rest = _parse_known(parser, arguments)
    assessment = _assessment(options, rest)
    for name, value in (held_out_losses(assessment) | assessment.scores()).items():
        Console().print(f"{name}: {value:.4f}", highlight=False)


def run_predict(arguments: Sequence[str]) -> None:
    """``plp predict``: the policy's actions on held-out trajectories, beside the expert's."""
    parser = _subject_options("predict", "Actions of a trained policy on held-out trajectories, as .npz.")
    parser.add_argument("--output", type=Path, help="file to write; predictions.npz in the run directory if not given")
    options, rest = _parse_known(parser, arguments)
    assessment = _assessment(options, rest)
    print(predict_actions(assessment, options.output or assessment.folder / "predictions.npz"))


def _assessment(options: argparse.Namespace, rest: list[str]) -> Assessment:
    if options.run_dir is not None:
        if rest:
            raise ConfigError(f"{rest[0]!r} is not accepted with a run directory, whose own configuration is used")
        run = RunDirectory.open(options.run_dir)
        experiment = parse(["--config", str(run.config)])
        done = [name for name in experiment.phases if run.checkpoint(name).exists()]
        if not done:
            raise ConfigError(f"{run.path}: has no checkpoint yet; finish a phase with plp fit --resume {run.path}")
        return Assessment(experiment, run.checkpoint(options.phase or done[-1], options.which), run.path)
    if options.checkpoint is None:
        raise ConfigError("nothing to look at; name a run directory, or --config FILE with --checkpoint FILE")
    return Assessment(parse(rest), options.checkpoint, Path())


def _subject_options(verb: str, description: str) -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(f"plp {verb}", description=description, exit_on_error=False)
    parser.add_argument("run_dir", nargs="?", type=Path, help="run directory")
    parser.add_argument(
        "--checkpoint", type=Path, help="checkpoint, to be used with --config instead of a run directory"
    )
    parser.add_argument("--phase", help="phase whose checkpoint to use; the last one if not given")
    parser.add_argument("--which", choices=["last", "best"], default="last", help="which checkpoint of the phase")
    return parser


def _fit_options() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        "plp fit",
        description="Train every phase of a method, evaluate and report.",
        add_help=False,
        exit_on_error=False,
    )
    parser.add_argument("--resume", metavar="RUN_DIR", help="go on where this run stopped; takes no other option")
    parser.add_argument("--phase", help="run this phase alone")
    parser.add_argument("--from", dest="origin", metavar="RUN_DIR", help="run whose earlier phases --phase builds on")
    parser.add_argument("--print_config", action="store_true", help="print the resolved configuration and stop")
    return parser


def _parse_known(parser: argparse.ArgumentParser, arguments: Sequence[str]) -> tuple[argparse.Namespace, list[str]]:
    try:
        options, rest = parser.parse_known_args(list(arguments))
    except argparse.ArgumentError as error:
        raise ConfigError(f"{error}; see {parser.prog} --help") from None
    if getattr(options, "print_config", False):
        rest.append("--print_config")
    return options, rest


def _asks_for_help(arguments: Sequence[str]) -> bool:
    return any(argument in ("-h", "--help") for argument in arguments)


def _environment() -> dict[str, object]:
    return {
        "command": shlex.join(["plp", *sys.argv[1:]]),
        "platform": platform.platform(),
        "versions": versions(),
    }
