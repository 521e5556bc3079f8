"""The time from a robot's named arrays to its actions, and the share of it that is not the networks' own.

The policy is PLP at its defaults, 192 units, with random weights, in the UR5e of R2R-Lift; one thread.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import torch

from benchmarks.measuring import Options, Row, at_most, in_turn, ratio, timed
from datamodules.problem import TransferProblem
from datamodules.types import Observation
from plp_lightning.envs import Lift
from plp_lightning.methods.plp.policy import PortablePolicy
from plp_lightning.runs.export import export
from plp_lightning.runs.robot_policy import RobotPolicy

DOMAIN, TASK = "ur5e", "x2y2h2"
NETWORKS = "networks alone"


def policy_of() -> PortablePolicy:
    """PLP for Sawyer and UR5e, as ``configs/r2r.yaml`` builds it."""
    torch.manual_seed(0)
    domains = [Lift("Sawyer").spec("sawyer"), Lift("UR5e").spec(DOMAIN)]
    return PortablePolicy(TransferProblem(domains, Lift.tasks.names, "sawyer", DOMAIN), columns="shared").eval()


def calls(policy: PortablePolicy, rows: int, folder: Path) -> Iterator[tuple[str, Callable[[], object]]]:
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

    yield NETWORKS, networks
    yield "predict_actions, tensors", forward
    yield "act, a vector", lambda: policy.act(Observation(state), DOMAIN, TASK)
    yield "act, arrays by name", lambda: policy.act(named, DOMAIN, TASK)
    if find_spec("onnxruntime") and find_spec("onnxscript"):
        yield "ONNX Runtime", _runtime(policy, named, folder)


def _runtime(policy: PortablePolicy, named: dict[str, np.ndarray], folder: Path) -> Callable[[], object]:
    import onnxruntime

    path = folder / "policy.onnx"
    if not path.exists():
        export(RobotPolicy(policy, DOMAIN, TASK), "onnx", path, {})
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    session = onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])
    return lambda: session.run(["action"], named)


def rows(options: Options) -> Iterator[Row]:
    with TemporaryDirectory() as folder:
        for count in (1, 100):
            ways = {
                name: timed(call, clock=time.process_time) for name, call in calls(policy_of(), count, Path(folder))
            }
            times = in_turn(ways, rounds := options.pick(1000, 100), warm=rounds // 10)
            for name in [*ways][1:]:
                bar = at_most(2.0) if name.startswith("act") else None
                yield ratio(f"{count} observation{'s' * (count > 1)}: {name} / {NETWORKS}", times, name, NETWORKS, bar)
