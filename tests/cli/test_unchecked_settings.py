"""Every setting has a bound that the parser knows."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
from collections.abc import Iterator

import pytest
from jsonargparse import ArgumentParser

import datamodules
import plp_lightning
from datamodules.settings import Configured
from plp_lightning.cli.config import build_parser
from plp_lightning.envs.base import Expert, Simulator


def configured_classes() -> list[type]:
    """Classes of this project that a configuration can name."""
    for package in (datamodules, plp_lightning):
        for module in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
            if "__main__" not in module.name and "train_walker" not in module.name and "plane" not in module.name:
                importlib.import_module(module.name)
    found = {kind for base in (Configured, Simulator, Expert) for kind in below(base)}
    ours = [kind for kind in found if kind.__module__.startswith(("datamodules.", "plp_lightning."))]
    return sorted((kind for kind in ours if not inspect.isabstract(kind)), key=lambda kind: kind.__qualname__)


def below(kind: type) -> Iterator[type]:
    for nearer in kind.__subclasses__():
        yield nearer
        yield from below(nearer)


@pytest.mark.parametrize("kind", configured_classes())
def test_no_setting_of_a_class_is_left_unchecked(kind: type) -> None:
    """The parser marks types that it cannot make a check of; such a setting would take any value."""
    parser = ArgumentParser()
    parser.add_class_arguments(kind, "settings", fail_untyped=True)
    assert "nvalidated" not in parser.format_help()


def test_no_setting_of_an_experiment_is_left_unchecked() -> None:
    assert "nvalidated" not in build_parser(["alignment", "adaptation"]).format_help()
