"""What ran: versions of this project and of what it stands on."""

from __future__ import annotations

import platform
from importlib.metadata import PackageNotFoundError, version

PACKAGES = (
    "plp-lightning",
    "torch",
    "lightning",
    "torchmetrics",
    "numpy",
    "h5py",
    "mujoco",
    "robosuite",
    "metaworld",
    "gymnasium-robotics",
)


def versions() -> dict[str, str]:
    """Version by package, and Python's; packages that are not installed are left out."""
    found = {"python": platform.python_version()}
    for package in PACKAGES:
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            continue
    return found
