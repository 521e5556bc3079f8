"""Words from outside: what may stand in them, what they mean, and how they are shown."""

from __future__ import annotations

import os
import re

CONTROL = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\ud800-\udfff]")
"""Characters that steer a terminal or can't be written down; line ends and tabs are none of them."""
LONGEST = 200  # Letters of a word that are shown


def visible(text: str) -> str:
    """A text with a mark in place of every control character: escape codes of a file must not steer a terminal."""
    return CONTROL.sub("\ufffd", text)


def one_line(text: str) -> str:
    r"""A text on one line that a terminal can show, very long words shortened.

    Example:
        >>> one_line("found\n  two  lines")
        'found two lines'
    """
    words = visible(text).split()
    return " ".join(word if len(word) <= LONGEST else f"{word[: LONGEST // 2]}…{word[-20:]}" for word in words)


def expand_home(text: str) -> str:
    """A path that begins with ``~/`` or ``~name/`` below that home folder; any other text as it is."""
    return os.path.expanduser(text) if re.match(r"~[^/\s]*/", text) else text
