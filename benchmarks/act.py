"""The time from a robot's named arrays to its actions, and the share of it that is not the networks' own.

Run from the repository: ``python benchmarks/act.py``. The policy is PLP at its defaults, 192 units, with
random weights, in the UR5e of R2R-Lift; one thread, all ways in turn, so that a busy machine is busy for all. ONNX
Runtime is timed where it and the extra ``export`` are installed.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable, Iterator
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import torch

from datamodules.problem import TransferProblem
from datamodules.types import Observation
from plp_lightning.envs import Lift
from plp_lightning.methods.plp.policy import PortablePolicy
from plp_lightning.runs.export import export
from plp_lightning.runs.robot_policy import RobotPolicy

DOMAIN, TASK = "ur5e", "x2y2h2"
Way = Callable[[], object]


def policy_of() -> PortablePolicy:
    """PLP for Sawyer and UR5e, as ``configs/r2r.yaml`` builds it."""
    torch.manual_seed(0)
    domains = [Lift("Sawyer").spec("sawyer"), Lift("UR5e").spec(DOMAIN)]
    return PortablePolicy(TransferProblem(domains, Lift.tasks.names, "sawyer", DOMAIN), columns="shared").eval()


def ways(policy: PortablePolicy, rows: int, folder: Path) -> Iterator[tuple[str, Way]]:
    """Ways to the actions of so many rows, by name; the bare networks first."""
    spec, rng = policy.domains[DOMAIN], np.random.default_rng(0)
    named = {key.name: rng.normal(size=(rows, *key.shape)).astype(np.float32) for key in spec.state_keys}
    state = np.concatenate([*named.values()], axis=1)
    seen, task = {DOMAIN: Observation(torch.tensor(state))}, {DOMAIN: torch.full((rows,), policy.tasks[TASK])}
    inputs = torch.zeros(rows, policy.states.width + len(policy.domains))
    context = torch.zeros(rows, policy.contexts.width + len(policy.domains))

    @torch.inference_mode()
    def networks() -> object:
        return policy.decoder(policy.common(policy.encoder(inputs), task[DOMAIN]), context)

    @torch.inference_mode()
    def forward() -> object:
        return policy.predict_actions(seen, task)

    yield "networks alone", networks
    yield "predict_actions, tensors", forward
    yield "act, a vector", lambda: policy.act(Observation(state), DOMAIN, TASK)
    yield "act, arrays by name", lambda: policy.act(named, DOMAIN, TASK)
    if find_spec("onnxruntime") and find_spec("onnxscript"):
        yield "ONNX Runtime", _runtime(policy, named, folder)


def _runtime(policy: PortablePolicy, named: dict[str, np.ndarray], folder: Path) -> Way:
    import onnxruntime

    path = folder / "policy.onnx"
    if not path.exists():
        export(RobotPolicy(policy, DOMAIN, TASK), "onnx", path, {})
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    session = onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])
    return lambda: session.run(["action"], named)


def compare(found: dict[str, Way], rounds: int) -> None:
    """Print the median time of each way, its tenth and nine tenths, and its ratio to the first."""
    times: dict[str, list[float]] = {name: [] for name in found}
    for turn in range(rounds + rounds // 10):
        for name, way in found.items():
            began = time.perf_counter()
            way()
            if turn >= rounds // 10:  # after some to get warm
                times[name].append(time.perf_counter() - began)
    first = np.median(next(iter(times.values())))
    for name, taken in times.items():
        low, middle, high = 1e3 * np.quantile(taken, [0.1, 0.5, 0.9])
        print(f"  {name:26} {middle:7.3f} ms  ({low:.3f} to {high:.3f})  {1e-3 * middle / first:5.2f} ×")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=1000)
    options = parser.parse_args()
    torch.set_num_threads(1)
    with tempfile.TemporaryDirectory() as folder:
        for rows in (1, 100):
            print(f"{rows} observation{'s' * (rows > 1)}: median (1st to 9th decile), ratio to the networks alone")
            compare(dict(ways(policy_of(), rows, Path(folder))), options.rounds)


if __name__ == "__main__":
    main()
