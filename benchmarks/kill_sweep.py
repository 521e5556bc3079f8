"""Kill a sweep at random moments, start it again each time, and compare what it comes to with an unbroken one.

``python benchmarks/kill_sweep.py`` runs configs/sweeps/smoke.yaml twice in a folder of its own, about five minutes on
two cores; exit code 1 says that results differ in more than times.
"""

from __future__ import annotations

import argparse
import json
import random
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

COMMAND = [sys.executable, "-m", "plp_lightning", "sweep", "--config", "sweeps/smoke"]


def main() -> None:
    options = argparse.ArgumentParser()
    options.add_argument("--kills", type=int, default=3)
    options.add_argument("--seed", type=int, default=0)
    chosen = options.parse_args()
    draw = random.Random(chosen.seed)
    with tempfile.TemporaryDirectory() as folder:
        whole, broken = Path(folder) / "whole", Path(folder) / "broken"
        seconds = sweep(whole)
        for _ in range(chosen.kills):
            after = draw.uniform(8, 0.5 * seconds)
            killed = start(broken)
            try:
                killed.wait(after)
            except subprocess.TimeoutExpired:
                killed.kill()
                killed.wait()
            print(f"killed after {after:.0f} s; {len(results(broken))} runs were done", flush=True)
        print(f"unbroken: {seconds:.0f} s; the rest of the killed one: {sweep(broken):.0f} s")
        expected, found = results(whole), results(broken)
    same = [name for name in expected if found.get(name) == expected[name]]
    for name in expected.keys() - {*same}:
        differs = [key for key, value in expected[name].items() if found.get(name, {}).get(key) != value]
        print(f"{name}: differs in {', '.join(differs)}")
    print(f"{len(same)} of {len(expected)} results are the same")
    sys.exit(same != [*expected])


def start(folder: Path) -> subprocess.Popen[bytes]:
    folder.mkdir(exist_ok=True)
    return subprocess.Popen(COMMAND, cwd=folder, stderr=subprocess.DEVNULL)


def sweep(folder: Path) -> float:
    """Seconds of a sweep that nobody stops."""
    began, code = time.monotonic(), start(folder).wait()
    assert code == 0, code
    return time.monotonic() - began


def results(folder: Path) -> dict[str, Any]:
    """Content of all results.json but times, by place."""
    found = {str(file.relative_to(folder)): json.loads(file.read_text()) for file in folder.rglob("results.json")}
    return {name: {key: x for key, x in found[name].items() if key != "seconds"} for name in sorted(found)}


if __name__ == "__main__":
    main()
