"""Whole files of earlier versions: a page, and what was kept of a run of each method."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml
from command import SMOKE

from plp_lightning.cli.config import parse

PAGE = """
data: {target: goal_3, held_out: 0.1, mix: 1.5}
collection: {linger: 7, wander: 2}
policy: {init_args: {latent: 16, clip: 5.0, image_channels: [4, 8], image_features: 16}}
alignment:
  init_args:
    terms: [adversarial, tcc]
    epochs: 3
    lr: 5.0e-3
    weight_decay: 1.0e-5
    lr_schedule: cosine
    mmd_weight: 0.5
    mmd_bandwidths: [1.0, 0.5]
    mmd_scale_gradient: false
    tcc_weight: 0.2
    tcc_similarity: scaled
    adversarial_weight: 0.3
    penalty_weight: 0.7
    discriminator_layers: 2
    discriminator_hidden: 24
    reconstruction_weight: 10.0
    reconstruction_halvings: 1
adaptation: {init_args: {epochs: 4, lr: 1.0e-3, lr_schedule: constant}}
score: {class_path: ClosenessScore, init_args: {samples: 50}}
"""
"""An experiment in the keys of the first version."""

FORMER = """
plp_t_disc:
  phases: [alignment, adaptation]
  policy:
    class_path: plp_lightning.policy.PortablePolicy
    init_args: {latent: 16, hidden: 8, gradient_floor: 0.2, clip: 5.0, image_channels: [4, 8], image_features: 16}
  alignment:
    class_path: plp_lightning.phases.Alignment
    init_args:
      {terms: [adversarial, tcc], mmd_weight: 0.5, tcc_weight: 0.2, adversarial_weight: 0.3, penalty_weight: 1.5,
       reconstruction_weight: 1.0, reconstruction_halvings: 1, mmd_scale_gradient: true, mmd_bandwidths: [1.0, 0.5],
       bc_reduction: mean, tcc_similarity: distance, discriminator_layers: 3, discriminator_hidden: 24, epochs: 3,
       lr: 5.0e-3, weight_decay: 1.0e-5, lr_schedule: constant}
  adaptation:
    class_path: plp_lightning.phases.Adaptation
    init_args: {epochs: 4, lr: 5.0e-3, weight_decay: 1.0e-5, lr_schedule: cosine}
plp_t_noaction:
  phases: [alignment, adaptation]
  policy:
    class_path: plp_lightning.baselines.StateOnlyPolicy
    init_args: {latent: 16, hidden: 8, decoder_state: all, clip: 5.0, image_channels: [4], image_features: 16}
  alignment:
    class_path: plp_lightning.baselines.StateOnlyAlignment
    init_args:
      {terms: [mmd, tcc], mmd_weight: 0.5, tcc_weight: 0.2, adversarial_weight: 0.3, penalty_weight: 1.5,
       reconstruction_weight: 1.0, reconstruction_halvings: 0, mmd_scale_gradient: true, mmd_bandwidths: [1.0, 0.5],
       next_reduction: sum, tcc_similarity: distance, discriminator_layers: 3, discriminator_hidden: 24, epochs: 3,
       lr: 5.0e-3, weight_decay: 0.0, lr_schedule: constant}
  adaptation:
    class_path: plp_lightning.baselines.StateOnlyAdaptation
    init_args: {next_reduction: sum, epochs: 4, lr: 5.0e-3, weight_decay: 0.0, lr_schedule: constant}
bc:
  phases: [alignment, adaptation]
  policy:
    class_path: plp_lightning.baselines.FlatPolicy
    init_args: {hidden: 8, layers: 2, gradient_floor: 0.2, clip: 5.0, image_channels: [4], image_features: 16}
  alignment:
    class_path: plp_lightning.baselines.FlatCloning
    init_args: {bc_reduction: sum, domains: null, epochs: 3, lr: 5.0e-3, weight_decay: 1.0e-5, lr_schedule: cosine}
  adaptation:
    class_path: plp_lightning.baselines.FlatAdaptation
    init_args: {bc_reduction: sum, epochs: 4, lr: 5.0e-3, weight_decay: 1.0e-5, lr_schedule: constant}
