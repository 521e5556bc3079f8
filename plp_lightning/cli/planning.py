"""A sweep's page → its runs, as the parser of ``plp fit`` understands them; nothing is simulated and no data read."""

from __future__ import annotations

import difflib
import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

from jsonargparse import ArgumentParser

from datamodules.amounts import DataSettings
from datamodules.errors import ConfigError
from datamodules.plain_yaml import dump_yaml, parse_yaml
from datamodules.transfer import TransferDataModule
from plp_lightning.cli.config import BASE, PAGES, find_page, parsed, read
from plp_lightning.cli.explanation import NEAR
from plp_lightning.cli.keeping import first_change
from plp_lightning.cli.yaml_files import read_yaml
from plp_lightning.runs.directory import RunDirectory
from plp_lightning.runs.experiment import Experiment
from plp_lightning.runs.rehearsal import check_method
from plp_lightning.runs.roles import find_roles
from plp_lightning.runs.settings import config_hash, with_defaults, without_places
from plp_lightning.sweeps.page import OWN, SweepPage, Variant, variants
from plp_lightning.sweeps.sharing import PlannedRun

LATER = (
    *("experiment", "method", "run_root", "data.root", "data.file", "data.image_memory", "data.target_task"),
    *("data.proxy_tasks", "data.proxy_goals", "data.target_trajectories", "data.mix_ratio", "collection.processes"),
)
"""Keys that say nothing of what a phase before the last learns; file and proxy tasks stand for some of them."""


def read_page(path: Path, root: str | None = None) -> list[SweepPage]:
    """Read the page of a sweep, and lay each of its ``parts`` over what it says beside them.

    Args:
        path: The page.
        root: Folder of the run directories, in place of the page's.

    Raises:
        ConfigError: If something is wrong with it.
    """
    tree = read_yaml(path)
    _check_keys(path, tree)
    parts = tree.pop("parts", [{}])
    if not isinstance(parts, list) or not parts or not all(isinstance(part, dict) for part in parts):
        raise ConfigError(f"{path}: parts is {parts!r}; expected a list, each with keys and values: mend it")
    for part in parts:
        _check_keys(path, {f"parts.{key}" if key == "parts" else key: part[key] for key in part})
    if inner := next((part for part in parts if "root" in part), None):
        raise ConfigError(f"{path}: a part sets root ({inner['root']!r}); expected one for all: set it beside parts")
    whole = {} if root is None else {"root": root}
    laid = [tree | part | whole for part in parts]
    return [_parse_page({key: value for key, value in part.items() if value is not None}) for part in laid]


def _check_keys(path: Path, tree: Mapping[str, Any]) -> None:
    known = [*SweepPage.__dataclass_fields__, "parts"]
    if unknown := [key for key in tree if key not in known]:
        near = difflib.get_close_matches(str(unknown[0]), known, n=1, cutoff=NEAR)
        hint = f"did you mean {near[0]!r}?" if near else f"expected a sweep's: {', '.join(known)}"
        raise ConfigError(f"{path}: unknown key {unknown[0]!r}; {hint}")


def _parse_page(tree: Mapping[str, Any]) -> SweepPage:
    parser = ArgumentParser(prog="plp sweep", exit_on_error=False)
    parser.add_argument("--config", action="config")
    parser.add_class_arguments(SweepPage)
    config = parsed(parser, ["--config", dump_yaml(tree)])
    page: SweepPage = SweepPage(**{name: config[name] for name in SweepPage.__dataclass_fields__})
    return page


def plan(parts: Sequence[SweepPage], flags: Sequence[str], name: str = "") -> list[PlannedRun]:
    """All runs of a page.

    Args:
        parts: The page's parts.
        flags: Further words for every run.
        name: The page's, which runs keep; they keep none if it is empty.

    Raises:
        ConfigError: If the parser refuses one, two share a directory, or settings of one have changed since it began.
    """
    _check_flags(flags)
    made_by = [f"--sweep={name}"] * bool(name)
    every = [(variant, page.root) for page in parts for variant in variants(page, find_word, flags)]
    runs = [run for variant, root in every for run in _runs(variant, [f"--run_root={root}", *made_by])]
    _check_directories(runs)
    return runs


def choose(runs: Sequence[PlannedRun], only: str) -> list[PlannedRun]:
    """Runs whose name matches a pattern, as shells have them; a :class:`ConfigError` if none does."""
    if chosen := [run for run in runs if fnmatchcase(run.name, only)]:
        return chosen
    raise ConfigError(f"--only {only!r} matches none of {len(runs)} runs, such as {runs[0].name!r}; change it")


def find_word(kind: str, name: str) -> tuple[str, str]:
    """The word for ``--config`` of a page, a file or one that this package brings, and the method that it sets up."""
    folder = "methods/" if kind == "methods" else ""
    ours = next((word for word in (f"{folder}{name}", name) if (PAGES / f"{word}.yaml").is_file()), None)
    if Path(name).is_file():
        word = str(Path(name).absolute())
    elif ours is not None and (PAGES / f"{ours}.yaml") != BASE:
        word = ours
    else:
        known = sorted(page.stem for page in (PAGES / folder).glob("*.yaml") if page != BASE)
        near = difflib.get_close_matches(name, known, n=1, cutoff=0.0)[0]
        raise ConfigError(f"{kind} names {name!r}, which is no page; did you mean {near!r}?")
    page = find_page(word)
    return word, str(read_yaml(page).get("method", page.stem))


