"""TensorBoard's pages as a browser shows them: what people look for is there, for every run and phase."""

from __future__ import annotations

import re
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from browser import Browser, needs_chromium
from command import plp, tiny_smoke

RUNS = [f"smoke/plp/goal_3/seed_{seed}" for seed in (0, 1)]
PHASES = ("alignment", "adaptation")
LINES = """(() => {
  const all = node => [...node.querySelectorAll("*")].flatMap(n => [n, ...(n.shadowRoot ? all(n.shadowRoot) : [])]);
  const lines = all(all(document).find(n => n.localName === "vz-line-chart2").shadowRoot);
  return lines.filter(n => n.matches("path.line") && (n.getAttribute("d") || "").includes("L")).length;
})()"""
"""Lines of two points or more in the first chart of a page."""

pytestmark = needs_chromium


@pytest.fixture(scope="module")
def address(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """Two runs, as TensorBoard serves them."""
    root = tmp_path_factory.mktemp("served")
    often = ["--evaluation.every_n_epochs", "{alignment: 1, adaptation: 1}", "--evaluation.latent_states", "20"]
    for seed in (0, 1):
        assert plp("fit", *tiny_smoke(root), *often, "--seed", seed).code == 0
    words = ["-m", "tensorboard.main", "--logdir", str(root), "--host", "127.0.0.1", "--port", "0", "--load_fast=false"]
    with (root / "told").open("w") as told:
        server = subprocess.Popen([sys.executable, *words], stdout=told, stderr=told)
    try:
        yield _served(root / "told", server)
    finally:
        server.kill()
        server.wait()


def _served(told: Path, server: subprocess.Popen[bytes]) -> str:
    until = time.monotonic() + 60
    while not (found := re.search(r"http://127\.0\.0\.1:\d+/", told.read_text())):
        assert server.poll() is None, told.read_text()
        assert time.monotonic() < until, told.read_text()
        time.sleep(0.1)
    return found[0]


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    with Browser(tmp_path_factory.mktemp("profile")) as found:
        yield found


def test_the_first_chart_is_success_in_both_domains_over_both_phases(address: str, browser: Browser) -> None:
    curves = [f"success/{trial} ({run}/{phase})" for trial in ("target", "source") for run in RUNS for phase in PHASES]
    text = browser.wait(f"{address}#custom_scalars", lambda text: all(curve in text for curve in curves))
    assert re.search(r"run 4 success [\d. -]*Matches \(8\) .* alignment .* held-out loss .* loss [\d. -]*Matches", text)
    until = time.monotonic() + 60
    while browser.value(LINES) != 2 * len(curves):  # each as it is and smoothed
        assert time.monotonic() < until
        time.sleep(0.1)


def test_curves_and_pictures_are_in_their_groups(address: str, browser: Browser) -> None:
    shown = (
        r"adaptation 4 cards .* alignment 5 cards .* behaviour 4 cards epoch final 5 cards latents loss 6 cards speed "
    )
    browser.wait(f"{address}#timeseries", lambda text: re.search(f"{shown}success 4 cards ", text))


def test_each_run_has_one_row_that_begins_with_its_names_and_its_success(address: str, browser: Browser) -> None:
    ids = [f"{run}/adaptation smoke plp {seed}" for seed, run in enumerate(RUNS)]
    text = browser.wait(f"{address}#hparams", lambda text: all(found in text for found in ids))
    assert "Number of matching session groups: 2 " in text
    assert re.search(r"Show Metrics experiment method seed target_task \S+ final/target_success ", text)


def test_pictures_stand_below_the_name_of_their_phase(address: str, browser: Browser) -> None:
    browser.wait(f"{address}#images", lambda text: all(f"{phase}/latents" in text for phase in PHASES))


def test_the_result_table_is_a_text_of_each_run(address: str, browser: Browser) -> None:
    row = r"target task in target domain \d\.\d\d \d\.\d\d – \d\.\d\d 4 "
    browser.wait(f"{address}#text", lambda text: len(re.findall(row, text)) == len(RUNS))
