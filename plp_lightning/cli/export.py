"""``plp export``: a run's policy for one robot and one task, in a file that runs without this project."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from plp_lightning.cli.options import OptionParser
from plp_lightning.cli.yaml_files import read_yaml
from plp_lightning.plugins import find_in_working_folder
from plp_lightning.runs.directory import RunDirectory
from plp_lightning.runs.export import SUFFIXES, WRITERS, export
from plp_lightning.runs.policies import check_own, checkpoint_of, load_policy
from plp_lightning.runs.records import file_hash
from plp_lightning.runs.robot_policy import RobotPolicy
from plp_lightning.runs.versions import commit, versions


def run_export(arguments: Sequence[str]) -> None:
    """``plp export RUN_DIR --to onnx|torch|safetensors``; needs neither demonstrations nor a simulator."""
    parser = OptionParser("plp export", description="A trained policy in a file of its own, with a card beside it.")
    parser.add_argument("run", type=Path, metavar="RUN_DIR", help="run whose policy to export")
    parser.add_argument("--to", choices=[*WRITERS], default="onnx", help="kind of the file; onnx if not given")
    parser.add_argument("--domain", help="robot that it acts in; the run's target domain if not given")
    parser.add_argument("--task", help="task that it does; the run's target task if not given")
    parser.add_argument("--phase", help="phase whose checkpoint to use; the last one if not given")
    parser.add_argument("--which", choices=["last", "best"], help="its checkpoint; what it handed on if not given")
    parser.add_argument("--out", type=Path, help="file to write; policy.onnx and the like in the run if not given")
    parser.add_argument("--allow_imports", action="append", default=[], help="package of yours with the policy's class")
    options = parser.parse_args(list(arguments))
    run = RunDirectory.open(options.run)
    find_in_working_folder(options.allow_imports)
    checkpoint = checkpoint_of(run, options.phase, options.which)
    check_own(run, checkpoint)
    policy = load_policy(checkpoint, allow_imports=options.allow_imports)
    domain = policy.problem.target_domain if options.domain is None else options.domain
    task = _target_task(run) if options.task is None else options.task
    path = options.out or run.path / f"policy{SUFFIXES[options.to]}"
    export(RobotPolicy(policy, domain, task), options.to, path, _provenance(run, checkpoint))
    print(f"{path}: acts in {domain} on {task}; {path.name}.json says what it wants")


def _target_task(run: RunDirectory) -> str:
    run.check_begun()
    data = read_yaml(run.config)["data"]
    return str(data["target_task"] if "target_task" in data else data["target"])  # as earlier versions called it


def _provenance(run: RunDirectory, checkpoint: Path) -> dict[str, Any]:
    """Origin of the policy, and its success there."""
    known = run.read_results() if run.results.exists() else {}
    told = {name: known[name] for name in ("experiment", "method", "target_task", "seed") if name in known}
    success = {name: known[name]["success"] for name in ("target", "source", "proxy") if name in known}
    made = {"checkpoint": str(checkpoint.relative_to(run.path)), "checkpoint_sha256": file_hash(checkpoint)}
    return told | made | {"success": success, "config_sha256": run.identity, "commit": commit(), "versions": versions()}
