"""A policy out of its run: a file for ONNX, PyTorch or safetensors, and a card beside it that says what it wants."""

from __future__ import annotations

import io
import json
import logging
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save as save_tensors

from datamodules.errors import CheckpointError, ConfigError
from datamodules.settings import blueprint
from datamodules.store.atomic import locked_folder, replacing, write_atomically
from plp_lightning.callbacks.checkpointing import HASH, content_hash
from plp_lightning.runs.records import bytes_hash
from plp_lightning.runs.robot_policy import RobotPolicy

CARD_VERSION = 1
POLICY = "policy"  # Key of the policy's blueprint in the metadata of a safetensors file


def export(robot: RobotPolicy, kind: str, path: Path, provenance: Mapping[str, Any]) -> None:
    """Write a policy to ``path``, and its card with spec, units, limits, rate and provenance to ``<path>.json``.

    Args:
        robot: The policy in one domain on one task.
        kind: One of :data:`WRITERS`.
        path: The file; one that is there is replaced.
        provenance: What the policy was made by; plain data.

    Raises:
        ConfigError: If a package is missing that the kind needs.
    """
    content = WRITERS[kind](robot)
    path = path.resolve()
    path.parent.mkdir(parents=True, exist_ok=True)
    with locked_folder(path.parent), replacing(path) as temporary:
        temporary.write_bytes(content)
    told = card(robot, provenance) | {"file": path.name, "format": kind, "sha256": bytes_hash(content)}
    write_atomically(path.with_name(f"{path.name}.json"), json.dumps(told, indent=2) + "\n")


def card(robot: RobotPolicy, provenance: Mapping[str, Any]) -> dict[str, Any]:
    """Facts that a program has to know to let the policy act: inputs, output, units, limits, rate."""
    spec, (low, high) = robot.spec, robot.spec.action_limits
    types = {"state": "float32", "image": "uint8"}
    inputs = [{"name": k.name, "shape": ["B", *k.shape], "dtype": types[k.kind], "unit": k.unit} for k in robot.inputs]
    task = next(name for name, number in robot.policy.tasks.items() if number == robot.task)
    return {
        "card_version": CARD_VERSION,
        "domain": spec.to_dict(),
        "task": task,
        "control_hz": spec.control_hz,
        "inputs": inputs,
        "output": {"name": "action", "shape": ["B", spec.action_size], "dtype": "float32"},
        "action_limits": {"low": [*low], "high": [*high]},
        "provenance": dict(provenance),
    }


def _onnx(robot: RobotPolicy) -> bytes:
    for package in ("onnx", "onnxscript"):
        if find_spec(package) is None:
            remedy = "install the extra 'export' with: pip install 'plp-lightning[export]'"
            raise ConfigError(f"--to onnx needs {package}, which is not installed; {remedy}")
    names = [key.name for key in robot.inputs]
    with _quiet():
        exported = torch.onnx.export(
            _program(robot), dynamo=True, input_names=names, output_names=["action"], verbose=False
        )
    assert exported is not None
    model = exported.model_proto
    for node in model.graph.node:
        node.ClearField("metadata_props")  # places in this machine's files that the exporter came by
    return bytes(model.SerializeToString())


def _torch(robot: RobotPolicy) -> bytes:
    written, program = io.BytesIO(), _program(robot)
    with _quiet():
        torch.export.save(program, written)
    return written.getvalue()


def _program(robot: RobotPolicy) -> torch.export.ExportedProgram:
    rows = torch.export.Dim("B")
    with _quiet():
        # Two rows: of one, the exporter would take that number for a constant.
        return torch.export.export(robot, robot.examples(2), dynamic_shapes=(tuple({0: rows} for _ in robot.inputs),))


@contextmanager
def _quiet() -> Iterator[None]:
    """Without torch's warnings of its own names, packages that no policy here uses, and weights laid out for images."""
    exporter = logging.getLogger("torch.onnx")
    level = exporter.level
    exporter.setLevel(logging.ERROR)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        exporter.setLevel(level)


def _safetensors(robot: RobotPolicy) -> bytes:
    policy = robot.policy
    told = {"problem": policy.problem.to_dict(), **blueprint(policy, ["problem"])}
    tensors = {name: value.contiguous().clone() for name, value in sorted(policy.state_dict().items())}
    return save_tensors(tensors, metadata={POLICY: json.dumps(told), HASH: content_hash({POLICY: told, **tensors})})


WRITERS: dict[str, Callable[[RobotPolicy], bytes]] = {"onnx": _onnx, "torch": _torch, "safetensors": _safetensors}
"""Kinds of files: ONNX; a program for ``torch.export.load``; all weights, for :func:`plp_lightning.load_policy`."""
SUFFIXES = {"onnx": ".onnx", "torch": ".pt2", "safetensors": ".safetensors"}


def read_safetensors(path: Path) -> dict[str, Any]:
    """Read an exported policy: its blueprint, ``policy``, and its weights, ``state_dict``, as a checkpoint has them.

    Raises:
        CheckpointError: If the file is damaged, or no policy of this project.
    """
    try:
        with safe_open(path, "pt") as file:
            metadata = file.metadata() or {}
            tensors = {name: file.get_tensor(name) for name in sorted(file.keys())}  # as they were hashed
        told = json.loads(metadata[POLICY])
    except (SafetensorError, OSError, KeyError, ValueError, RecursionError) as error:
        raise CheckpointError(f"{path}: no exported policy ({error}); use one written by plp export") from None
    if metadata.get(HASH) != content_hash({POLICY: told, **tensors}):
        raise CheckpointError(f"{path}: its content does not match its hash, so the file is damaged; export it again")
    return {"policy": told, "state_dict": {f"policy.{name}": value for name, value in tensors.items()}}
