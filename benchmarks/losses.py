"""Forward and backward of the losses against the plain ways to write them; ratios within one run.

python benchmarks/losses.py
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

import torch
from torch import Tensor

from plp_lightning.methods.plp.losses import mmd, tcc

ROUNDS = 60
EXACT, PRODUCT = "donot_use_mm_for_euclid_dist", "use_mm_for_euclid_dist"


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


def seconds(loss: Callable[[], Tensor]) -> float:
    """Processor time of one thread, so that waiting for a busy machine does not count."""
    start = time.process_time()
    torch.autograd.backward(loss())
    return time.process_time() - start


def compare(title: str, ways: dict[str, Callable[[], Tensor]]) -> None:
    """Print the least time of each way, taken in turn so that a busy machine is busy for all, and its ratio."""
    times: dict[str, list[float]] = {name: [] for name in ways}
    for _ in range(ROUNDS):
        for name, loss in ways.items():
            times[name].append(seconds(loss))
    own = min(next(iter(times.values())))
    for name, taken in times.items():
        print(f"{title:22} {name:22} {min(taken) * 1e3:8.2f} ms  {min(taken) / own:6.2f} ×")


def relative_error(value: Tensor, exact: Tensor) -> float:
    return float(((value.double() - exact).norm() / exact.norm()).item())


def accuracy(title: str, latents: Sequence[Tensor]) -> None:
    """Print the errors of the float32 loss and of its gradient against float64 from exact distances."""
    ways: dict[str, Callable[[list[Tensor]], Tensor]] = {
        "mmd": mmd,
        "cdist, exact": lambda latents: mmd_by_cdist(latents, EXACT),
        "cdist, matrix product": lambda latents: mmd_by_cdist(latents, PRODUCT),
    }
    doubles = [latent.double().requires_grad_() for latent in latents]
    exact = mmd_by_cdist(doubles, EXACT)
    exact_slope = torch.cat(torch.autograd.grad(exact, doubles))
    for name, way in ways.items():
        leaves = [latent.clone().requires_grad_() for latent in latents]
        loss = way(leaves)
        slope = torch.cat(torch.autograd.grad(loss, leaves))
        errors = relative_error(loss.detach(), exact.detach()), relative_error(slope, exact_slope)
        print(f"{title:22} {name:22} value off by {errors[0]:.0e}, gradient by {errors[1]:.0e}")


def compare_mmd(latents: list[Tensor]) -> None:
    ways: dict[str, Callable[[], Tensor]] = {
        "mmd": lambda: mmd(latents),
        "mmd, three kernels": lambda: mmd(latents, bandwidths=(1.0, 0.5, 0.25)),
        "cdist, exact": lambda: mmd_by_cdist(latents, EXACT),
        "cdist, matrix product": lambda: mmd_by_cdist(latents, PRODUCT),
    }
    compare(f"MMD 2x{len(latents[0])}x192", ways)


def main() -> None:
    torch.set_num_threads(1)
    torch.manual_seed(0)
    for size in (256, 128):
        compare_mmd([torch.randn(size, 192, requires_grad=True) for _ in range(2)])
    walks = [torch.randn(64, 16, 192, requires_grad=True) for _ in range(2)]
    masks = [torch.arange(16) < torch.randint(5, 17, (64, 1)) for _ in range(2)]
    compare(
        "TCC 64x16x192",
        {
            "tcc": lambda: tcc(walks[0], masks[0], walks[1], masks[1]),
            "pair by pair": lambda: tcc_by_pairs(walks[0], masks[0], walks[1], masks[1]),
        },
    )
    x, y = torch.randn(256, 192), torch.randn(256, 192) + 0.3
    accuracy("normal", [x, y])
    accuracy("norm 140", [x + 10, y + 10])
    accuracy("norm 140, spread 0.01", [0.01 * x + 10, 0.01 * y + 10])
    accuracy("near-duplicates", [torch.cat([x[:128], x[:128] + 1e-4 * y[:128]]), y])


if __name__ == "__main__":
    main()
