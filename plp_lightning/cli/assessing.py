"""The verbs that look at a trained policy: test, validate, predict; what they, and rollout, are asked."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console

from datamodules.errors import ConfigError
from plp_lightning.cli.config import option_values, parse, trusted
from plp_lightning.cli.options import OptionParser, positive, seed
from plp_lightning.runs.assessment import Assessment, held_out_losses, predict_actions
from plp_lightning.runs.directory import RunDirectory
from plp_lightning.runs.printing import shown
from plp_lightning.runs.results import print_success


def run_test(arguments: Sequence[str]) -> None:
    """``plp test``: success rates of a run's policy in the simulators."""
    parser = assessment_options("test", arguments, "Success rates of a trained policy in the simulators.")
    parser.add_argument("--episodes", type=positive, help="episodes of each trial; the configuration's if not given")
    parser.add_argument("--episode_seed", type=seed, help="seed of the initial states; the run's if not given")
    parser.add_argument("--output", type=Path, help="JSON file to write; test.json in the run directory if not given")
    assessment, options = read_assessment(parser, arguments)
    outcomes = assessment.success(options.episodes, options.episode_seed)
    print_success(outcomes, f"{assessment.experiment.name} · {assessment.checkpoint}")
    assessment.write(options.output or assessment.folder / "test.json", {"trials": outcomes})


def run_validate(arguments: Sequence[str]) -> None:
    """``plp validate``: held-out losses of a run's policy."""
    parser = assessment_options("validate", arguments, "Held-out losses and alignment scores of a trained policy.")
    assessment, _ = read_assessment(parser, arguments)
    for name, value in (held_out_losses(assessment) | assessment.scores()).items():
        Console().print(f"{shown(name)}: {value:.4f}", highlight=False)


def run_predict(arguments: Sequence[str]) -> None:
    """``plp predict``: the policy's actions on held-out trajectories, beside the expert's."""
    parser = assessment_options("predict", arguments, "Actions of a trained policy on held-out trajectories, as .npz.")
    parser.add_argument("--output", type=Path, help="file to write; predictions.npz in the run directory if not given")
    assessment, options = read_assessment(parser, arguments)
    print(predict_actions(assessment, options.output or assessment.folder / "predictions.npz"))


def _names_files(arguments: Sequence[str]) -> bool:
    return any(word.partition("=")[0] == "--config" for word in arguments)


def assessment_options(verb: str, arguments: Sequence[str], description: str) -> OptionParser:
    """Options of a run directory, or of files with a checkpoint, whichever the arguments name."""
    usage = f"plp {verb} RUN_DIR [options]\n       plp {verb} --config FILE … --checkpoint FILE [options]"
    parser = OptionParser(f"plp {verb}", usage=usage, description=description, allow_abbrev=False)
    if _names_files(arguments):
        parser.add_argument("--checkpoint", type=Path, required=True, help="checkpoint of a policy set up by the files")
        return parser
    parser.add_argument("run", type=Path, nargs="?", metavar="RUN_DIR", help="run whose policy to look at")
    parser.add_argument("--phase", help="phase whose checkpoint to use; the last one if not given")
    parser.add_argument("--which", choices=["last", "best"], help="its checkpoint; what it handed on if not given")
    parser.add_argument("--allow_imports", action="append", default=[], help="package of yours that the run uses")
    return parser


def read_assessment(parser: OptionParser, arguments: Sequence[str]) -> tuple[Assessment, argparse.Namespace]:
    """The policy to look at, and the values of all options."""
    if _names_files(arguments):
        options, rest = parser.parse_known_args(list(arguments))
        _check_files_alone(rest)
        return Assessment(parse(rest), options.checkpoint, Path()), options
    if option_values(arguments, "checkpoint"):
        raise ConfigError("--checkpoint goes with --config FILE; a run directory has its own: name --phase or --which")
    options = parser.parse_args(list(arguments))
    if options.run is None:
        raise ConfigError("nothing to look at; name a run directory first, or --config FILE with --checkpoint FILE")
    return _of_run(options.run, options), options


def _check_files_alone(rest: Sequence[str]) -> None:
    for name in ("phase", "which"):
        if option_values(rest, name):
            raise ConfigError(f"--{name} chooses a checkpoint of a run directory; expected --checkpoint alone: drop it")


def _of_run(path: Path, options: argparse.Namespace) -> Assessment:
    run = RunDirectory.open(path)
    run.check_begun()
    experiment = parse(["--config", str(run.config), *trusted(options.allow_imports)])
    if options.phase not in (None, *experiment.method.phases):
        raise ConfigError(
            f"--phase is {options.phase!r}; the phases of {path} are {', '.join(experiment.method.phases)}"
        )
    done = [name for name in experiment.method.phases if run.checkpoint(name).exists()]
    if not done:
        raise ConfigError(f"{run.path}: has no checkpoint yet; finish a phase with plp fit --resume {run.path}")
    return Assessment(experiment, run.chosen(options.phase or done[-1], options.which), run.path, run)
