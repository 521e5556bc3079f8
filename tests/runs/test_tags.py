"""Curves are grouped on TensorBoard by what they measure, and keep their names everywhere else."""

from __future__ import annotations

import re

import pytest
from command import ROOT

from plp_lightning.runs.tags import board_tag

KNOWN = {
    "train/bc": "loss/train/bc",
    "train/loss": "loss/train/loss",
    "train/latent_std": "latents/std",
    "val/bc_flat": "loss/held_out/bc_flat",
    "val/next": "loss/held_out/next",
    "eval/target_success": "success/target",
    "eval/proxy_source_success": "success/proxy_source",
    "eval/proxy_steps_to_success": "behaviour/proxy_steps_to_success",
    "eval/source_invalid": "behaviour/source_invalid",
    "alignment/closeness": "alignment/closeness",
    "final/target_success": "final/target_success",
    "epoch": "epoch",
    "lr-FusedAdamW": "lr-FusedAdamW",
}


@pytest.mark.parametrize("name", KNOWN)
def test_a_tag_begins_with_what_is_measured(name: str) -> None:
    assert board_tag(name) == KNOWN[name]
    assert board_tag(board_tag(name)) == KNOWN[name]


def test_the_page_of_curves_tells_the_tags() -> None:
    rows = re.findall(r"^\| `(\S+)` \| `(\S+)` \|", (ROOT / "docs" / "curves.md").read_text(), re.MULTILINE)
    assert len(rows) >= 8
    assert [board_tag(name) for name, _ in rows] == [tag for _, tag in rows]
