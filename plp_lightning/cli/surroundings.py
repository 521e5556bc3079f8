"""Variables of the environment that would change what a run computes or writes: settled before libraries are loaded."""

from __future__ import annotations

import os

RANKS = (
    *("RANK", "LOCAL_RANK", "GROUP_RANK", "NODE_RANK", "WORLD_SIZE", "LOCAL_WORLD_SIZE"),
    *("SLURM_PROCID", "SLURM_LOCALID", "SLURM_NODEID", "JSM_NAMESPACE_RANK"),
)
"""Variables by which a scheduler numbers processes; Lightning lets all but the first of them write nothing."""


def settle_surroundings() -> None:
    """Make each process a run of its own on one device, whatever started it, with figures that need no screen."""
    # Several runs at once must not fight for cores.
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    os.environ["MPLBACKEND"] = "Agg"  # A notebook's own backend is not there in a process that it starts.
    for name in RANKS:
        os.environ.pop(name, None)
