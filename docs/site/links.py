"""A link that leads out of docs/ becomes a page of the site, since no address is known where the file could be seen."""

from __future__ import annotations

import os.path
import re
from collections.abc import Callable, Iterator
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
LINK = re.compile(r"(?<=\]\()(?!\w+:)([^)\s#]+)(#[^)\s]*)?(?=\))")
"""Target and anchor of a link to a file."""
FENCE = re.compile(r"(^```.*?^```$)", re.DOTALL | re.MULTILINE)
LANGUAGES = {".py": "python", ".yaml": "yaml", ".toml": "toml"}

origins: dict[str, Path] = {}
"""Files that a page which is made shows, by the page's name."""


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add a page for each file outside of docs/ that a page leads to, and for those that these lead to."""
    origins.clear()
    waiting = [ROOT / name for name in ("CONTRIBUTING.md", "CHANGELOG.md", "SECURITY.md")]
    written = [file for file in files.documentation_pages() if file.generated_by is None]
    waiting += [place for file in written for place in _outside(_origin(file))]
    while waiting:
        place = waiting.pop()
        name = _name(place)
        if place.is_relative_to(ROOT) and place.exists() and files.get_file_from_path(name) is None:
            origins[name] = place
            files.append(File.generated(config, name, content=_shown(place)))
            waiting += _outside(place)
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Lead a page's links to where the site has what they name."""
    here = _origin(page.file)

    def led(found: re.Match[str]) -> str:
        name = _name(_place(here, found[1]))
        there = files.get_file_from_path(name)
        way = os.path.relpath(name, os.path.dirname(page.file.src_uri)) if there else found[1]
        return way + (found[2] or "")

    return _outside_of_code(markdown, lambda text: LINK.sub(led, text))


def _origin(file: File) -> Path:
    return origins.get(file.src_uri) or DOCS / file.src_uri


def _place(page: Path, target: str) -> Path:
    return Path(os.path.normpath((page if page.is_dir() else page.parent) / target))


def _outside(page: Path) -> Iterator[Path]:
    """Gives the places outside of docs/ that a page leads to."""
    if page.suffix == ".md" or page.is_dir():
        places = (_place(page, target) for target, _ in LINK.findall(FENCE.sub("", _shown(page))))
        yield from (place for place in places if not place.is_relative_to(DOCS))


def _name(place: Path) -> str:
    """Path in the site of a file or a folder."""
    if place.is_relative_to(DOCS):
        return f"{(place / 'README.md' if place.is_dir() else place).relative_to(DOCS)}"
    if place.parent == ROOT and place.suffix == ".md":
        return f"project/{place.stem.lower()}.md"
    return f"source/{os.path.relpath(place, ROOT)}" + ("/index.md" if place.is_dir() else ".md")


def _shown(place: Path) -> str:
    """A file or folder as a page: Markdown as it is, other text as code, a folder as a list."""
    title = f"# `{os.path.relpath(place, ROOT)}`\n\n"
    if place.is_dir():
        return title + "".join(f"- [`{one.name}`]({one.name})\n" for one in sorted(place.iterdir()) if one.is_file())
    text = place.read_text()
    return text if place.suffix == ".md" else f"{title}````{LANGUAGES.get(place.suffix, 'text')}\n{text}````\n"


def _outside_of_code(markdown: str, change: Callable[[str], str]) -> str:
    return "".join(part if FENCE.fullmatch(part) else change(part) for part in FENCE.split(markdown))
