"""Verdict: whether a transfer can be trusted, from what is known without the target task in the target domain."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from datamodules.streams import Stream, generator
from datamodules.transfer import TransferDataModule
from plp_lightning.evaluation.held_out import ActionPairs, action_errors
from plp_lightning.evaluation.mixing import NeighbourhoodScore, task_rows
from plp_lightning.evaluation.scores import encode
from plp_lightning.methods.plp.policy import PortablePolicy
from plp_lightning.methods.policy import Policy

SAMPLES = 100  # States of each domain and task; a verdict is to cost seconds
PAGE = "docs/verdict.md"
WITHOUT = "nothing falls short; this method has no latent space that all domains share"


@dataclass(frozen=True)
class Check:
    """A bound of one fact.

    Args:
        fact: Name of the fact; one of each domain is ``<fact>/<domain>``.
        told: What the fact is.
        why: What is wrong where the bound is not kept.
        remedy: What to try then.
        least: Least value that is well.
        most: Largest value that is well.
    """

    fact: str
    told: str
    why: str
    remedy: str
    least: float = -math.inf
    most: float = math.inf

    def keeps(self, value: float) -> bool:
        """True for a value that is well."""
        return self.least <= value <= self.most

    @property
    def bound(self) -> str:
        """The bound in words."""
        return f"at least {self.least:g}" if math.isfinite(self.least) else f"at most {self.most:g}"


NOT_CLONED = (
    "the demonstrations are not cloned well enough to be transferred",
    "--alignment.epochs with twice as many, more demonstrations, or policy.scaling of the keys that decide",
)
CHECKS = (
    Check(
        "cloned",
        "success on proxy tasks",
        *NOT_CLONED,
        least=0.8,
    ),
    Check(
        "unexplained",
        "share of held-out actions that is not explained",
        *NOT_CLONED,
        most=0.1,
    ),
    Check(
        "mix",
        "share of a latent state's neighbours that are of the other domain",
        "the domains lie apart in the latent space",
        "--alignment.terms.mmd.weight with twice as much, --data.tasks_per_batch with fewer, or the overlay plp_t",
        least=0.3,
    ),
    Check(
        "spread",
        "spread of latent states",
        "the latent states have shrunk to a point, so nothing is told apart there",
        "--alignment.terms.mmd.weight with half as much",
        least=0.01,
    ),
    Check(
        "learnt",
        "success of the target task in the source domain",
        "the common policy has not learnt the target task where it was shown",
        "--adaptation.epochs with twice as many, or more demonstrations of it",
        least=0.8,
    ),
    Check(
        "proxies",
        "number of proxy tasks",
        "few tasks leave open how the domains correspond where no proxy task leads",
        "more proxy tasks on all sides of the target task (--data.proxy_tasks)",
        least=5,
    ),
)


def facts(
    policy: Policy, data: TransferDataModule, success: Mapping[str, float], held_out: ActionPairs
) -> dict[str, float]:
    """Gathers what is known of a policy at the end of a phase, without the target task in the target domain.

    Args:
        policy: The trained policy, in eval mode.
        data: The demonstrations.
        success: Success rates of the trials ``proxy``, ``proxy_source`` and ``source``, as far as they were simulated
            and the phase has trained for them.
        held_out: Its actions on held-out trajectories, ``(N, A)``, beside the demonstrated ones; empty without any.

    Returns:
        ``cloned/<domain>``, success on proxy tasks, or ``unexplained/<domain>``, the share of the held-out actions'
        variance that predictions miss, where nothing is simulated; ``learnt``; and, of portable latent policies,
        ``mix``, ``spread`` and, where the domains share no columns, ``proxies``, their number.
    """
    found = dict(_cloning(data, success, held_out))
    if "source" in success:
        found["learnt"] = success["source"]
    if isinstance(policy, PortablePolicy):
        found |= _latent_facts(policy, data)
    return found


def shortfalls(known: Mapping[str, float]) -> list[tuple[str, Check]]:
    """Facts that miss their bound, each with its check; worst causes first."""
    return [(name, check) for check in CHECKS for name in _of(check, known) if not check.keeps(known[name])]


def verdict(known: Mapping[str, float]) -> list[str]:
    """The verdict in lines: ``aligned``, or what falls short and which key to try."""
    missed = shortfalls(known)
    if not missed:
        return [f"verdict: {'aligned' if 'mix' in known else WITHOUT}"]
    return [f"verdict: falls short ({PAGE})", *(_line(name, known[name], check) for name, check in missed)]


def _line(name: str, value: float, check: Check) -> str:
    _, _, domain = name.partition("/")
    place = f" in {domain}" if domain else ""
    return f"  {check.told}{place} is {value:.2f}, expected {check.bound}: {check.why}; try {check.remedy}"


def _of(check: Check, known: Mapping[str, float]) -> list[str]:
    return [name for name in known if name.partition("/")[0] == check.fact]


def _cloning(
    data: TransferDataModule, success: Mapping[str, float], held_out: ActionPairs
) -> Iterator[tuple[str, float]]:
    trials = {"proxy_source": data.source_domain, "proxy": data.target_domain}
    simulated = {domain: success[trial] for trial, domain in trials.items() if trial in success}
    yield from ((f"cloned/{domain}", rate) for domain, rate in simulated.items())
    for domain, error in action_errors(held_out).items():
        shown = held_out[domain][1]
        variance = float(((shown - shown.mean(axis=0)) ** 2).mean())
        if domain not in simulated and variance > 0:
            yield f"unexplained/{domain}", error / variance


def _latent_facts(policy: PortablePolicy, data: TransferDataModule) -> dict[str, float]:
    joined = torch.cat([_latents(policy, data, domain) for domain in (data.source_domain, data.target_domain)])
    found = NeighbourhoodScore(SAMPLES)(policy, data, {}) | {"spread": float(joined.std(dim=0).mean())}
    shared = policy.arguments.get("columns") == "shared"  # what the domains' numbers mean is known then
    return found if shared else found | {"proxies": float(len(data.proxy_tasks))}


def _latents(policy: PortablePolicy, data: TransferDataModule, domain: str) -> Tensor:
    """Latent states ``(N, Z)`` of some steps of each proxy task."""
    drawn = [task_rows(data, domain, task) for task in data.proxy_tasks]
    some = [generator(Stream.SCORED_STATES, len(rows)).permutation(rows)[:SAMPLES] for rows in drawn]
    rows = torch.from_numpy(np.sort(np.concatenate(some)))
    return encode(policy, domain, data.datasets[domain].observation.take(rows)).float()
