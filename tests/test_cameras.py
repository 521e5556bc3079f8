"""Domains of any number of cameras, each of its own size, with a state or none: the whole chain."""

from __future__ import annotations

import json
import signal
from pathlib import Path

import cameras
import numpy as np
import onnxruntime
import pytest
import torch
import yaml
from command import ROOT, TINY, checkpoint, complaint, dies, plp, results, same

import plp_lightning
from datamodules.types import DomainSpec, Observation
from plp_lightning.runs.directory import RunDirectory

STEP = "plp_lightning.callbacks.preemption:Preemption.on_train_batch_end"


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return cameras.write(tmp_path_factory.mktemp("cameras") / "cameras.hdf5")


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory, file: Path) -> RunDirectory:
    folder = tmp_path_factory.mktemp("run")
    answer = plp("fit", *cameras.words(file, folder), *cameras.overlay("plp_t"))
    assert answer.code == 0, answer
    return cameras.run_of(folder, "plp_t")


def test_a_file_shows_every_camera_and_a_domain_without_state_is_sound(file: Path) -> None:
    told = plp("data", "inspect", file).out
    assert "plp-trajectories 1.3" in told
    for words in ("two wide image 8 × 12 × 3", "two wrist image 6 × 6 × 1", "eyes wide image 8 × 12 × 3"):
        assert words in " ".join(told.replace("│", " ").split())
    checked = plp("data", "validate", file)
    assert checked.code == 0
    assert "warning" not in checked.out


def test_three_domains_train_and_are_drawn_and_scored(run: RunDirectory) -> None:
    told = results(run)
    assert {"blind", "two", "eyes"} <= told["held_out"].keys()
    assert 0 <= told["alignment"]["mix"] <= 1
    names = {path.name for path in run.phase("alignment").iterdir()}
    assert {"latents.png", "reconstructions.png"} <= names
    shapes = {name.split(".")[2] for name in checkpoint(run, "alignment")["state_dict"] if "policy.image_enc" in name}
    assert shapes == {"8x12x3", "6x6x1"}


@pytest.mark.parametrize("nth", [3, 9])
def test_a_killed_run_resumes_to_the_same_weights(run: RunDirectory, file: Path, tmp_path: Path, nth: int) -> None:
    words = ["fit", *cameras.words(file, tmp_path), *cameras.overlay("plp_t")]
    assert dies(words, STEP, nth, signal.SIGKILL) == -signal.SIGKILL
    other = cameras.run_of(tmp_path, "plp_t")
    answer = plp("fit", "--resume", other.path)
    assert answer.code == 0, answer
    for phase in ("alignment", "adaptation"):
        assert same(checkpoint(run, phase)["state_dict"], checkpoint(other, phase)["state_dict"])


@pytest.mark.parametrize("spec", cameras.DOMAINS, ids=lambda spec: spec.name)
def test_onnx_asks_for_every_camera_and_acts_alike(run: RunDirectory, spec: DomainSpec, tmp_path: Path) -> None:
    answer = plp("export", run.path, "--to", "onnx", "--domain", spec.name, "--out", tmp_path / "p.onnx")
    assert answer.code == 0, answer
    session = onnxruntime.InferenceSession(tmp_path / "p.onnx", providers=["CPUExecutionProvider"])
    card = json.loads((tmp_path / "p.onnx.json").read_text())
    keys = [*spec.state_keys, *spec.image_keys]
    assert [given.name for given in session.get_inputs()] == [given["name"] for given in card["inputs"]]
    assert [given["name"] for given in card["inputs"]] == [key.name for key in keys]
    policy = plp_lightning.load_policy(run.path)
    for rows in (1, 3):
        seen = cameras.observations(spec, rows, rows)
        named = {key.name: seen.state[:, spec.columns([key.name])] for key in spec.state_keys} | dict(seen.images)
        (action,) = session.run(None, named)
        expected = policy.act(named, spec.name, "lift")
        assert np.abs(action - expected).max() < 1e-5
        np.testing.assert_array_equal(policy.act(seen, spec.name, "lift"), expected)
        one = policy.act({name: values[0] for name, values in named.items()}, spec.name, "lift")
        np.testing.assert_allclose(one, expected[0], atol=1e-6)


