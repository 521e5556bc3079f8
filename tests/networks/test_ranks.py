"""Rows that are dealt out to ranks come back in order, and the mean of the ranks' gradients is that of one process."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from command import processes
from torch import Tensor, distributed, nn

from plp_lightning.losses import r1_penalty
from plp_lightning.networks.perceptrons import TaskNetwork, mlp
from plp_lightning.networks.ranks import Ranks, dealing, dealt


def losses(rows: int) -> list[Tensor]:
    """Loss and gradients of two networks in a row, of which the second has a penalty on its slope."""
    torch.manual_seed(0)
    first, second = mlp(3, 5, 1, 4).double(), TaskNetwork(4, 2, 1, 5, 1).double()
    x, task = torch.randn(rows, 3, dtype=torch.float64), torch.arange(rows) % 2
    between = dealt(first, x)
    judged = second(between, task)[:, 0]
    seen = between.detach().requires_grad_()
    distances = (between[:, None] - between).square().sum()  # of all rows from each other
    loss = judged.square().mean() + distances + r1_penalty(second(seen, task)[:, 0], seen, torch.ones(rows))
    loss.backward()
    parameters = nn.ModuleList([first, second]).parameters()
    return [loss.detach(), *(p.grad for p in parameters if p.grad is not None)]


def take_part(rank: int, total: int, rows: int, folder: Path) -> None:
    torch.set_num_threads(1)
    distributed.init_process_group("gloo", f"file://{folder}/meeting", rank=rank, world_size=total)
    with dealing(Ranks(rank, total)):
        loss, *gradients = losses(rows)
    for gradient in gradients:
        distributed.all_reduce(gradient)
    torch.save([loss, *(gradient / total for gradient in gradients)], folder / f"{rank}.pt")


@pytest.mark.parametrize("rows", [2, 3, 8])  # fewer than ranks are dealt to nobody
def test_three_ranks_have_the_gradients_of_one(rows: int, tmp_path: Path) -> None:
    started = [processes.Process(target=take_part, args=(rank, 3, rows, tmp_path)) for rank in range(3)]
    for process in started:
        process.start()
    expected = losses(rows)
    for rank, process in enumerate(started):
        process.join(60)
        assert process.exitcode == 0
        for mine, theirs in zip(torch.load(tmp_path / f"{rank}.pt"), expected, strict=True):
            torch.testing.assert_close(mine, theirs, rtol=1e-12, atol=1e-12)


def test_shares_differ_by_one_row_at_most_and_are_all_rows() -> None:
    for total in range(1, 6):
        for rows in range(20):
            sizes = Ranks(0, total).sizes(rows)
            assert sum(sizes) == rows
            assert max(sizes) - min(sizes) <= 1


def test_alone_a_network_is_called() -> None:
    assert torch.equal(dealt(torch.neg, torch.ones(2)), -torch.ones(2))
