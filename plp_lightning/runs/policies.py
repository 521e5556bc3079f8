"""Trained policies, out of run directories and checkpoints; nothing else of a run is needed, and nothing is started."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import torch
import yaml

from datamodules.errors import CheckpointError, ConfigError
from datamodules.problem import TransferProblem
from datamodules.settings import build
from plp_lightning.callbacks.checkpointing import check_owner, read_checkpoint
from plp_lightning.methods.policy import Policy
from plp_lightning.methods.upgrade import upgrade_blueprint, upgrade_checkpoint, with_todays_settings
from plp_lightning.plugins import plugins
from plp_lightning.runs.directory import RunDirectory
from plp_lightning.runs.export import SUFFIXES, read_safetensors
from plp_lightning.runs.specs import check_checkpoint

PACKAGE = "plp_lightning"


def load_policy(
    path: Path | str, phase: str | None = None, which: str | None = None, allow_imports: Sequence[str] = ()
) -> Policy:
    """Load a trained policy, ready to act on states ``(n, O)``: ``policy.act(observation, domain=…, task=…)``.

    Args:
        path: A run directory, a checkpoint in one, or a safetensors file that ``plp export`` wrote.
        phase: Phase whose checkpoint to take; the last one that has any if not given.
        which: ``last`` or ``best`` checkpoint of the phase; the one that it handed on if not given.
        allow_imports: Packages of yours that the policy's class may be imported from.

    Raises:
        ConfigError: If there is no such run or phase, or the policy's class may not be imported.
        CheckpointError: If the checkpoint is damaged or would run code.
    """
    file = Path(path)
    if not file.is_file():
        run = RunDirectory.open(file)
        file = checkpoint_of(run, phase, which)
        check_own(run, file)
    content = read_safetensors(file) if file.suffix == SUFFIXES["safetensors"] else read_checkpoint(file)
    problem = TransferProblem.from_dict(content["policy"]["problem"])
    # mypy allows no abstract class to stand for its subclasses: https://github.com/python/mypy/issues/4717
    policy: Policy = build(_blueprint(content["policy"], file), Policy, [PACKAGE, *plugins(), *allow_imports], problem)  # type: ignore[type-abstract]
    _put_weights(policy, content, file)
    return policy.eval()


def check_own(run: RunDirectory, checkpoint: Path) -> None:
    """Make sure that a checkpoint in a run's folder is the run's own, and what its phase left when it was done.

    Raises:
        CheckpointError: If it is damaged, of another run or phase, or was exchanged since.
        ConfigError: If the record of the phase has changed.
    """
    phase = checkpoint.parents[1].name
    check_owner(read_checkpoint(checkpoint), checkpoint, run.identity, phase)
    if checkpoint == run.handed_on(phase) and phase in run.done_phases():
        run.check_done(phase)


def load_policy_weights(policy: Policy, checkpoint: Path) -> None:
    """Put a phase's weights, scaling included, into a policy; CheckpointError says if they are of another policy."""
    content = read_checkpoint(checkpoint)
    check_checkpoint(checkpoint, policy.problem, content)
    _put_weights(policy, content, checkpoint)


def _put_weights(policy: Policy, content: dict[str, Any], checkpoint: Path) -> None:
    upgrade_checkpoint(content)
    state, prefix = content["state_dict"], "policy."
    try:
        policy.load_state_dict({k.removeprefix(prefix): v for k, v in state.items() if k.startswith(prefix)})
    except RuntimeError as error:
        found = str(error).strip().splitlines()[-1].strip()
        remedy = "use the configuration that it was trained with"
        raise CheckpointError(f"{checkpoint}: is of another policy ({found}); {remedy}") from None
    except (AttributeError, TypeError) as error:
        raise CheckpointError(f"{checkpoint}: holds no weights ({error}); use one written by plp fit") from None
    lost = [name for name, weights in policy.named_parameters() if not torch.isfinite(weights).all()]
    lost += [name for name, values in policy.named_buffers() if torch.isnan(values).any()]
    if lost:
        raise CheckpointError(f"{checkpoint}: {lost[0]} is not finite; use a checkpoint from before training diverged")


def checkpoint_of(run: RunDirectory, phase: str | None, which: str | None) -> Path:
    """Checkpoint of a phase, or of the last one that has any; a :class:`ConfigError` says if there is none.

    Without ``last`` or ``best`` it is the one that the phase handed on.
    """
    names = [phase] if phase else [*run.status()["phases"]]
    files = [run.chosen(name, which) for name in names]
    if not (found := [file for file in files if file.exists()]):
        remedy, kind = f"finish a phase with plp fit --resume {run.path}", "" if which is None else f" {which!r}"
        raise ConfigError(f"{run.path}: has no checkpoint{kind} of {phase or 'any phase'}; {remedy}")
    return found[-1]


def _blueprint(record: Mapping[str, Any], checkpoint: Path) -> Mapping[str, Any]:
    """Class and settings of a policy; earlier versions kept the class in the run's configuration alone."""
    if "class_path" in record:
        return with_todays_settings(record)
    config = checkpoint.parents[2] / "config.yaml"
    if not config.is_file():
        raise CheckpointError(f"{checkpoint}: does not say of which class its policy is; expected {config} beside it")
    told = yaml.safe_load(config.read_text(encoding="utf-8"))["policy"]["class_path"]
    return upgrade_blueprint(told, record["architecture"])
