"""Names of earlier versions: every old key, flag and class is understood, and told its new name."""

from __future__ import annotations

import copy
from pathlib import Path
from typing import Any

import pytest
import yaml
from command import SMOKE, plp

from datamodules.errors import ConfigError
from plp_lightning.cli.config import parse
from plp_lightning.cli.renamed import ALIGNMENT, CDIL, CLASSES, GROUPS, PHASE, POLICY, rename, rename_flag

PHASES = ["alignment", "adaptation"]

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


def told(page: dict[str, Any]) -> list[str]:
    return rename(page, PHASES)[1]


# -- one key at a time -------------------------------------------------------------------------------


@pytest.mark.parametrize(("group", "old"), [(group, old) for group, table in GROUPS.items() for old in table])
def test_old_keys_of_groups_have_their_new_names(group: str, old: str) -> None:
    new = GROUPS[group][old]
    renamed, found = rename({group: {old: 3, "other": 4}}, PHASES)
    assert renamed == {group: {new: 3, "other": 4}}
    assert found == [f"{group}.{old} is {group}.{new}"]
    assert rename_flag(f"{group}.{old}", {}) == f"{group}.{new}"


def at(tree: dict[str, Any], key: str) -> Any:
    for name in key.split("."):
        tree = tree[name]
    return tree


@pytest.mark.parametrize(
    ("kind", "place", "old", "new"),
    [
        *[("Alignment", "alignment", old, new) for old, new in ALIGNMENT.items()],
        *[("StateOnlyAlignment", "alignment", old, new) for old, new in ALIGNMENT.items()],
        *[("CdilAlignment", "alignment", old, new) for old, new in CDIL.items()],
        *[("BCAdaptation", "adaptation", old, new) for old, new in PHASE.items() if old != "lr_schedule"],
        *[("PortablePolicy", "policy", old, new) for old, new in POLICY.items() if new],
        *[("ContextualPolicy", "policy", old, new) for old, new in POLICY.items() if new],
    ],
)
def test_old_settings_are_where_they_are_now(kind: str, place: str, old: str, new: str) -> None:
    tree = {place: {"class_path": kind, "init_args": {old: 3, "other": 4}}}
    before = copy.deepcopy(tree)
    renamed, found = rename(tree, PHASES)
    assert tree == before
    assert at(settings(renamed[place]), new) == 3
    assert old not in settings(renamed[place])
    assert settings(renamed[place])["other"] == 4
    assert found == [f"{place}.{old} is {place}.{new.replace('.init_args.', '.')}"]
    flag = f"{place}.{new.replace('.init_args.', '.')}"
    assert rename_flag(f"{place}.{old}", tree) == rename_flag(f"{place}.init_args.{old}", tree) == flag


@pytest.mark.parametrize(("kind", "name"), [("GamaAlignment", "adversarial_weight"), ("GamaPolicy", "image_channels")])
def test_settings_that_kept_their_names_stay(kind: str, name: str) -> None:
    place = "policy" if kind.endswith("Policy") else "alignment"
    tree = {place: {"class_path": kind, "init_args": {name: 3}}}
    assert rename(tree, PHASES) == (tree, [])
    assert rename_flag(f"{place}.{name}", tree) == f"{place}.{name}"


@pytest.mark.parametrize(("word", "schedule"), [("cosine", {"class_path": "CosineDecay"}), ("constant", None)])
def test_words_for_schedules_are_classes(word: str, schedule: Any) -> None:
    renamed, found = rename({"alignment": {"init_args": {"lr_schedule": word}}}, PHASES)
    assert renamed == {"alignment": {"init_args": {"lr_scheduler": schedule}}}
    assert found == ["alignment.lr_schedule is alignment.lr_scheduler"]


@pytest.mark.parametrize("words", [[], ["mmd"], ["tcc", "adversarial"], ["mmd", "tcc", "adversarial"]])
def test_a_list_of_terms_chooses_them_and_leaves_the_others_away(words: list[str]) -> None:
    renamed, found = rename({"alignment": {"init_args": {"terms": words, "tcc_weight": 0.2}}}, PHASES)
    terms = settings(renamed["alignment"])["terms"]
    assert {name for name, term in terms.items() if term and "class_path" in term} == set(words)
    assert terms["mmd"] == ({"class_path": "MMD"} if "mmd" in words else None)
    assert terms["tcc"] == ({"class_path": "TCC", "init_args": {"weight": 0.2}} if "tcc" in words else None)
    assert "the list alignment.terms is a mapping from names to classes" in found


def test_a_word_that_was_no_term_is_told() -> None:
    with pytest.raises(ConfigError, match=r"alignment\.terms names 'mdm'; expected some of mmd, adversarial, tcc"):
        rename({"alignment": {"init_args": {"terms": ["tcc", "mdm"]}}}, PHASES)


def test_one_score_is_a_list_of_one() -> None:
    renamed, found = rename({"score": {"class_path": "ClosenessScore"}}, PHASES)
    assert renamed == {"score": [{"class_path": "ClosenessScore"}]}
    assert found == ["one score is a list of one"]


