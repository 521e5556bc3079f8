"""``plp list``: what there is to choose from, a line each."""

from __future__ import annotations

import inspect
import itertools
import re
from collections.abc import Iterator, Sequence
from pathlib import Path

from datamodules.words import visible
from plp_lightning.cli.classes import known_classes
from plp_lightning.cli.config import BASE, PAGES, parse, trusted
from plp_lightning.cli.options import OptionParser
from plp_lightning.envs.base import Expert, Simulator
from plp_lightning.evaluation.behaviour import BehaviourMetric
from plp_lightning.evaluation.scores import AlignmentScore
from plp_lightning.methods.plp.terms import AlignmentTerm

Lines = Iterator[tuple[str, str]]
"""A name and what is to be said of it."""
FOLDERS = {"experiments": "", "methods": "methods", "recipes": "recipes", "studies": "studies", "sweeps": "sweeps"}
CLASSES = {
    "simulators": Simulator,
    "experts": Expert,
    "terms": AlignmentTerm,
    "scores": AlignmentScore,
    "metrics": BehaviourMetric,
}
SENTENCE_END = re.compile(r"(?<=\.)\s+(?=[A-Z])")
ROLE = re.compile(r":\w+:`[\w.~]*?(\w+)`")
KINDS = {
    "experiments": "pages, for --config NAME",
    "methods": "overlays, for --config methods/NAME behind a page",
    "recipes": "overlays over page and method, for --config recipes/NAME",
    "studies": "pages and overlays that ask one question, for --config studies/NAME",
    "sweeps": "pages of many runs, for plp sweep --config sweeps/NAME",
    "simulators": "classes for domains.*.simulator",
    "experts": "classes for domains.*.expert",
    "terms": "classes for alignment.terms.*",
    "scores": "classes for score",
    "metrics": "classes for evaluation.metrics",
    "tasks": "tasks of an experiment: plp list tasks r2r",
}


def run_list(arguments: Sequence[str]) -> None:
    """``plp list``: the kinds; ``plp list KIND``: pages, classes, or the tasks of an experiment."""
    parser = OptionParser("plp list", description="What there is to choose from, a line each.")
    parser.add_argument("kind", choices=KINDS, nargs="?", help="what to list")
    parser.add_argument("experiment", nargs="?", default="smoke", help="whose tasks; a page's file or short name")
    parser.add_argument("--allow_imports", action="append", default=[], help="package of yours that the page uses")
    options = parser.parse_args(list(arguments))
    found = [*_lines(options.kind, options.experiment, options.allow_imports)]
    width = max(len(name) for name, _ in found)
    for name, told in found:
        print(visible(f"{name:{width}}  {told}".rstrip()))


def _lines(kind: str | None, experiment: str, allowed: Sequence[str]) -> Lines:
    if kind is None:
        return iter((f"plp list {name}", told) for name, told in KINDS.items())
    if kind in FOLDERS:
        return _pages(PAGES / FOLDERS[kind])
    return _classes(CLASSES[kind]) if kind in CLASSES else _tasks(experiment, allowed)


def _pages(folder: Path) -> Lines:
    for page in sorted(folder.glob("*.yaml")):
        if page != BASE:
            yield page.stem, first_comment(page)


def first_comment(page: Path) -> str:
    """The first sentence of the comment that a page begins with."""
    lines = page.read_text().splitlines()
    comment = " ".join(line.lstrip("# ") for line in itertools.takewhile(lambda line: line.startswith("#"), lines))
    return _first_sentence(comment)


def _first_sentence(text: str) -> str:
    """Without what Sphinx makes of names in it."""
    return SENTENCE_END.split(ROLE.sub(r"\1", text))[0]


def _classes(root: type) -> Lines:
    concrete = (kind for kind in known_classes([root]) if kind is not root and not inspect.isabstract(kind))
    for kind in sorted({*concrete}, key=lambda kind: kind.__name__):
        yield kind.__name__, _first_sentence((inspect.getdoc(kind) or "").split("\n")[0])


def _tasks(experiment: str, allowed: Sequence[str]) -> Lines:
    """Targets that an experiment may have, with the tasks that each is made of."""
    made = parse(["--config", experiment, *trusted(allowed)])
    simulators = [*made.simulators.values()]
    if not simulators:
        yield from ((task, "") for task in made.data.tasks)
        return
    tasks = simulators[0].tasks
    for name in tasks.targets or tasks.names:
        parts = f"{len(tasks.of(name))} tasks: {', '.join(tasks.of(name))}" if tasks.targets else ""
        yield name, f"{parts}{'; ' * bool(parts)}the page's target" if name == made.data.target_task else parts
