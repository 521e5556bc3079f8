"""Vectors of domains that differ in length: scaled, in columns of one shared vector, with rows in one batch."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Literal

import numpy as np
import torch
from torch import Tensor, nn

from datamodules.batches.normalization import DEFAULT_KEY, Affine, Scaling, Statistics
from datamodules.errors import ConfigError
from datamodules.types import DomainSpec

Sharing = Literal["own", "shared"]


class InputScaler(nn.Module):
    """Per-domain scaling of raw states; its numbers are buffers, so a checkpoint carries them.

    Args:
        domains: Specifications of all domains.
        statistics: Statistics of raw states, by domain; states stay as they are without.
        scaling: Kind of scaling, by observation key.

    Raises:
        ConfigError: If ``scaling`` names a key that no domain has.
    """

    offset: Tensor
    scale: Tensor
    limit: Tensor

    def __init__(
        self, domains: Sequence[DomainSpec], statistics: Mapping[str, Statistics] | None, scaling: Mapping[str, Scaling]
    ) -> None:
        super().__init__()
        keys = dict.fromkeys(key.name for spec in domains for key in spec.state_keys)
        if unknown := [name for name in scaling if name not in (*keys, DEFAULT_KEY)]:
            expected = f"{', '.join(keys)}, and {DEFAULT_KEY!r}"
            raise ConfigError(f"scaling names {unknown[0]!r}; the state keys are {expected}")
        self.rows = {spec.name: (i, spec.state_size) for i, spec in enumerate(domains)}
        known = statistics or {spec.name: Statistics.identity(spec.state_size) for spec in domains}
        fits = [Affine.build(spec, known[spec.name], scaling) for spec in domains]
        width = max(spec.state_size for spec in domains)
        for name in ("offset", "scale", "limit"):
            rows = [np.pad(row, (0, width - len(row))) for row in (getattr(fit, name) for fit in fits)]
            self.register_buffer(name, torch.tensor(np.stack(rows), dtype=torch.float32))

    def forward(self, state: Tensor, domain: str) -> Tensor:
        """Raw ``(..., O)`` → scaled ``(..., O)``."""
        row, size = self.rows[domain]
        limit = self.limit[row, :size]
        return torch.clamp((state - self.offset[row, :size]) * self.scale[row, :size], -limit, limit)


class DomainColumns:
    """Places of each domain's numbers in the vector that enters or leaves a shared network.

    A network that reads column i of every domain with the same weights takes it for granted that they mean the
    same. That helps where they do, and misleads the alignment where they don't: joint angles of two robots, axes
    that are swapped. There each domain gets columns of its own, zero for all others.

    Args:
        sizes: Length of each domain's vector; the order is the domain id.
        sharing: ``own`` columns for each domain, or columns ``shared`` by all, zero behind the end of short vectors.
    """

    def __init__(self, sizes: Mapping[str, int], sharing: Sharing) -> None:
        own = sharing == "own"
        starts = [sum([*sizes.values()][:i]) if own else 0 for i in range(len(sizes))]
        self.slices = {d: slice(a, a + n) for a, (d, n) in zip(starts, sizes.items(), strict=True)}
        self.width = max(columns.stop for columns in self.slices.values())

    def take(self, x: Tensor, domain: str) -> Tensor:
        """``(B, width)`` → the domain's ``(B, n)``."""
        return x[:, self.slices[domain]]

    def place(self, x: Tensor, domain: str) -> Tensor:
        """The domain's ``(B, n)`` → ``(B, width + D)``: zeros elsewhere, and the one-hot domain id behind."""
        placed = x.new_zeros(x.shape[0], self.width + len(self.slices))
        placed[:, self.slices[domain]] = x
        placed[:, self.width + list(self.slices).index(domain)] = 1
        return placed

    def join(self, parts: Mapping[str, Tensor]) -> Tensor:
        """Every domain's ``(B_d, n_d)``, one below the other: ``(Σ B_d, width + D)``."""
        return torch.cat([self.place(x, domain) for domain, x in parts.items()])


def split_by_domain(joined: Tensor, parts: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Takes rows ``(Σ B_d, N)`` apart again: ``(B_d, N)`` by domain, as many as ``parts`` has, in its order."""
    return dict(zip(parts, joined.split([part.shape[0] for part in parts.values()]), strict=True))


def take_columns(x: Tensor, columns: Sequence[int]) -> Tensor:
    """Columns ``(B, n)`` of ``x (B, N)``; no copy if they stand side by side.

    A list as an index would be copied to the device, which waits for it.
    """
    runs: list[list[int]] = []
    for column in columns:
        if runs and runs[-1][-1] + 1 == column:
            runs[-1].append(column)
        else:
            runs.append([column])
    parts = [x[:, run[0] : run[-1] + 1] for run in runs] or [x[:, :0]]
    return parts[0] if len(parts) == 1 else torch.cat(parts, dim=1)
