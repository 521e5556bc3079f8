"""The speed at which V2V is drawn, beside ``mujoco.Renderer`` at its defaults on the shipped scene.

Run from the repository: ``python benchmarks/rendering.py [--frames 40]``. All ways of drawing take turns on the same
states, so that a busy machine slows all of them alike; seconds are the processor's, on one thread.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable

from plp_lightning.envs.rendering.backend import choose_backend

choose_backend()  # mujoco.Renderer asks for it when MuJoCo is imported

import mujoco  # noqa: E402
import numpy as np  # noqa: E402

from plp_lightning.envs.rendering.camera import Camera, Viewpoint, free_camera  # noqa: E402
from plp_lightning.envs.tabletop.model import (  # noqa: E402
    REACH_FILE,
    WINDOW_FILE,
    TabletopModel,
    reach_model,
    read_scene,
    window_model,
)
from plp_lightning.envs.tabletop.simulator import VIEWS, View  # noqa: E402

SIZE = 64
SHARE = 10
"""Our images for each image of the slow renderer."""
SCENES: tuple[tuple[str, View, Callable[[int], TabletopModel]], ...] = (
    (REACH_FILE, "front_left", reach_model),
    (REACH_FILE, "front_right", reach_model),
    (WINDOW_FILE, "rear", window_model),
    (WINDOW_FILE, "front", window_model),
)


def at_rest(model: mujoco.MjModel) -> mujoco.MjData:
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return data


def seconds(draw: Callable[[], object], count: int) -> float:
    start = time.process_time()
    for _ in range(count):
        draw()
    return (time.process_time() - start) / count


def compare(scene: str, view: View, light: TabletopModel, frames: int) -> tuple[float, float]:
    """Median seconds for an image of the default renderer and of ours."""
    shipped = read_scene(scene).compile()
    viewpoint, full, ours = Viewpoint(*VIEWS[view]), at_rest(shipped), at_rest(light.model)
    renderer, camera = mujoco.Renderer(shipped, SIZE, SIZE), Camera(light.model, viewpoint, SIZE)
    eye = free_camera(viewpoint)

    def default() -> np.ndarray:
        renderer.update_scene(full, eye)
        image: np.ndarray = renderer.render()
        return image

    rounds = [(seconds(default, 1), seconds(lambda: camera.image(ours), SHARE)) for _ in range(frames + 2)]
    renderer.close()
    camera.close()
    slow, fast = np.median(rounds[2:], axis=0)  # the first two compile shaders
    return float(slow), float(fast)


def main() -> None:
    """Measure every scene and print rates and ratios."""
    parser = argparse.ArgumentParser(description="Rates of drawing V2V.")
    parser.add_argument("--frames", type=int, default=40, help="images of the slow renderer for each scene")
    options = parser.parse_args()
    print(f"backend: {choose_backend()}, {SIZE} x {SIZE}")
    for scene, view, model in SCENES:
        slow, fast = compare(scene, view, model(SIZE), options.frames)
        rates = f"default {1 / slow:6.1f} frames/s  ours {1 / fast:6.1f} frames/s  {slow / fast:5.1f} x"
        print(f"{scene:28} {view:12} {rates}")


if __name__ == "__main__":
    main()
