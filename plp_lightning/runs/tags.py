"""Names of curves on TensorBoard's page, which groups them by what stands before the first slash."""

from __future__ import annotations

import re

from plp_lightning.runs.results import ROWS

TAGS = (
    (r"train/latent_std", r"latents/std"),
    (r"train/(.+)", r"loss/train/\1"),
    (r"val/(.+)", r"loss/held_out/\1"),
    (rf"eval/({'|'.join(ROWS)})_success", r"success/\1"),
    (r"eval/(.+)", r"behaviour/\1"),
)
"""Names in ``metrics.csv``, by which a ``monitor`` is called too, and their tags: the first that fits."""


def board_tag(name: str) -> str:
    """Tag of what is logged by a name: ``loss/held_out/bc`` of ``val/bc``; other names are tags as they are."""
    for pattern, tag in TAGS:
        if found := re.fullmatch(pattern, name):
            return found.expand(tag)
    return name
