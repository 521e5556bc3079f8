from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import combinations

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from plp_lightning.methods.plp.losses import mmd
from plp_lightning.methods.plp.losses.mmd import pair_weights


def by_loops(latents: Sequence[Tensor], bandwidth: float = 1.0) -> float:
    """The paper's formula, one pair of rows after the other."""
    rows = [latent.tolist() for latent in latents]
    pooled = [row for domain in rows for row in domain]
    mean = sum(math.dist(a, b) for a, b in combinations(pooled, 2)) / math.comb(len(pooled), 2)

    def expectation(xs: list[list[float]], ys: list[list[float]]) -> float:
        width = bandwidth * mean
        return sum(math.exp(-((math.dist(x, y) / width) ** 2)) for x in xs for y in ys) / (len(xs) * len(ys))

    pairs = [expectation(x, x) + expectation(y, y) - 2 * expectation(x, y) for x, y in combinations(rows, 2)]
    return sum(pairs) / len(pairs)


def by_differentiation(latents: Sequence[Tensor], scale_gradient: bool = True) -> tuple[Tensor, Tensor]:
    """Value and gradient for two domains in float64 from exact distances, differentiated by autograd."""
    pooled = torch.cat(list(latents)).double().requires_grad_()
    distance = torch.cdist(pooled, pooled, compute_mode="donot_use_mm_for_euclid_dist")
    mean = distance.sum() / (len(pooled) * (len(pooled) - 1))
    mean = mean if scale_gradient else mean.detach()
    kernel, n = torch.exp(-((distance / mean) ** 2)), len(latents[0])
    loss = kernel[:n, :n].mean() + kernel[n:, n:].mean() - 2 * kernel[:n, n:].mean()
    loss.backward()
    return loss.detach(), gradient(pooled)


def value_and_gradient(latents: Sequence[Tensor], scale_gradient: bool = True) -> tuple[Tensor, Tensor]:
    leaves = [latent.clone().requires_grad_() for latent in latents]
    loss = mmd(leaves, scale_gradient)
    loss.backward()
    return loss.detach(), torch.cat([gradient(leaf) for leaf in leaves])


def gradient(leaf: Tensor) -> Tensor:
    assert leaf.grad is not None
    return leaf.grad


def normal(*sizes: int, width: int = 3, seed: int = 0, dtype: torch.dtype = torch.float64) -> list[Tensor]:
    generator = torch.Generator().manual_seed(seed)
    return [torch.randn(size, width, generator=generator, dtype=dtype) + 0.3 * d for d, size in enumerate(sizes)]


def test_two_points_each_by_hand() -> None:
    # Domains at distance d: 8 of 12 ordered pairs are d apart, so m = 2 d / 3, and the loss is 2 - 2 exp(-9/4).
    latents = [torch.zeros(2, 1), torch.full((2, 1), 7.0)]
    assert mmd(latents).item() == pytest.approx(2 - 2 * math.exp(-9 / 4), rel=1e-6)


@pytest.mark.parametrize("sizes", [(5, 5), (1, 6), (1, 1), (4, 2, 3), (2, 3, 1, 4)])
def test_equals_the_formula_by_loops(sizes: tuple[int, ...]) -> None:
    latents = normal(*sizes)
    assert mmd(latents).item() == pytest.approx(by_loops(latents), rel=1e-10)


def test_several_bandwidths_add_up() -> None:
    latents, bandwidths = normal(4, 2, 3), (1.0, 0.5, 0.2)
    expected = sum(by_loops(latents, bandwidth) for bandwidth in bandwidths)
    assert mmd(latents, bandwidths=bandwidths).item() == pytest.approx(expected, rel=1e-10)


