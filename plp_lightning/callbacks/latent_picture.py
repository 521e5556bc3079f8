"""A picture of the latent space in TensorBoard and in the run directory."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from lightning.pytorch import Callback, LightningModule, Trainer
from lightning.pytorch.loggers import TensorBoardLogger
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from sklearn.manifold import TSNE

from datamodules.transfer import TransferDataModule
from plp_lightning.evaluation.scores import encode, sample_states
from plp_lightning.phases import Phase


class LatentPicture(Callback):
    """t-SNE of all domains' latent states on proxy tasks, at the end of a phase or every n epochs.

    Args:
        samples: States of each domain.
        every_n_epochs: Epochs between two pictures; 0 draws one at the end of the phase only.
    """

    def __init__(self, samples: int = 500, every_n_epochs: int = 0) -> None:
        self.samples, self.every_n_epochs = samples, every_n_epochs

    def on_train_epoch_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Draw, if it is this epoch's turn."""
        epoch = trainer.current_epoch + 1
        turn = self.every_n_epochs > 0 and epoch % self.every_n_epochs == 0
        if (turn or epoch == trainer.max_epochs) and isinstance(pl_module, Phase):
            self._draw(trainer, pl_module)

    def _draw(self, trainer: Trainer, phase: Phase) -> None:
        data: TransferDataModule = trainer.datamodule  # type: ignore[attr-defined]
        latents = {d: encode(phase.policy, d, sample_states(data, d, self.samples)).numpy() for d in data.domains}
        figure = latent_figure(latents)
        for logger in trainer.loggers:
            if isinstance(logger, TensorBoardLogger):
                logger.experiment.add_image("latents", pixels(figure), trainer.global_step, dataformats="HWC")
                figure.savefig(Path(logger.log_dir) / "latents.png", dpi=120)


def latent_figure(latents: dict[str, np.ndarray]) -> Figure:
    """Scatter plot of the t-SNE projection of ``latents[domain] (N_d, Z)``, one colour a domain."""
    joined = np.concatenate(list(latents.values()))
    perplexity = min(30.0, (len(joined) - 1) / 3)
    flat = TSNE(perplexity=perplexity, random_state=0, init="pca").fit_transform(joined)
    figure = Figure(figsize=(5, 5), layout="tight")
    axes = figure.subplots()
    ends = np.cumsum([len(part) for part in latents.values()])
    for domain, points in zip(latents, np.split(flat, ends[:-1]), strict=True):
        axes.scatter(points[:, 0], points[:, 1], s=8, alpha=0.6, label=domain, linewidths=0)
    axes.set(xticks=[], yticks=[], title="latent states of the proxy tasks (t-SNE)")
    axes.legend(markerscale=2)
    return figure


def pixels(figure: Figure) -> np.ndarray:
    """RGB image ``(H, W, 3)`` uint8 of a figure."""
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3].copy()