contextual:
  phases: [alignment]
  policy:
    class_path: plp_lightning.baselines.ContextualPolicy
    init_args: {hidden: 192, heads: 8, dropout: 0.1, clip: 5.0, image_channels: [4, 8], image_features: 16}
  alignment:
    class_path: plp_lightning.baselines.ContextualCloning
    init_args: {epochs: 64, lr: 1.0e-3, weight_decay: 1.0e-5, lr_schedule: cosine}
gama:
  phases: [pretraining, alignment, adaptation]
  policy:
    class_path: plp_lightning.baselines.GamaPolicy
    init_args: {hidden: 8, policy_layers: 4, action_map_state: true, clip: 5.0, image_channels: [4, 8]}
  pretraining:
    class_path: plp_lightning.baselines.GamaPretraining
    init_args: {reconstruction_hidden: 32, epochs: 2, lr: 5.0e-4, weight_decay: 0.0, lr_schedule: cosine}
  alignment:
    class_path: plp_lightning.baselines.GamaAlignment
    init_args:
      {adversarial_weight: 0.4, penalty_weight: 1.5, discriminator_layers: 4, discriminator_hidden: 24,
       discriminator_lr: 2.0e-4, dynamics_lr: 3.0e-4, epochs: 3, lr: 1.0e-3, weight_decay: 1.0e-5, lr_schedule: cosine}
  adaptation:
    class_path: plp_lightning.baselines.GamaAdaptation
    init_args: {target_mix: true, epochs: 4, lr: 5.0e-4, weight_decay: 1.0e-5, lr_schedule: constant}
cdil:
  phases: [positions, alignment, dynamics, adaptation]
  policy:
    class_path: plp_lightning.baselines.CdilPolicy
    init_args: {latent: 16, hidden: 8, policy_layers: 4, clip: 5.0, image_channels: [4, 8]}
  positions:
    class_path: plp_lightning.baselines.CdilPositions
    init_args: {reconstruction_hidden: 32, epochs: 2, lr: 5.0e-4, weight_decay: 0.0}
  alignment:
    class_path: plp_lightning.baselines.CdilAlignment
    init_args:
      {adversarial_weight: 9.0, cycle_weight: 8.0, latent_weight: 7.0, position_weight: 6.0, noise: 0.2,
       penalty_weight: 1.0, discriminator_layers: 4, discriminator_hidden: 24, discriminator_lr: null,
       first_moment: 0.4, slowdown: 0.25, epochs: 3, lr: 5.0e-4, weight_decay: 1.0e-5}
  dynamics:
    class_path: plp_lightning.baselines.CdilDynamics
    init_args: {epochs: 2, lr: 5.0e-4, weight_decay: 0.0}
  adaptation:
    class_path: plp_lightning.baselines.CdilAdaptation
    init_args: {epochs: 4, lr: 5.0e-4, weight_decay: 1.0e-5}
