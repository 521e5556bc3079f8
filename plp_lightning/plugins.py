"""Packages beside this one whose classes configurations may name: those that are installed for it, and a user's own."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from functools import cache
from importlib.metadata import entry_points

from datamodules.errors import ConfigError

GROUPS = ("plp.simulators", "plp.terms", "plp.methods")
"""Entry points under which an installed package announces modules; their classes are known by short names then."""


@cache
def plugins() -> tuple[str, ...]:
    """Import what installed packages announce, once, and give the packages' names.

    Raises:
        ConfigError: If one of them can't be imported.
    """
    points = [point for group in GROUPS for point in entry_points(group=group)]
    for point in points:
        try:
            point.load()
        except Exception as error:  # a package of others has errors of its own
            told = f"entry point {point.name!r} ({point.value}) can't be imported: {type(error).__name__}: {error}"
            raise ConfigError(f"{told}; mend the package or uninstall it") from None
    return tuple(dict.fromkeys(point.module.partition(".")[0] for point in points))


def find_in_working_folder(packages: Sequence[str]) -> None:
    """Let a user's own packages, which they allowed by name, be found in the folder that they work in."""
    if packages and os.getcwd() not in sys.path:
        sys.path.append(os.getcwd())  # last: nothing there hides an installed package
