"""robomimic's side of ``robomimic_bc.py``, in an environment that has robomimic and nothing of this project.

    python robomimic_worker.py FILE STEPS BATCH UNITS LAYERS

Says ``ready``, and then answers each line, ``bc`` or ``loader``, with the processor's seconds of a step or batch.
"""

from __future__ import annotations

import os
import sys
import time
from typing import Any

import h5py
import torch

ANSWERS = os.fdopen(os.dup(1), "w")
os.dup2(2, 1)  # robomimic prints as it is imported, and later

# torchvision of the package index does not find its operators beside a CPU build of torch; BC asks for none of them.
_operators = torch.library.Library("torchvision", "DEF")
_operators.define("nms(Tensor dets, Tensor scores, float iou_threshold) -> Tensor")
_operators.define("qnms(Tensor dets, Tensor scores, float iou_threshold) -> Tensor")

from robomimic.algo import algo_factory  # type: ignore[import-not-found]  # noqa: E402
from robomimic.config import config_factory  # type: ignore[import-not-found]  # noqa: E402
from robomimic.utils import obs_utils, train_utils  # type: ignore[import-not-found]  # noqa: E402
from robomimic.utils.dataset import SequenceDataset  # type: ignore[import-not-found]  # noqa: E402
from torch import nn  # noqa: E402


def new_model(file: str, units: int, layers: int) -> Any:
    """Robomimic's BC with so many hidden layers, of GELU units as ours."""
    config = config_factory("bc")
    with config.values_unlocked():
        config.observation.modalities.obs.low_dim = ["state"]
        config.algo.actor_layer_dims = (units,) * layers
    obs_utils.initialize_obs_utils_with_config(config)
    with h5py.File(file) as opened:
        demo = opened["data/demo_0"]
        shapes, actions = {"state": demo["obs/state"].shape[1:]}, demo["actions"].shape[1]
    model = algo_factory("bc", config, shapes, actions, torch.device("cpu"))
    for module in [*model.nets.modules()]:
        for name, part in module.named_children():
            if isinstance(part, nn.ReLU):
                setattr(module, name, nn.GELU())
    return model


def new_loader(file: str, batch: int) -> Any:
    """Batches of its dataset, all of it in memory."""
    keys = {"obs_keys": ("state",), "dataset_keys": ("actions",)}
    dataset = SequenceDataset(file, **keys, hdf5_cache_mode="all", hdf5_use_swmr=False, load_next_obs=False)
    return torch.utils.data.DataLoader(dataset, batch_size=batch, shuffle=True, drop_last=True)


def seconds_of_cloning(model: Any, loader: Any, steps: int) -> float:
    began = time.process_time()
    train_utils.run_epoch(model, loader, epoch=1, num_steps=steps)
    return (time.process_time() - began) / steps


def seconds_of_loading(loader: Any, steps: int) -> float:
    began = time.process_time()
    for _, _ in zip(range(steps), loader, strict=False):
        pass
    return (time.process_time() - began) / steps


def main(file: str, steps: int, batch: int, units: int, layers: int) -> None:
    """Answer until nobody asks any more."""
    torch.set_num_threads(1)
    model, loader = new_model(file, units, layers), new_loader(file, batch)
    print("ready", file=ANSWERS, flush=True)
    for line in sys.stdin:
        cloning = line.strip() == "bc"
        taken = seconds_of_cloning(model, loader, steps) if cloning else seconds_of_loading(loader, steps)
        print(taken, file=ANSWERS, flush=True)


if __name__ == "__main__":
    main(sys.argv[1], *map(int, sys.argv[2:]))
