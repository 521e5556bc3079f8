"""The HTML of a report is one file that works without a network, and is whole."""

from __future__ import annotations

import base64
import html as entities
import io
import json
import re
import subprocess
from html.parser import HTMLParser
from pathlib import Path

import pytest
from browser import CHROMIUM, QUIET, needs_chromium
from command import ROOT, plp
from PIL import Image
from samples import NASTY, add_run

LOOK = """<script>onload = () => {
  const broken = [...document.images].filter(image => !image.complete || image.naturalWidth === 0).length;
  const wide = document.documentElement.scrollWidth > document.documentElement.clientWidth;
  const names = performance.getEntriesByType("resource").map(entry => entry.name);
  const asked = names.filter(name => !name.startsWith("data:"));
  document.title = JSON.stringify({images: document.images.length, broken, wide, asked});
};</script></body>"""
BLOCKING = re.compile(r'<meta http-equiv="Content-Security-Policy"[^>]*>')


class Page(HTMLParser):
    """All that a page refers to."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags, self.sources, self.links, self.names = set[str](), list[str](), list[str](), list[str]()
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        known = dict(attrs)
        self.tags.add(tag)
        self.sources += [known[name] for name in ("src", "srcset", "data", "poster", "background") if name in known]
        if tag == "link":
            self.sources.append(known["href"])
        elif "href" in known:
            self.links.append(known["href"])
        if "id" in known:
            self.names.append(known["id"])


@pytest.fixture(scope="module")
def pages(tmp_path_factory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("pages")
    for seed in (0, 1):
        add_run(folder / "runs", ("latents", "paths", "own"), seed=seed)
        add_run(folder / "runs", ("latents",), method="plp_t", seed=seed)
    add_run(folder / "runs", ("film",), experiment="mine", method="plp_goals_5", target_task=NASTY)
    add_run(folder / "runs", experiment="mine", method="plp_goals_10", target_task=NASTY)
    found = {}
    for name, runs in {"kept": ROOT / "docs" / "results", "runs": folder / "runs"}.items():
        answer = plp("report", runs, "--out", folder / name)
        assert answer.code == 0, answer
        assert answer.err == ""
        found[name] = folder / name / "report.html"
    return found


@pytest.mark.parametrize("name", ["kept", "runs"])
def test_a_page_has_all_that_it_shows_and_every_link_leads_somewhere(pages, name) -> None:
    text = pages[name].read_text()
    page = Page(text)
    assert not page.tags & {"script", "iframe", "object", "embed", "base", "form", "audio", "video"}
    assert page.sources
    assert all(source.startswith("data:") for source in page.sources)
    assert not re.search(r"url\(|@import", text)
    assert len(page.names) == len({*page.names})
    assert all(link.startswith("#") for link in page.links)
    assert {link[1:] for link in page.links} <= {*page.names}
    assert sum(link.startswith("#runs-") for link in page.links) > 20
    for source in page.sources:
        if source.startswith("data:image/png;base64,"):
            Image.open(io.BytesIO(base64.b64decode(source.partition(",")[2]))).load()


def test_figures_of_runs_are_there_and_others_are_told_as_not_run(pages) -> None:
    text = pages["runs"].read_text()
    figures = re.findall(r"<h3>(.*?)</h3>\s*(<p class=\"missing\">)?", text)
    shown = {entities.unescape(title) for title, missing in figures if not missing}
    assert shown == {"Success", "Alignment: Top-1 accuracy", "Alignment: Top-5 accuracy", "Number of proxy goals"} | {
        *("Over epochs", "Latent states", "Trajectories", "Films", "own"),
    }
    assert {title for title, missing in figures if missing} >= {
        "Weight of MMD",
        "Alignment: Closeness",
        "Nearest states",
    }
    assert "alignment.optimizer.lr = 0.001" in text
    for told in ("badc0de", "c0ffee", "p2p_medium-plp_t/1/results.json"):
        assert told in text


def test_names_that_are_markup_are_shown_as_they_are(pages) -> None:
    text = pages["runs"].read_text()
    assert "<script>" not in text
    assert NASTY in entities.unescape(text)


def browsed(page: str, width: int, folder: Path) -> dict[str, object]:
    """What a browser found in a page whose scripts may run."""
    copy = folder / "page.html"
    copy.write_text(BLOCKING.sub("", page).replace("</body>", LOOK))
    options = [*QUIET, f"--window-size={width},900", "--dump-dom", f"--user-data-dir={folder / 'profile'}"]
    done = subprocess.run([str(CHROMIUM), *options, copy.as_uri()], capture_output=True, text=True, timeout=120)
    found: dict[str, object] = json.loads(entities.unescape(re.findall(r"<title>(.*?)</title>", done.stdout)[0]))
    return found


@needs_chromium
@pytest.mark.parametrize(("name", "width"), [("kept", 1280), ("runs", 1280), ("runs", 400)])
def test_a_browser_shows_every_image_asks_for_nothing_and_only_tables_scroll(pages, name, width, tmp_path) -> None:
    found = browsed(pages[name].read_text(), width, tmp_path)
    assert found == {"images": found["images"], "broken": 0, "wide": False, "asked": []}
    assert int(str(found["images"])) >= 4


@needs_chromium
def test_a_page_that_is_not_whole_would_be_found(tmp_path) -> None:
    wrong = '<img src="http://localhost:9/x.png"><div style="width: 3000px">x</div>'
    page = f"<!DOCTYPE html><html><head><title>x</title></head><body>{wrong}</body></html>"
    assert browsed(page, 800, tmp_path) == {
        **{"images": 1, "broken": 1, "wide": True},
        "asked": ["http://localhost:9/x.png"],
    }
