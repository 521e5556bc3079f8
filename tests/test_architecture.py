"""The shape of the house: imports run one way, files are short, public names are documented, examples are true."""

from __future__ import annotations

import ast
import doctest
import importlib
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
import torch

ROOT = Path(__file__).parent.parent
SOURCES = sorted(path for package in ("datamodules", "plp_lightning") for path in (ROOT / package).rglob("*.py"))
TESTS = sorted((ROOT / "tests").rglob("*.py"))

WORDS = {
    "datamodules.errors",
    "datamodules.types",
    "datamodules.named",
    "datamodules.problem",
    "datamodules.settings",
    "datamodules.specs",
    "datamodules.limits",
    "datamodules.streams",
    "datamodules.batches.normalization",
}
ENVS, METHODS = "plp_lightning.envs", "plp_lightning.methods"
ALL = {"datamodules", "plp_lightning"}

MAY_IMPORT: dict[str, set[str]] = {
    # What is below imports at most what is beside it; a package may import its own modules. First match counts.
    "datamodules.errors": set(),
    "datamodules.settings": {"datamodules.errors"},
    "datamodules.specs": set(),
    "datamodules.streams": set(),
    "datamodules.limits": {"datamodules.errors"},
    "datamodules.named": {"datamodules.errors", "datamodules.types"},
    "datamodules.types": {"datamodules.errors", "datamodules.limits"},
    "datamodules.store": WORDS,
    "datamodules.batches": WORDS | {"datamodules.store"},
    "datamodules.formats": WORDS | {"datamodules.store"},
    "datamodules": {"datamodules"},
    "plp_lightning.stopping": set(),
    "plp_lightning.parent": set(),
    "plp_lightning.placement": {"datamodules.errors"},
    "plp_lightning.plugins": {"datamodules.errors"},
    "plp_lightning.networks": WORDS,
    "plp_lightning.losses": WORDS,
    METHODS: {"datamodules", "plp_lightning.losses", "plp_lightning.networks"},
    ENVS: WORDS | {"datamodules.store.atomic", "plp_lightning.stopping"},
    "plp_lightning.evaluation": {"datamodules", ENVS, METHODS},
    "plp_lightning.callbacks": {"datamodules", ENVS, METHODS, "plp_lightning.evaluation", "plp_lightning.stopping"},
    "plp_lightning.pictures": {"datamodules", ENVS, METHODS, "plp_lightning.evaluation"},
    "plp_lightning.report": {"datamodules.errors", "datamodules.words", "plp_lightning.pictures.style"}
    | {"plp_lightning.evaluation.bootstrap", "plp_lightning.evaluation.statistics", "plp_lightning.runs.curves"}
    | {"plp_lightning.runs.records"},
    "plp_lightning.steps": {"datamodules", METHODS, "plp_lightning.networks.ranks"},
    "plp_lightning.runs": {"datamodules", ENVS, METHODS, "plp_lightning.evaluation"}
    | {"plp_lightning.callbacks", "plp_lightning.pictures", "plp_lightning.stopping", "plp_lightning.plugins"}
    | {"plp_lightning.steps", "plp_lightning.placement", "plp_lightning.parent"},
    "plp_lightning.sweeps": {
        *("datamodules.errors", "datamodules.settings", "datamodules.words", "datamodules.store.atomic"),
        *("plp_lightning.runs.directory", "plp_lightning.parent", "plp_lightning.envs.cores"),
    },
    "plp_lightning.cli.main": {
        "datamodules.errors",
        "datamodules.words",
        "plp_lightning.cli",
        "plp_lightning.placement",
        "plp_lightning.stopping",
    },
    # The command line joins everything.
    "plp_lightning.cli": ALL,
    "plp_lightning.__main__": {"plp_lightning.cli"},
    "plp_lightning": ALL,
}
ENTRY = "plp_lightning.cli.main"
LIGHT = (
    "plp_lightning",
    "plp_lightning.cli.main",
    "plp_lightning.cli.data",
    "plp_lightning.cli.report",
    "datamodules.store.writer",
    "plp_lightning.runs.collection",
    "plp_lightning.sweeps.local",
    "plp_lightning.sweeps.slurm",
    "plp_lightning.sweeps.page",
)
SIMULATORS = {"mujoco", "robosuite", "gymnasium", "gymnasium_robotics", "metaworld"}
NO_SIMULATOR = ("datamodules", "plp_lightning.losses", "plp_lightning.networks", METHODS)


def relative(path: Path) -> str:
    return str(path.relative_to(ROOT))


