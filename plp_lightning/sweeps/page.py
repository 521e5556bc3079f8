"""The page of a sweep: experiments × methods × target tasks × seeds × overrides."""

# No annotations from __future__ here: the parser evaluates none in the constructors that dataclasses generate.
import difflib
import json
from collections import Counter
from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple, TypeVar

from datamodules.errors import ConfigError
from datamodules.settings import Seed

T = TypeVar("T", bound=Hashable)
OWN = {
    "seed": "seeds of the sweep's page",
    "data.target_task": "targets of the sweep's page",
    "run_root": "root of the sweep's page",
    "method": "the override's name",
    "sweep": "the name of the sweep's page",
    **dict.fromkeys(("phase", "from"), "what runs have in common"),
    **dict.fromkeys(("resume", "print_config"), "plp fit alone"),
}
"""Settings that a sweep gives to its runs, and what they come from."""


@dataclass(frozen=True, kw_only=True)
class SweepPage:
    """Runs of a sweep: every experiment with every method, target task, seed and override.

    ``methods``, ``targets`` and ``seeds`` are lists for all experiments, or lists by experiment; an experiment without
    a list of its own has the default.

    Args:
        experiments: Pages by short name or path; a list of pages is laid over one another, and known by the last.
        methods: Overlays by short name or path; plp if not given.
        targets: Target tasks; the experiment's own if not given.
        seeds: Seeds; 0 if not given.
        overrides: Settings by name and dotted key, laid over page and overlay; ``config`` names pages of settings. The
            name follows the method's in the run directory; without settings it does not.
        root: Folder of the run directories; runs if not given.
    """

    experiments: list[str | list[str]]
    methods: list[str] | dict[str, list[str]] = field(default_factory=lambda: ["plp"])
    targets: list[str] | dict[str, list[str]] | None = None
    seeds: list[Seed] | dict[str, list[Seed]] = field(default_factory=lambda: [0])
    overrides: dict[str, dict[str, Any] | None] = field(default_factory=lambda: {"none": None})
    root: str = "runs"


class Variant(NamedTuple):
    """One experiment, method and override; its runs differ in target task and seed alone."""

    experiment: str  # as the page knows it
    words: list[str]  # of plp fit
    targets: list[str]  # the experiment's own if empty
    seeds: list[int]


def variants(page: SweepPage, find: Callable[[str, str], tuple[str, str]], flags: Sequence[str]) -> Iterator[Variant]:
    """All variants of a page, in its order.

    Args:
        page: The page.
        find: Gives for ``experiments`` or ``methods`` and a page's name the word for ``--config``, and the name of the
            method that the page sets up.
        flags: Further words of every run.

    Raises:
        ConfigError: If a list is empty, names something twice, or names what is not there.
    """
    if not all(page.experiments):
        raise ConfigError("experiments holds an empty list; expected pages that are laid over one another: name some")
    labels = {pages if isinstance(pages, str) else pages[-1]: pages for pages in page.experiments}
    _check_list("experiments", [pages if isinstance(pages, str) else "+".join(pages) for pages in page.experiments])
    _check_list("overrides", list(page.overrides))
    for label, pages in labels.items():
        below = [find("experiments", name)[0] for name in ([pages] if isinstance(pages, str) else pages)]
        seeds = _of(page.seeds, label, labels, [0], "seeds")
        targets = _of(page.targets, label, labels, [], "targets") if page.targets is not None else []
        for overlay in _of(page.methods, label, labels, ["plp"], "methods"):
            word, method = find("methods", overlay)
            for name, settings in page.overrides.items():
                words = [*_configs([*below, word]), *flags, *_override(name, settings or {}, method)]
                yield Variant(label, words, targets, seeds)


def _of(
    lists: Sequence[T] | Mapping[str, list[T]], label: str, labels: Mapping[str, Any], default: list[T], key: str
) -> list[T]:
    """The list of one experiment."""
    if isinstance(lists, Mapping):
        if unknown := [name for name in lists if name not in labels]:
            near = difflib.get_close_matches(unknown[0], labels, n=1, cutoff=0.0)[0]
            told = f"{key} names experiment {unknown[0]!r}, which experiments lacks"
            raise ConfigError(f"{told}; did you mean {near!r}?")
        if label not in lists:
            return default
        found, place = lists[label], f"{key}.{label}"
    else:
        found, place = list(lists), key
    _check_list(place, found)
    return found


def _check_list(place: str, found: Sequence[Hashable]) -> None:
    if not found:
        raise ConfigError(f"{place} is empty; expected at least one: name some or leave it away")
    if len({*found}) < len(found):
        twice = Counter(found).most_common(1)[0][0]
        raise ConfigError(f"{place} names {twice!r} twice; expected each once: leave one away")


def _override(name: str, settings: Mapping[str, Any], method: str) -> list[str]:
    if not settings:
        return []
    for key in settings:
        if key in OWN:
            raise ConfigError(f"overrides.{name} sets {key}, which comes from {OWN[key]}; leave it away")
    given = settings.get("config", [])
    pages = [given] if isinstance(given, str) else given
    if not isinstance(pages, list) or not all(isinstance(item, str) for item in pages):
        raise ConfigError(f"overrides.{name}.config is {given!r}; expected a page or a list of pages: mend it")
    words = _configs(pages)
    words += [f"--{key}={_word(value)}" for key, value in settings.items() if key != "config"]
    return [*words, f"--method={method}_{name}"]


def _configs(pages: Sequence[str]) -> list[str]:
    return [word for page in pages for word in ("--config", page)]


def _word(value: object) -> str:
    return value if isinstance(value, str) else json.dumps(value)
