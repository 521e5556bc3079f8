"""Choosing a backend, and a camera's pictures: right way up, and close to MuJoCo's full ones."""

from __future__ import annotations

import ctypes
import importlib
import os
import subprocess
import sys
import textwrap
from pathlib import Path

import mujoco
import numpy as np
import pytest

from datamodules.errors import UserError
from plp_lightning.envs.native import STATE
from plp_lightning.envs.rendering import backend, camera
from plp_lightning.envs.rendering.backend import choose_backend, works
from plp_lightning.envs.rendering.camera import Camera, Viewpoint
from plp_lightning.envs.tabletop.model import WINDOW_FILE, read_scene
from plp_lightning.envs.tabletop.simulator import VIEWS, View, Window

ROOT = Path(__file__).parents[2]
SCENE = """
<mujoco>
  <worldbody>
    <light pos="0 0 3"/>
    <geom type="sphere" size="0.3" pos="-0.5 0 0.5" rgba="1 0 0 1"/>
    <geom type="sphere" size="0.3" pos="0.5 0 -0.5" rgba="0 0 1 1"/>
  </worldbody>
</mujoco>
"""

drawn = pytest.mark.skipif(not (works("egl") or works("osmesa")), reason="neither EGL nor OSMesa is installed")


@pytest.mark.parametrize(
    ("working", "explicit", "chosen"),
    [
        ({"egl", "osmesa"}, None, "egl"),
        ({"osmesa"}, None, "osmesa"),
        ({"egl", "osmesa"}, "osmesa", "osmesa"),
        ({"osmesa"}, "EGL", "egl"),
        ({"egl"}, "", "egl"),
    ],
)
def test_backend(working: set[str], explicit: str | None, chosen: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(backend, "works", lambda backend: backend in working)
    monkeypatch.setenv("MUJOCO_GL", explicit or "")
    monkeypatch.delenv("LP_NUM_THREADS", raising=False)
    if explicit is None:
        monkeypatch.delenv("MUJOCO_GL")
    assert choose_backend() == chosen
    assert (os.environ["MUJOCO_GL"], os.environ["LP_NUM_THREADS"]) == (chosen, "0")


def test_without_any_backend_the_packages_are_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(backend, "works", lambda _: False)
    monkeypatch.delenv("MUJOCO_GL", raising=False)
    with pytest.raises(UserError, match=r"^images cannot be drawn: .* apt-get install libegl1 libgl1-mesa-dri$"):
        choose_backend()
    assert "MUJOCO_GL" not in os.environ


@pytest.mark.parametrize("value", ["glfw", "disable"])
def test_backends_that_draw_on_a_screen_or_not_at_all_are_refused(value: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MUJOCO_GL", value)
    with pytest.raises(UserError, match=f"MUJOCO_GL is '{value}'; expected egl or osmesa, or unset it"):
        choose_backend()


def test_a_backend_without_its_library_does_not_work(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(name: str) -> None:
        raise OSError(f"{name}: cannot open shared object file")

    monkeypatch.setattr(ctypes, "CDLL", refuse)
    assert not works.__wrapped__("egl")
    assert not works.__wrapped__("osmesa")


def test_a_context_that_cannot_be_made_is_a_users_error(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(name: str) -> None:
        raise AttributeError("'NoneType' object has no attribute 'eglQueryString'")  # what PyOpenGL says

    monkeypatch.setattr(camera, "choose_backend", lambda: "osmesa")
    monkeypatch.setattr(importlib, "import_module", refuse)
    with pytest.raises(UserError, match=r"osmesa does not work on this machine; .* apt-get install libosmesa6"):
        Camera(mujoco.MjModel.from_xml_string(SCENE), Viewpoint(90, 0, 3), 16)


@drawn
def test_pictures_are_the_right_way_up() -> None:
    model = mujoco.MjModel.from_xml_string(SCENE)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    camera = Camera(model, Viewpoint(azimuth=90.0, elevation=0.0, distance=3.0, lookat=(0.0, 0.0, 0.0)), 32)
    image = camera.image(data)
    given = np.zeros((32, 32, 3), dtype=np.uint8)
    assert camera.image(data, given) is given
    camera.close()
    np.testing.assert_array_equal(image, given)
    assert (image.shape, image.dtype) == ((32, 32, 3), np.uint8)
    # Looking along +y, x runs to the right: the red ball is above on the left, the blue one below on the right.
    quarters = image.reshape(2, 16, 2, 16, 3).astype(int).max(axis=(1, 3))
    assert quarters[0, 0].argmax() == 0
    assert quarters[1, 1].argmax() == 2
    assert quarters[0, 0, 0] > 100 > quarters[0, 1].max()
    assert quarters[1, 1, 2] > 100 > quarters[1, 0].max()


def full_data(window: Window, episode: int, shipped: mujoco.MjModel) -> mujoco.MjData:
    """The shipped scene in the state of an episode that was just reset."""
    scene, data = window._physics.scene, mujoco.MjData(shipped)
    ours = mujoco.MjData(scene.model)
    mujoco.mj_setState(scene.model, ours, window._physics.states[episode], STATE)
    shipped.body("window").pos = ours.mocap_pos[scene.furniture[0]]
    data.qpos = ours.qpos
    mujoco.mj_forward(shipped, data)
    return data


@drawn
@pytest.mark.parametrize("view", ["front_left", "front_right", "front", "rear"])
def test_pictures_with_fewer_triangles_look_alike(view: View) -> None:
    window, shipped = Window(view, threads=1), read_scene(WINDOW_FILE).compile()
    images = window.reset(["open", "close_x0y1", "close_x1y0"], [0, 1, 2]).images["image"]
    assert images is not None
    shipped.site_group[:] = 5
    camera = Camera(shipped, Viewpoint(*VIEWS[view]), 64)
    for episode, light in enumerate(images.astype(int)):
        full = camera.image(full_data(window, episode, shipped)).astype(int)
        assert np.abs(full - light).mean() < 4
        assert np.corrcoef(full.ravel(), light.ravel())[0, 1] > 0.94  # edges are not smoothed
    camera.close()


@drawn
def test_pictures_are_close_to_the_default_renderers() -> None:
    """MuJoCo's own renderer, shadows, reflections and all; it has to be asked in a fresh process."""
    script = """
        from plp_lightning.envs.rendering.backend import choose_backend
        choose_backend()
        import mujoco
        import numpy as np
        from test_rendering import WINDOW_FILE, Viewpoint, Window, VIEWS, full_data, read_scene
        from plp_lightning.envs.rendering.camera import free_camera

        window, shipped = Window("front", threads=1), read_scene(WINDOW_FILE).compile()
        light = window.reset(["open"], [0]).images["image"][0].astype(int)
        shipped.site_group[:] = 5
        renderer = mujoco.Renderer(shipped, 64, 64)
        renderer.update_scene(full_data(window, 0, shipped), free_camera(Viewpoint(*VIEWS["front"])))
        full = renderer.render().astype(int)
        print(np.abs(full - light).mean(), np.corrcoef(full.ravel(), light.ravel())[0, 1])
        renderer.close()
        """
    paths = f"import sys; sys.path[:0] = {[str(ROOT), str(Path(__file__).parent)]!r}\n"
    call = [sys.executable, "-c", paths + textwrap.dedent(script)]
    done = subprocess.run(call, capture_output=True, text=True, check=True)
    difference, correlation = map(float, done.stdout.split())
    assert difference < 20  # mostly the light that shadows take and mirrors give
    assert correlation > 0.94
