"""Image encoders of one's own, their weights, and cameras that are not as a policy knows them: one line each."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cameras
import numpy as np
import pytest
import torch
import yaml
from command import ROOT, checkpoint, complaint, plp
from safetensors.torch import save_file

import plp_lightning
from datamodules.errors import UserError
from plp_lightning.callbacks.freezing import FrozenPartsChangedError
from plp_lightning.networks import Vision

EXAMPLES = ROOT / "docs" / "examples"
ONE_SIZE = (cameras.BLIND, cameras.EYES)
WRONG = """
from dataclasses import dataclass
import torch
from plp_lightning import ImageEncoderFactory

@dataclass(frozen=True)
class Odd(ImageEncoderFactory):
    features: int = 4
    kind: str = "function"

    def build(self, shape):
        if self.kind == "function":
            return lambda image: image
        return torch.nn.Flatten() if self.kind == "wide" else torch.nn.Linear(7, 4)

class Plain(torch.nn.Module):
    pass
"""


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return cameras.write(tmp_path / "cameras.hdf5", ONE_SIZE)


def words(
    file: Path, folder: Path, encoder: dict[str, Any], monkeypatch: pytest.MonkeyPatch, package: str = "patches"
) -> list[str]:
    """Options of a tiny run with this image encoder."""
    monkeypatch.syspath_prepend(EXAMPLES)
    monkeypatch.syspath_prepend(folder)
    (folder / "odd.py").write_text(WRONG)
    given = cameras.words(file, folder, ONE_SIZE, image_encoder=encoder)
    page = yaml.safe_load((folder / "cameras.yaml").read_text())
    page["alignment"]["init_args"]["terms"] = {"reconstruction": {"init_args": {"channels": [4]}}}
    (folder / "cameras.yaml").write_text(yaml.safe_dump(page))
    return [*given, "--allow_imports", package]


def patches(**settings: Any) -> dict[str, Any]:
    return {"class_path": "patches.Patches", "init_args": {"features": 6, "width": 2, **settings}}


@pytest.fixture
def weights(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> dict[str, torch.Tensor]:
    """Weights of the example's encoder for the file's images."""
    monkeypatch.syspath_prepend(EXAMPLES)
    import patches

    return dict(patches.Patches(features=6, width=2).build((8, 12, 3)).state_dict())


@pytest.mark.parametrize("suffix", ["safetensors", "pt"])
def test_weights_of_a_file_stay_as_they_are_and_are_in_the_checkpoint(
    suffix: str, weights: dict[str, torch.Tensor], file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    place = tmp_path / f"w.{suffix}"
    extra = {**weights, "head.weight": torch.zeros(2)}
    save_file(extra, place) if suffix == "safetensors" else torch.save(extra, place)
    given = words(file, tmp_path, patches(weights=str(place), freeze=True), monkeypatch)
    answer = plp("fit", *given)
    assert answer.code == 0, answer
    run = cameras.run_of(tmp_path)
    place.unlink()
    for phase in ("alignment", "adaptation"):
        found = checkpoint(run, phase)
        prefix = "policy.image_encoder.8x12x3."
        state = {n.removeprefix(prefix): v for n, v in found["state_dict"].items() if n.startswith(prefix)}
        assert state.keys() == weights.keys()
        assert all(torch.equal(state[name], weights[name]) for name in weights)
        assert "image_encoder" in found["callbacks"]["FreezeGuard"]["before"]
    policy = plp_lightning.load_policy(run.path, allow_imports=["patches"])
    assert policy.act(cameras.observations(cameras.EYES, 2), "eyes", "push").shape == (2, 2)
    assert not any(p.requires_grad for p in policy.image_encoder.parameters())


def test_weights_that_are_not_frozen_begin_there_and_learn(
    weights: dict[str, torch.Tensor], file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    save_file(weights, tmp_path / "w.safetensors")
    answer = plp("fit", *words(file, tmp_path, patches(weights=str(tmp_path / "w.safetensors")), monkeypatch))
    assert answer.code == 0, answer
    state = checkpoint(cameras.run_of(tmp_path), "alignment")["state_dict"]
    far = (state["policy.image_encoder.8x12x3.patches.weight"] - weights["patches.weight"]).abs().max()
    assert 0 < far < 0.1


def test_a_frozen_encoder_that_changes_is_noticed(
    weights: dict[str, torch.Tensor], file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    given = words(file, tmp_path, patches(freeze=True), monkeypatch)
    encode = Vision.forward

    def drifting(self: Vision, observation: Any) -> torch.Tensor:
        with torch.no_grad():
            next(self.parameters()).add_(1e-3)
        return encode(self, observation)

    monkeypatch.setattr(Vision, "forward", drifting)
    with pytest.raises(FrozenPartsChangedError, match="image_encoder"):
        plp("fit", *given)


class Harm:
    def __reduce__(self) -> tuple[Callable[..., Any], tuple[str]]:
        return exec, ("raise SystemExit(7)",)


def harmful(place: Path, weights: dict[str, torch.Tensor]) -> None:
    torch.save({**weights, "harm": Harm()}, place)


FILES: dict[str, tuple[str, Callable[[Path, dict[str, torch.Tensor]], Any], str]] = {
    "none": ("w.pt", lambda place, w: None, "no such file of image encoder weights"),
    "folder": ("w.pt", lambda place, w: place.mkdir(), "no such file of image encoder weights"),
    "code": ("w.pt", harmful, "cannot be read as weights"),
    "pickle": ("w.pt", lambda place, w: place.write_bytes(pickle.dumps(Harm())), "cannot be read as weights"),
    "text": ("w.safetensors", lambda place, w: place.write_text("x" * 99), "cannot be read as weights"),
    "empty": ("w.pt", lambda place, w: place.write_bytes(b""), "cannot be read as weights"),
    "list": ("w.pt", lambda place, w: torch.save([torch.zeros(1)], place), "something else than tensors by name"),
    "lacks": (
        "w.safetensors",
        lambda place, w: save_file({n: x for n, x in w.items() if n != "joined.bias"}, place),
        "no tensor 'joined.bias'; expected weights of this encoder",
    ),
    "shape": (
        "w.safetensors",
        lambda place, w: save_file({**w, "joined.bias": torch.zeros(7)}, place),
        r"'joined.bias' is of shape (7,); expected (6,)",
    ),
}


@pytest.mark.parametrize("case", FILES)
def test_weights_that_do_not_fit_are_told(
    case: str, weights: dict[str, torch.Tensor], file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    name, write, told = FILES[case]
    write(tmp_path / name, weights)
    given = words(file, tmp_path, patches(weights=str(tmp_path / name), freeze=True), monkeypatch)
    assert told in complaint("fit", *given)
    assert not (tmp_path / "runs").exists()


@pytest.mark.parametrize(
    ("encoder", "told"),
    [
        ({"class_path": "odd.Odd"}, "Odd.build gives function; expected a torch.nn.Module"),
        ({"class_path": "odd.Odd", "init_args": {"kind": "wide"}}, "Odd makes (2, 288), torch.uint8 of 2 images"),
        ({"class_path": "odd.Odd", "init_args": {"kind": "fails"}}, "Odd fails on images of shape (8, 12, 3)"),
        ({"class_path": "odd.Plain"}, "Plain"),
        ({"class_path": "odd.Missing"}, "Missing"),
        ({"class_path": "torch.nn.Linear"}, "torch.nn.Linear"),
        ({"features": 0}, "features"),
    ],
    ids=str,
)
def test_encoders_that_are_none_are_told(
    encoder: dict[str, Any], told: str, file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert told in complaint("fit", *words(file, tmp_path, encoder, monkeypatch, "odd"))
    assert not (tmp_path / "runs").exists()


def test_channels_to_draw_images_by_are_asked_for(file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    given = words(file, tmp_path, patches(), monkeypatch)
    page = yaml.safe_load((tmp_path / "cameras.yaml").read_text())
    page["alignment"]["init_args"].pop("terms")
    (tmp_path / "cameras.yaml").write_text(yaml.safe_dump(page))
    told = complaint("fit", *given)
    assert "name ImageReconstruction.channels, or leave the term away" in told


def test_a_policy_that_leaves_images_aside_needs_a_state(
    file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    told = complaint("fit", *words(file, tmp_path, {"channels": []}, monkeypatch))
    assert "domain 'eyes' shows images alone, and the policy has no channels" in told


def test_arrays_that_are_no_images_of_the_cameras_are_told(tmp_path: Path) -> None:
    domains = (cameras.BLIND, cameras.TWO)
    answer = plp("fit", *cameras.words(cameras.write(tmp_path / "d.hdf5", domains), tmp_path, domains))
    assert answer.code == 0, answer
    policy, seen = plp_lightning.load_policy(cameras.run_of(tmp_path).path), cameras.observations(cameras.TWO, 2)
    images: dict[str, Any] = dict(seen.images)
    wrong: list[tuple[Any, str]] = [
        ({}, "no images of camera 'wide' in domain 'two'; give them beside the state"),
        ({"wide": images["wide"]}, "lacks 'wrist'"),
        (images["wide"], "images are of type ndarray; domain 'two' shows arrays by name, of wide, wrist"),
        ({**images, "wrist": images["wrist"][:, :3]}, r"'wrist' is of shape \(2, 3, 6, 1\); expected \(…, 6, 6, 1\)"),
        ({**images, "wrist": images["wrist"].astype(np.float32)}, "'wrist' is of type float32; expected uint8"),
        ({**images, "wrist": images["wrist"][:1]}, r"'wrist' has \(1,\) rows, the state \(2,\)"),
        (None, "images are of type NoneType"),
    ]
    for given, told in wrong:
        with pytest.raises(UserError, match=told):
            policy.act(seen._replace(images=given), "two", "push")
    named = {"tip": seen.state, **{name: image for name, image in images.items() if name != "wrist"}}
    with pytest.raises(UserError, match="observation lacks 'wrist'; domain 'two' shows wide, tip, wrist"):
        policy.act(named, "two", "push")
    policy.act(cameras.observations(cameras.BLIND, 2), "blind", "push")
