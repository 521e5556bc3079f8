"""Files over files: which settings a class change keeps, which defaults it takes, and what is left away."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml
from command import ROOT, SMOKE

from datamodules.errors import ConfigError
from plp_lightning.cli.classes import ALLOWED_IMPORTS
from plp_lightning.cli.config import parse, resolve
from plp_lightning.cli.layers import completed, insert, overlay, without_spare_parts
from plp_lightning.cli.yaml_files import read_yaml

SPARE = ("mmd", "tcc", "adversarial")


def laid(*layers: dict[str, Any]) -> Any:
    tree: Any = {}
    for layer in layers:
        tree = overlay(tree, layer, ALLOWED_IMPORTS)
    return tree


def part(kind: str, **settings: Any) -> dict[str, Any]:
    return {"class_path": kind, "init_args": settings}


def resolved(*words: str) -> dict[str, Any]:
    """What the files and flags of an experiment come to, as a run keeps it."""
    found: dict[str, Any] = yaml.safe_load(parse([*SMOKE, *words]).config)
    return found


def overlay_of(name: str) -> list[str]:
    return ["--config", str(ROOT / "configs" / "methods" / f"{name}.yaml")]


def test_later_keys_win_and_the_others_stay() -> None:
    first = {"data": {"pairs": 3, "stride": 4}, "seed": 1}
    assert laid(first, {"data": {"pairs": 5}}) == {"data": {"pairs": 5, "stride": 4}, "seed": 1}
    assert first == {"data": {"pairs": 3, "stride": 4}, "seed": 1}


def test_a_list_is_replaced_and_a_plus_appends() -> None:
    assert laid({"phases": ["a", "b"]}, {"phases": ["c"]}) == {"phases": ["c"]}
    assert laid({"callbacks": [1]}, {"callbacks+": [2, 3]}, {"callbacks+": 4}) == {"callbacks": [1, 2, 3, 4]}
    assert laid({}, {"callbacks+": [2]}) == {"callbacks": [2]}


def test_another_class_keeps_what_files_say_of_settings_that_it_shares_and_nothing_else() -> None:
    below = part("PortablePolicy", latent=8, hidden=16, scaling={"position": 4.0})
    assert laid(below, {"class_path": "GamaPolicy"}) == part("GamaPolicy", hidden=16, scaling={"position": 4.0})
    assert below["init_args"].keys() == {"latent", "hidden", "scaling"}


def test_another_class_takes_no_default_of_the_class_before() -> None:
    changed = laid(part("PortablePolicy", latent=8), {"class_path": "ContextualPolicy"})
    assert completed(changed, ALLOWED_IMPORTS)["init_args"]["hidden"] == 256
    assert completed(part("PortablePolicy"), ALLOWED_IMPORTS)["init_args"]["hidden"] == 192


def test_the_same_class_keeps_all_settings() -> None:
    same = laid(part("PortablePolicy", latent=8), part("PortablePolicy", hidden=4))
    assert same == part("PortablePolicy", latent=8, hidden=4)


def test_a_class_may_be_told_by_its_name_alone() -> None:
    below = part("PortablePolicy", latent=8, hidden=16)
    assert laid(below, "GamaPolicy") == part("GamaPolicy", hidden=16)
    assert laid({"init_args": {"weight": 0.2}}, "TCC") == part("TCC", weight=0.2)


def test_files_may_name_classes_alone(tmp_path: Path) -> None:
    page = {"alignment": {"init_args": {"terms": {"tcc": "TCC"}, "optimizer": "torch.optim.SGD"}}}
    (tmp_path / "short.yaml").write_text(yaml.safe_dump(page))
    alignment = resolved("--config", str(tmp_path / "short.yaml"))["alignment"]["init_args"]
    assert alignment["terms"]["tcc"]["class_path"].endswith("TCC")
    assert alignment["optimizer"]["class_path"] == "torch.optim.SGD"
    assert alignment["optimizer"]["init_args"]["lr"] == 2e-3, "the page below says so"
    (tmp_path / "short.yaml").write_text("policy: BCPolicy\nalignment: BCCloning\nadaptation: BCAdaptation\n")
    by_name, by_class = resolved("--config", str(tmp_path / "short.yaml")), resolved(*overlay_of("bc"))
    assert all(by_name[key] == by_class[key] for key in ("policy", "alignment", "adaptation"))


def test_the_new_class_has_the_last_word() -> None:
    below = part("Alignment", epochs=3, bc_reduction="sum")
    assert laid(below, part("GamaAlignment", epochs=7)) == part("GamaAlignment", epochs=7)


def test_a_key_that_no_class_has_is_refused_where_the_class_changes() -> None:
    with pytest.raises(ConfigError, match=r"unknown key 'latnt' of PortablePolicy; see plp fit --help"):
        laid(part("PortablePolicy", latnt=8), {"class_path": "GamaPolicy"})


def test_an_unknown_key_is_refused_where_the_class_stays(tmp_path: Path) -> None:
    (tmp_path / "wrong.yaml").write_text("policy: {init_args: {latnt: 8}}\n")
    with pytest.raises(ConfigError, match=r"unknown key 'policy\.latnt'; did you mean 'policy\.latent'"):
        parse([*SMOKE, "--config", str(tmp_path / "wrong.yaml")])


def test_settings_of_classes_that_are_unknown_here_stay_for_the_parser_to_judge() -> None:
    assert laid(part("own.Policy", own=8), {"class_path": "other.Policy"}) == part("other.Policy", own=8)


def test_null_leaves_a_part_away() -> None:
    terms = {"terms": {"mmd": part("MMD", weight=0.5), "tcc": part("TCC")}}
    assert laid(terms, {"terms": {"mmd": None}}) == {"terms": {"mmd": None, "tcc": part("TCC")}}


def test_a_term_that_was_left_away_comes_back_with_its_class() -> None:
    assert laid({"mmd": part("MMD", weight=0.5)}, {"mmd": None}, {"mmd": part("MMD")}) == {"mmd": part("MMD")}


def tree_with(terms: dict[str, Any]) -> dict[str, Any]:
    return {"phases": ["alignment"], "alignment": part("Alignment", terms=terms), "later": part("Adaptation")}


def test_spare_terms_and_phases_are_left_away_and_named() -> None:
    terms = {"mmd": part("MMD"), "tcc": {"init_args": {"weight": 0.2}}, "adversarial": None}
    kept, dropped = without_spare_parts(tree_with(terms), ["alignment", "later"], SPARE)
    assert kept == {"phases": ["alignment"], "alignment": part("Alignment", terms={"mmd": part("MMD")})}
    assert dropped == ["alignment.init_args.terms.tcc", "alignment.init_args.terms.adversarial"]


def test_a_term_of_ones_own_needs_a_class_but_may_be_null() -> None:
    told = r"alignment\.terms\.mdm has no class; give its class_path, or name one of: mmd, tcc, adversarial"
    with pytest.raises(ConfigError, match=told):
        without_spare_parts(tree_with({"mdm": {"init_args": {"weight": 1}}}), ["alignment"], SPARE)
    own = {"mdm": part("MMD"), "other": None}
    kept, dropped = without_spare_parts(tree_with(own), ["alignment"], SPARE)
    assert kept["alignment"]["init_args"]["terms"] == {"mdm": part("MMD")}
    assert dropped == ["alignment.init_args.terms.other"]


def test_a_page_sets_up_terms_for_the_methods_that_choose_them(tmp_path: Path) -> None:
    page = {"alignment": {"init_args": {"terms": {"tcc": {"init_args": {"weight": 0.25}}}}}}
    (tmp_path / "page.yaml").write_text(yaml.safe_dump(page))
    words = ["--config", str(tmp_path / "page.yaml")]
    assert resolved(*words)["alignment"]["init_args"]["terms"]["tcc"] is None
    chosen = resolved(*words, *overlay_of("plp_t"))["alignment"]["init_args"]["terms"]
    assert chosen["tcc"]["init_args"]["weight"] == 0.25
    assert chosen["mmd"]["init_args"]["weight"] == 0.1


def test_settings_of_a_phase_that_the_method_has_not_are_left_away() -> None:
    tree, *_ = resolve([*SMOKE, *overlay_of("contextual")], ALLOWED_IMPORTS)
    assert tree["phases"] == ["alignment"]
    assert "adaptation" not in tree


def test_flags_choose_classes_before_defaults_are_filled_in() -> None:
    by_flag = resolved("--policy", "BCPolicy", "--alignment", "BCCloning", "--adaptation", "BCAdaptation")
    by_file = resolved(*overlay_of("bc"))
    for key in ("policy", "alignment", "adaptation"):
        assert by_flag[key] == by_file[key]


@pytest.mark.parametrize("flag", ["--policy.class_path", "--policy", "--policy="])
def test_a_class_is_chosen_in_any_spelling(flag: str) -> None:
    words = [flag + "ContextualPolicy"] if flag.endswith("=") else [flag, "ContextualPolicy"]
    tree, _, rest, _ = resolve([*SMOKE, *words, "--seed", "3"], ALLOWED_IMPORTS)
    assert tree["policy"]["class_path"] == "ContextualPolicy"
    assert tree["policy"]["init_args"]["hidden"] == 64, "the page says so"
    assert tree["policy"]["init_args"]["heads"] == 8
    assert "latent" not in tree["policy"]["init_args"]
    assert rest == ["--seed", "3"]


def test_a_flag_chooses_terms_optimizers_and_schedules_and_takes_them_away() -> None:
    words = ["--alignment.terms.tcc", "TCC", "--alignment.terms.mmd", "null", "--alignment.terms.tcc.weight", "0.25"]
    words += ["--alignment.lr_scheduler", "LinearDecay", "--alignment.optimizer", "torch.optim.SGD"]
    alignment = resolved(*words)["alignment"]["init_args"]
    assert alignment["terms"]["mmd"] is None
    assert alignment["terms"]["tcc"]["init_args"]["weight"] == 0.25
    assert alignment["lr_scheduler"]["class_path"].endswith("LinearDecay")
    assert alignment["optimizer"]["class_path"] == "torch.optim.SGD"
    assert alignment["optimizer"]["init_args"]["lr"] == 2e-3, "the page says so"


def test_what_is_resolved_does_not_change_the_second_time() -> None:
    once = completed(part("GamaPolicy", hidden=4), ALLOWED_IMPORTS)
    assert completed(once, ALLOWED_IMPORTS) == once
    nested = completed({"list": [part("GamaPolicy")], "plain": 3}, ALLOWED_IMPORTS)
    assert nested["list"][0]["init_args"]["policy_layers"] == 3
    assert nested["plain"] == 3


def test_dotted_keys_are_set() -> None:
    tree: dict[str, Any] = {"a": {"b": {"c": 1, "d": 2}}}
    insert(tree, "a.x.y", 3)
    assert tree == {"a": {"b": {"c": 1, "d": 2}, "x": {"y": 3}}}


def test_what_a_method_does_not_choose_is_left_away_from_a_copy() -> None:
    tree = {"phases": ["b"], "a": {}, "b": {"init_args": {"terms": {"mmd": {"init_args": {}}, "tcc": "TCC"}}}}
    kept, dropped = without_spare_parts(tree, ["a", "b"], ["mmd"])
    assert kept == {"phases": ["b"], "b": {"init_args": {"terms": {"tcc": "TCC"}}}}
    assert dropped == ["b.init_args.terms.mmd"]
    assert "mmd" in tree["b"]["init_args"]["terms"], "the tree that was given is as it was"


def test_an_empty_file_says_nothing(tmp_path: Path) -> None:
    (tmp_path / "empty.yaml").write_text("")
    assert read_yaml(tmp_path / "empty.yaml") == {}
