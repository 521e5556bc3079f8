"""MuJoCo's models out of XML, as bytes; a program of its own, for MuJoCo keeps all meshes that it has compiled."""

from __future__ import annotations

import sys
import xml.etree.ElementTree as ET
from typing import Any

import mujoco
import numpy as np

ARENA = "16M"  # room for contacts in each thread; an episode needs less than a tenth of it


def own_xml(env: Any) -> str:
    """The file of an environment of robosuite, with room for the contacts that there are."""
    root = ET.fromstring(env.edit_model_xml(env.model.get_xml()))
    for size in root.findall("size"):  # robosuite asks for room for thousands of contacts: a gigabyte in each thread
        root.remove(size)
    ET.SubElement(root, "size", memory=ARENA)
    return ET.tostring(root, encoding="unicode")


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
