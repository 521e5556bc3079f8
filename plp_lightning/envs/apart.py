"""Modules that are run in a process of their own, whose memory is given back with it."""

from __future__ import annotations

import os
import subprocess
import sys


def run_apart(module: str, *words: str, given: bytes = b"") -> subprocess.CompletedProcess[bytes]:
    """Run a module of this package with words and input; its answer, what it complains of and its exit code.

    Raises:
        OSError: If no process can be started.
    """
    command = [sys.executable, "-m", f"plp_lightning.envs.{module}", *words]
    paths = {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    return subprocess.run(command, input=given, env=os.environ | paths, capture_output=True, check=False)
