"""Images of cameras beside their reconstructions from latent states, in TensorBoard and in the run directory."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import torch
from lightning.pytorch import Callback, LightningModule, Trainer
from matplotlib.figure import Figure

from datamodules.transfer import TransferDataModule
from datamodules.types import Observation
from plp_lightning.evaluation.scores import sample_states
from plp_lightning.methods.plp import Alignment
from plp_lightning.methods.plp.terms import ImageReconstruction
from plp_lightning.pictures.publish import publish

ROWS = ("seen", "reconstructed")


class ReconstructionPicture(Callback):
    """Draws images of proxy tasks, each above its reconstruction, at the end of a phase that has an image decoder.

    Args:
        samples: Images of each domain.
    """

    def __init__(self, samples: int = 8) -> None:
        self.samples = samples

    def on_train_epoch_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        last = trainer.current_epoch + 1 == trainer.max_epochs
        if last and isinstance(pl_module, Alignment) and _decoders(pl_module):
            data: TransferDataModule = trainer.datamodule  # type: ignore[attr-defined]
            publish(trainer, "reconstructions", reconstruction_figure(reconstructions(pl_module, data, self.samples)))


@torch.no_grad()
def reconstructions(phase: Alignment, data: TransferDataModule, count: int) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """``count`` images of proxy tasks of each camera, as seen and as reconstructed.

    Returns:
        By domain, and camera where a domain has several: ``(N, H, W, C)`` uint8, and ``(N, H', W', C)`` in (0, 1),
        smaller if the decoder's images are.
    """
    seen: dict[str, Observation[torch.Tensor]] = {
        spec.name: sample_states(data, spec.name, count) for spec in data.specs if spec.image_keys
    }
    latent = phase.policy.encode({d: obs.map(lambda x: x.to(phase.device)) for d, obs in seen.items()})
    made = _decoders(phase)[0].reconstruct(latent)
    told = {view: view[0] if len(seen[view[0]].images) == 1 else "\n".join(view) for view in made}
    pairs = {told[d, name]: (seen[d].images[name], image) for (d, name), image in made.items()}
    return {name: (image.numpy(), again.float().cpu().numpy()) for name, (image, again) in pairs.items()}


def _decoders(phase: Alignment) -> list[ImageReconstruction]:
    terms = (term for term in phase.alignment_terms if isinstance(term, ImageReconstruction))
    return [term for term in terms if term.image_decoder is not None]


def reconstruction_figure(pairs: Mapping[str, tuple[np.ndarray, np.ndarray]]) -> Figure:
    """Two rows for each camera: images ``(N, H, W, C)``, and below them reconstructions ``(N, H', W', C)``."""
    count = max(len(seen) for seen, _ in pairs.values())
    figure = Figure(figsize=(1.2 * count + 1.2, 2.5 * len(pairs)), layout="constrained")
    grid = figure.subplots(2 * len(pairs), count, squeeze=False)
    for axes in grid.flat:
        axes.axis("off")
    rows = [(domain, what, images) for domain, pair in pairs.items() for what, images in zip(ROWS, pair, strict=True)]
    for row, (domain, what, images) in zip(grid, rows, strict=True):
        row[0].text(-0.1, 0.5, f"{domain}\n{what}", transform=row[0].transAxes, ha="right", va="center", fontsize=10)
        for axes, image in zip(row, images, strict=False):
            axes.imshow(image)
    return figure
