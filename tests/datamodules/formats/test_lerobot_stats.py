from __future__ import annotations

import numpy as np
import pytest

from datamodules.formats.lerobot_stats import summarise


@pytest.mark.parametrize("shape", [(), (3,), (4, 5, 3)])
def test_statistics_of_parts_join_to_those_of_the_whole(shape: tuple[int, ...]) -> None:
    random = np.random.default_rng(0)
    if len(shape) == 3:
        parts = [random.integers(9, 200, size=(steps, *shape), dtype=np.uint8) for steps in (3, 1, 7)]
    else:
        parts = [random.normal(size=(steps, *shape)) * steps + steps for steps in (3, 1, 7)]
    joined = summarise(parts[0]) + summarise(parts[1]) + summarise(parts[2])
    whole = np.concatenate(parts) / (255 if len(shape) == 3 else 1)
    rows = whole.reshape(-1, *shape[-1:])
    told = joined.plain()
    assert told["count"] == [11]
    for name, expected in {"min": np.min, "max": np.max, "mean": np.mean, "std": np.std}.items():
        found = np.array(told[name])
        assert found.shape == ((3, 1, 1) if len(shape) == 3 else shape or (1,))
        np.testing.assert_allclose(found.ravel(), np.ravel(expected(rows, axis=0)), rtol=1e-12)
