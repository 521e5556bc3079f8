"""The site is refused where it would mislead, and takes in pages by itself. script/docs builds the real one."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from types import ModuleType

import pytest
from command import ROOT

pytest.importorskip("mkdocs", reason="needs the extra docs")

from mkdocs.commands.build import build
from mkdocs.config import load_config
from mkdocs.exceptions import Abort, BuildError

HOOKS = ROOT / "docs" / "site"
WRONG = {
    "a page": "[there](nowhere.md)",
    "an anchor": "[there](#nowhere)",
    "a picture": "![there](nowhere.png)",
    "a page without a place": "",
    "another host": '<img src="https://elsewhere.example/picture.png">',
}


def hook(name: str) -> ModuleType:
    """A file of docs/site, as mkdocs loads it."""
    spec = importlib.util.spec_from_file_location(name, HOOKS / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def build_site(folder: Path, text: str, more: str | None = None) -> Path:
    """Build a site of one page, or two, by the project's own settings."""
    (folder / "docs").mkdir()
    (folder / "docs" / "index.md").write_text(f"# Page\n\n{text}\n")
    if more is not None:
        (folder / "docs" / "more.md").write_text(more)
    own = {"docs_dir": f"{folder / 'docs'}", "site_dir": f"{folder / 'out'}", "nav": ["index.md"], "plugins": []}
    config = load_config(f"{ROOT / 'mkdocs.yml'}", hooks=[f"{HOOKS / 'alone.py'}"], strict=True, **own)
    build(config)
    return folder / "out" / "index.html"


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_a_sound_page_is_built(tmp_path: Path) -> None:
    assert "there" in build_site(tmp_path, "[there](#page)").read_text()


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
@pytest.mark.parametrize("text", WRONG.values(), ids=WRONG)
def test_a_site_that_would_mislead_is_refused(text: str, tmp_path: Path) -> None:
    with pytest.raises((Abort, BuildError)):
        build_site(tmp_path, text, more=None if text else "# Lost\n")


def test_a_new_page_comes_into_the_navigation_once(tmp_path: Path) -> None:
    for name in ("one.md", "two.md", "parts/three.md"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text("# Page\n")
    navigation = hook("navigation")
    nav = [{"First": "two.md"}, {"Parts": ["parts/*.md"]}, {"More": ["*.md"]}]
    filled = navigation._filled(nav, tmp_path, {*navigation._entries(nav)})
    assert filled == [{"First": "two.md"}, {"Parts": ["parts/three.md"]}, {"More": ["one.md"]}]


@pytest.mark.parametrize(
    ("page", "target", "name"),
    [
        ("docs/report.md", "studies.md", "studies.md"),
        ("docs/methods/plp.md", "../../CONTRIBUTING.md", "project/contributing.md"),
        ("CONTRIBUTING.md", "docs/examples/", "examples/README.md"),
        ("docs/recipes.md", "../configs/recipes", "source/configs/recipes/index.md"),
        ("docs/examples/README.md", "../../plp_lightning/envs/views.py", "source/plp_lightning/envs/views.py.md"),
    ],
)
def test_a_link_out_of_the_documentation_has_a_page(page: str, target: str, name: str) -> None:
    links = hook("links")
    assert links._name(links._place(ROOT / page, target)) == name


def test_pictures_are_small() -> None:
    sizes = [path.stat().st_size for path in (ROOT / "docs" / "pictures").glob("*.png")]
    assert max(sizes) < 150_000
    assert sum(sizes) < 1_500_000
