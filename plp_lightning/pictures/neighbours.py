"""States of two domains that are nearest to each other in the latent space, as cameras or simulators show them."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure
from scipy.spatial.distance import cdist

from datamodules.types import Observation
from plp_lightning.pictures.style import GREY

PAIRS = 8  # Pairs that are shown, from the nearest to the farthest
Pictures = np.ndarray | Mapping[int, np.ndarray]


def neighbour_pairs(first: np.ndarray, second: np.ndarray, count: int = PAIRS) -> list[tuple[int, int, float]]:
    """Rows of ``(N, Z)`` and ``(M, Z)`` that are each other's nearest, and their distance.

    Returns:
        At most ``count`` pairs, evenly chosen by their distance: the first is the nearest, the last the farthest.
    """
    distances = cdist(first, second)
    there, back = distances.argmin(axis=1), distances.argmin(axis=0)
    mutual = [(i, int(j), float(distances[i, j])) for i, j in enumerate(there) if back[j] == i]
    mutual.sort(key=lambda pair: pair[2])
    chosen = np.linspace(0, len(mutual) - 1, min(count, len(mutual))).round().astype(int)
    return [mutual[i] for i in chosen]


def neighbour_figure(latents: Mapping[str, np.ndarray], images: Mapping[str, Pictures]) -> Figure | None:
    """Pairs of nearest states, an image above the other; None unless two domains have images.

    Args:
        latents: By domain, ``(N_d, Z)``; the first two with images are shown.
        images: By domain, ``(H, W, C)`` uint8 of the same states by their index, of those in pairs at least.
    """
    domains = [domain for domain in latents if domain in images][:2]
    if len(domains) < 2:
        return None
    pairs = neighbour_pairs(latents[domains[0]], latents[domains[1]])
    figure = Figure(figsize=(1.3 * len(pairs) + 1.2, 3.1), layout="constrained")
    for side, (domain, row) in enumerate(zip(domains, figure.subplots(2, len(pairs), squeeze=False), strict=True)):
        row[0].text(-0.1, 0.5, domain, transform=row[0].transAxes, ha="right", va="center", fontsize=10)
        for axes, (*rows, distance) in zip(row, pairs, strict=True):
            axes.imshow(images[domain][int(rows[side])])
            axes.axis("off")
            if side == 0:
                axes.set_title(f"{distance:.2g}", fontsize=9, color=GREY)
    figure.suptitle("nearest states in the latent space, and their distance", fontsize=12)
    return figure


def seen_images(seen: Mapping[str, Observation]) -> dict[str, np.ndarray]:
    """Images ``(N, H, W, C)`` of the domains that have a camera, of the first of several."""
    return {d: np.asarray(next(iter(states.images.values()))) for d, states in seen.items() if states.images}
