"""Calls of robosuite that leave nothing behind: neither lines on the screen nor the renderer that it prefers."""

from __future__ import annotations

import logging
import os
import warnings
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def quiet() -> Iterator[None]:
    """Let robosuite neither print nor leave the rendering backend it prefers in the environment."""
    logger, backend = logging.getLogger("robosuite_logs"), os.environ.get("MUJOCO_GL")
    disabled, logger.disabled = logger.disabled, True
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        logger.disabled = disabled
        os.environ.pop("MUJOCO_GL", None)
        if backend is not None:
            os.environ["MUJOCO_GL"] = backend
