"""Input scaling of the policy."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import torch
from torch import Tensor, nn

from datamodules.batches.normalization import DEFAULT_KEY, Affine, Scaling, Statistics
from datamodules.errors import ConfigError
from datamodules.types import DomainSpec


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
        _check_keys(domains, scaling)
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


def _check_keys(domains: Sequence[DomainSpec], scaling: Mapping[str, Scaling]) -> None:
    keys = dict.fromkeys(key.name for spec in domains for key in spec.state_keys)
    unknown = [name for name in scaling if name not in keys and name != DEFAULT_KEY]
    if unknown:
        raise ConfigError(f"scaling names {unknown[0]!r}; the state keys are {', '.join(keys)}, and {DEFAULT_KEY!r}")
