"""Text of others on the screen: as it is, and nothing but text."""

from __future__ import annotations

from rich.markup import escape

from datamodules.words import visible


def shown(text: object) -> str:
    """Text for rich's consoles and tables: brackets are no markup, and control characters steer no terminal."""
    return escape(visible(str(text)))