"""
"""What the first version kept of a run's policy and phases, by method: values that differ from today's defaults."""


def resolved(path: Path, *flags: str) -> dict[str, Any]:
    found: dict[str, Any] = yaml.safe_load(parse([*SMOKE, "--config", str(path), *flags]).config)
    return found


def settings(part: dict[str, Any]) -> dict[str, Any]:
    found: dict[str, Any] = part["init_args"]
    return found


def short(path: str) -> str:
    return path.rpartition(".")[2]


def test_a_page_in_old_keys_is_the_page_in_new_ones(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "old.yaml").write_text(PAGE)
    found = resolved(tmp_path / "old.yaml")
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"plp: {tmp_path / 'old.yaml'}: names have changed: data.target is data.target_task, ")
    assert line.endswith(" more")
    data = {name: found["data"][name] for name in ("target_task", "val_fraction", "mix_ratio")}
    assert data == {"target_task": "goal_3", "val_fraction": 0.1, "mix_ratio": 1.5}
    assert (found["collection"]["hold_steps"], found["collection"]["random_start_steps"]) == (7, 2)
    encoder = settings(found["policy"])["image_encoder"]
    assert [settings(encoder)[name] for name in ("channels", "features")] == [[4, 8], 16]
    alignment = settings(found["alignment"])
    assert settings(alignment["optimizer"]) == {"lr": 5e-3, "weight_decay": 1e-5, "first_moment": 0.9}
    assert short(alignment["lr_scheduler"]["class_path"]) == "CosineDecay"
    terms = {name: term and settings(term) for name, term in alignment["terms"].items()}
    assert terms == {
        "mmd": None,
        "tcc": {"weight": 0.2, "similarity": "scaled", "reduction": "mean"},
        "adversarial": {"weight": 0.3, "penalty_weight": 0.7, "layers": 2, "hidden": 24},
        "reconstruction": {"weight": 10.0, "downsampling": 1, "channels": None},
    }
    assert settings(found["adaptation"])["lr_scheduler"] is None
    assert [(short(score["class_path"]), settings(score)["samples"]) for score in found["score"]] == [
        ("ClosenessScore", 50)
    ]


def test_few_changes_are_all_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "old.yaml").write_text("data: {mix: 1.5}\nalignment: {init_args: {lr: 0.5}}\n")
    resolved(tmp_path / "old.yaml")
    assert capsys.readouterr().err == (
        f"plp: {tmp_path / 'old.yaml'}: names have changed: data.mix is data.mix_ratio, "
        "alignment.lr is alignment.optimizer.lr\n"
    )


def weights_of(alignment: dict[str, Any]) -> dict[str, Any]:
    weights = alignment["weights"]
    found: dict[str, Any] = weights.get("init_args", weights)
    return found


@pytest.mark.parametrize("method", yaml.safe_load(FORMER))
def test_what_was_kept_of_an_old_run_keeps_its_values(method: str, tmp_path: Path) -> None:
    kept = yaml.safe_load(FORMER)[method]
    (tmp_path / "config.yaml").write_text(yaml.safe_dump({"method": method, **kept}))
    found = resolved(tmp_path / "config.yaml")
    assert (found["method"], found["phases"]) == (method, kept["phases"])
    old, policy = kept["policy"]["init_args"], settings(found["policy"])
    assert short(found["policy"]["class_path"]) == short(kept["policy"]["class_path"]).replace("Flat", "BC")
    assert {name: policy[name] for name in old if name in policy} == {n: v for n, v in old.items() if n in policy}
    assert old.keys() - policy.keys() <= {"clip", "image_channels", "image_features"}
    for phase in kept["phases"]:
        was, now = kept[phase]["init_args"], settings(found[phase])
        assert short(found[phase]["class_path"]) == short(kept[phase]["class_path"]).replace("Flat", "BC")
        assert now["epochs"] == was["epochs"]
        optimizer = settings(now["optimizer"])
        assert (optimizer["lr"], optimizer["weight_decay"]) == (was["lr"], was["weight_decay"])
        schedule = now["lr_scheduler"] and short(now["lr_scheduler"]["class_path"])
        if "slowdown" in was:
            assert schedule == "LinearDecay"
        else:
            assert schedule == ("CosineDecay" if was.get("lr_schedule") == "cosine" else None)
        same = was.keys() & now.keys() - {"terms"}
        assert {name: now[name] for name in same} == {name: was[name] for name in same}


def test_terms_of_an_old_run_are_those_that_it_had(tmp_path: Path) -> None:
    for method, chosen in (("plp_t_disc", {"tcc", "adversarial"}), ("plp_t_noaction", {"mmd", "tcc"})):
        kept = yaml.safe_load(FORMER)[method]
        (tmp_path / "config.yaml").write_text(yaml.safe_dump({"method": method, **kept}))
        terms = settings(resolved(tmp_path / "config.yaml")["alignment"])["terms"]
        assert {name for name, term in terms.items() if term} == chosen | {"reconstruction"}
        assert settings(terms["tcc"])["weight"] == 0.2
    assert settings(terms["mmd"]) == {"weight": 0.5, "bandwidths": [1.0, 0.5], "scale_gradient": True}


def test_cdils_weights_moments_and_slowdown_of_an_old_run_stay(tmp_path: Path) -> None:
    (tmp_path / "config.yaml").write_text(yaml.safe_dump({"method": "cdil", **yaml.safe_load(FORMER)["cdil"]}))
    alignment = settings(resolved(tmp_path / "config.yaml")["alignment"])
    weights = {"adversarial": 9.0, "cycle": 8.0, "latent": 7.0, "position": 6.0, "penalty": 1.0}
    assert weights_of(alignment) == weights
    assert settings(alignment["optimizer"])["first_moment"] == 0.4
    assert settings(alignment["lr_scheduler"]) == {"share": 0.25}
