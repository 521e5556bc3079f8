"""Cross-domain policy transfer: align a latent space on proxy tasks, adapt the common policy, act elsewhere.

::

    import plp_lightning as plp

    policy = plp.load_policy("runs/smoke/plp/goal_3/seed_0")
    actions = policy.act(observation, domain="tall", task=["goal_3"])

Names below are what extensions build on; each is imported when it is first used, so that this package is light.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from datamodules.types import DomainSpec, Observation, ObservationKey, Trajectory
    from plp_lightning.envs.base import Expert, Simulator, Step
    from plp_lightning.evaluation.scores import AlignmentScore
    from plp_lightning.methods import Adaptation, AligningPolicy, Alignment, Phase, Policy, PortablePolicy
    from plp_lightning.methods.plp.terms import AlignmentTerm, EncodedBatch
    from plp_lightning.networks import ImageEncoderFactory
    from plp_lightning.recording import Recorder
    from plp_lightning.runs.policies import load_policy

_HOMES = {
    "datamodules.types": ("DomainSpec", "Observation", "ObservationKey", "Trajectory"),
    "plp_lightning.envs.base": ("Expert", "Simulator", "Step"),
    "plp_lightning.evaluation.scores": ("AlignmentScore",),
    "plp_lightning.methods": ("Adaptation", "AligningPolicy", "Alignment", "Phase", "Policy", "PortablePolicy"),
    "plp_lightning.methods.plp.terms": ("AlignmentTerm", "EncodedBatch"),
    "plp_lightning.networks": ("ImageEncoderFactory",),
    "plp_lightning.recording": ("Recorder",),
    "plp_lightning.runs.policies": ("load_policy",),
}

__all__ = [
    "Adaptation",
    "AligningPolicy",
    "Alignment",
    "AlignmentScore",
    "AlignmentTerm",
    "DomainSpec",
    "EncodedBatch",
    "Expert",
    "ImageEncoderFactory",
    "Observation",
    "ObservationKey",
    "Phase",
    "Policy",
    "PortablePolicy",
    "Recorder",
    "Simulator",
    "Step",
    "Trajectory",
    "load_policy",
]


def __getattr__(name: str) -> Any:
    """Import a public name."""
    home = next((module for module, names in _HOMES.items() if name in names), None)
    if home is None:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(home), name)
