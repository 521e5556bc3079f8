"""Alignment terms: injected, each with its weight, its networks and what it asks batches for."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest
import seen
import tiny
import torch
from lightning.pytorch import Trainer
from torch import Tensor, nn

from datamodules.errors import ConfigError
from datamodules.transfer import TransferDataModule
from datamodules.types import BatchSpec
from plp_lightning.methods.plp import Alignment, PortablePolicy
from plp_lightning.methods.plp.losses import mmd, tcc
from plp_lightning.methods.plp.terms import (
    MMD,
    TCC,
    AlignmentTerm,
    DomainAdversarial,
    EncodedBatch,
    ImageReconstruction,
    TermFactory,
)


class Centred(AlignmentTerm):
    """A term of a user's own, with a parameter: the distance of latent states from a learned centre."""

    def __init__(self, policy: PortablePolicy, weight: float = 0.5) -> None:
        super().__init__(policy)
        self.weight, self.centre = weight, nn.Parameter(torch.ones(policy.latent_size))

    def forward(self, batch: EncodedBatch) -> dict[str, tuple[Tensor, float]]:
        latents = torch.cat([*batch.latent.values()])
        return {"centred": ((latents - self.centre).square().mean(), self.weight)}


class Recorded(Alignment):
    logs_now = True  # type: ignore[assignment]

    def log_parts(self, parts: dict[str, Tensor], batch_size: int) -> None:
        self.parts = parts


@pytest.fixture
def data(trajectory_file: Path) -> TransferDataModule:
    return tiny.data_module(trajectory_file)


def encoded(data: TransferDataModule, policy: PortablePolicy) -> EncodedBatch:
    batch = next(iter(data.loader(BatchSpec(pairs="thinned"))))
    latent = {d: policy.encode({d: s.observation})[d] for d, s in batch.steps.items()}
    frames = {d: policy.encode({d: s.observation})[d] for d, s in batch.pairs.items()}
    return EncodedBatch(latent, batch.steps, frames, batch.pairs)


def test_thin_terms_are_their_functions_with_a_weight_beside(data: TransferDataModule) -> None:
    policy = tiny.policy(data)
    batch = encoded(data, policy)
    ((loss, weight),) = MMD(policy, 0.3, (1.0, 0.2), False)(batch).values()
    torch.testing.assert_close(loss, mmd([*batch.latent.values()], False, (1.0, 0.2)))
    assert weight == 0.3
    (u, of_u), (v, of_v) = ((batch.pair_latent[d][s.frame], s.mask) for d, s in batch.pairs.items())
    for reduction in ("mean", "sum"):
        ((loss, weight),) = TCC(policy, 0.7, reduction=reduction)(batch).values()
        torch.testing.assert_close(loss, tcc(u, of_u, v, of_v, reduction=reduction))
        assert weight == 0.7


def test_the_discriminator_has_the_sizes_asked_for_and_counts_fully(data: TransferDataModule) -> None:
    policy = tiny.policy(data)
    term = DomainAdversarial(policy, 0.2, 0.4, layers=2, hidden=5)
    assert [layer.out_features for layer in term.modules() if isinstance(layer, nn.Linear)] == [5, 5, 2]
    weights = {name: weight for name, (_, weight) in term(encoded(data, policy)).items()}
    assert weights == {"adversarial": 0.2, "discriminator": 1.0, "penalty": 0.4}
    assert "penalty" not in DomainAdversarial(policy, penalty_weight=0.0)(encoded(data, policy))


def test_where_nothing_is_seen_nothing_is_reconstructed(data: TransferDataModule) -> None:
    policy = tiny.policy(data)
    term = ImageReconstruction(policy)
    assert term.image_decoder is None
    assert term(encoded(data, policy)) == {}


def test_reconstruction_is_of_every_domains_images(seen_file: Path) -> None:
    data = seen.data_module(seen_file)
    policy = seen.policy(data)
    term, batch = ImageReconstruction(policy, 0.25), encoded(data, policy)
    ((loss, weight),) = term(batch).values()
    assert weight == 0.25
    errors = [
        (made - batch.steps[d].observation.images[name].float() / 255).square().mean().item()
        for (d, name), made in term.reconstruct(batch.latent).items()
    ]
    assert len(errors) == 2
    assert loss.item() == pytest.approx(sum(errors) / 2, rel=1e-4)


@pytest.mark.parametrize(
    ("terms", "pairs"),
    [({}, "none"), ({"a": MMD}, "none"), ({"a": TCC}, "thinned"), ({"a": Centred, "b": TCC}, "thinned")],
)
def test_batches_hold_pairs_if_a_term_compares_them(
    terms: dict[str, TermFactory], pairs: str, data: TransferDataModule
) -> None:
    assert Alignment(tiny.policy(data), terms).batch_spec == BatchSpec(pairs=pairs)  # type: ignore[arg-type]


def test_a_term_of_ones_own_counts_is_logged_and_trained(
    data: TransferDataModule, make_trainer: Callable[..., Trainer]
) -> None:
    phase = Recorded(tiny.policy(data), {"mine": Centred})
    batch = next(iter(data.loader(phase.batch_spec)))
    total = phase.training_step(batch, 0)
    assert set(phase.parts) == {"bc", "centred", "loss", "latent_std"}
    torch.testing.assert_close(total, phase.parts["bc"] + 0.5 * phase.parts["centred"])
    before = phase.terms["mine"].centre.clone()
    make_trainer(epochs=1).fit(phase, datamodule=data)
    assert not torch.equal(phase.terms["mine"].centre, before)
    assert not [name for name in phase.policy.state_dict() if "centre" in name]


def test_two_terms_of_one_class_stand_side_by_side(data: TransferDataModule) -> None:
    phase = Recorded(tiny.policy(data), {"one": Centred, "two": partial(Centred, weight=2.0)})
    assert [term.weight for term in phase.alignment_terms] == [0.5, 2.0]
    assert {n for n in phase.state_dict() if n.startswith("terms.")} == {"terms.one.centre", "terms.two.centre"}


def test_without_terms_nothing_is_aligned(data: TransferDataModule) -> None:
    phase = Recorded(tiny.policy(data))
    total = phase.training_step(next(iter(data.loader(phase.batch_spec))), 0)
    assert set(phase.parts) == {"bc", "loss", "latent_std"}
    assert torch.equal(total, phase.parts["bc"])


@pytest.mark.parametrize(
    ("make", "told"),
    [
        (lambda policy: DomainAdversarial(policy, layers=0), r"DomainAdversarial\.layers is 0; .*from 1 to 1000"),
        (lambda policy: DomainAdversarial(policy, hidden=0), r"DomainAdversarial\.hidden is 0; .*at least 1"),
        (lambda policy: TCC(policy, weight=float("nan")), r"TCC\.weight is nan; expected a number, at least 0"),
        (lambda policy: MMD(policy, bandwidths=()), r"MMD\.bandwidths is empty"),
    ],
)
def test_wrong_settings_of_terms_are_told(make: TermFactory, told: str, data: TransferDataModule) -> None:
    with pytest.raises(ConfigError, match=told):
        make(tiny.policy(data))
