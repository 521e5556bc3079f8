"""Columns are taken as slices: the same numbers as with a list, and no copy where they stand side by side."""

from __future__ import annotations

import pytest
import torch

from plp_lightning.networks import take_columns


@pytest.mark.parametrize("columns", [[], [0], [4], [1, 2, 3], [0, 1, 2, 3, 4], [0, 2, 4], [3, 1], [1, 2, 4, 0], [2, 2]])
def test_columns_are_those_of_a_list(columns: list[int]) -> None:
    x = torch.arange(10.0).view(2, 5)
    assert torch.equal(take_columns(x, columns), x[:, columns])


@pytest.mark.parametrize("columns", [[], [3], [1, 2, 3], [0, 1, 2, 3, 4]])
def test_columns_side_by_side_are_not_copied(columns: list[int]) -> None:
    x = torch.arange(10.0).view(2, 5)
    assert take_columns(x, columns).untyped_storage().data_ptr() == x.untyped_storage().data_ptr()
