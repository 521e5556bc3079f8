"""Success before a phase whose weights come from a run with another target task: nobody has measured it yet."""

from __future__ import annotations

from pathlib import Path

from datamodules.plain_yaml import parse_yaml
from plp_lightning.runs.devices import on_device, resolved_device
from plp_lightning.runs.directory import RunDirectory
from plp_lightning.runs.experiment import Experiment
from plp_lightning.runs.policies import load_policy_weights


def note_before(experiment: Experiment, run: RunDirectory, name: str, weights: Path, origin: RunDirectory) -> None:
    """Evaluate the policy that a phase begins with, unless ``origin`` did so; the phase's record keeps the outcomes.

    They are those that an unbroken run would have at the end of the phase before.
    """
    names = list(experiment.method.phases)
    if "before" in run.phase_record(name) or _target_task(origin) == experiment.data.target_task:
        return
    policy = experiment.build_policy()
    load_policy_weights(policy, weights)
    if experiment.method.phases[names[names.index(name) - 1]](policy).policy_acts:
        policy.eval()
        with on_device(policy, resolved_device(experiment.trainer)):
            outcomes = {trial: found.to_dict() for trial, found in experiment.evaluate(policy).items()}
        run.update_status("running", name, {"before": outcomes})


def _target_task(run: RunDirectory) -> str:
    return str(parse_yaml(run.config.read_text(encoding="utf-8"))["data"]["target_task"])
