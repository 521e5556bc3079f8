from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor

from datamodules.errors import UserError
from plp_lightning.evaluation.alignment import Closeness, TopAccuracy, closeness, top_accuracy


def sets(*shapes: tuple[int, int], seed: int = 0) -> list[Tensor]:
    generator = torch.Generator().manual_seed(seed)
    return [torch.randn(shape, generator=generator) for shape in shapes]


def closeness_by_loops(latent_a: Tensor, latent_b: Tensor, position_a: Tensor, position_b: Tensor) -> float:
    a = list(zip(latent_a.tolist(), position_a.tolist(), strict=True))
    b = list(zip(latent_b.tolist(), position_b.tolist(), strict=True))
    distances = sorted(math.dist(z, w) for z, _ in a for w, _ in b)
    quantile = distances[int(0.05 * len(distances))]

    def share(own: list, other: list) -> float:
        partners = [min(other, key=lambda state: math.dist(p, state[1]))[0] for _, p in own]
        return sum(math.dist(z, w) < quantile for (z, _), w in zip(own, partners, strict=True)) / len(own)

    return (share(a, b) + share(b, a)) / 2


def top_accuracy_by_loops(latent_a: Tensor, latent_b: Tensor, k: int) -> float:
    a, b = latent_a.tolist(), latent_b.tolist()
    hits = 0
    for own, other in ((a, b), (b, a)):
        for i, z in enumerate(own):
            hits += i in sorted(range(len(other)), key=lambda j: math.dist(z, other[j]))[:k]
    return hits / (2 * len(a))


@pytest.mark.parametrize(("n", "m"), [(12, 12), (10, 17), (40, 3), (1, 20)])
def test_closeness_equals_loops(n: int, m: int) -> None:
    latent_a, latent_b, position_a, position_b = sets((n, 4), (m, 4), (n, 2), (m, 2))
    # Latents that know something of the position, so that the score is neither 0 nor 1.
    latent_a[:, :2], latent_b[:, :2] = latent_a[:, :2] + 2 * position_a, latent_b[:, :2] + 2 * position_b
    score = closeness(latent_a, latent_b, position_a, position_b)
    assert score.item() == pytest.approx(closeness_by_loops(latent_a, latent_b, position_a, position_b))


def test_closeness_by_hand() -> None:
    # 5 x 4 = 20 pairs, so exactly the single nearest pair of latents is close: a0 and b0, 0.1 apart. Both have
    # each other as partner: 1 of 5 states in the one direction, 1 of 4 in the other.
    latent_a = torch.tensor([[0.0], [10.0], [20.0], [30.0], [40.0]])
    latent_b = torch.tensor([[0.1], [13.0], [24.0], [35.0]])
    position_a, position_b = torch.arange(5.0)[:, None], torch.arange(4.0)[:, None]
    assert closeness(latent_a, latent_b, position_a, position_b).item() == pytest.approx((1 / 5 + 1 / 4) / 2)


def test_closeness_is_one_if_latents_are_positions_and_chance_if_they_know_nothing() -> None:
    noise_a, noise_b = sets((600, 8), (600, 8))
    position_a, position_b = torch.rand(2, 600, 2, generator=torch.Generator().manual_seed(1))
    assert closeness(3 * position_a, 3 * position_b, position_a, position_b).item() == 1
    assert closeness(noise_a, noise_b, position_a, position_b).item() == pytest.approx(0.05, abs=0.025)


def test_closeness_does_not_reward_collapse() -> None:
    position_a, position_b = sets((30, 2), (30, 2))
    constant = torch.full((30, 4), 0.3)
    assert closeness(constant, constant, position_a, position_b).item() == 0


def test_closeness_needs_twenty_pairs() -> None:
    latent_a, latent_b = sets((3, 2), (6, 2))
    with pytest.raises(UserError, match="found 18 pairs of states; expected at least 20: evaluate more states"):
        closeness(latent_a, latent_b, latent_a, latent_b)


@pytest.mark.parametrize("k", [1, 3, 5])
def test_top_accuracy_equals_loops(k: int) -> None:
    latent_a, noise = sets((30, 4), (30, 4))
    latent_b = latent_a + 0.7 * noise
    assert top_accuracy(latent_a, latent_b, k).item() == pytest.approx(top_accuracy_by_loops(latent_a, latent_b, k))


