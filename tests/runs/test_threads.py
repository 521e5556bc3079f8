"""Threads beside the first take floats below 1e-38 for 0, which the first does when it is asked to."""

from __future__ import annotations

import subprocess
import sys

import pytest
import torch

SHARES = """
import torch
from plp_lightning.runs.threads import use_threads

def share():
    tiny = torch.full((2**20,), 1e-39) * 1
    return (tiny.view(torch.int32) == 0).float().mean().item()

use_threads(2)
plain = share()
torch.set_flush_denormal(True)
print(torch.get_num_threads(), plain, share())
"""


@pytest.mark.skipif(not torch.set_flush_denormal(False), reason="this processor always counts with them")
def test_both_threads_leave_out_the_smallest_floats_when_the_first_is_asked_to():
    done = subprocess.run([sys.executable, "-c", SHARES], capture_output=True, text=True, check=True)
    threads, plain, asked = map(float, done.stdout.split())
    assert (threads, asked) == (2, 1)
    assert plain <= 0.5  # the first, by itself, counts with all floats
