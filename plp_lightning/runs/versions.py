"""Versions of this project and of the packages that it stands on."""

from __future__ import annotations

import contextlib
import platform
import subprocess
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

OURS = "plp-lightning"
FOUNDATIONS = ("torch", "lightning", "torchmetrics", "numpy", "h5py")
SIMULATORS = ("mujoco", "robosuite", "metaworld", "gymnasium-robotics", "numba")  # The extra `sim`
PACKAGES = (OURS, *FOUNDATIONS, *SIMULATORS)


def versions() -> dict[str, str]:
    """Version by package, and Python's; packages that are not installed are left out."""
    found = {"python": platform.python_version()}
    for package in PACKAGES:
        with contextlib.suppress(PackageNotFoundError):
            found[package] = version(package)
    return found


@cache
def commit() -> str | None:
    """Gives the commit of the checkout that this package was imported from; None if there is none.

    It ends in ``-dirty`` if a tracked file was changed. Asked for again, it is what it was at first: what was
    imported does not change while a run goes on, but the checkout may.
    """
    try:
        # A package that is installed below somebody else's checkout is not part of that.
        _git("ls-files", "--error-unmatch", Path(__file__).name)
        return _git("describe", "--always", "--dirty", "--abbrev=40", "--exclude=*")
    except (OSError, subprocess.SubprocessError):
        return None


def _git(*words: str) -> str:
    command = ["git", "-C", str(Path(__file__).parent), *words]
    return subprocess.run(command, capture_output=True, text=True, check=True, timeout=60).stdout.strip()
