"""Variables of the environment that would change what a run computes or writes: settled before libraries are loaded."""

from __future__ import annotations

import os

from plp_lightning.placement import take_place


def settle_surroundings() -> None:
    """Make each process a run of its own until its settings say otherwise, with figures that need no screen."""
    # Several runs at once must not fight for cores.
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    os.environ["MPLBACKEND"] = "Agg"  # A notebook's own backend is not there in a process that it starts.
    take_place(os.environ)
