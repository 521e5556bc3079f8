"""Makes ``lerobot_v3_0`` and ``lerobot_v3_0_video``, or ``lerobot_v2_1``, beside it: whichever the version writes.

pip install 'lerobot[dataset]==0.6.1' && python make_lerobot.py          # v3.0, Python 3.12
pip install 'lerobot==0.3.3' 'datasets<4' && python make_lerobot.py      # v2.1
"""

from __future__ import annotations

import shutil
from pathlib import Path

import golden_values
import numpy as np
from lerobot.datasets.lerobot_dataset import CODEBASE_VERSION, LeRobotDataset

HERE, VECTORS, NAMES = Path(__file__).parent, {"observation.state": 5, "action": 2}, ["height", "width", "channels"]


def make(name: str, video: bool) -> None:
    features = {
        k: {"dtype": "float32", "shape": (n,), "names": [f"x{i}" for i in range(n)]} for k, n in VECTORS.items()
    }
    for camera, shape in golden_values.CAMERAS.items():
        if not video or camera == "front":  # encoders want more pixels than the small camera has
            kind = "video" if video else "image"
            features[f"observation.images.{camera}"] = {"dtype": kind, "shape": shape, "names": NAMES}
    root = HERE / name
    shutil.rmtree(root, ignore_errors=True)
    settings = {"root": root, "robot_type": "made_up", "use_videos": video}
    dataset = LeRobotDataset.create("golden/made_up", golden_values.HZ, features, **settings)
    for one in golden_values.episodes():
        for step, action in enumerate(one.actions):
            seen = {k.rpartition(".")[2]: one.seen[k.rpartition(".")[2]][step] for k in features if "images" in k}
            frame = {f"observation.images.{camera}": image for camera, image in seen.items()}
            frame["observation.state"] = np.concatenate([one.seen[k][step] for k in golden_values.KEYS])
            frame["action"] = action
            try:
                dataset.add_frame({**frame, "task": one.task})
            except TypeError:
                dataset.add_frame(frame, task=one.task)  # 0.3.3
        dataset.save_episode()
    if hasattr(dataset, "finalize"):
        dataset.finalize()
    shutil.rmtree(root / "images", ignore_errors=True)


if __name__ == "__main__":
    version = CODEBASE_VERSION.replace(".", "_")
    make(f"lerobot_{version}", video=False)
    if CODEBASE_VERSION == "v3.0":
        make(f"lerobot_{version}_video", video=True)
