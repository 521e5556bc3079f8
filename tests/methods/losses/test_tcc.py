from __future__ import annotations

import math
from typing import Literal, get_args

import pytest
import torch
from torch import Tensor

from plp_lightning.methods.plp.losses import tcc

Softmax = Literal["distance", "squared", "scaled"]
Reduction = Literal["mean", "sum"]


def softmax(logits: list[float]) -> list[float]:
    top = max(logits)
    weights = [math.exp(logit - top) for logit in logits]
    return [weight / sum(weights) for weight in weights]


def cycle(u: list[list[float]], v: list[list[float]], kind: Softmax) -> list[float]:
    """Loss of each frame of u on its way u → v → u, by the paper's formula."""
    logit = {
        "distance": lambda a, b: -math.dist(a, b),
        "squared": lambda a, b: -(math.dist(a, b) ** 2),
        "scaled": lambda a, b: -(math.dist(a, b) ** 2) / (0.1 * len(a)),
    }[kind]
    losses = []
    for i, frame in enumerate(u):
        weights = softmax([logit(frame, other) for other in v])
        near = [sum(w * other[z] for w, other in zip(weights, v, strict=True)) for z in range(len(frame))]
        losses.append(-math.log(softmax([-(math.dist(near, other) ** 2) for other in u])[i]))
    return losses


def by_loops(pairs: list[tuple[Tensor, Tensor]], kind: Softmax, reduction: Reduction) -> float:
    total = 0.0
    for u, v in pairs:
        for there, back in ((u.tolist(), v.tolist()), (v.tolist(), u.tolist())):
            losses = cycle(there, back, kind)
            total += (sum(losses) / (len(losses) if reduction == "mean" else 1)) / 2
    return total / len(pairs)


def demonstrations(
    lengths: list[tuple[int, int]], width: int = 3, dtype: torch.dtype = torch.float64
) -> list[tuple[Tensor, Tensor]]:
    generator = torch.Generator().manual_seed(0)
    return [
        (
            torch.randn(first, width, generator=generator, dtype=dtype),
            torch.randn(second, width, generator=generator, dtype=dtype),
        )
        for first, second in lengths
    ]


def pad(sequences: list[Tensor], length: int, filler: float) -> tuple[Tensor, Tensor]:
    padded = sequences[0].new_full((len(sequences), length, sequences[0].shape[1]), filler)
    mask = torch.zeros(len(sequences), length, dtype=torch.bool)
    for p, sequence in enumerate(sequences):
        padded[p, : len(sequence)], mask[p, : len(sequence)] = sequence, True
    return padded, mask


def batch(pairs: list[tuple[Tensor, Tensor]], spare: int = 0, filler: float = 0.0) -> tuple[Tensor, ...]:
    first, second = [u for u, _ in pairs], [v for _, v in pairs]
    return (
        *pad(first, max(map(len, first)) + spare, filler),
        *pad(second, max(map(len, second)) + 2 * spare, filler),
    )


LENGTHS = [(4, 6), (2, 3), (5, 1), (7, 2)]


def test_two_frames_by_hand() -> None:
    # From 0 to (0, 1): weights 1 / (1 + 1/e) and its rest x = 0.26894 = ṽ. Back: the logits differ by
    # (1 - x)² - x² = 1 - 2 x = 0.46212, so the loss is log(1 + exp(-0.46212)); all four cycles look the same.
    walk, valid = torch.tensor([[[0.0], [1.0]]]), torch.ones(1, 2, dtype=torch.bool)
    assert tcc(walk, valid, walk, valid).item() == pytest.approx(0.488551, abs=1e-5)
    assert tcc(walk, valid, walk, valid, reduction="sum").item() == pytest.approx(2 * 0.488551, abs=1e-5)


@pytest.mark.parametrize("kind", get_args(Softmax))
@pytest.mark.parametrize("reduction", get_args(Reduction))
def test_equals_the_formula_by_loops(kind: Softmax, reduction: Reduction) -> None:
    pairs = demonstrations(LENGTHS)
    loss = tcc(*batch(pairs), first_softmax=kind, reduction=reduction)
    assert loss.item() == pytest.approx(by_loops(pairs, kind, reduction), rel=1e-10)


@pytest.mark.parametrize("reduction", get_args(Reduction))
def test_a_batch_is_the_mean_over_its_pairs(reduction: Reduction) -> None:
    pairs = demonstrations(LENGTHS)
    alone = [tcc(*batch([pair]), reduction=reduction) for pair in pairs]
    torch.testing.assert_close(tcc(*batch(pairs), reduction=reduction), torch.stack(alone).mean())


def test_both_domains_are_treated_alike() -> None:
    first, first_mask, second, second_mask = batch(demonstrations(LENGTHS))
    torch.testing.assert_close(tcc(second, second_mask, first, first_mask), tcc(first, first_mask, second, second_mask))


@pytest.mark.parametrize("kind", get_args(Softmax))
def test_frames_far_apart_find_themselves(kind: Softmax) -> None:
    walk = torch.eye(6)[None] * 50
    valid = torch.ones(1, 6, dtype=torch.bool)
    assert tcc(walk, valid, walk, valid, kind).item() == pytest.approx(0, abs=1e-6)
    shuffled = walk[:, [3, 1, 5, 0, 2, 4]]
    assert tcc(walk, valid, shuffled, valid, kind).item() == pytest.approx(0, abs=1e-6)


