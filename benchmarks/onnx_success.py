"""Success of an exported policy in a Gymnasium environment, by ONNX Runtime alone: what a robot's own computer does.

    python benchmarks/onnx_success.py policy.onnx --env my_package:MyArm-v0 --make '{"links": 3}' \
        --reset '{"task": "reach the middle front block"}' --out episodes.json

An observation is a dictionary by the names of the policy's inputs; a policy of one input takes an array, or all values
of a dictionary that lacks its name, in their order. An episode is solved if the environment says ``is_success`` or
``success`` in any step. Needs gymnasium and onnxruntime; knows nothing of plp.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import onnxruntime


def given(session: Any, observation: Any) -> dict[str, np.ndarray]:
    """The policy's inputs, each with one row of the observation's values."""
    inputs = session.get_inputs()
    if not isinstance(observation, Mapping):
        observation = {inputs[0].name: observation}
    if len(inputs) == 1 and inputs[0].name not in observation:
        observation = {inputs[0].name: np.concatenate([np.ravel(value) for value in observation.values()])}
    types = {"tensor(float)": np.float32, "tensor(uint8)": np.uint8}
    return {i.name: np.asarray(observation[i.name], types[i.type])[None] for i in inputs}


def solves(session: Any, env: Any, seed: int, reset: Mapping[str, Any]) -> bool:
    """Tells whether the policy solves the episode of that seed."""
    observation, _ = env.reset(seed=seed, options=dict(reset))
    solved = over = False
    while not over:
        (actions,) = session.run(["action"], given(session, observation))
        observation, _, terminated, truncated, info = env.step(actions[0])
        solved |= bool(info.get("is_success", info.get("success", False)))
        over = terminated or truncated
    return solved


def interval(share: float, count: int, z: float = 1.959964) -> tuple[float, float]:
    """Wilson's 95 % interval of a share."""
    middle, half = share + z**2 / (2 * count), z * np.sqrt(share * (1 - share) / count + (z / (2 * count)) ** 2)
    low, high = ((middle + sign * half) / (1 + z**2 / count) for sign in (-1, 1))
    return round(float(low), 4), round(float(high), 4)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("policy", type=Path)
    parser.add_argument("--env", required=True, help="id of the environment, with its module before a colon")
    parser.add_argument("--make", type=json.loads, default={}, help="arguments of the environment, JSON")
    parser.add_argument("--reset", type=json.loads, default={}, help="options of its reset, JSON")
    parser.add_argument("--episodes", type=int, default=100)
    parser.add_argument("--first_seed", type=int, default=90_000)
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    session = onnxruntime.InferenceSession(options.policy, providers=["CPUExecutionProvider"])
    env = gymnasium.make(options.env, disable_env_checker=True, **options.make)
    seeds = range(options.first_seed, options.first_seed + options.episodes)
    failed = [seed for seed in seeds if not solves(session, env, seed, options.reset)]
    success = round(1 - len(failed) / len(seeds), 4)
    found = {"success": success, "interval": interval(success, len(seeds)), "episodes": len(seeds), "failed": failed}
    found |= {"env": options.env, "make": options.make, "reset": options.reset, "first_seed": options.first_seed}
    print(f"{options.policy}: success {success:.2f} ({found['interval'][0]:.2f} – {found['interval'][1]:.2f})")
    if options.out:
        options.out.write_text(json.dumps(found, indent=2) + "\n")


if __name__ == "__main__":
    main()
