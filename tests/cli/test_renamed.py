"""Names of earlier versions: every old key, flag and class is understood, and told its new name."""

from __future__ import annotations

import copy
from pathlib import Path
from typing import Any

import pytest
import yaml
from command import ROOT, SMOKE, plp

from datamodules.errors import ConfigError
from plp_lightning.cli.config import parse
from plp_lightning.cli.renamed import ALIGNMENT, CDIL, CLASSES, GROUPS, PHASE, POLICY, rename, rename_flag

PHASES = ["alignment", "adaptation"]
BASE = {"policy": {"class_path": "PortablePolicy"}, "alignment": {"class_path": "Alignment"}}
"""What every file is laid over."""


def settings(part: dict[str, Any]) -> dict[str, Any]:
    found: dict[str, Any] = part["init_args"]
    return found


def short(path: str) -> str:
    return path.rpartition(".")[2]


# -- one key at a time -------------------------------------------------------------------------------


@pytest.mark.parametrize(("group", "old"), [(group, old) for group, table in GROUPS.items() for old in table])
def test_old_keys_of_groups_have_their_new_names(group: str, old: str) -> None:
    new = GROUPS[group][old]
    renamed, found = rename({group: {old: 3, "other": 4}}, PHASES, BASE)
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
    renamed, found = rename(tree, PHASES, BASE)
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
    assert rename(tree, PHASES, BASE) == (tree, [])
    assert rename_flag(f"{place}.{name}", tree) == f"{place}.{name}"


def test_a_file_that_names_no_class_is_read_as_of_the_class_below() -> None:
    below = {"policy": {"class_path": "GamaPolicy"}, "alignment": {"class_path": "CdilAlignment"}}
    today = {"policy": {"init_args": {"image_channels": [4]}}, "alignment": {"init_args": {"discriminator_layers": 2}}}
    assert rename(today, PHASES, below) == (today, [])
    assert rename(today, PHASES, BASE)[0] == {
        "policy": {"init_args": {"image_encoder": {"channels": [4]}}},
        "alignment": {"init_args": {"terms": {"adversarial": {"init_args": {"layers": 2}}}}},
    }


@pytest.mark.parametrize(("word", "schedule"), [("cosine", {"class_path": "CosineDecay"}), ("constant", None)])
def test_words_for_schedules_are_classes(word: str, schedule: Any) -> None:
    renamed, found = rename({"alignment": {"init_args": {"lr_schedule": word}}}, PHASES, BASE)
    assert renamed == {"alignment": {"init_args": {"lr_scheduler": schedule}}}
    assert found == ["alignment.lr_schedule is alignment.lr_scheduler"]


@pytest.mark.parametrize("words", [[], ["mmd"], ["tcc", "adversarial"], ["mmd", "tcc", "adversarial"]])
def test_a_list_of_terms_chooses_them_and_leaves_the_others_away(words: list[str]) -> None:
    renamed, found = rename({"alignment": {"init_args": {"terms": words, "tcc_weight": 0.2}}}, PHASES, BASE)
    terms = settings(renamed["alignment"])["terms"]
    assert {name for name, term in terms.items() if term and "class_path" in term} == set(words)
    assert terms["mmd"] == ({"class_path": "MMD"} if "mmd" in words else None)
    assert terms["tcc"] == ({"class_path": "TCC", "init_args": {"weight": 0.2}} if "tcc" in words else None)
    assert "the list alignment.terms is a mapping from names to classes" in found


def test_a_word_that_was_no_term_is_told() -> None:
    with pytest.raises(ConfigError, match=r"alignment\.terms names 'mdm'; expected some of mmd, adversarial, tcc"):
        rename({"alignment": {"init_args": {"terms": ["tcc", "mdm"]}}}, PHASES, BASE)


def test_one_score_is_a_list_of_one() -> None:
    renamed, found = rename({"score": {"class_path": "ClosenessScore"}}, PHASES, BASE)
    assert renamed == {"score": [{"class_path": "ClosenessScore"}]}
    assert found == ["one score is a list of one"]


@pytest.mark.parametrize("kind", ["PortablePolicy", "GamaPolicy", "CdilPolicy", "ContextualPolicy"])
def test_the_bound_of_inputs_that_always_holds_may_be_named_and_no_other(kind: str) -> None:
    def policy(clip: float) -> dict[str, Any]:
        return {"policy": {"class_path": kind, "init_args": {"clip": clip}}}

    assert rename(policy(5.0), PHASES, BASE)[0] == {"policy": {"class_path": kind, "init_args": {}}}
    with pytest.raises(
        ConfigError, match=r"policy\.clip is 3\.0; expected 5\.0, which it always is now; leave it away"
    ):
        rename(policy(3.0), PHASES, BASE)


@pytest.mark.parametrize("old", CLASSES)
def test_old_classes_have_their_new_names(old: str) -> None:
    for name in (f"plp_lightning.baselines.{old}", f"plp_lightning.baselines.flat.{old}", old):
        tree = {"policy": {"class_path": name}, "callbacks": [{"class_path": name}]}
        new = CLASSES[old]
        assert rename(tree, PHASES, BASE)[0] == {"policy": {"class_path": new}, "callbacks": [{"class_path": new}]}


@pytest.mark.parametrize("path", ["own.Alignment", "plp_lightning.methods.plp.alignment.Alignment", "Alignment"])
def test_classes_that_did_not_move_keep_their_names(path: str) -> None:
    assert rename({"alignment": {"class_path": path}}, PHASES, BASE) == ({"alignment": {"class_path": path}}, [])


def test_todays_names_are_not_touched(tmp_path: Path) -> None:
    page = yaml.safe_load(Path(SMOKE[1]).read_text())
    assert rename(page, PHASES, BASE) == (page, [])


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
    ("method", "old", "new"),
    [
        ("cdil", "encoder_layers", "translator_encoder_layers"),
        ("cdil", "decoder_layers", "translator_decoder_layers"),
        ("contextual", "encoder_layers", "encoder_blocks"),
        ("contextual", "decoder_layers", "decoder_blocks"),
    ],
)
def test_networks_that_are_no_part_of_plp_have_names_of_their_own(
    method: str, old: str, new: str, capsys: pytest.CaptureFixture[str]
) -> None:
    overlay = ["--config", str(ROOT / "configs" / "methods" / f"{method}.yaml")]
    found = yaml.safe_load(parse([*SMOKE, *overlay, f"--policy.{old}", "2"]).config)
    assert found["policy"]["init_args"][new] == 2
    assert f"--policy.{old} is --policy.{new}" in capsys.readouterr().err


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
