from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import pytest
import tiny
import torch
from lightning.pytorch import Trainer
from torch import Tensor

from datamodules.batches import rounding
from datamodules.errors import ConfigError
from datamodules.types import Batch, BatchSpec
from plp_lightning.losses import behavioural_cloning
from plp_lightning.methods.plp import Alignment
from plp_lightning.methods.plp.losses import (
    domain_discriminator_loss,
    domain_generator_loss,
    domain_r1_penalty,
    mmd,
    standardise_jointly,
    tcc,
)
from plp_lightning.methods.plp.policy import PortablePolicy
from plp_lightning.methods.plp.terms import MMD, TCC, DomainAdversarial, TermFactory


class Recorded(Alignment):
    """Keeps the parts of a step instead of logging them."""

    logs_now = True  # type: ignore[assignment]

    def log_parts(self, parts: dict[str, Tensor], batch_size: int) -> None:
        self.parts, self.batch_size = parts, batch_size


WEIGHED: dict[str, TermFactory] = {
    "mmd": partial(MMD, weight=0.3),
    "tcc": partial(TCC, weight=0.7),
    "adversarial": partial(DomainAdversarial, weight=0.9, penalty_weight=0.6, hidden=16, layers=2),
}


def build(policy: PortablePolicy, terms: Sequence[str]) -> Recorded:
    torch.manual_seed(1)
    return Recorded(policy, {name: WEIGHED[name] for name in terms})


def discriminator_of(phase: Alignment) -> torch.nn.Module:
    term = phase.terms["adversarial"]
    assert isinstance(term, DomainAdversarial)
    return term.discriminator


def separate_losses(phase: Alignment, batch: Batch) -> dict[str, Tensor]:
    """Each loss from passes of its own, one domain at a time."""
    policy, steps = phase.policy, batch.steps
    out = {d: policy({d: s.observation}, {d: s.task}) for d, s in steps.items()}
    latents = [out[d].latent[d] for d in steps]
    parts = {"bc": behavioural_cloning({d: out[d].action[d] for d in steps}, {d: s.action for d, s in steps.items()})}
    if "mmd" in phase.terms:
        parts["mmd"] = mmd(latents, bandwidths=tiny.KERNELS)
    if "tcc" in phase.terms:
        frames = [policy.encode({d: s.observation})[d][s.frame] for d, s in batch.pairs.items()]
        masks = [s.mask for s in batch.pairs.values()]
        parts["tcc"] = tcc(frames[0], masks[0], frames[1], masks[1])
    if "adversarial" in phase.terms:
        seen, discriminator = standardise_jointly(latents), discriminator_of(phase)
        parts["discriminator"] = domain_discriminator_loss(discriminator, seen)
        parts["penalty"] = domain_r1_penalty(discriminator, seen)
        parts["adversarial"] = domain_generator_loss(discriminator, seen)
    return parts


ALL_TERMS: list[list[str]] = [
    [],
    ["mmd"],
    ["tcc"],
    ["mmd", "tcc"],
    ["adversarial"],
    ["adversarial", "tcc"],
    ["mmd", "tcc", "adversarial"],
]


@pytest.mark.parametrize("terms", ALL_TERMS, ids="+".join)
def test_the_parts_of_a_step_are_the_separate_losses_and_their_weighted_sum(
    trajectory_file: Path, terms: list[str]
) -> None:
    data = tiny.data_module(trajectory_file)
    phase = build(tiny.policy(data), terms)
    batch = next(iter(data.loader(phase.batch_spec)))
    total = phase.training_step(batch, 0)
    expected = separate_losses(phase, batch)
    assert set(phase.parts) == {*expected, "loss", "latent_std"}
    for name, value in expected.items():
        torch.testing.assert_close(phase.parts[name], value, rtol=1e-4, atol=1e-6)
    weights = {"mmd": 0.3, "tcc": 0.7, "adversarial": 0.9, "penalty": 0.6}
    by_hand = sum(weights.get(name, 1.0) * value.item() for name, value in expected.items())
    assert total.item() == pytest.approx(by_hand, rel=1e-5)
    assert torch.equal(phase.parts["loss"], total)
    assert phase.batch_size == 32


def test_only_tcc_asks_for_pairs(trajectory_file: Path) -> None:
    policy = tiny.policy(tiny.data_module(trajectory_file))
    demands = {"+".join(terms): build(policy, terms).batch_spec for terms in ALL_TERMS}
    assert {name for name, d in demands.items() if d == BatchSpec(pairs="thinned")} == {
        n for n in demands if "tcc" in n
    }
    assert {d for name, d in demands.items() if "tcc" not in name} == {BatchSpec()}


def test_only_adversarial_training_has_a_discriminator(trajectory_file: Path) -> None:
    policy = tiny.policy(tiny.data_module(trajectory_file))
    assert not [name for name in build(policy, ["mmd", "tcc"]).state_dict() if "discriminator" in name]
    assert discriminator_of(build(policy, ["adversarial"]))(torch.zeros(3, 8)).shape == (3, 2)


def gradients(loss: Tensor, module: torch.nn.Module) -> list[Tensor]:
    parameters = list(module.parameters())
    found = torch.autograd.grad(loss, parameters, retain_graph=True, allow_unused=True)
    return [torch.zeros_like(p) if g is None else g for p, g in zip(parameters, found, strict=True)]