@pytest.mark.parametrize("kind", ["PortablePolicy", "GamaPolicy", "CdilPolicy", "ContextualPolicy"])
def test_the_bound_of_inputs_that_always_holds_may_be_named_and_no_other(kind: str) -> None:
    def policy(clip: float) -> dict[str, Any]:
        return {"policy": {"class_path": kind, "init_args": {"clip": clip}}}

    assert rename(policy(5.0), PHASES)[0] == {"policy": {"class_path": kind, "init_args": {}}}
    with pytest.raises(
        ConfigError, match=r"policy\.clip is 3\.0; expected 5\.0, which it always is now; leave it away"
    ):
        rename(policy(3.0), PHASES)


@pytest.mark.parametrize("old", CLASSES)
def test_old_classes_have_their_new_names(old: str) -> None:
    for name in (f"plp_lightning.baselines.{old}", f"plp_lightning.baselines.flat.{old}", old):
        tree = {"policy": {"class_path": name}, "callbacks": [{"class_path": name}]}
        new = CLASSES[old]
        assert rename(tree, PHASES)[0] == {"policy": {"class_path": new}, "callbacks": [{"class_path": new}]}


@pytest.mark.parametrize("path", ["own.Alignment", "plp_lightning.methods.plp.alignment.Alignment", "Alignment"])
def test_classes_that_did_not_move_keep_their_names(path: str) -> None:
    assert rename({"alignment": {"class_path": path}}, PHASES) == ({"alignment": {"class_path": path}}, [])


def test_todays_names_are_not_touched(tmp_path: Path) -> None:
    page = yaml.safe_load(Path(SMOKE[1]).read_text())
    assert rename(page, PHASES) == (page, [])


# -- whole files -------------------------------------------------------------------------------------


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
    assert list(encoder.get("init_args", encoder).values()) == [[4, 8], 16]
    alignment = settings(found["alignment"])
    assert settings(alignment["optimizer"]) == {"lr": 5e-3, "weight_decay": 1e-5, "first_moment": 0.9}
    assert short(alignment["lr_scheduler"]["class_path"]) == "CosineDecay"
    terms = {name: term and settings(term) for name, term in alignment["terms"].items()}
    assert terms == {
        "mmd": None,
        "tcc": {"weight": 0.2, "similarity": "scaled"},
        "adversarial": {"weight": 0.3, "penalty_weight": 0.7, "layers": 2, "hidden": 24},
        "reconstruction": {"weight": 10.0, "downsampling": 1},
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


# -- flags -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("flags", "key", "value"),
    [
        (["--data.held_out", "0.25"], "data.val_fraction", 0.25),
        (["--collection.linger=3"], "collection.hold_steps", 3),
        (["--alignment.lr", "0.5"], "alignment.init_args.optimizer.init_args.lr", 0.5),
        (["--alignment.init_args.lr=0.5"], "alignment.init_args.optimizer.init_args.lr", 0.5),
        (["--alignment.mmd_weight", "0.5"], "alignment.init_args.terms.mmd.init_args.weight", 0.5),
        (["--adaptation.weight_decay", "0.5"], "adaptation.init_args.optimizer.init_args.weight_decay", 0.5),
    ],
)
def test_old_flags_are_understood_and_told(
    flags: list[str], key: str, value: float, capsys: pytest.CaptureFixture[str]
) -> None:
    found = yaml.safe_load(parse([*SMOKE, *flags]).config)
    assert at(found, key) == value
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"plp: flags: names have changed: {flags[0].split('=')[0]} is --")


@pytest.mark.parametrize(
    ("flags", "key", "expected"),
    [
        (["--alignment.lr_schedule", "cosine"], "lr_scheduler", "CosineDecay"),
        (["--alignment.lr_scheduler", "CosineDecay", "--alignment.lr_schedule=constant"], "lr_scheduler", None),
        (["--alignment.terms", "[tcc]"], "terms.tcc", "TCC"),
        (["--alignment.terms", "[tcc]"], "terms.mmd", None),
        (["--alignment.terms=[mmd, adversarial]"], "terms.adversarial", "DomainAdversarial"),
    ],
)
def test_old_flags_that_were_words_choose_classes(flags: list[str], key: str, expected: str | None) -> None:
    found = at(settings(yaml.safe_load(parse([*SMOKE, *flags]).config)["alignment"]), key)
    assert (found and short(found["class_path"])) == expected


def test_an_old_flag_of_a_bound_that_always_holds_is_understood() -> None:
    assert parse([*SMOKE, "--policy.clip", "5"]).config == parse(SMOKE).config
    with pytest.raises(ConfigError, match=r"policy\.clip is 3; expected 5\.0, which it always is now; leave it away"):
        parse([*SMOKE, "--policy.clip", "3"])


def test_new_flags_are_silent() -> None:
    answer = plp("fit", *SMOKE, "--data.val_fraction", "0.25", "--alignment.optimizer.lr", "0.5", "--print_config")
    assert (answer.code, answer.err) == (0, "")
