from __future__ import annotations

import numpy as np
import pytest
import tiny

from datamodules.batches.normalization import Affine, Scaling, Statistics
from datamodules.errors import ConfigError

STATE = np.array([[1.0, 10.0, 5.0], [3.0, 30.0, 5.0]], dtype=np.float32)  # means 2, 20, 5; deviations 1, 10, 0
SPEC = tiny.spec("arm", 3, 2)  # key a: column 0, key b: columns 1 and 2


def apply(affine: Affine, state: np.ndarray) -> list[float]:
    scaled: list[float] = np.clip((state - affine.offset) * affine.scale, -affine.limit, affine.limit).tolist()
    return scaled


def build(scaling: dict[str, Scaling]) -> Affine:
    return Affine.build(SPEC, Statistics.fit(STATE), scaling)


def test_statistics_are_those_of_the_population() -> None:
    fitted = Statistics.fit(STATE)
    assert fitted.mean.tolist() == [2, 20, 5]
    assert fitted.std.tolist() == [1, 10, 0]


def test_statistics_of_large_numbers_are_kept_in_double_precision() -> None:
    state = np.array([[1e4], [1e4 + 0.01]], dtype=np.float32)
    assert Statistics.fit(state).std[0] == pytest.approx(float(state[1, 0] - state[0, 0]) / 2, rel=1e-6)


def test_zscore_is_the_default_and_clips_at_so_many_deviations() -> None:
    assert apply(build({}), np.array([3.0, 0.0, 5.0])) == [1, -2, 0]
    assert apply(build({}), np.array([100.0, -1000.0, 5.0])) == [5, -5, 0]


def test_a_constant_column_keeps_its_unit() -> None:
    assert apply(build({}), np.array([2.0, 20.0, 5.5])) == [0, 0, 0.5]


def test_none_leaves_a_key_raw_and_unclipped() -> None:
    assert apply(build({"b": "none"}), np.array([3.0, 400.0, -70.0])) == [1, 400, -70]


def test_a_number_centres_and_multiplies_without_a_bound() -> None:
    assert apply(build({"b": 20.0}), np.array([3.0, 21.0, 4.0])) == [1, 20, -20]


def test_default_serves_the_keys_that_are_not_named() -> None:
    assert apply(build({"default": "none", "a": "zscore"}), np.array([3.0, 400.0, 7.0])) == [1, 400, 7]


@pytest.mark.parametrize("word", ["z-score", "2.0"])
def test_an_unknown_word_is_refused(word: str) -> None:
    with pytest.raises(ConfigError, match=f"scaling of 'a' is '{word}'; expected 'zscore', 'none' or a number"):
        build({"a": word})  # type: ignore[dict-item]


def test_identity_changes_nothing_within_the_bound() -> None:
    affine = Affine.build(SPEC, Statistics.identity(3), {})
    assert apply(affine, np.array([1.5, -2.0, 9.0])) == [1.5, -2, 5]
