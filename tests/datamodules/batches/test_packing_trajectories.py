from __future__ import annotations

import numpy as np
import tiny
from hypothesis import given
from hypothesis import strategies as st

from datamodules.batches.dataset import thin_out

SPEC = tiny.spec("arm", 3, 2)


def frames_of(length: int, phase: float, stride: int) -> list[int]:
    """The kept steps of one trajectory, one by one: shorter strides for shorter trajectories."""
    stride = min(stride, length - 1) or 1
    first = int(phase * min(stride, max(1, length - stride)))
    return list(range(first, length, stride))


@given(
    st.lists(st.integers(1, 60), min_size=1, max_size=6),
    st.integers(1, 20),
    st.lists(st.floats(0, 1, exclude_max=True), min_size=8, max_size=8),
    st.lists(st.integers(0, 5), min_size=1, max_size=8),
)
def test_thinned_trajectories_agree_with_a_loop(
    lengths: list[int], stride: int, phases: list[float], picks: list[int]
) -> None:
    episodes = np.array([pick % len(lengths) for pick in picks])
    phase = np.array(phases[: len(episodes)])
    table = tiny.dataset(SPEC, lengths, [0] * len(lengths))
    found = thin_out(table, episodes, phase, stride)
    kept = [frames_of(lengths[e], p, stride) for e, p in zip(episodes, phase, strict=True)]
    expected = [[table.offset[e] + t for t in frames] for e, frames in zip(episodes, kept, strict=True)]
    longest = max(map(len, expected))
    assert found.mask.shape == found.frame.shape == (len(episodes), longest)
    for row, frames in enumerate(expected):
        assert found.mask[row].tolist() == [t < len(frames) for t in range(longest)]
        states = found.observation.state[found.frame[row]][found.mask[row]]
        assert states[:, 0].tolist() == frames
        assert found.frame[row][~found.mask[row]].tolist() == [0] * (longest - len(frames))
    assert len(found.observation.state) == sum(map(len, expected))


@given(st.integers(2, 100), st.integers(1, 40), st.floats(0, 1, exclude_max=True))
def test_two_frames_are_kept_at_the_least(length: int, stride: int, phase: float) -> None:
    table = tiny.dataset(SPEC, [length], [0])
    found = thin_out(table, np.array([0]), np.array([phase]), stride)
    assert found.mask.all()
    assert found.mask.sum() >= 2
    gaps = found.observation.state[1:, 0] - found.observation.state[:-1, 0]
    assert set(gaps.tolist()) == {min(stride, length - 1)}


def test_one_of_every_sixteen_frames_from_any_of_the_first_sixteen() -> None:
    table = tiny.dataset(SPEC, [100], [0])
    phases = np.arange(16) / 16
    found = thin_out(table, np.zeros(16, dtype=np.int64), phases, 16)
    begins = found.observation.state[found.frame[:, 0]][:, 0].tolist()
    assert begins == list(range(16))
    assert sorted(found.observation.state[:, 0].tolist()) == list(range(100))


def test_a_trajectory_of_one_step_gives_one_frame() -> None:
    found = thin_out(tiny.dataset(SPEC, [1, 5], [0, 0]), np.array([0, 1]), np.array([0.9, 0.0]), 4)
    assert found.mask.tolist() == [[True, False], [True, True]]
    assert found.observation.state[:, 0].tolist() == [0, 1, 5]