def _check_flags(flags: Sequence[str]) -> None:
    for word in flags:
        key = word.partition("=")[0].removeprefix("--")
        if key in OWN:
            raise ConfigError(f"--{key} comes from {OWN[key]}; leave it away")


def _runs(variant: Variant, own: Sequence[str]) -> Iterator[PlannedRun]:
    """Runs of one variant; the parser reads it once, as target task and seed are plain values."""
    places = [*variant.words, *own]
    first = [f"--data.target_task={target}" for target in variant.targets[:1]]
    try:
        template, _ = read([*places, *first])
    except ConfigError as error:
        raise ConfigError(f"{variant.experiment}: {error}") from None
    tree = parse_yaml(template.config)
    data = {target: _data(template, target) for target in variant.targets or [template.data.target_task]}
    proxies = [module.proxy_tasks for module in data.values()]
    reading = _phases_that_read_targets(template) if len({*proxies}) < len(proxies) else [*template.method.phases]
    for target, module in data.items():
        tree["data"]["target_task"] = target
        collection = _collection(module, tree)
        for seed in variant.seeds:
            words = ["fit", *places, f"--data.target_task={target}", f"--seed={seed}"]
            experiment = replace(template, data=module, seed=seed)
            yield _planned(experiment, tree | {"seed": seed}, words, reading, collection)


def _data(template: Experiment, target: str) -> TransferDataModule:
    """The template's data with another target task."""
    known = template.data
    assert isinstance(known.demonstrations, DataSettings)
    settings = replace(known.demonstrations, target_task=target)
    roles = find_roles(template.domains, settings, known.path)
    return TransferDataModule(known.path, roles, settings, settings, known.seed, known.image_memory, known.collector)


def _phases_that_read_targets(template: Experiment) -> list[str]:
    """Phases whose batches hold demonstrations of the target task; all of them where callbacks may look at it."""
    check_method(template)
    policy = template.method.policy(template.unscaled_problem)
    steps = {name: build(policy).batch_spec.steps for name, build in template.method.phases.items()}
    return [name for name in steps if steps[name] in ("all", "mix") or template.callbacks]


def _collection(data: TransferDataModule, tree: Mapping[str, Any]) -> tuple[str, bool]:
    """Hash of the demonstrations that runs need, empty if nobody can make any; and whether all of them are there."""
    if data.collector is None:
        return "", True
    return _hash([data.needed(), tree["collection"], tree["domains"]]), not data.missing()


def _planned(
    experiment: Experiment,
    tree: dict[str, Any],
    words: list[str],
    reading: Sequence[str],
    collection: tuple[str, bool],
) -> PlannedRun:
    path = experiment.run_path
    name = str(path.relative_to(experiment.run_root))
    begun = RunDirectory(path).status() if (path / "config.yaml").exists() else None
    wanted = list(experiment.method.phases) if begun is None else begun.get("wanted") or list(experiment.method.phases)
    decided = [
        _decided(experiment, tree, phase, reading) if phase in wanted else f"{name}:{phase}"
        for phase in experiment.method.phases
    ]
    if begun is not None:
        _check_same(name, path, tree)
    phases = list(experiment.method.phases)
    done = [] if begun is None else RunDirectory(path).done_phases()
    return PlannedRun(name, words, path, phases, decided, experiment.data.path, *collection, begun is not None, done)


def _decided(experiment: Experiment, tree: Mapping[str, Any], phase: str, reading: Sequence[str]) -> str:
    """Hash of all that decides the policy after a phase: settings, data, and the phases up to it."""
    phases = list(experiment.method.phases)
    until = phases[: phases.index(phase) + 1]
    kept = {
        key: value for key, value in without_places(tree).items() if key not in (*phases, "data", "phases", "handover")
    }
    kept |= {f"data.{key}": value for key, value in tree["data"].items()}
    kept = {key: value for key, value in kept.items() if key not in LATER}
    kept["collection"] = {key: value for key, value in kept["collection"].items() if f"collection.{key}" not in LATER}
    target = experiment.data.target_task if any(name in reading for name in until) else None
    trained = [(name, tree[name], experiment.handover.of(name)) for name in until]
    return _hash([kept, trained, str(experiment.data.path), experiment.data.proxy_tasks, target])


def _hash(content: object) -> str:
    return hashlib.sha256(json.dumps(content, sort_keys=True, default=str).encode()).hexdigest()


def _check_directories(runs: Sequence[PlannedRun]) -> None:
    seen: dict[Path, PlannedRun] = {}
    for run in runs:
        other = seen.setdefault(run.directory, run)
        if other is not run:
            differs = next((a for a, b in zip(run.words, other.words, strict=False) if a != b), run.words[-1])
            told = f"{run.directory}: two runs share this directory, one with {differs}"
            raise ConfigError(f"{told}; expected one for each: give overrides or pages names of their own")


def _check_same(name: str, path: Path, tree: Mapping[str, Any]) -> None:
    """Refuse, by a :class:`ConfigError`, a run that began with other settings than it would begin with now."""
    run = RunDirectory(path)
    results = run.read_json(run.results.name)
    if results.get("config_sha256") == config_hash(tree):
        return
    begun_with = read_yaml(run.config)
    changed = first_change(without_places(with_defaults(begun_with)), without_places(with_defaults(tree)))
    if changed:
        remedy = "restore the setting, name another root, or remove the run"
        raise ConfigError(f"{name}: {changed} has changed since the run began; {remedy}")
