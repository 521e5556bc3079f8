"""Every configuration that is shipped can be read and printed; test_matrix.py runs each."""

from __future__ import annotations

import copy
import dataclasses
import inspect
import itertools
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import yaml
from command import METHODS, ROOT, TINY, complaint, plp
from lightning.pytorch import Trainer

from datamodules.store.writer import write_trajectories
from datamodules.types import Observation, Trajectory
from plp_lightning.cli import config
from plp_lightning.cli.classes import ALLOWED_IMPORTS, defaults, find_class
from plp_lightning.cli.config import BASE, DataSettings, allow_imports, build_parser, parse, resolve
from plp_lightning.cli.layers import completed, insert, overlay
from plp_lightning.methods.optimization import FusedAdamW, LinearDecay
from plp_lightning.runs.experiment import Experiment
from plp_lightning.runs.plans import CollectionConfig, EvaluationPlan

EXPERIMENTS = sorted(path for path in (ROOT / "configs").glob("*.yaml") if path.name != "base.yaml")
BY_NAME = {path.stem: path for path in EXPERIMENTS}


def pairs() -> Iterator[Any]:
    """Method and experiment of each test; all methods on one experiment and PLP on all always run."""
    for method, experiment in itertools.product(METHODS, EXPERIMENTS):
        marks = [] if method.stem == "plp" or experiment.stem == "p2p_umaze" else [pytest.mark.matrix]
        yield pytest.param(method, experiment, id=f"{method.stem}-{experiment.stem}", marks=marks)


@pytest.mark.parametrize(("method", "experiment"), list(pairs()))
def test_every_method_on_every_experiment_is_printed_as_it_reruns(
    experiment: Path, method: Path, tmp_path: Path
) -> None:
    first = parse(["--config", str(experiment), *TINY, "--config", str(method)])
    assert (first.name, first.method.name) == (experiment.stem, method.stem)
    assert first.data.source_domain != first.data.target_domain
    assert not set(first.data.proxy_tasks) & set(first.data.target_tasks)
    (tmp_path / "printed.yaml").write_text(first.config)
    again = parse(["--config", str(tmp_path / "printed.yaml")])
    assert again.config == first.config
    assert again.run_path == first.run_path


def test_flags_beat_files_and_later_files_beat_earlier_ones(tmp_path: Path) -> None:
    late = {
        "data": {"batch_size": 7, "pairs": 3},
        "alignment": {"init_args": {"optimizer": {"init_args": {"lr": 0.5}}}},
    }
    (tmp_path / "late.yaml").write_text(yaml.safe_dump(late))
    words = ["--config", str(BY_NAME["smoke"]), "--config", str(tmp_path / "late.yaml"), "--data.pairs", "5"]
    printed = yaml.safe_load(plp("fit", *words, "--print_config").out)
    assert (printed["data"]["batch_size"], printed["data"]["pairs"], printed["data"]["stride"]) == (7, 5, 4)
    alignment = printed["alignment"]["init_args"]
    assert (alignment["optimizer"]["init_args"]["lr"], alignment["epochs"]) == (0.5, 10)


def test_printing_a_config_writes_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert plp("fit", "--config", BY_NAME["smoke"], "--print_config").code == 0
    assert not list(tmp_path.iterdir())


def test_base_config_alone_is_no_experiment() -> None:
    assert "give an experiment" in complaint("fit", "--config", BASE)


def invent_demonstrations(experiment: Experiment) -> None:
    """Random states and actions of the right shapes: what a miniature run needs, without an expert."""
    rng, made = np.random.default_rng(0), []
    specs = [domain.simulator.spec(name) for name, domain in experiment.domains.items()]
    for spec in specs:
        for task, count in experiment.data.needed()[spec.name].items():
            for seed in range(count):
                states = rng.normal(size=(20, spec.state_size)).astype(np.float32)
                actions = rng.uniform(-1, 1, (20, spec.action_size)).astype(np.float32)
                images = {key.name: rng.integers(0, 256, (20, *key.shape), np.uint8) for key in spec.image_keys}
                made.append(Trajectory(spec.name, task, Observation(states, images), actions, seed, success=True))
    write_trajectories(experiment.data.path, specs, experiment.data.tasks, made, {"command": "tests"})


def stated_keys(content: Any, place: str = "") -> set[str]:
    """Dotted keys of all that a file says."""
    if not isinstance(content, dict | list) or not content:
        return {place}
    items = content.items() if isinstance(content, dict) else enumerate(content)
    return {key for name, value in items for key in stated_keys(value, f"{place}.{name}".lstrip("."))}


