"""All benchmarks by name: where they are, and how long they may take."""

from __future__ import annotations

from collections.abc import Iterator
from importlib import import_module
from typing import Any, NamedTuple

from benchmarks.measuring import Options, Row


class Benchmark(NamedTuple):
    """A function of a module that gives rows, and what it is asked for."""

    module: str
    function: str = "rows"
    arguments: tuple[Any, ...] = ()
    seconds: int = 600  # after which it is stopped; or sooner in the short form
    short: bool = False  # part of the short form

    def rows(self, options: Options) -> Iterator[Row]:
        """Measure, a row after the other."""
        found: Iterator[Row] = getattr(import_module(self.module), self.function)(options, *self.arguments)
        return found


CPU = {
    "p2p_alignment": Benchmark("benchmarks.phase_steps", "trainer", ("p2p_alignment",), short=True),
    "p2p_adaptation": Benchmark("benchmarks.phase_steps", "trainer", ("p2p_adaptation",)),
    "p2a_plp_t": Benchmark("benchmarks.phase_steps", "trainer", ("p2a_plp_t_alignment",)),
    "r2r": Benchmark("benchmarks.phase_steps", "trainer", ("r2r_alignment",)),
    "cached_latents": Benchmark("benchmarks.cached_latents", short=True),
    "robomimic": Benchmark("benchmarks.robomimic_bc"),
    "loader": Benchmark("benchmarks.loading", short=True),
    "losses": Benchmark("benchmarks.losses", short=True),
    "act": Benchmark("benchmarks.act", short=True),
    "vision": Benchmark("benchmarks.vision"),
    "point": Benchmark("benchmarks.simulators", "maze", ("point",), short=True),
    "ant": Benchmark("benchmarks.simulators", "maze", ("ant",)),
    "lift": Benchmark("benchmarks.simulators", "lift"),
    "reach": Benchmark("benchmarks.simulators", "reach"),
    "gym_reacher": Benchmark("benchmarks.gym_episodes", arguments=("Reacher-v5", 50, 20), short=True),
    "gym_cheetah": Benchmark("benchmarks.gym_episodes", arguments=("HalfCheetah-v5", 200, 8)),
    "gym_fetch": Benchmark("benchmarks.gym_episodes", arguments=("gymnasium_robotics:FetchReach-v4", 50, 4)),
    "metaworld": Benchmark("benchmarks.suites", "metaworld"),
    "robosuite": Benchmark("benchmarks.suites", "robosuite"),
    "images": Benchmark("benchmarks.images", short=True),
    "mujoco_rollout": Benchmark("benchmarks.mujoco_rollout"),
    "contextual": Benchmark("benchmarks.contextual"),
    "batch": Benchmark("benchmarks.growth", "batch"),
    "domains": Benchmark("benchmarks.growth", "domains"),
    "tasks": Benchmark("benchmarks.growth", "tasks"),
    "length": Benchmark("benchmarks.growth", "length"),
    "memory": Benchmark("benchmarks.memory"),
    "start": Benchmark("benchmarks.start"),
}
GPU = {
    "gpu_p2p_alignment": Benchmark("benchmarks.phase_steps", "on_device", ("p2p_alignment", 1.0), seconds=45),
    "gpu_p2p_adaptation": Benchmark("benchmarks.phase_steps", "on_device", ("p2p_adaptation", 0.5), seconds=45),
    "gpu_p2a_plp_t": Benchmark("benchmarks.phase_steps", "on_device", ("p2a_plp_t_alignment", 2.0), seconds=45),
    "gpu_r2r": Benchmark("benchmarks.phase_steps", "on_device", ("r2r_alignment", 1.0), seconds=45),
    "gpu_v2v_reach": Benchmark("benchmarks.phase_steps", "on_device", ("v2v_reach_alignment", 6.0), seconds=45),
    "gpu_contextual": Benchmark("benchmarks.phase_steps", "on_device", ("p2p_contextual", 8.0), seconds=45),
    "gpu_weights": Benchmark("benchmarks.phase_steps", "same_weights", ("p2p_alignment",), seconds=45),
    "gpu_whole_run": Benchmark("benchmarks.whole_runs", "whole", seconds=180),
    "gpu_many_runs": Benchmark("benchmarks.whole_runs", "many", seconds=240),
}
BENCHMARKS = CPU | GPU
