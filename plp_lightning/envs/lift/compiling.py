"""MuJoCo's models out of XML, as bytes; a program of its own, for MuJoCo keeps all meshes that it has compiled."""

from __future__ import annotations

import sys

import mujoco
import numpy as np


def binary(model: mujoco.MjModel) -> np.ndarray:
    """A compiled model as bytes ``(n,)``, which only the same version of MuJoCo reads."""
    content = np.empty(mujoco.mj_sizeModel(model), np.uint8)
    mujoco.mj_saveModel(model, None, content)
    return content


def compiled(xml: str) -> bytes:
    """The model of a file of MuJoCo's, as bytes."""
    return binary(mujoco.MjModel.from_xml_string(xml)).tobytes()


if __name__ == "__main__":
    sys.stdout.buffer.write(compiled(sys.stdin.buffer.read().decode()))