def test_every_command_knows_three_domains(run: RunDirectory, tmp_path: Path) -> None:
    checked = plp("validate", run.path)
    assert all(f"val/bc_{spec.name}" in checked.out for spec in cameras.DOMAINS)
    assert "blind, eyes, two" in plp("predict", run.path).out
    assert "acts in no domain that has a simulator" in complaint("test", run.path)
    for kind in ("torch", "safetensors"):
        assert plp("export", run.path, "--to", kind, "--out", tmp_path / f"p.{kind}").code == 0
    seen = cameras.observations(cameras.EYES, 3)
    expected = plp_lightning.load_policy(run.path).act(seen, "eyes", "lift")
    program = torch.export.load(tmp_path / "p.torch").module()
    acted = program(torch.from_numpy(seen.images["wide"])).detach().numpy()
    np.testing.assert_allclose(acted, expected, atol=1e-5)
    again = plp_lightning.load_policy(tmp_path / "p.safetensors").act(seen, "eyes", "lift")
    np.testing.assert_array_equal(again, expected)


def test_images_of_the_only_camera_need_no_name(run: RunDirectory) -> None:
    policy, seen = plp_lightning.load_policy(run.path), cameras.observations(cameras.EYES, 2)
    alone = Observation(seen.state, seen.images["wide"])  # type: ignore[arg-type]
    np.testing.assert_array_equal(policy.act(alone, "eyes", "push"), policy.act(seen, "eyes", "push"))


@pytest.mark.parametrize("method", ["bc", "plp_state", "plp_disc", "gama", "cdil", "contextual"])
def test_methods_look_at_all_cameras_or_refuse_three_domains(method: str, file: Path, tmp_path: Path) -> None:
    pair = method in ("gama", "cdil", "contextual")
    domains = cameras.DOMAINS[1:] if pair else cameras.DOMAINS
    short = ["--trainer.max_epochs", "1", "--score", "[]", *cameras.overlay(method)]
    if pair:
        (tmp_path / "three").mkdir()
        three = cameras.words(file, tmp_path / "three", hidden=8, method=method)
        assert "blind, eyes, two" in complaint("fit", *three, *short)
    short += ["--data.epoch_steps", "50"] * (method == "gama")  # which acts on nothing that it sees for a while
    answer = plp("fit", *cameras.words(file, tmp_path, domains, hidden=8, method=method), *short)
    assert answer.code == 0, answer
    policy = plp_lightning.load_policy(cameras.run_of(tmp_path, method).path)
    seen = cameras.observations(cameras.EYES, 2)
    before = policy.act(seen, "eyes", "push")
    dark = seen._replace(images={name: np.zeros_like(image) for name, image in seen.images.items()})
    assert before.shape == (2, 2)
    assert not np.array_equal(policy.act(dark, "eyes", "push"), before)


def test_three_simulators_with_several_cameras_run_the_whole_chain(tmp_path: Path) -> None:
    page = yaml.safe_load((ROOT / "tests" / "conf" / "seen.yaml").read_text())
    settings = {"left": {"wrist_size": 8}, "right": {"wrist_size": 6, "image_size": 12}, "third": {"map_seed": 3}}
    page["domains"]["third"] = {**page["domains"]["left"]}
    for name, told in settings.items():
        domain = page["domains"][name]
        page["domains"][name] = {
            **domain,
            "simulator": {**domain["simulator"], "init_args": {**domain["simulator"]["init_args"], **told}},
        }
    (tmp_path / "three.yaml").write_text(yaml.safe_dump(page))
    words = ["--config", tmp_path / "three.yaml", *TINY, "--data.root", tmp_path, "--run_root", tmp_path / "runs"]
    answer = plp("fit", *words, "--evaluation.latent_states", "20")
    assert answer.code == 0, answer
    assert "target task in target domain" in answer.out
    run = RunDirectory(tmp_path / "runs" / "three" / "plp" / "blue" / "seed_0")
    assert {"film.png", "film.gif", "reconstructions.png", "latents.png"} <= {p.name for p in run.path.glob("*/*")} | {
        p.name for p in run.path.glob("*")
    }
    assert plp("test", run.path).code == 0
