"""Options of the verbs that need no configuration file, with mistakes told in one line."""

from __future__ import annotations

import argparse
from typing import NoReturn

from datamodules.errors import ConfigError


class OptionParser(argparse.ArgumentParser):
    """Raises where argparse would print its usage and leave."""

    def error(self, message: str) -> NoReturn:
        raise ConfigError(f"{message}; see {self.prog} --help")


def positive(text: str) -> int:
    """A count: a whole number of at least 1, up to a thousand million."""
    return _number(text, 1, 1_000_000_000, "at least 1")


def seed(text: str) -> int:
    """A seed: a whole number that 32 bits hold."""
    return _number(text, 0, (1 << 32) - 1, f"from 0 to {(1 << 32) - 1}")


def _number(text: str, least: int, most: int, told: str) -> int:
    if not text.isdecimal() or len(text) > len(str(most)) or not least <= int(text) <= most:
        raise argparse.ArgumentTypeError(f"found {text!r}; expected a whole number {'of ' * (least == 1)}{told}")
    return int(text)
