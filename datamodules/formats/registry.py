"""Formats by name: those of this project, and those that other packages bring as entry points ``plp.formats``."""

from __future__ import annotations

import importlib
from importlib.metadata import entry_points

from datamodules.errors import ConfigError
from datamodules.formats.mapping import unknown
from datamodules.formats.source import Format

GROUP = "plp.formats"
OURS = {
    "robomimic": "datamodules.formats.robomimic:Robomimic",
    "lerobot": "datamodules.formats.lerobot:LeRobot",
    "minari": "datamodules.formats.minari:Minari",
    "d4rl": "datamodules.formats.d4rl:D4RL",
    "gymnasium": "datamodules.formats.recordings:Recordings",
}


def format_names() -> list[str]:
    """Names of all formats; nothing of other packages is imported for that."""
    return [*dict.fromkeys([*OURS, *(point.name for point in entry_points(group=GROUP))])]


def find_format(name: str) -> type[Format]:
    """Class of a format; a :class:`ConfigError` says if there is none of that name, or it is no format."""
    if name in OURS:
        module, _, kind = OURS[name].partition(":")
        found = getattr(importlib.import_module(module), kind)
    else:
        point = next(iter(entry_points(group=GROUP, name=name)), None)
        found = unknown(name, format_names(), "format") if point is None else point.load()
    if not (isinstance(found, type) and issubclass(found, Format)):
        raise ConfigError(f"entry point {name!r} of {GROUP} is {found!r}; expected a subclass of Format")
    return found
