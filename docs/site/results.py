"""Pages of experiments end with every result that is kept of them, beside the paper's value."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import yaml
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.pages import Page

ROOT = Path(__file__).parents[2]
PAPER = ROOT / "plp_lightning" / "report" / "paper.yaml"
HEAD = """

## Measured

Success of the target task in the target domain; the paper's values are of nine runs.
[Reports](../report.md#numbers) says how to read them.

| method | target task | seed | success | 95 % interval | the paper |
| --- | --- | --- | --- | --- | --- |
"""
OTHERWISE = """
‡ with [other settings than meant](../results/README.md#measured-with-other-settings-than-meant), to be measured again.
"""
MISTAKEN = ("gama", "gama_state", "cdil", "contextual")


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: object) -> str:
    """Append the table to an experiment's page."""
    folder = ROOT / "docs" / "results" / Path(page.file.src_uri).stem
    if not page.file.src_uri.startswith("experiments/") or not folder.is_dir():
        return markdown
    found = [json.loads(path.read_text()) for path in sorted(folder.glob("*/*.json"))]
    runs = [run for run in found if run.get("target")]
    paper = yaml.safe_load(PAPER.read_text())["values"].get(folder.name, {})
    rows = "".join(_row(run, paper) for run in runs)
    return markdown + HEAD + rows + (OTHERWISE if any(run["method"] in MISTAKEN for run in runs) else "")


def _row(run: dict[str, Any], paper: dict[str, list[float]]) -> str:
    method, target = run["method"], run["target"]
    theirs = "{:.2f} ± {:.2f}".format(*paper[method]) if method in paper else "–"
    mark = " ‡" if method in MISTAKEN else ""
    low, high = target["interval"]
    told = f"| {target['success']:.2f}{mark} | {low:.2f} – {high:.2f} | {theirs} |\n"
    return f"| `{method}` | `{run['target_task']}` | {run['seed']} {told}"
