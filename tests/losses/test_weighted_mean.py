from __future__ import annotations

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from plp_lightning.losses import weighted_mean


@given(st.lists(st.tuples(st.floats(-5, 5), st.floats(0.01, 1)), min_size=1, max_size=6), st.floats(0.1, 10))
def test_it_is_the_mean_of_single_samples_whatever_the_unit_of_weights(
    samples: list[tuple[float, float]], unit: float
) -> None:
    value, weight = torch.tensor(samples, dtype=torch.float64).T
    one_by_one = sum(number * share for number, share in samples) / sum(share for _, share in samples)
    expected = pytest.approx(one_by_one, abs=1e-12)
    assert weighted_mean(value, weight).item() == expected
    assert weighted_mean(value, weight * unit).item() == expected


def test_weights_do_not_broadcast() -> None:
    with pytest.raises(AssertionError, match=r"one weight a sample \(4,\), got \(1,\)"):
        weighted_mean(torch.zeros(4), torch.ones(1))
