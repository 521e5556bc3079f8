"""All benchmarks by name: where they are, and how long they may take."""

from __future__ import annotations

from collections.abc import Iterator
from importlib import import_module
from typing import Any, NamedTuple

from benchmarks.measuring import Options, Row


class Benchmark(NamedTuple):
    """A function of a module of this folder that gives rows, and what it is asked for."""

    module: str
    function: str = "rows"
    arguments: tuple[Any, ...] = ()
    seconds: int = 300  # after which it is stopped; or sooner in the short form
    short: bool = False  # part of the short form

    def rows(self, options: Options) -> Iterator[Row]:
        """Measure, a row after the other."""
        found: Iterator[Row] = getattr(import_module(f"benchmarks.{self.module}"), self.function)(
            options, *self.arguments
        )
        return found


CPU = {
    "trainer": Benchmark("phase_steps", "trainer", seconds=600, short=True),
    "written_out": Benchmark("phase_steps", "written_out"),
    "adaptation": Benchmark("cached_latents", short=True),
    "robomimic": Benchmark("robomimic_bc"),
    "loader": Benchmark("loading", short=True),
    "losses": Benchmark("losses", short=True),
    "act": Benchmark("act", short=True),
    "vision": Benchmark("vision"),
    "point": Benchmark("simulators", "maze", ("point",), short=True),
    "ant": Benchmark("simulators", "maze", ("ant",)),
    "lift": Benchmark("simulators", "lift"),
    "reach": Benchmark("simulators", "reach"),
    "images": Benchmark("images", short=True),
    "mujoco_rollout": Benchmark("mujoco_rollout"),
    "contextual": Benchmark("contextual"),
    "batch": Benchmark("growth", "batch"),
    "domains": Benchmark("growth", "domains"),
    "tasks": Benchmark("growth", "tasks"),
    "length": Benchmark("growth", "length"),
    "memory": Benchmark("memory"),
    "start": Benchmark("start"),
}
GPU = {
    "gpu_p2p_alignment": Benchmark("phase_steps", "on_device", ("p2p_alignment", 1.0), seconds=45),
    "gpu_p2p_adaptation": Benchmark("phase_steps", "on_device", ("p2p_adaptation", 0.5), seconds=45),
    "gpu_p2a_plp_t": Benchmark("phase_steps", "on_device", ("p2a_plp_t_alignment", 2.0), seconds=45),
    "gpu_r2r": Benchmark("phase_steps", "on_device", ("r2r_alignment", 1.0), seconds=45),
    "gpu_v2v_reach": Benchmark("phase_steps", "on_device", ("v2v_reach_alignment", 6.0), seconds=45),
    "gpu_contextual": Benchmark("phase_steps", "on_device", ("p2p_contextual", 8.0), seconds=45),
    "gpu_weights": Benchmark("phase_steps", "same_weights", ("p2p_alignment",), seconds=45),
    "gpu_whole_run": Benchmark("whole_runs", "whole", seconds=150),
    "gpu_many_runs": Benchmark("whole_runs", "many", seconds=200),
}
BENCHMARKS = CPU | GPU