def is_stated(place: str, stated: set[str]) -> bool:
    place = without_numbers(place)
    return any(key == place or key.startswith(f"{place}.") for key in map(without_numbers, stated))


def without_numbers(key: str) -> str:
    """A key without its places in lists: what a page adds by ``metrics+`` stands elsewhere in the whole."""
    return re.sub(r"\+?\.\d+(?=\.|$)|\+(?=\.|$)", "", key)


def plain(default: Any) -> Any:
    """A signature's default as YAML has it; what a factory makes is told by its class and settings."""
    if dataclasses.is_dataclass(default) and not isinstance(default, type):
        return plain(dataclasses.asdict(default))
    if isinstance(default, dict):
        return {name: plain(value) for name, value in default.items()}
    return [plain(value) for value in default] if isinstance(default, list | tuple) else default


def made_by(factory: Any) -> tuple[type, dict[str, Any]]:
    """Class of the optimizer or schedule that a signature's default makes, and the settings that it is given."""
    if isinstance(factory, type):
        return factory, {}
    parameter = torch.nn.Parameter(torch.zeros(1))
    for given in ([parameter], torch.optim.SGD([parameter], lr=1.0)):
        try:
            made = factory(given)
        except (TypeError, AttributeError):
            continue
        if isinstance(made, FusedAdamW):
            (group,) = made.param_groups
            said = {"lr": group["lr"], "weight_decay": group["weight_decay"], "first_moment": group["betas"][0]}
            return FusedAdamW, said
        return type(made), {"share": made.share} if isinstance(made, LinearDecay) else {}
    raise AssertionError(factory)


def leaks(part: Any, place: str, default: Any, stated: set[str]) -> Iterator[str]:
    """Keys below ``place`` whose values are neither their class's defaults nor stated by a file.

    Args:
        part: The resolved value.
        place: Its key.
        default: What the signature of its class, or of its group, says.
        stated: Keys that files state.
    """
    if isinstance(part, dict) and "class_path" in part:
        kind = find_class(part["class_path"], ["plp_lightning", "torch", "lightning"])
        assert kind is not None, part
        chosen, own = made_by(default) if callable(default) else (type(default), {})
        if kind is not chosen and not is_stated(f"{place}.class_path", stated):
            yield f"{place}.class_path"
        own = dataclasses.asdict(default) if dataclasses.is_dataclass(default) else own if kind is chosen else {}
        for name, value in (part.get("init_args") or {}).items():
            key = f"{place}.init_args.{name}" if not dataclasses.is_dataclass(default) else f"{place}.{name}"
            yield from leaks(value, key, own.get(name, defaults(kind)[name]), stated)
    elif isinstance(part, dict) and part:
        known = plain(default) if isinstance(plain(default), dict) else {}
        for name, value in part.items():
            yield from leaks(value, f"{place}.{name}", known.get(name), stated)
    elif isinstance(part, list) and any(isinstance(item, dict) for item in part):
        for i, item in enumerate(part):
            yield from leaks(item, f"{place}.{i}", None, stated)
    elif part in ({}, []) and not isinstance(default, list | tuple | dict):
        return  # the default of a group is made by a factory, and no list or mapping stands beside it
    elif part != plain(default) and not is_stated(place, stated):
        yield place


def fields(group: type) -> dict[str, Any]:
    return {name: None if value is inspect.Parameter.empty else value for name, value in defaults(group).items()}


GROUPS = {"data": DataSettings, "collection": CollectionConfig, "evaluation": EvaluationPlan, "trainer": Trainer}


def leaked(files: Sequence[Path], tree: dict[str, Any]) -> list[str]:
    """All keys of a resolved configuration whose values came from nowhere."""
    stated = {key for file in (BASE, *files) for key in stated_keys(yaml.safe_load(file.read_text()))}
    found: list[str] = []
    for name, part in tree.items():
        if name in GROUPS:
            for key, value in part.items():
                default = fields(GROUPS[name]).get(key)
                found += leaks(value, f"{name}.{key}", default, stated)
        elif name in ("domains", "policy", "score", "callbacks", *tree["phases"]):
            found += leaks(part, name, None, stated)
    return found


