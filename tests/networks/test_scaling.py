from __future__ import annotations

import numpy as np
import pytest
import tiny
import torch

from datamodules.batches.normalization import CLIP, Scaling, Statistics
from datamodules.errors import ConfigError
from plp_lightning.networks import InputScaler

SMALL, LARGE = tiny.spec("small", 3, 2), tiny.spec("large", 6, 4)
STATISTICS = {"small": tiny.statistics(SMALL, 1), "large": tiny.statistics(LARGE, 2)}


def scaler(scaling: dict[str, Scaling], fitted: bool = True) -> InputScaler:
    return InputScaler([SMALL, LARGE], STATISTICS if fitted else None, scaling)


@pytest.mark.parametrize("spec", [SMALL, LARGE])
def test_each_domain_is_scaled_by_its_own_numbers(spec: object) -> None:
    domain = SMALL if spec is SMALL else LARGE
    state = np.random.default_rng(0).normal(0, 5, (40, domain.state_size)).astype(np.float32)
    fit = STATISTICS[domain.name]
    by_hand = np.clip((state - fit.mean) / fit.std, -CLIP, CLIP)
    by_hand[:, 1:] = (state[:, 1:] - fit.mean[1:]) * 10
    found = scaler({"b": 10.0})(torch.from_numpy(state), domain.name)
    np.testing.assert_allclose(found, by_hand, atol=1e-4)
    assert (np.abs(by_hand[:, 0]) == CLIP).any()


def test_scaling_travels_in_the_state_dict() -> None:
    fitted, fresh = scaler({}), scaler({}, fitted=False)
    state = torch.randn(4, 3)
    assert not torch.allclose(fitted(state, "small"), fresh(state, "small"))
    fresh.load_state_dict(fitted.state_dict())
    assert torch.equal(fitted(state, "small"), fresh(state, "small"))
    assert set(fitted.state_dict()) == {"offset", "scale", "limit"}
    assert list(fitted.parameters()) == []


def test_a_raw_key_is_passed_through_unbounded() -> None:
    state = torch.tensor([[1e6, -1e6, 3.0]])
    assert torch.equal(scaler({"default": "none"})(state, "small"), state)


def test_gradients_flow_through_the_scaling() -> None:
    state = torch.zeros(1, 3, requires_grad=True)
    scaler({"default": 4.0})(state, "small").sum().backward()
    assert state.grad is not None
    assert state.grad.tolist() == [[4, 4, 4]]


def test_statistics_are_needed_for_every_domain_or_none() -> None:
    with pytest.raises(KeyError, match="large"):
        InputScaler([SMALL, LARGE], {"small": Statistics.identity(3)}, {})


def test_a_key_that_no_domain_has_is_refused() -> None:
    with pytest.raises(ConfigError, match="scaling names 'posiiton'; the state keys are a, b, and 'default'"):
        scaler({"posiiton": 20.0})


def test_a_key_that_one_domain_has_is_enough() -> None:
    other = tiny.DomainSpec("other", (tiny.ObservationKey("angle", (2,)),), 2, 10.0)
    both = InputScaler([SMALL, other], None, {"angle": 3.0})
    assert both(torch.ones(1, 2), "other").tolist() == [[3, 3]]