def test_top_accuracy_by_hand() -> None:
    latent_a, latent_b = torch.tensor([[0.0], [1.0], [5.0]]), torch.tensor([[0.9], [1.9], [5.9]])
    # Top 1: a0 and a2 find theirs (a1 finds b0); b0 finds a1, b1 finds a1, b2 finds a2: 2/3 and 2/3.
    assert top_accuracy(latent_a, latent_b, 1).item() == pytest.approx(2 / 3)
    assert top_accuracy(latent_a, latent_b, 2).item() == 1


def test_top_accuracy_averages_both_directions() -> None:
    # All of a finds its own b except a1 (finds b0); from b, nearest a of b0 is a1 as well.
    latent_a, latent_b = torch.tensor([[0.0], [3.0]]), torch.tensor([[2.0], [100.0]])
    # a0 → b0 right, a1 → b0 wrong; b0 → a1 wrong, b1 → a1 right.
    assert top_accuracy(latent_a, latent_b, 1).item() == pytest.approx(0.5)
    latent_b = torch.tensor([[1.0], [100.0]])
    # a0 → b0 right, a1 → b0 wrong; b0 → a0 right, b1 → a1 right.
    assert top_accuracy(latent_a, latent_b, 1).item() == pytest.approx(0.75)


def test_top_accuracy_of_collapsed_latents_is_chance() -> None:
    constant = torch.full((50, 4), 0.3)
    assert top_accuracy(constant, constant, 1).item() == pytest.approx(1 / 50)
    assert top_accuracy(constant, constant, 5).item() == pytest.approx(5 / 50)


def test_top_accuracy_tells_neighbours_apart_far_from_the_origin() -> None:
    (latent,) = sets((200, 192))
    latent = 0.01 * latent + 10
    assert top_accuracy(latent, latent + 1e-4, 1).item() == 1


def test_shapes_are_checked() -> None:
    three, four = torch.zeros(5, 3), torch.zeros(5, 4)
    with pytest.raises(AssertionError, match=r"expected \(N, Z\) and \(M, Z\), got \(5, 3\) and \(5, 4\)"):
        closeness(three, four, three, three)
    with pytest.raises(AssertionError, match=r"\(5, 5\) pairs of latents, \(4, 5\) of positions"):
        closeness(three, three, three[:4], three)
    with pytest.raises(AssertionError, match="expected as many rows in both, got 5 and 4"):
        top_accuracy(three, three[:4], 1)
    with pytest.raises(AssertionError, match="expected k >= 1, got 0"):
        top_accuracy(three, three, 0)


def test_closeness_metric_sees_all_batches_until_reset() -> None:
    states = sets((30, 4), (26, 4), (30, 2), (26, 2))
    metric = Closeness()
    metric.update(states[0][:13], states[1][:5], states[2][:13], states[3][:5])
    metric.update(states[0][13:], states[1][5:], states[2][13:], states[3][5:])
    assert metric.compute() == closeness(*states)
    metric.reset()
    metric.update(*[states[2], states[3]] * 2)
    assert metric.compute() == closeness(*[states[2], states[3]] * 2)


def test_top_accuracy_metric_sees_all_batches_until_reset() -> None:
    latent_a, noise = sets((30, 4), (30, 4))
    latent_b = latent_a + 0.7 * noise
    metric = TopAccuracy(k=3)
    for rows in (slice(0, 11), slice(11, 30)):
        metric.update(latent_a[rows], latent_b[rows])
    assert metric.compute() == top_accuracy(latent_a, latent_b, 3)
    metric.reset()
    metric.update(latent_a, latent_a)
    assert metric.compute() == 1


@pytest.mark.parametrize("metric", [Closeness(), TopAccuracy(k=5)])
def test_metrics_join_the_states_of_all_processes(metric: Closeness | TopAccuracy) -> None:
    assert metric.higher_is_better
    assert not metric.is_differentiable
    assert not metric.full_state_update
    joined = {name: reduce([torch.zeros(2, 3), torch.ones(1, 3)]) for name, reduce in metric._reductions.items()}
    assert {tuple(state.shape) for state in joined.values()} == {(3, 3)}
