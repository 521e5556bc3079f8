"""Alignment of the latent space: do states that correspond lie close together?"""

from __future__ import annotations

import torch
from torch import Tensor
from torchmetrics import Metric
from torchmetrics.utilities import dim_zero_cat

from datamodules.errors import UserError

CLOSEST = 0.05  # share of all cross-domain pairs that counts as close; so much is scored by chance


def closeness(latent_a: Tensor, latent_b: Tensor, position_a: Tensor, position_b: Tensor) -> Tensor:
    """Probability that corresponding states are among the closest 5 % of all cross-domain pairs of latents.

    A state corresponds to that state of the other domain whose position is nearest. Mean of both directions. Chance
    scores 0.05; latents that are all the same score 0, since none of their distances is below the quantile. See
    https://arxiv.org/abs/2407.16912, section 5.3 and its appendix.

    Args:
        latent_a: ``(N, Z)``.
        latent_b: ``(M, Z)``; N M distances are held at once, 16 MB for 2000 states each.
        position_a: ``(N, P)``, in coordinates that the domains share: of the agent or the end effector, m.
        position_b: ``(M, P)``.

    Returns:
        Scalar in [0, 1].

    Raises:
        UserError: If there are fewer than 20 pairs, too few for a 5 % quantile.

    Example:
        >>> line = torch.arange(100.0).view(-1, 1)
        >>> closeness(line, line, line, line), closeness(line, line + 500, line, line)
        (tensor(1.), tensor(0.))
    """
    _assert_sets(latent_a, latent_b)
    _assert_sets(position_a, position_b)
    distance, gap = _distances(latent_a, latent_b), _distances(position_a, position_b)
    assert distance.shape == gap.shape, f"{tuple(distance.shape)} pairs of latents, {tuple(gap.shape)} of positions"
    close = distance < _quantile(distance)
    return (_partner_share(close, gap) + _partner_share(close.T, gap.T)) / 2


def top_accuracy(latent_a: Tensor, latent_b: Tensor, k: int) -> Tensor:
    """Share of states whose true partner is among the k latents of the other domain that are nearest.

    Mean of both directions. Of latents that are equally far, any order is equally likely, so that latents that are
    all the same score k / N, as chance does. See https://arxiv.org/abs/2407.16912, section 5.3 and its appendix.

    Args:
        latent_a: ``(N, Z)``.
        latent_b: ``(N, Z)``; row i is the partner of ``latent_a[i]``.
        k: At least 1.

    Returns:
        Scalar in [0, 1].

    Example:
        >>> latent = torch.tensor([[0.0], [1.0], [5.0]])
        >>> top_accuracy(latent, latent + 0.9, k=1), top_accuracy(latent, latent + 0.9, k=2)
        (tensor(0.6667), tensor(1.))
    """
    _assert_sets(latent_a, latent_b)
    assert len(latent_a) == len(latent_b), f"expected as many rows in both, got {len(latent_a)} and {len(latent_b)}"
    assert k >= 1, f"expected k >= 1, got {k}"
    distance = _distances(latent_a, latent_b)
    return (_hit_rate(distance, k) + _hit_rate(distance.T, k)) / 2


class _Collected(Metric):
    """Keeps all states seen since the last reset, a list of tensors for each name."""

    is_differentiable = False
    higher_is_better = True
    full_state_update = False
    names: tuple[str, ...]

    def __init__(self) -> None:
        super().__init__()
        for name in self.names:
            self.add_state(name, default=[], dist_reduce_fx="cat")

    def update(self, *states: Tensor) -> None:
        for name, found in zip(self.names, states, strict=True):
            getattr(self, name).append(found)

    def _seen(self) -> list[Tensor]:
        return [dim_zero_cat(getattr(self, name)) for name in self.names]


class Closeness(_Collected):
    """:func:`closeness` of all states seen since the last reset: latents and positions, as that takes them.

    Example:
        >>> metric, line = Closeness(), torch.arange(100.0).view(-1, 1)
        >>> for half in (line[:50], line[50:]):
        ...     metric.update(half, half, half, half)
        >>> metric.compute()
        tensor(1.)
    """

    names = ("latent_a", "latent_b", "position_a", "position_b")

    def compute(self) -> Tensor:
        return closeness(*self._seen())


class TopAccuracy(_Collected):
    """:func:`top_accuracy` of all true pairs seen since the last reset.

    Args:
        k: Number of nearest latents that may hold the partner.

    Example:
        >>> metric = TopAccuracy(k=1)
        >>> metric.update(torch.tensor([[0.0], [1.0]]), torch.tensor([[0.1], [1.1]]))
        >>> metric.compute()
        tensor(1.)
    """

    names = ("latent_a", "latent_b")

    def __init__(self, k: int = 1) -> None:
        super().__init__()
        self.k = k

    def compute(self) -> Tensor:
        latent_a, latent_b = self._seen()
        return top_accuracy(latent_a, latent_b, self.k)


def _distances(a: Tensor, b: Tensor) -> Tensor:
    """``(N, M)``; not by a matrix product, whose rounding would reorder close neighbours."""
    return torch.cdist(a.float(), b.float(), compute_mode="donot_use_mm_for_euclid_dist")


def _quantile(distance: Tensor) -> Tensor:
    """The distance that 5 % of all pairs, rounded down, are below if no two are equal."""
    count = int(CLOSEST * distance.numel())
    if count == 0:
        raise UserError(f"found {distance.numel()} pairs of states; expected at least 20: evaluate more states")
    return distance.flatten().kthvalue(count + 1).values


def _partner_share(close: Tensor, gap: Tensor) -> Tensor:
    return close.gather(1, gap.argmin(1, keepdim=True)).float().mean()


def _hit_rate(distance: Tensor, k: int) -> Tensor:
    partner = distance.diagonal()[:, None]
    closer, equal = (distance < partner).sum(1), (distance == partner).sum(1)
    return ((k - closer) / equal).clamp(0, 1).mean()


def _assert_sets(a: Tensor, b: Tensor) -> None:
    same = a.ndim == b.ndim == 2 and a.shape[1] == b.shape[1]
    assert same, f"expected (N, Z) and (M, Z), got {tuple(a.shape)} and {tuple(b.shape)}"