@pytest.mark.parametrize("method", METHODS, ids=lambda path: path.stem)
def test_no_value_of_any_page_differs_from_its_default_unless_a_file_says_so(method: Path) -> None:
    for page in EXPERIMENTS:
        files = [page, method]
        tree = resolve([word for file in files for word in ("--config", str(file))], ALLOWED_IMPORTS).tree
        assert leaked(files, tree) == [], page.stem


@pytest.mark.parametrize("page", ["p2a_medium", "v2v_reach"])
@pytest.mark.parametrize("method", METHODS, ids=lambda path: path.stem)
def test_what_the_parser_fills_in_is_a_default_too(method: Path, page: str) -> None:
    files = [BY_NAME[page], method]
    allow_imports(ALLOWED_IMPORTS)
    tree = resolve([word for file in files for word in ("--config", str(file))], ALLOWED_IMPORTS).tree
    parser = build_parser(tree["phases"])
    parsed = parser.parse_args(["--config", yaml.safe_dump(tree, sort_keys=False)])
    assert leaked(files, yaml.safe_load(parser.dump(parsed, skip_unset=False))) == []


@pytest.mark.parametrize(
    ("method", "leak"),
    [
        ("contextual", "policy.init_args.hidden"),
        ("gama", "policy.init_args.policy_layers"),
        ("cdil", "policy.init_args.policy_layers"),
    ],
)
def test_a_leak_would_be_found(method: str, leak: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def leaky(below: Any, above: Any, allowed: Sequence[str]) -> Any:
        """Fills in the defaults of the classes below first, as earlier versions did."""
        return overlay(completed(below, allowed), above, allowed)

    monkeypatch.setattr(config, "overlay", leaky)
    files = [BY_NAME["v2v_open"], ROOT / "configs" / "methods" / f"{method}.yaml"]
    tree = resolve([word for file in files for word in ("--config", str(file))], ALLOWED_IMPORTS).tree
    assert leak in leaked(files, tree)


def test_a_value_from_nowhere_would_be_found() -> None:
    files = [BY_NAME["p2a_medium"], ROOT / "configs" / "methods" / "plp.yaml"]
    tree = resolve([word for file in files for word in ("--config", str(file))], ALLOWED_IMPORTS).tree
    for key, value in (
        ("policy.init_args.latent", 7),
        ("alignment.init_args.terms.mmd.init_args.scale_gradient", False),
        ("alignment.init_args.optimizer.init_args.first_moment", 0.5),
        ("data.val_fraction", 0.5),
        ("evaluation.episodes", 3),
        ("domains.ant.simulator.init_args.radius", 9.0),
    ):
        changed = copy.deepcopy(tree)
        insert(changed, key, value)
        assert leaked(files, changed) == [key]


def test_each_method_keeps_its_own_weights_and_schedule_whatever_pages_set_for_plp() -> None:
    def alignment(method: str, page: str) -> dict[str, Any]:
        overlay_file = ROOT / "configs" / "methods" / f"{method}.yaml"
        words = ["--config", str(BY_NAME[page]), "--config", str(overlay_file)]
        found: dict[str, Any] = yaml.safe_load(parse(words).config)["alignment"]["init_args"]
        return found

    for page in ("p2a_medium", "v2v_reach", "smoke"):
        gama, cdil = alignment("gama", page), alignment("cdil", page)
        assert (gama["adversarial_weight"], gama["penalty_weight"], gama["discriminator_layers"]) == (0.5, 1.0, 2)
        weights = cdil["weights"].get("init_args", cdil["weights"])
        assert (weights["adversarial"], weights["penalty"], cdil["discriminator_layers"]) == (10.0, 0.1, 3)
        assert cdil["lr_scheduler"]["class_path"].endswith("LinearDecay")
        assert cdil["optimizer"]["init_args"]["first_moment"] == 0.5


@pytest.mark.parametrize("method", ["bc", "cdil", "contextual", "gama", "gama_state"])
def test_sizes_that_pages_state_are_of_plps_networks_alone(method: str) -> None:
    """A Transformer's decoder once had one block, since P2P-medium's action decoder has one layer."""
    files = [path for path in EXPERIMENTS if path.stem != "smoke"]  # which makes every method small
    for page in files:
        # A page may leave all to the defaults.
        said = yaml.safe_load(page.read_text()).get("policy", {}).get("init_args", {})
        tree = resolve(["--config", str(page), "--config", str(METHODS[0].with_stem(method))], ALLOWED_IMPORTS).tree
        assert not [name for name in tree["policy"]["init_args"] if isinstance(said.get(name), int)], page.stem
