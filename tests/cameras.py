"""Three domains in one file: one blind, one with two cameras of different sizes, one that shows images alone."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import yaml
from command import ROOT

from datamodules.store.writer import write_trajectories
from datamodules.types import DomainSpec, Observation, ObservationKey, Trajectory
from plp_lightning.runs.directory import RunDirectory

TASKS = ("push", "pull", "lift")
WIDE, WRIST = ObservationKey("wide", (8, 12, 3), "image"), ObservationKey("wrist", (6, 6, 1), "image")
BLIND = DomainSpec("blind", (ObservationKey("joints", (3,)),), 2, 10.0)
TWO = DomainSpec("two", (WIDE, ObservationKey("tip", (2,), unit="m"), WRIST), 3, 10.0)
EYES = DomainSpec("eyes", (WIDE,), 2, 20.0, action_low=(0.0, -2.0), action_high=(4.0, 2.0))
DOMAINS = (BLIND, TWO, EYES)
SIZES: dict[str, Any] = {"latent": 8, "hidden": 8, "encoder_layers": 1, "policy_layers": 1, "decoder_layers": 1}
SIZES |= {"image_encoder": {"channels": [4, 4], "features": 6}}


def observations(spec: DomainSpec, rows: int, seed: int = 0) -> Observation[np.ndarray]:
    """Random observations of a domain."""
    rng = np.random.default_rng(seed)
    images = {key.name: rng.integers(0, 256, (rows, *key.shape), dtype=np.uint8) for key in spec.image_keys}
    return Observation(rng.normal(size=(rows, spec.state_size)).astype(np.float32), images)


def demonstration(spec: DomainSpec, task: str, seed: int, steps: int = 6) -> Trajectory:
    """A demonstration of random values, whose last observation is known."""
    actions = np.random.default_rng([seed, 1]).uniform(-1, 1, (steps, spec.action_size)).astype(np.float32)
    return Trajectory(spec.name, task, observations(spec, steps + 1, seed), actions, seed, True)


def write(path: Path, domains: tuple[DomainSpec, ...] = DOMAINS, each: int = 3) -> Path:
    """A file of ``each`` demonstrations of every task in every domain."""
    made = [demonstration(spec, task, seed) for spec in domains for task in TASKS for seed in range(each)]
    write_trajectories(path, domains, TASKS, made, {"command": "tests"})
    return path


def words(
    demonstrations: Path, folder: Path, domains: tuple[DomainSpec, ...] = DOMAINS, method: str = "plp", **policy: Any
) -> list[str]:
    """Options of a tiny run on the file's domains, from the last but one to the last."""
    data: dict[str, Any] = {"source_domain": domains[-2].name, "target_domain": domains[-1].name}
    data |= {"target_task": "lift", "file": str(demonstrations)}
    data |= {"batch_size": 12, "epoch_steps": 5, "pairs": 2, "stride": 2}
    config: dict[str, Any] = {"experiment": "cameras", "domains": {spec.name: {} for spec in domains}, "data": data}
    if method.startswith("plp"):
        policy = SIZES | policy
        config |= {"alignment": {"init_args": {"epochs": 2}}, "adaptation": {"init_args": {"epochs": 2}}}
    elif method in ("bc", "contextual"):
        policy = {"image_encoder": SIZES["image_encoder"]} | policy
    config["policy"] = {"init_args": policy}
    config["score"] = [{"class_path": "NeighbourhoodScore"}]
    (folder / "cameras.yaml").write_text(yaml.safe_dump(config))
    return ["--config", str(folder / "cameras.yaml"), "--run_root", str(folder / "runs")]


def run_of(folder: Path, method: str = "plp") -> RunDirectory:
    """The run that these words make."""
    return RunDirectory(folder / "runs" / "cameras" / method / "lift" / "seed_0")


def overlay(method: str) -> list[str]:
    """Options that choose a method."""
    return ["--config", str(ROOT / "configs" / "methods" / f"{method}.yaml")]
