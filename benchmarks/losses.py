"""Forward and backward of the losses against the plain ways to write them."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence

import torch
from torch import Tensor

from benchmarks.measuring import Bar, Options, Row, at_most, in_turn, ratio, timed
from plp_lightning.methods.plp.losses import mmd, tcc

WIDTH = 192
PRECISE, PRODUCT = "donot_use_mm_for_euclid_dist", "use_mm_for_euclid_dist"


def mmd_by_cdist(latents: Sequence[Tensor], mode: str) -> Tensor:
    pooled, n = torch.cat(list(latents)), len(latents[0])
    distance = torch.cdist(pooled, pooled, compute_mode=mode)
    kernel = torch.exp(-((distance * (len(pooled) * (len(pooled) - 1)) / distance.sum()) ** 2))
    return kernel[:n, :n].mean() + kernel[n:, n:].mean() - 2 * kernel[:n, n:].mean()


def tcc_by_pairs(first: Tensor, first_mask: Tensor, second: Tensor, second_mask: Tensor) -> Tensor:
    losses = []
    for u, u_mask, v, v_mask in zip(first, first_mask, second, second_mask, strict=True):
        for own, other in ((u[u_mask], v[v_mask]), (v[v_mask], u[u_mask])):
            near = torch.softmax(-torch.cdist(own, other), dim=1) @ other
            losses.append(torch.nn.functional.cross_entropy(-(torch.cdist(near, own) ** 2), torch.arange(len(own))))
    return torch.stack(losses).mean()


def compared(name: str, ours: Callable[[], Tensor], plain: Callable[[], Tensor], bar: Bar | None, rounds: int) -> Row:
    """The row of a loss and its gradient against another way, in processor time."""
    ways = {
        way: timed(lambda loss=loss: torch.autograd.backward(loss()), clock=time.process_time)  # type: ignore[misc]
        for way, loss in (("ours", ours), ("plain", plain))
    }
    return ratio(name, in_turn(ways, rounds, warm=3), "ours", "plain", bar)


def rows(options: Options) -> Iterator[Row]:
    torch.manual_seed(0)
    rounds, sizes = options.pick(60, 15), (256, 128)
    for size in sizes[: options.pick(2, 1)]:
        latents = [torch.randn(size, WIDTH, requires_grad=True) for _ in range(2)]
        name = f"MMD of 2 × {size} latents / cdist"
        for mode, told, bar in ((PRECISE, "exact", at_most(1.0)), (PRODUCT, "by products", None)):
            plain = lambda latents=latents, mode=mode: mmd_by_cdist(latents, mode)  # noqa: E731
            yield compared(f"{name}, {told}", lambda latents=latents: mmd(latents), plain, bar, rounds)  # type: ignore[misc]
    walks = [torch.randn(64, 16, WIDTH, requires_grad=True) for _ in range(2)]
    masks = [torch.arange(16) < torch.randint(5, 17, (64, 1)) for _ in range(2)]
    args = walks[0], masks[0], walks[1], masks[1]
    name = "TCC of 64 pairs of 16 frames / pair by pair"
    yield compared(name, lambda: tcc(*args), lambda: tcc_by_pairs(*args), at_most(1.0), rounds)
