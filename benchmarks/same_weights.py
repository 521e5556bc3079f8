"""A test whether two checkouts train the same weights, bit for bit: each method on the smoke page, phase by phase.

    python benchmarks/same_weights.py OTHER_CHECKOUT [--steps 50] [--methods plp plp_t …]

Both run with this interpreter, on the same demonstrations (the other checkout's) and with the same settings. Names of
parameters that have moved since are understood. Exit status 1 if any weight differs.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import torch

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

from plp_lightning.callbacks.checkpointing import read_checkpoint  # noqa: E402
from plp_lightning.methods.upgrade import upgrade_checkpoint  # noqa: E402

METHODS = ("plp", "plp_t", "plp_t_disc", "gama", "cdil", "contextual", "bc")
LEAKED = {
    "gama": ["--policy.policy_layers", "3", "--alignment.discriminator_layers", "2"],
    "cdil": [
        *["--policy.policy_layers", "3", "--alignment.discriminator_layers", "3"],
        *["--alignment.penalty_weight", "0.1"],
    ],
}
"""Settings of classes to which earlier versions gave another class's defaults."""


def fit(
    checkout: Path, method: str, folder: Path, options: list[str], steps: int
) -> dict[str, dict[str, torch.Tensor]]:
    """Weights after each phase, by phase."""
    runs = folder / checkout.name
    command = [
        *[sys.executable, "-m", "plp_lightning", "fit", "--config", "configs/smoke.yaml"],
        *["--config", f"configs/methods/{method}.yaml", "--run_root", str(runs), "--data.root", str(folder / "data")],
        *["--trainer.max_steps", str(steps), "--trainer.accelerator", "cpu", *options],
    ]
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "PYTHONPATH": str(checkout)}
    done = subprocess.run(command, cwd=checkout, env=environment, capture_output=True, text=True)
    if done.returncode:
        sys.exit(f"{checkout}, {method}: {done.stderr}")
    found = {}
    for file in sorted(runs.rglob(f"{method}/*/seed_0/*/checkpoints/last.ckpt")):
        content = read_checkpoint(file)
        upgrade_checkpoint(content)
        found[file.parents[1].name] = content["state_dict"]
    return found


def main() -> None:
    """Compare and print a line for each phase of each method."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("other", type=Path)
    parser.add_argument("--steps", type=int, default=50)
    parser.add_argument("--methods", nargs="+", default=METHODS)
    options = parser.parse_args()
    differ = False
    with tempfile.TemporaryDirectory() as name:
        for method in options.methods:
            old = fit(options.other.resolve(), method, Path(name), LEAKED.get(method, []), options.steps)
            new = fit(ROOT, method, Path(name), [], options.steps)
            for phase, weights in old.items():
                other = new.get(phase, {})
                wrong = [
                    n
                    for n in {*weights, *other}
                    if n not in other or n not in weights or not torch.equal(weights[n], other[n])
                ]
                differ |= bool(wrong)
                print(f"{method:12} {phase:12} {len(weights):4} tensors, {len(wrong)} differ {sorted(wrong)[:3] or ''}")
    sys.exit(int(differ))


if __name__ == "__main__":
    main()
