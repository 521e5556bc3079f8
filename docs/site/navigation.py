"""The navigation takes in new pages by itself: an entry such as ``methods/*.md`` is all that no other entry names."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from mkdocs.config.defaults import MkDocsConfig


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Put pages in the place of patterns."""
    named = {*_entries(config.nav)}
    config.nav = _filled(config.nav, Path(config.docs_dir), named)
    return config


def _entries(nav: Any) -> Iterator[str]:
    for entry in nav.values() if isinstance(nav, dict) else nav:
        yield from [entry] if isinstance(entry, str) else _entries(entry)


def _filled(nav: Any, docs: Path, named: set[str]) -> Any:
    if isinstance(nav, dict):
        return {title: _filled(entry, docs, named) for title, entry in nav.items()}
    if not isinstance(nav, list):
        return nav
    filled: list[Any] = []
    for entry in nav:
        if isinstance(entry, str) and "*" in entry:
            pages = sorted(f"{path.relative_to(docs)}" for path in docs.glob(entry))
            filled += [page for page in pages if page not in named]
        else:
            filled.append(_filled(entry, docs, named))
    return filled
