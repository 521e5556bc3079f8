"""The speed at which V2V is drawn, beside ``mujoco.Renderer`` at its defaults on the shipped scene; one thread."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator

from plp_lightning.envs.rendering.backend import choose_backend

choose_backend()  # mujoco.Renderer asks for it when MuJoCo is imported

import mujoco  # noqa: E402

from benchmarks.measuring import Options, Row, at_least, in_turn, ratio, timed  # noqa: E402
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
OURS, DEFAULT = "ours", "mujoco.Renderer"
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


def compared(scene: str, view: View, light: TabletopModel, rounds: int) -> dict[str, list[float]]:
    """Seconds of the processor for an image of ours and of the default renderer, of the same things."""
    shipped = read_scene(scene).compile()
    viewpoint, full, ours = Viewpoint(*VIEWS[view]), at_rest(shipped), at_rest(light.model)
    renderer, camera = mujoco.Renderer(shipped, SIZE, SIZE), Camera(light.model, viewpoint, SIZE)
    eye = free_camera(viewpoint)

    def default() -> None:
        renderer.update_scene(full, eye)
        renderer.render()

    ways = {
        OURS: timed(lambda: camera.image(ours), SHARE, time.process_time),
        DEFAULT: timed(default, clock=time.process_time),
    }
    times = in_turn(ways, rounds, warm=2)  # the first two compile shaders
    renderer.close()
    camera.close()
    return times


def rows(options: Options) -> Iterator[Row]:
    for scene, view, model in SCENES[: options.pick(len(SCENES), 1)]:
        times = compared(scene, view, model(SIZE), options.pick(40, 3))
        name = f"{scene.removesuffix('.xml')}, {view}, {SIZE} × {SIZE}: {DEFAULT} / {OURS}"
        yield ratio(name, times, DEFAULT, OURS, at_least(40.0))
