"""The paper's own recipe, on every experiment."""

from __future__ import annotations

import pytest
import yaml
from command import ROOT

from plp_lightning.cli.config import parse

BY_NAME = {path.stem: path for path in (ROOT / "configs").glob("*.yaml") if path.name != "base.yaml"}
RECIPES = {
    "p2p": "literal_maze",
    "p2a": "literal_maze",
    "a2s": "literal_maze",
    "r2r": "literal_lift",
    "v2v": "literal_vision",
}
PAPERS = {"literal_maze": (20, 5e-4, 0.2), "literal_lift": (100, 1e-4, 0.2), "literal_vision": (80, 5e-4, 0.1)}
"""Alignment epochs, rate and weight of TCC, as the paper's appendix prints them."""


@pytest.mark.parametrize("name", sorted(name for name in BY_NAME if name.split("_")[0] in RECIPES))
def test_the_literal_recipe_leaves_nothing_of_a_page_that_the_paper_prints_otherwise(name: str) -> None:
    recipe = RECIPES[name.split("_")[0]]
    files = [
        BY_NAME[name],
        ROOT / "configs" / "recipes" / f"{recipe}.yaml",
        ROOT / "configs" / "methods" / "plp_t.yaml",
    ]
    made = yaml.safe_load(parse([word for file in files for word in ("--config", str(file))]).config)
    alignment, collection, policy = made["alignment"]["init_args"], made["collection"], made["policy"]["init_args"]
    adaptation = made["adaptation"]["init_args"]
    rate = alignment["optimizer"]["init_args"]["lr"]
    terms = {term: alignment["terms"][term]["init_args"] for term in ("mmd", "tcc")}
    assert (alignment["epochs"], rate, terms["tcc"]["weight"]) == PAPERS[recipe]
    assert (alignment["lr_scheduler"], alignment["bc_reduction"], terms["tcc"]["reduction"]) == (None, "sum", "sum")
    assert (terms["mmd"]["weight"], terms["mmd"]["bandwidths"]) == (0.1, [1.0])
    assert (collection["noise"], collection["noise_steps"], collection["random_start_steps"]) == (0, 1, 0)
    assert (adaptation["support_weight"], adaptation["lr_scheduler"]) == (0, None)
    assert (policy["encoder_state"], policy["gradient_floor"]) == ("all", 0)
    assert policy["decoder_state"] == ("all" if recipe == "literal_maze" else "none")
    assert (made["data"]["tasks_per_batch"], made["data"]["val_fraction"]) == (None, 0)


@pytest.mark.parametrize("method", ["plp", "plp_t_noaction", "bc", "gama", "cdil", "contextual"])
@pytest.mark.parametrize("name", ["p2p_medium", "v2v_reach"])
def test_the_stable_recipe_goes_on_top_of_any_experiment_and_method(name: str, method: str) -> None:
    files = [
        BY_NAME[name],
        ROOT / "configs" / "methods" / f"{method}.yaml",
        ROOT / "configs" / "recipes" / "stable.yaml",
    ]
    made = yaml.safe_load(parse([word for file in files for word in ("--config", str(file))]).config)
    assert made["handover"] == {"average_over": 0.1, "epoch": "best"}
    for phase in {"alignment", "adaptation"} & {*made["phases"]}:
        assert made[phase]["init_args"]["lr_scheduler"]["class_path"].endswith(".CosineDecay")
