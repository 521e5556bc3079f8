"""Loggers that a configuration adds to a run's own: built anew for each phase, told the settings once, and ended."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path

from lightning.pytorch.loggers import Logger

from datamodules.errors import ConfigError
from plp_lightning.runs.experiment import Experiment

HINT = re.compile(r"pip install (?:-\S+ )*'?([\w-]+)")  # in what Lightning says of a package that it lacks


def further_loggers(experiment: Experiment, run: Path, phase: str) -> list[Logger]:
    """Build them for one phase of a run; nothing is written or sent yet.

    Raises:
        ConfigError: If one can't be built, or a package that it needs is not installed.
    """
    title = "-".join([*experiment.run_path.relative_to(experiment.run_root).parts, phase])
    try:
        return experiment.loggers((run / phase).absolute(), title)
    except Exception as error:  # each class has errors of its own for settings that cannot be
        if (hint := HINT.search(str(error))) is None:
            raise ConfigError(f"trainer.logger: {_line(error)}; mend the logger's settings") from None
        told = f"trainer.logger needs {hint[1]}, which is not installed; install it with pip install {hint[1]}"
        raise ConfigError(f"{told}, or leave the logger away") from None


def tell_settings(loggers: Sequence[Logger], settings: Mapping[str, str | float | int | bool]) -> None:
    """Log a run's settings, by which a logger begins what it calls a run.

    Raises:
        ConfigError: If it can't, for want of a network or an account, say.
    """
    for logger in loggers:
        try:
            logger.log_hyperparams(dict(settings))
        except OSError:
            raise
        except Exception as error:
            told = f"{type(logger).__name__} can't begin ({_line(error)}); expected a logger that works here"
            raise ConfigError(f"{told}: mend --trainer.logger or what it needs") from None


def end(logger: Logger) -> None:
    """Finish what a logger calls a run where that is left to its user, as W&B's is: the next phase begins another."""
    finish = getattr(getattr(logger, "experiment", None), "finish", None)
    if callable(finish):
        finish()


def _line(error: Exception) -> str:
    return f"{type(error).__name__}: {' '.join(str(error).split())[:200]}"