def test_narrow_kernels_see_a_gap_that_changes_its_direction_from_place_to_place() -> None:
    places = 6 * torch.rand(1000, 2, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    gap = 1 - 2 * (places.floor().sum(1, keepdim=True) % 2)  # up or down like the fields of a chessboard
    above, below = (
        torch.cat([half, side * gap[i::2]], dim=1)
        for i, (side, half) in enumerate([(0.5, places[::2]), (-0.5, places[1::2])])
    )
    wide, narrow = (mmd([above, below], bandwidths=[bandwidth]).item() for bandwidth in (1.0, 0.25))
    assert narrow > 5 * wide


@given(
    st.lists(
        st.lists(st.tuples(*[st.floats(-50, 50, allow_subnormal=False)] * 2), min_size=1, max_size=5),
        min_size=2,
        max_size=4,
    )
)
@settings(max_examples=60, deadline=None)
def test_is_finite_not_negative_and_the_formula_for_any_points(rows: list[list[tuple[float, float]]]) -> None:
    latents = [torch.tensor(domain, dtype=torch.float64) for domain in rows]
    loss, slope = value_and_gradient(latents)
    assert loss >= -1e-12
    assert slope.isfinite().all()
    pooled = torch.cat(latents)
    if torch.cdist(pooled, pooled).max() > 1e-3:
        assert loss.item() == pytest.approx(by_loops(latents), abs=1e-7)


def test_zero_on_equal_sets_whatever_their_order() -> None:
    (latent,) = normal(7)
    assert mmd([latent, latent.flip(0)]).item() == pytest.approx(0, abs=1e-15)


def test_is_symmetric_and_grows_with_the_gap() -> None:
    x, y = normal(6, 9)
    assert mmd([x, y]).item() == pytest.approx(mmd([y, x]).item(), rel=1e-12)
    gaps = [mmd([x, y + shift]).item() for shift in (0.0, 1.0, 2.0, 4.0)]
    assert gaps == sorted(gaps)
    assert gaps[-1] > 5 * gaps[0]


@pytest.mark.parametrize("scale", [1e-4, 3.0, 1e4])
def test_scale_changes_nothing_but_the_length_of_the_gradient(scale: float) -> None:
    latents = normal(6, 9)
    loss, slope = value_and_gradient(latents)
    scaled, scaled_slope = value_and_gradient([scale * latent for latent in latents])
    torch.testing.assert_close(scaled, loss)
    torch.testing.assert_close(scaled_slope * scale, slope)


def test_translation_changes_nothing() -> None:
    latents = normal(6, 9)
    moved = [latent + torch.tensor([5.0, -70.0, 300.0]) for latent in latents]
    for ours, theirs in zip(value_and_gradient(moved), value_and_gradient(latents), strict=True):
        torch.testing.assert_close(ours, theirs)


def test_gradient_neither_scales_nor_moves_the_latents() -> None:
    latents = normal(6, 9)
    _, slope = value_and_gradient(latents)
    assert slope.norm() > 0.01
    assert (slope * torch.cat(latents)).sum().item() == pytest.approx(0, abs=1e-14)
    assert slope.sum(0).tolist() == pytest.approx([0, 0, 0], abs=1e-14)


@pytest.mark.parametrize("scale_gradient", [True, False])
def test_the_scale_is_differentiated_or_constant(scale_gradient: bool) -> None:
    latents = normal(6, 9)
    found = value_and_gradient(latents, scale_gradient)
    for ours, theirs in zip(found, by_differentiation(latents, scale_gradient), strict=True):
        torch.testing.assert_close(ours, theirs)
    others = value_and_gradient(latents, not scale_gradient)
    assert found[0] == others[0]
    assert (found[1] - others[1]).norm() > 0.1 * found[1].norm()


def runaway(scale_gradient: bool) -> float:
    """Slope of the loss along the way of one row, far from all others, further away."""
    first, second = normal(20, 20)
    first[0] = torch.tensor([20.0, 0.0, 0.0])
    _, slope = value_and_gradient([first, second + 1.0], scale_gradient)
    return float(slope[0, 0])


def test_a_row_gains_nothing_by_running_away_if_the_scale_is_constant() -> None:
    assert runaway(scale_gradient=True) < -1e-4
    assert runaway(scale_gradient=False) == pytest.approx(0, abs=1e-8)


@pytest.mark.parametrize("bandwidths", [(1.0,), (1.0, 0.3)])
@pytest.mark.parametrize("sizes", [(4, 3), (2, 3, 2)])
def test_gradient_by_finite_differences(sizes: tuple[int, ...], bandwidths: tuple[float, ...]) -> None:
    leaves = [latent.requires_grad_() for latent in normal(*sizes)]
    assert torch.autograd.gradcheck(lambda *latents: mmd(latents, bandwidths=bandwidths), leaves)


def offset(latent: Tensor) -> Tensor:
    """Moved so far that all rows have a norm of about 140."""
    return latent + 140 / math.sqrt(latent.shape[1])


def twins(latent: Tensor, gap: float) -> Tensor:
    """The second half of the rows all but repeats the first half."""
    half = latent[: len(latent) // 2]
    return torch.cat([half, half + gap * torch.randn(half.shape, generator=torch.Generator().manual_seed(1))])


@pytest.mark.parametrize("size", [64, 256])
@pytest.mark.parametrize(
    "change",
    [
        lambda latent: latent,
        offset,
        lambda latent: offset(0.01 * latent),
        lambda latent: twins(latent, 1e-3),
        lambda latent: twins(latent, 1e-6),
        lambda latent: offset(twins(latent, 1e-2)),
    ],
    ids=["normal", "offset", "narrow and offset", "near-duplicates", "nearer duplicates", "offset near-duplicates"],
)
def test_float32_is_as_good_as_float64(change, size: int) -> None:
    latents = [change(latent) for latent in normal(size, size, width=192, dtype=torch.float32)]
    loss, slope = value_and_gradient(latents)
    exact_loss, exact_slope = by_differentiation(latents)
    assert loss.dtype == slope.dtype == torch.float32
    assert loss.item() == pytest.approx(exact_loss.item(), rel=1e-4)
    assert (slope - exact_slope).norm() < 1e-3 * exact_slope.norm()


def test_float32_gradient_stays_small_where_one_domain_all_but_repeats_the_other() -> None:
    x, y = normal(128, 128, width=192, dtype=torch.float32)
    _, apart = value_and_gradient([x, y])
    loss, slope = value_and_gradient([x, x + 1e-5 * y])
    _, exact = by_differentiation([x, x + 1e-5 * y])
    assert abs(loss.item()) < 1e-7
    assert (slope - exact).norm() < 1e-5 * apart.norm()


def test_duplicates_and_collapse_give_no_nan() -> None:
    x, y = normal(4, 4)
    _, slope = value_and_gradient([x[[0, 0, 1]], torch.cat([x[:1], y])])
    assert slope.isfinite().all()
    assert slope.norm() > 0.01
    for place in (0.0, 12.3456):
        loss, slope = value_and_gradient([torch.full((5, 3), place), torch.full((4, 3), place)])
        assert loss.item() == pytest.approx(0, abs=1e-6)
        assert slope.abs().max() == 0


def test_autocast_and_half_precision_latents_are_compared_in_float32() -> None:
    latents = [latent.bfloat16() for latent in normal(32, 32, width=16)]
    expected = mmd([latent.float() for latent in latents])
    with torch.autocast("cpu", dtype=torch.bfloat16):
        assert mmd(latents) == expected
        assert mmd([latent.float() for latent in latents]) == expected


def test_weights_make_the_mean_over_pairs_of_domains() -> None:
    weights = pair_weights([1, 2, 4], torch.zeros(1, dtype=torch.float64))
    assert weights.sum().item() == pytest.approx(0, abs=1e-15)
    assert weights[0, 0].item() == pytest.approx(2 / 3)
    assert weights[1, 2].item() == pytest.approx(2 / 3 / 4)
    assert weights[0, 6].item() == pytest.approx(-1 / 3 / 4)
    torch.testing.assert_close(weights, weights.T)


def test_shapes_are_checked() -> None:
    with pytest.raises(AssertionError, match="at least two domains, got 1"):
        mmd([torch.zeros(3, 2)])
    with pytest.raises(AssertionError, match=r"expected \(B_d, Z\), got \[\(3, 2\), \(3, 4\)\]"):
        mmd([torch.zeros(3, 2), torch.zeros(3, 4)])
    with pytest.raises(AssertionError, match=r"expected \(B_d, Z\), got \[\(3, 2\), \(0, 2\)\]"):
        mmd([torch.zeros(3, 2), torch.zeros(0, 2)])
