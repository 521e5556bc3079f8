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
    """A count: a whole number of at least 1."""
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"found {text!r}; expected a whole number of at least 1")
    return int(text)