def module_name(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


MODULES = {module_name(path): path for path in SOURCES}


def below(name: str, package: str) -> bool:
    return name == package or name.startswith(f"{package}.")


def imported(text: str) -> Iterator[str]:
    """Modules that a source imports anywhere in it, lazily or for types alone too."""
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "relative import"
            names = [f"{node.module}.{alias.name}" for alias in node.names]
            yield from (name if name in MODULES else str(node.module) for name in names)


def layer(module: str) -> str:
    return next(name for name in MAY_IMPORT if below(module, name))


def forbidden(module: str, names: Iterator[str]) -> list[str]:
    own, allowed = layer(module), MAY_IMPORT[layer(module)]
    ours = [name for name in names if any(below(name, package) for package in ALL)]
    fine = [name for name in ours if any(below(name, package) for package in (own, *allowed))]
    return sorted({*ours} - {*fine})


@pytest.mark.parametrize("module", MODULES)
def test_imports_run_one_way(module: str) -> None:
    assert forbidden(module, imported(MODULES[module].read_text())) == []


def test_a_wrong_import_would_be_found() -> None:
    assert forbidden("plp_lightning.methods.plp.alignment", iter(["plp_lightning.envs.lift"])) == [
        "plp_lightning.envs.lift"
    ]
    assert forbidden("datamodules.types", iter(["datamodules.batches.dataset", "datamodules.errors"])) == [
        "datamodules.batches.dataset"
    ]
    assert forbidden("plp_lightning.evaluation.x", iter(["plp_lightning.runs"])) == ["plp_lightning.runs"]


def test_imports_are_found_wherever_they_are() -> None:
    lazy = "def f():\n    from plp_lightning import cli\n    import datamodules.store.writer as h\n"
    typed = "if TYPE_CHECKING:\n    from plp_lightning.envs import Lift\n"
    assert {*imported(lazy + typed)} == {"plp_lightning.envs", "plp_lightning.cli", "datamodules.store.writer"}


def test_every_package_has_its_row_in_the_table() -> None:
    packages = {name for name, path in MODULES.items() if path.name == "__init__.py" and name.count(".") == 1}
    assert {name for name in packages if name.startswith("plp_lightning")} <= MAY_IMPORT.keys()


def test_only_the_entry_point_imports_the_command_line() -> None:
    assert [name for name, path in MODULES.items() if ENTRY in imported(path.read_text())] == ["plp_lightning.__main__"]


@pytest.mark.parametrize("module", [name for name in MODULES if any(below(name, part) for part in NO_SIMULATOR)])
def test_data_policy_and_phases_know_no_simulator(module: str) -> None:
    assert not {name.split(".")[0] for name in imported(MODULES[module].read_text())} & SIMULATORS


@pytest.mark.parametrize("module", LIGHT)
def test_light_modules_do_not_import_torch(module: str) -> None:
    code = f"import sys, {module}; print([name for name in ('torch', 'lightning', 'mujoco') if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


@pytest.mark.parametrize("path", [*SOURCES, *TESTS], ids=relative)
def test_no_file_is_longer_than_300_lines(path: Path) -> None:
    assert len(path.read_text().splitlines()) <= 300


def test_files_of_tests_have_names_of_their_own() -> None:
    names = [path.name for path in TESTS if path.name.startswith("test_")]
    assert sorted(names) == sorted({*names}), "pytest takes one of them for the other"


def test_no_file_is_a_drawer_for_everything() -> None:
    assert not [relative(path) for path in [*SOURCES, *TESTS] if path.stem in ("utils", "util", "helpers", "misc")]


def public(tree: ast.Module) -> Iterator[ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef]:
    """Public classes and functions of a module, and public methods of its public classes."""
    bodies = [tree.body]
    while bodies:
        for node in bodies.pop():
            if isinstance(node, ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef) and node.name[0] != "_":
                yield node
                if isinstance(node, ast.ClassDef):
                    bodies.append(node.body)


def overrides(module: str, class_name: str, name: str) -> bool:
    """Whether a base class documents a method of this name."""
    kind = getattr(importlib.import_module(module), class_name)
    return any(getattr(vars(base).get(name), "__doc__", None) for base in kind.__mro__[1:])


def bare(module: str) -> Iterator[str]:
    """Public names without a docstring that no base class documents either."""
    tree = ast.parse(MODULES[module].read_text())
    for node in public(tree):
        if not ast.get_docstring(node):
            owner = next((c for c in ast.walk(tree) if isinstance(c, ast.ClassDef) and node in c.body), None)
            if owner is None or not overrides(module, owner.name, node.name):
                yield node.name


@pytest.mark.parametrize("module", MODULES)
def test_public_names_are_documented(module: str) -> None:
    assert ast.get_docstring(ast.parse(MODULES[module].read_text()))
    assert [*bare(module)] == []


@pytest.mark.parametrize("module", [name for name, path in MODULES.items() if ">>> " in path.read_text()])
def test_examples_do_what_they_say(module: str) -> None:
    outcome = doctest.testmod(importlib.import_module(module), extraglobs={"torch": torch})
    assert outcome.attempted > 0
    assert outcome.failed == 0


@pytest.mark.parametrize("module", MODULES)
def test_functions_are_short_and_name_what_they_take(module: str) -> None:
    for node in ast.walk(ast.parse(MODULES[module].read_text())):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            body = node.body[1:] if ast.get_docstring(node) else node.body
            lines = (body[-1].end_lineno or 0) - body[0].lineno + 1 if body else 0
            assert lines <= 50, f"{node.name}: {lines} lines"
            assert node.name != "__init__" or node.args.kwarg is None, "a constructor takes **kwargs"