def test_frames_that_look_alike_are_guessed() -> None:
    still, valid = torch.ones(1, 5, 3), torch.ones(1, 5, dtype=torch.bool)
    assert tcc(still, valid, still, valid).item() == pytest.approx(math.log(5), rel=1e-6)


@pytest.mark.parametrize("kind", get_args(Softmax))
@pytest.mark.parametrize("filler", [0.0, -3.0, 1e6])
def test_padding_does_not_matter(kind: Softmax, filler: float) -> None:
    pairs = demonstrations(LENGTHS, dtype=torch.float32)
    first, first_mask, second, second_mask = batch(pairs)
    longer, longer_mask, other, other_mask = batch(pairs, spare=3, filler=filler)
    leaves = [tensor.requires_grad_() for tensor in (first, second, longer, other)]
    short, long = tcc(first, first_mask, second, second_mask, kind), tcc(longer, longer_mask, other, other_mask, kind)
    torch.testing.assert_close(long, short)
    first_grad, second_grad, longer_grad, other_grad = torch.autograd.grad(short + long, leaves)
    torch.testing.assert_close(longer_grad[longer_mask], first_grad[first_mask])
    torch.testing.assert_close(other_grad[other_mask], second_grad[second_mask])
    assert longer_grad[~longer_mask].abs().max() == 0
    assert other_grad[~other_mask].abs().max() == 0


def test_single_frames_cost_nothing() -> None:
    assert tcc(*batch(demonstrations([(1, 1), (1, 1)]))).item() == 0


def test_translation_changes_nothing() -> None:
    first, first_mask, second, second_mask = batch(demonstrations(LENGTHS))
    torch.testing.assert_close(
        tcc(first + 40, first_mask, second + 40, second_mask), tcc(first, first_mask, second, second_mask)
    )


@pytest.mark.parametrize("kind", get_args(Softmax))
def test_gradient_by_finite_differences(kind: Softmax) -> None:
    first, first_mask, second, second_mask = batch(demonstrations([(3, 4), (2, 3)], width=2))
    leaves = first.requires_grad_(), second.requires_grad_()
    assert torch.autograd.gradcheck(lambda u, v: tcc(u, first_mask, v, second_mask, kind), leaves)


def test_equal_frames_give_no_nan() -> None:
    (u, v), *_ = demonstrations([(4, 4)], dtype=torch.float32)
    first = torch.cat([u, u[:1], v]).requires_grad_()
    valid = torch.ones(1, len(first), dtype=torch.bool)
    tcc(first[None], valid, first[None], valid).backward()
    assert first.grad is not None
    assert first.grad.isfinite().all()
    assert first.grad.norm() > 1e-3


def worst_gradient_error(ours: list[Tensor], exact: list[Tensor]) -> float:
    return max(((a - b).norm() / b.norm()).item() for a, b in zip(ours, exact, strict=True))


@pytest.mark.parametrize("shift", [0.0, 10.0])
def test_float32_is_as_good_as_float64(shift: float) -> None:
    pairs = [(0.5 * u + shift, 0.5 * v + shift) for u, v in demonstrations([(12, 16)] * 8, 192, torch.float32)]
    first, first_mask, second, second_mask = batch(pairs)
    leaves = [first.requires_grad_(), second.requires_grad_()]
    doubles = [leaf.detach().double().requires_grad_() for leaf in leaves]
    loss, exact = (
        tcc(leaves[0], first_mask, leaves[1], second_mask),
        tcc(doubles[0], first_mask, doubles[1], second_mask),
    )
    assert loss.item() == pytest.approx(exact.item(), rel=1e-4)
    error = worst_gradient_error(list(torch.autograd.grad(loss, leaves)), list(torch.autograd.grad(exact, doubles)))
    assert error < 1e-3


def test_autocast_and_half_precision_latents_are_compared_in_float32() -> None:
    first, first_mask, second, second_mask = batch(demonstrations(LENGTHS))
    half = first.bfloat16(), second.bfloat16()
    expected = tcc(half[0].float(), first_mask, half[1].float(), second_mask)
    with torch.autocast("cpu", dtype=torch.bfloat16):
        assert tcc(half[0], first_mask, half[1], second_mask) == expected
        assert tcc(half[0].float(), first_mask, half[1].float(), second_mask) == expected


def test_shapes_are_checked() -> None:
    latent, mask = torch.zeros(2, 3, 4), torch.ones(2, 3, dtype=torch.bool)
    with pytest.raises(AssertionError, match=r"expected latents \(P, T, Z\), got \(3, 4\)"):
        tcc(latent[0], mask, latent, mask)
    with pytest.raises(AssertionError, match=r"expected latents \(2, 3, 4\), got \(1, 3, 4\)"):
        tcc(latent, mask, latent[:1], mask)
    with pytest.raises(AssertionError, match=r"expected a mask \(2, 3\), got \(2, 2\)"):
        tcc(latent, mask, latent, mask[:, :2])
    with pytest.raises(AssertionError, match=r"expected a bool mask, got torch\.float32"):
        tcc(latent, mask.float(), latent, mask)
