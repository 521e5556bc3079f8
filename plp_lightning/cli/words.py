"""Words of the command line as they are meant, before any verb reads them."""

from __future__ import annotations

from collections.abc import Sequence

from datamodules.errors import ConfigError
from datamodules.words import CONTROL, expand_home


def read_words(words: Sequence[str]) -> list[str]:
    """Expand ``~/`` in words and in values of ``--option=value``; a ConfigError says if one can't be written down."""
    for word in words:
        if CONTROL.search(word):
            raise ConfigError(f"{word!r} holds a control character; expected letters that can be read: leave it away")
    return [_expanded(word) for word in words]


def _expanded(word: str) -> str:
    option, joint, value = word.partition("=")
    return option + joint + expand_home(value) if word.startswith("--") else expand_home(word)