def test_each_adversarial_loss_teaches_one_player_only(trajectory_file: Path) -> None:
    data = tiny.data_module(trajectory_file)
    phase = build(tiny.policy(data), ["adversarial"])
    batch = next(iter(data.loader(BatchSpec("proxy_tasks"))))
    total = phase.training_step(batch, 0)
    expected, discriminator = separate_losses(phase, batch), discriminator_of(phase)
    of_discriminator = gradients(expected["discriminator"] + 0.6 * expected["penalty"], discriminator)
    assert all(g.abs().sum() > 0 for g in of_discriminator)
    torch.testing.assert_close(gradients(total, discriminator), of_discriminator, rtol=1e-3, atol=1e-6)
    of_encoder = gradients(expected["bc"] + 0.9 * expected["adversarial"], phase.policy.encoder)
    torch.testing.assert_close(gradients(total, phase.policy.encoder), of_encoder, rtol=1e-3, atol=1e-6)
    for of_the_other in ("discriminator", "penalty"):
        assert all(g.abs().sum() == 0 for g in gradients(phase.parts[of_the_other], phase.policy.encoder))
    assert all(g.abs().sum() == 0 for g in gradients(phase.parts["adversarial"], discriminator))


def test_without_a_penalty_none_is_computed(trajectory_file: Path) -> None:
    data = tiny.data_module(trajectory_file)
    phase = Recorded(tiny.policy(data), {"adversarial": partial(DomainAdversarial, penalty_weight=0)})
    phase.training_step(next(iter(data.loader(phase.batch_spec))), 0)
    assert phase.parts.keys() == {"bc", "adversarial", "discriminator", "loss", "latent_std"}


def test_the_spread_of_the_latents_is_watched(trajectory_file: Path) -> None:
    data = tiny.data_module(trajectory_file)
    phase = build(tiny.policy(data), [])
    batch = next(iter(data.loader(BatchSpec("proxy_tasks"))))
    phase.training_step(batch, 0)
    latents = phase.policy.encode({d: s.observation for d, s in batch.steps.items()})
    by_hand = torch.cat(list(latents.values())).std(dim=0).mean()
    torch.testing.assert_close(phase.parts["latent_std"], by_hand)
    assert not phase.parts["latent_std"].requires_grad


def test_alignment_learns_and_changes_all_parts(trajectory_file: Path, make_trainer: Callable[..., Trainer]) -> None:
    data = tiny.data_module(trajectory_file, batch_size=64)
    phase = Alignment(tiny.policy(data), tiny.terms("mmd", "tcc"), optimizer=tiny.adamw(6e-3), lr_scheduler=None)
    before = {name: value.clone() for name, value in phase.state_dict().items()}
    trainer = make_trainer(epochs=8)
    trainer.fit(phase, datamodule=data)
    changed = {name for name, value in phase.state_dict().items() if not torch.equal(value, before[name])}
    assert changed == {name for name in before if not name.startswith("policy.scaler")}
    batch = next(iter(data.val_dataloader()))
    policies = (phase.policy, tiny.policy(data))
    trained, untrained = (separate_losses(Alignment(policy, tiny.terms()), batch)["bc"].item() for policy in policies)
    assert trained < 0.5 * untrained


@pytest.mark.parametrize(
    ("bandwidths", "told"),
    [
        ((), r"MMD\.bandwidths is empty; expected one or more widths above 0"),
        ((1.0, 0.0), r"MMD\.bandwidths is 0\.0; expected a number above 0; change it"),
    ],
)
def test_kernels_have_a_width(bandwidths: tuple[float, ...], told: str, trajectory_file: Path) -> None:
    with pytest.raises(ConfigError, match=told):
        MMD(tiny.policy(tiny.data_module(trajectory_file)), bandwidths=bandwidths)


def test_mmd_has_the_kernels_asked_for(trajectory_file: Path) -> None:
    data = tiny.data_module(trajectory_file)
    policy, batch = tiny.policy(data), next(iter(data.loader(BatchSpec("proxy_tasks"))))
    latents = [*policy.encode({d: s.observation for d, s in batch.steps.items()}).values()]
    found = Recorded(policy, {"mmd": partial(MMD, bandwidths=(1.0, 0.2))})
    found.training_step(batch, 0)
    torch.testing.assert_close(found.parts["mmd"], mmd(latents, bandwidths=[1.0, 0.2]))


def test_rows_that_fill_a_batch_up_change_no_gradient(trajectory_file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    data, found, rows = tiny.data_module(trajectory_file), [], list[int]()
    for _ in range(2):
        phase = build(tiny.policy(data), ["mmd", "tcc"])
        phase.policy.encoder.register_forward_hook(lambda module, args, out: rows.append(len(out)))
        phase.training_step(next(iter(data.loader(phase.batch_spec))), 0).backward()
        found.append({name: parameter.grad for name, parameter in phase.named_parameters()})
        monkeypatch.setattr(rounding, "wants_rows_that_recur", lambda sequences: True)
    assert rows[1] > rows[0]
    torch.testing.assert_close(*found, rtol=1e-4, atol=1e-6)


def test_rows_are_filled_up_in_half_precision_alone(trajectory_file: Path) -> None:
    data, rows = tiny.data_module(trajectory_file), list[int]()
    phase = build(tiny.policy(data), ["tcc"])
    phase.policy.encoder.register_forward_hook(lambda module, args, out: rows.append(len(out)))
    for half in (False, True):
        for _, batch in zip(range(3), data.loader(phase.batch_spec), strict=False):
            with torch.autocast("cpu", torch.bfloat16, enabled=half):
                phase.training_step(batch, 0)
    assert sum(rows[3:]) > sum(rows[:3])
    assert all(half >= single for single, half in zip(rows[:3], rows[3:], strict=True))
