"""Folders of runs as ``plp fit`` leaves them, for the tests of reports: results, curves and pictures."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from PIL import Image

RESULT = {
    "experiment": "p2p_medium",
    "method": "plp",
    "target_task": "goal_1_6",
    "seed": 0,
    "phases": ["alignment", "adaptation"],
    "target": {"success": 0.5, "episodes": 100, "invalid": 0, "interval": [0.4, 0.6], "before": 0.1},
    "source": {"success": 0.75},
    "proxy": {"success": 0.9},
    "alignment": {"top1": 0.4, "top5": 0.8},
    "seconds": {"alignment": 20.0, "adaptation": 3.0},
    "settings": {"alignment.optimizer.lr": 0.001},
    "config_sha256": "c0ffee",
    "commit": "badc0de",
}
CURVES = "step,metric,value\n4,eval/target_success,0.25\n4,alignment/top5,0.5\n4,epoch,0\n9,epoch,1\n"
NASTY = '<script>alert("1")</script> | $x_1$ 50 % \\ & {a} #1 ~^ `b` *c* [d](e) Ü 目'


def add_run(folder: Path, pictures: tuple[str, ...] = (), **changes: object) -> Path:
    """A run directory with curves of both phases, and pictures of the last one; the folder of its results."""
    content = RESULT | changes
    place = (
        folder
        / "-".join(str(content[key]).replace("/", "_")[:20] for key in ("experiment", "method"))
        / str(content["seed"])
    )
    for phase in ("alignment", "adaptation"):
        (place / phase).mkdir(parents=True)
        (place / phase / "metrics.csv").write_text(CURVES)
    for name in pictures:
        colours = np.random.default_rng(0).integers(0, 255, (40, 60, 3), np.uint8)
        Image.fromarray(colours).save(place / "adaptation" / f"{name}.png")
    (place / "results.json").write_text(json.dumps(content))
    return place
