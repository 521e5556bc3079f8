"""Numbers of rows that come again: in bfloat16 a processor makes a program for each shape of a matrix, once.

That takes ten times as long as a batch's product, so batches whose rows vary are filled up a little.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import torch
from torch import Tensor

from datamodules.batches.fixed import is_filled
from datamodules.named import join_observations
from datamodules.types import Observation, PackedTrajectories

SHAPES = 16
"""Numbers of rows, evenly spaced, from one power of two to the next."""


def rows_to_fill(rows: int, most: int | None = None) -> int:
    """Rows that are put behind so many rows: one at the least, a sixteenth of all at most, and at most ``most``.

    >>> [rows_to_fill(rows) + rows for rows in (5, 1000, 1023, 1024, 1030)]
    [6, 1024, 1024, 1088, 1088]
    """
    unit = max(1, (1 << (rows.bit_length() - 1)) // SHAPES)
    if most is not None:
        unit = min(unit, 1 << (most.bit_length() - 1))
    return unit - rows % unit


def wants_rows_that_recur(sequences: Iterable[PackedTrajectories]) -> bool:
    """Tell whether programs are made for these ``(P, T)``: on a processor, in half precision, if their rows vary."""
    rows_vary = [s.mask.device.type == "cpu" and not is_filled(s) for s in sequences]
    return torch.is_autocast_enabled("cpu") and bool(rows_vary) and all(rows_vary)


def fill_up(
    seen: Mapping[str, Observation[Tensor]], sequences: Mapping[str, PackedTrajectories]
) -> Mapping[str, Observation[Tensor]]:
    """Repeat some rows behind those of one domain ``(B_d, …)``, if it is worth it, so that the number of all recurs.

    Sequences ``(P, T)`` are those whose frames are among the rows.
    """
    if not wants_rows_that_recur(sequences.values()):
        return seen
    domain, rows = [*sequences][-1], {d: len(part.state) for d, part in seen.items()}
    more = rows_to_fill(sum(rows.values()), most=rows[domain])
    return {**seen, domain: join_observations([seen[domain], seen[domain].take(slice(more))], torch.cat)}


def with_rows_that_recur(*sequences: PackedTrajectories) -> tuple[PackedTrajectories, ...]:
    """Put one more trajectory, if it is worth it, behind those ``(P, T)`` of each domain: it fills their frames up."""
    return tuple(map(_with_one_more, sequences)) if wants_rows_that_recur(sequences) else sequences


def _with_one_more(sequences: PackedTrajectories) -> PackedTrajectories:
    rows, time = len(sequences.action), sequences.mask.shape[1]
    more = rows_to_fill(rows, most=time)
    added = torch.arange(time)[None] < more

    def fill(x: Tensor) -> Tensor:
        return torch.cat([x, x[:1].expand(more, *x.shape[1:])])

    frame = torch.cat([sequences.frame, (rows + torch.arange(time)[None]) * added])
    mask = torch.cat([sequences.mask, added])
    return PackedTrajectories(sequences.observation.map(fill), frame, mask, fill(sequences.action))
