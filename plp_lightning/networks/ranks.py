"""RANKS: processes that train one policy together: networks deal the rows of a batch out to them.

Each rank holds the whole batch and takes the same step. Only the way through a network is divided: each rank sends its
own rows through, and all put what came out together again, in order. So whatever lies between networks, losses that
compare all rows with each other above all, is that of one process, random draws included.

Tensors of the whole batch have the gradient of one process on every rank. Those of a rank's own rows have theirs times
the number of ranks, so that the mean over ranks is right for every parameter, whether its network was dealt to or not.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from itertools import pairwise
from typing import Any, NamedTuple, cast

import torch
from torch import Tensor, distributed


class Ranks(NamedTuple):
    """One of ``total`` ranks."""

    own: int
    total: int

    def sizes(self, rows: int) -> list[int]:
        """Number of rows that each rank sends through a network; they differ by one at most.

        Example:
            >>> Ranks(0, 3).sizes(8)
            [2, 3, 3]
        """
        return [end - start for start, end in pairwise(rows * i // self.total for i in range(self.total + 1))]


_dealing: ContextVar[Ranks | None] = ContextVar("dealing", default=None)


@contextmanager
def dealing(ranks: Ranks | None) -> Iterator[None]:
    """Let networks deal rows out in the block, which all ranks enter alike; None lets them do all themselves."""
    before = _dealing.set(ranks)
    try:
        yield
    finally:
        _dealing.reset(before)


def dealt(network: Callable[..., Tensor], *rows: Tensor) -> Tensor:
    """Send rows ``(B, …)`` through a network that looks at each by itself: ``(B, …)``.

    Within :func:`dealing` the rows are dealt out to the ranks, unless there are too few; elsewhere it is a call.
    """
    ranks = _dealing.get()
    if ranks is None or len(rows[0]) < ranks.total:
        return network(*rows)
    with dealing(None):
        own = network(*(cast("Tensor", _Own.apply(part, ranks)) for part in rows))  # type: ignore[no-untyped-call]
    return cast("Tensor", _All.apply(own, ranks, len(rows[0])))  # type: ignore[no-untyped-call]


class _Own(torch.autograd.Function):
    """Rows of all ranks ``(B, …)`` → the rank's own ``(b, …)``."""

    @staticmethod
    def forward(ctx: Any, rows: Tensor, ranks: Ranks) -> Tensor:
        ctx.ranks, ctx.rows = ranks, len(rows)
        own: Tensor = rows.split(ranks.sizes(len(rows)))[ranks.own]
        return own.clone()

    @staticmethod
    def backward(ctx: Any, grad: Tensor) -> tuple[Tensor, None]:
        return _All.apply(grad, ctx.ranks, ctx.rows) / ctx.ranks.total, None  # type: ignore[no-untyped-call]


class _All(torch.autograd.Function):
    """The rank's own rows ``(b, …)`` → those of all ranks ``(B, …)``, in order."""

    @staticmethod
    def forward(ctx: Any, own: Tensor, ranks: Ranks, rows: int) -> Tensor:
        ctx.ranks, sizes = ranks, ranks.sizes(rows)
        padded = own.new_zeros(max(sizes), *own.shape[1:])  # backends want as many rows of every rank
        padded[: len(own)] = own
        parts = [torch.empty_like(padded) for _ in sizes]
        distributed.all_gather(parts, padded)
        return torch.cat([part[:size] for part, size in zip(parts, sizes, strict=True)])

    @staticmethod
    def backward(ctx: Any, grad: Tensor) -> tuple[Tensor, None, None]:
        return _Own.apply(grad, ctx.ranks) * ctx.ranks.total, None, None  # type: ignore[no-untyped-call]
