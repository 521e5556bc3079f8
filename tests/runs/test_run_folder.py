from __future__ import annotations

from pathlib import Path

import pytest
from command import tiny_smoke

from plp_lightning.cli.config import parse


@pytest.mark.parametrize(
    ("task", "folder"),
    [("goal_3", "goal_3"), ("lift the lid!", "lift_the_lid-e6b88773"), ("../../out", "out-a94848ef")],
)
def test_a_run_of_a_sentence_has_a_folder_like_the_others(tmp_path: Path, task: str, folder: str) -> None:
    experiment = parse(tiny_smoke(tmp_path))
    experiment.data.target_task = task
    assert experiment.run_path == tmp_path / "smoke" / "plp" / folder / "seed_0"
