"""Code in the documentation, as tests find it."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from command import ROOT

PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", ROOT / "SECURITY.md", *sorted((ROOT / "docs").rglob("*.md"))]
BLOCK = re.compile(r"^```(\w*)\n(.*?)^```$", re.DOTALL | re.MULTILINE)


class Snippet(NamedTuple):
    """A block of code and the page that it stands on."""

    page: str
    code: str

    def __str__(self) -> str:
        return self.page


def snippets(language: str) -> list[Snippet]:
    """Blocks of a language, page by page."""
    found = ((page, *block) for page in PAGES for block in BLOCK.findall(page.read_text()))
    return [Snippet(f"{page.relative_to(ROOT)}", code) for page, kind, code in found if kind == language]


def commands() -> Iterator[tuple[str, tuple[str, ...]]]:
    """Pages, and words of each command of a shell on them; ``NAME=VALUE`` before a command is left out."""
    for page, code in snippets("bash"):
        for line in code.replace("\\\n", " ").splitlines():
            words = shlex.split(line, comments=True)
            while words and re.match(r"[A-Z_]+=", words[0]):
                words = words[1:]
            if ">" in words:  # where the answer goes
                words = words[: words.index(">")]
            if words:
                yield page, tuple(words)


def cells(notebook: Path) -> Iterator[str]:
    """Code of a notebook, cell by cell."""
    import json

    for cell in json.loads(notebook.read_text())["cells"]:
        if cell["cell_type"] == "code":
            yield "".join(cell["source"])
