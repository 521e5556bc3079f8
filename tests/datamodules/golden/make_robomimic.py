"""Makes ``robomimic.hdf5`` beside it: arrays as robomimic's documentation has them, masks by its own script.

robomimic has no writer for demonstrations that are not of one of its simulators.

    pip install robomimic==0.3.0 h5py && python make_robomimic.py
"""

from __future__ import annotations

import json
from pathlib import Path

import golden_values
import h5py
import numpy as np
from robomimic.scripts.split_train_val import split_train_val_from_hdf5

HERE = Path(__file__).parent
MIDDLE, REACH = (golden_values.HIGH + golden_values.LOW) / 2, (golden_values.HIGH - golden_values.LOW) / 2


def main() -> None:
    path, total, tasks = HERE / "robomimic.hdf5", 0, dict[str, list[str]]()
    with h5py.File(path, "w") as file:
        data = file.create_group("data")
        for number, one in enumerate(golden_values.episodes()):
            group, steps = data.create_group(f"demo_{number}"), len(one.actions)
            for key, values in one.seen.items():
                packed = {"compression": "gzip"} if values.ndim == 4 else {}
                group.create_dataset(f"obs/{key}", data=values[:-1], **packed)
                group.create_dataset(f"next_obs/{key}", data=values[1:], **packed)
            group["actions"] = (one.actions.astype(np.float64) - MIDDLE) / REACH
            group["rewards"] = group["dones"] = (np.arange(steps) == steps - 1).astype(np.int64)
            group["states"] = np.zeros((steps, 4))
            group.attrs.update({"num_samples": steps, "model_file": "<mujoco/>"})
            total += steps
            tasks.setdefault(one.task.replace(" ", "_"), []).append(f"demo_{number}")
        args = {"env_name": "Made-Up", "type": 1, "env_kwargs": {"control_freq": golden_values.HZ}}
        data.attrs.update({"total": total, "env_args": json.dumps(args)})
        for task, members in tasks.items():
            file[f"mask/{task}"] = np.array(members, dtype="S")
    split_train_val_from_hdf5(str(path), val_ratio=0.25)


if __name__ == "__main__":
    main()
