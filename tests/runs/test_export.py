"""A policy that left its run acts as it does there."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import onnx
import onnxruntime
import pytest
import seen
import tiny
import torch
from command import ROOT, complaint, plp

import plp_lightning
from datamodules.errors import CheckpointError, ConfigError
from datamodules.types import DomainSpec, Observation
from plp_lightning.methods.plp.policy import PortablePolicy
from plp_lightning.methods.policy import Policy
from plp_lightning.networks import ImageEncoding
from plp_lightning.runs.export import export
from plp_lightning.runs.robot_policy import RobotPolicy

OLD = ROOT / "tests" / "old_runs" / "smoke"
CLOSE = 1e-5


def run_of(method: str) -> Path:
    return OLD / method / "goal_3" / "seed_0"


def by_onnx(file: Path, values: list[np.ndarray]) -> np.ndarray:
    session = onnxruntime.InferenceSession(file, providers=["CPUExecutionProvider"])
    names = [given.name for given in session.get_inputs()]
    (action,) = session.run(None, dict(zip(names, values, strict=True)))
    return np.asarray(action)


@pytest.mark.parametrize("method", ["plp_t_disc", "bc", "gama", "cdil"])
def test_onnx_and_torch_act_alike(method: str, tmp_path: Path) -> None:
    for kind in ("onnx", "torch"):
        answer = plp("export", run_of(method), "--to", kind, "--out", tmp_path / kind)
        assert answer.code == 0, answer
    policy = plp_lightning.load_policy(run_of(method))
    program = torch.export.load(tmp_path / "torch").module()
    for rows in (1, 2, 5):
        state = np.random.default_rng(rows).normal(size=(rows, 7)).astype(np.float32)
        expected = policy.act(Observation(state), "tall", "goal_3")
        assert np.abs(by_onnx(tmp_path / "onnx", [state]) - expected).max() < CLOSE
        assert np.abs(program(torch.from_numpy(state)).detach().numpy() - expected).max() < CLOSE


def test_a_card_says_what_the_policy_wants(tmp_path: Path) -> None:
    plp("export", run_of("bc"), "--to", "torch", "--out", tmp_path / "p.pt2", "--domain", "flat", "--task", "goal_1")
    card = json.loads((tmp_path / "p.pt2.json").read_text())
    assert (card["domain"]["name"], card["task"], card["control_hz"], card["format"]) == ("flat", "goal_1", 10, "torch")
    assert card["inputs"] == [{"name": "position", "shape": ["B", 4], "dtype": "float32", "unit": ""}]
    assert card["action_limits"] == {"low": [-1, -1], "high": [1, 1]}
    assert card["provenance"]["checkpoint"] == "adaptation/checkpoints/last.ckpt"
    assert 0 <= card["provenance"]["success"]["target"] <= 1


def test_weights_come_back_bit_for_bit(tmp_path: Path) -> None:
    file = tmp_path / "policy.safetensors"
    assert plp("export", run_of("plp_t_disc"), "--to", "safetensors", "--out", file).code == 0
    one, other = plp_lightning.load_policy(file), plp_lightning.load_policy(run_of("plp_t_disc"))
    assert one.state_dict().keys() == other.state_dict().keys()
    assert all(torch.equal(one.state_dict()[name], value) for name, value in other.state_dict().items())


def test_damaged_files_are_refused(tmp_path: Path) -> None:
    file = tmp_path / "policy.safetensors"
    plp("export", run_of("bc"), "--to", "safetensors", "--out", file)
    content = bytearray(file.read_bytes())
    content[-5] ^= 1
    file.write_bytes(content)
    with pytest.raises(CheckpointError, match="does not match its hash"):
        plp_lightning.load_policy(file)
    for odd in (b"", bytes(content[:100]), b"x" * 100):
        file.write_bytes(odd)
        with pytest.raises(CheckpointError, match="no exported policy"):
            plp_lightning.load_policy(file)


def test_no_path_of_this_machine_travels_along(tmp_path: Path) -> None:
    plp("export", run_of("bc"), "--out", tmp_path / "p.onnx")
    assert str(ROOT).encode() not in (tmp_path / "p.onnx").read_bytes()
    onnx.checker.check_model(onnx.load(tmp_path / "p.onnx"))


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["--domain", "round"], "found domain 'round'; expected one of: flat, tall"),
        (["--domain", ""], "found domain ''; expected one of: flat, tall"),
        (["--task", ""], "found task ''; expected one of"),
        (["--task", "goal_99"], "found task 'goal_99'; expected one of: "),
        (["--phase", "pretraining"], "has no checkpoint of pretraining"),
        (["--to", "tflite"], "invalid choice"),
    ],
)
def test_what_is_not_there_is_told(words: list[str], told: str, tmp_path: Path) -> None:
    assert told in complaint("export", run_of("bc"), "--out", tmp_path / "p", *words)
    assert not [*tmp_path.iterdir()]


def test_a_policy_with_a_memory_stays_in_python(tmp_path: Path) -> None:
    told = complaint("export", run_of("contextual"), "--out", tmp_path / "p.onnx")
    assert "ContextualPolicy remembers its episode" in told


def _with_limits() -> Policy:
    spec = DomainSpec("b", tiny.spec("b", 5, 2).observation, 2, 10.0, "", (-6.0, 0.0), (6.0, 4.0))
    torch.manual_seed(0)
    return PortablePolicy(tiny.problem([tiny.spec("a", 3, 2), spec], ["x", "y"]), latent=8, hidden=16)


def test_actions_are_in_the_units_of_the_robot(tmp_path: Path) -> None:
    policy = _with_limits()
    robot = RobotPolicy(policy, "b", "y")
    export(robot, "onnx", tmp_path / "p.onnx", {})
    state = np.random.default_rng(0).normal(size=(3, 5)).astype(np.float32)
    found = by_onnx(tmp_path / "p.onnx", [state[:, :1], state[:, 1:]])
    task = {"b": torch.ones(3, dtype=torch.int64)}
    scaled = policy.predict_actions({"b": Observation(torch.from_numpy(state))}, task)["b"].detach().numpy()
    assert np.abs(found - (scaled * [6, 2] + [0, 2])).max() < CLOSE


def test_policies_that_see_leave_too(tmp_path: Path) -> None:
    domains = [domain.world.spec(name) for name, domain in seen.domains().items()]
    torch.manual_seed(0)
    policy = PortablePolicy(tiny.problem(domains, ["x", "y"]), latent=8, hidden=16, image_encoder=ImageEncoding([4, 4]))
    name = policy.cameras[-1]
    export(RobotPolicy(policy, name, "x"), "onnx", tmp_path / "p.onnx", {})
    rng, spec = np.random.default_rng(0), policy.domains[name]
    image = rng.integers(0, 255, (3, *spec.image_keys[0].shape), dtype=np.uint8)
    state = rng.normal(size=(3, spec.state_size)).astype(np.float32)
    columns = [state[:, spec.columns([key.name])] for key in spec.state_keys]
    expected = policy.act(Observation(state, {spec.image_keys[0].name: image}), name, "x")
    assert np.abs(by_onnx(tmp_path / "p.onnx", [*columns, image]) - expected).max() < CLOSE


def test_without_the_packages_the_remedy_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("plp_lightning.runs.export.find_spec", lambda package: None)
    with pytest.raises(ConfigError, match=r"pip install 'plp-lightning\[export\]'"):
        export(RobotPolicy(_with_limits(), "b", "y"), "onnx", tmp_path / "p.onnx", {})
