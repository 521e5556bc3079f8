"""Classes that a configuration may name, by short name or import path, and the settings that their signatures state."""

from __future__ import annotations

import importlib
import inspect
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

from lightning.pytorch import Callback
from lightning.pytorch.loggers import Logger
from torch.optim import Optimizer
from torch.optim.lr_scheduler import LRScheduler

from datamodules.errors import ConfigError
from plp_lightning.envs.base import Expert, Simulator
from plp_lightning.evaluation.behaviour import BehaviourMetric
from plp_lightning.evaluation.scores import AlignmentScore
from plp_lightning.methods.phase import Phase
from plp_lightning.methods.plp.terms import AlignmentTerm
from plp_lightning.methods.policy import Policy
from plp_lightning.networks import ImageEncoderFactory

ALLOWED_IMPORTS = [
    *("plp_lightning", "datamodules", "torchmetrics", "torch.optim"),
    *("lightning.pytorch.callbacks", "lightning.pytorch.loggers"),
]
"""Packages that a configuration may import from; a file that names another is refused before the import happens."""
WORLDS = ("gymnasium", "gymnasium_robotics")
"""Packages whose environments a configuration may name; the core of this project goes without them."""
ROOTS = (
    *(Policy, Phase, AlignmentTerm, ImageEncoderFactory, Simulator, Expert, AlignmentScore, BehaviourMetric),
    *(Callback, Logger, Optimizer, LRScheduler),
)
"""Their subclasses are what a configuration names."""


def known_classes(roots: Iterable[type] = ROOTS) -> Iterator[type]:
    """Every class loaded so far that a configuration may name."""
    for kind in roots:
        yield kind
        yield from known_classes(kind.__subclasses__())


def find_class(name: str, allowed: Sequence[str]) -> type | None:
    """The class of a short name or an import path in an allowed package; None without one, which the parser tells."""
    module, _, short = name.rpartition(".")
    if not module:
        return next((kind for kind in known_classes() if kind.__name__ == short), None)
    if not is_allowed(module, allowed):
        return None
    try:
        found = getattr(importlib.import_module(module), short, None)
    except ImportError:
        return None
    return found if isinstance(found, type) else None


def is_allowed(module: str, allowed: Sequence[str]) -> bool:
    """Tell whether a module is one of the allowed packages, or in one."""
    return any(module == package or module.startswith(f"{package}.") for package in allowed)


def check_imports(simulators: Mapping[str, Simulator], allowed: Sequence[str]) -> None:
    """Refuse simulators that would import what nobody allowed, before they do."""
    for name, simulator in simulators.items():
        for module in simulator.imports:
            if not is_allowed(module, [*allowed, *WORLDS]):
                told = f"the simulator of domain {name!r} imports {module}; expected a package that you allow"
                raise ConfigError(f"{told}: add --allow_imports {module.partition('.')[0]} if you trust it")


def defaults(kind: type) -> dict[str, Any]:
    """Settings of a class by name, each with its default, or ``inspect.Parameter.empty`` without one."""
    return {name: parameter.default for name, parameter in inspect.signature(kind).parameters.items()}
