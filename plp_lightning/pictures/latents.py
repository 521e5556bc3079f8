"""A picture of the latent space in TensorBoard and in the run directory."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch
from lightning.pytorch import Callback, LightningModule, Trainer
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from datamodules.transfer import TransferDataModule
from plp_lightning.envs.base import Simulator
from plp_lightning.envs.faults import blaming, forgiving
from plp_lightning.envs.views import Arranged
from plp_lightning.evaluation.scores import AlignmentScore, encode, sample_rows
from plp_lightning.methods.phase import Phase
from plp_lightning.methods.policy import AligningPolicy
from plp_lightning.pictures.neighbours import Pictures, neighbour_figure, neighbour_pairs, seen_images
from plp_lightning.pictures.publish import publish
from plp_lightning.pictures.reenactment import Reenactment
from plp_lightning.pictures.style import COLOURS, MARKERS

LEGEND: dict[str, Any] = {"loc": "upper center", "bbox_to_anchor": (0.5, 0), "ncols": 3, "markerscale": 2}


class LatentPicture(Callback):
    """t-SNE of all domains' latent states on proxy tasks, at the end of a phase or every n epochs.

    As in the paper (Figure 3), lines join states of source and target domain that correspond. The target task in
    the target domain is never read. Where a simulator tells how an episode is arranged, the same points are also
    coloured by that: whether latent states know it decides whether a task can be adapted to. States that are each
    other's nearest are shown too (``neighbours.png``), as cameras have seen them or as simulators draw them.

    Args:
        samples: States of each domain.
        every_n_epochs: Epochs between two pictures; 0 draws one at the end of the phase only.
        pairs: Corresponding states that are joined.
        score: Score that knows which states correspond; without one nothing is joined.
        simulators: Simulators by domain.
        reenactment: Draws states that no camera has seen; without it they are not shown.
    """

    def __init__(
        self,
        samples: int = 500,
        every_n_epochs: int = 0,
        pairs: int = 20,
        score: AlignmentScore | None = None,
        simulators: Mapping[str, Simulator] | None = None,
        reenactment: Reenactment | None = None,
    ) -> None:
        self.samples, self.every_n_epochs, self.pairs = samples, every_n_epochs, pairs
        self.score, self.simulators, self.reenactment = score, simulators or {}, reenactment

    def on_train_epoch_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        epoch = trainer.current_epoch + 1
        turn = self.every_n_epochs > 0 and epoch % self.every_n_epochs == 0
        policy = pl_module.policy if isinstance(pl_module, Phase) else None
        if (turn or epoch == trainer.max_epochs) and isinstance(policy, AligningPolicy):
            self._draw(trainer, policy)

    def _draw(self, trainer: Trainer, policy: AligningPolicy) -> None:
        data: TransferDataModule = trainer.datamodule  # type: ignore[attr-defined]
        rows = {d: sample_rows(data, d, self.samples) for d in data.domains}
        seen = {d: data.datasets[d].observation.take(torch.from_numpy(chosen)) for d, chosen in rows.items()}
        latents = {d: encode(policy, d, states).numpy() for d, states in seen.items()}
        kinds = {d: self._arrangements(data, d, chosen) for d, chosen in rows.items()}
        publish(trainer, "latents", latent_figure(latents, self._joined(policy, data), kinds))
        nearest = {d: latents[d] for d in (data.source_domain, data.target_domain) if d in latents}
        figure = neighbour_figure(nearest, self._images(data, rows, seen_images(seen), nearest))
        if figure is not None:
            publish(trainer, "neighbours", figure)

    def _images(
        self,
        data: TransferDataModule,
        rows: Mapping[str, np.ndarray],
        seen: Mapping[str, np.ndarray],
        latents: Mapping[str, np.ndarray],
    ) -> dict[str, Pictures]:
        """Pictures by cameras of states, and drawings of those that are nearest where there is no camera."""
        images: dict[str, Pictures] = dict(seen)
        if self.reenactment is None or len(latents) < 2:
            return images
        first, second = latents.values()
        pairs = neighbour_pairs(first, second)
        for side, domain in enumerate(latents):
            if domain not in images:
                chosen = [int(pair[side]) for pair in pairs]
                drawn = self.reenactment.images(data, domain, rows[domain][chosen])
                if not drawn:
                    break
                images[domain] = dict(zip(chosen, drawn, strict=True))
        return images

    def _arrangements(self, data: TransferDataModule, domain: str, rows: np.ndarray) -> list[str]:
        """Arrangement of each row's episode; empty if the simulator knows of none."""
        dataset, simulator = data.datasets[domain], self.simulators.get(domain)
        if not isinstance(simulator, Arranged):
            return []
        episodes = dataset.episode_of(rows)
        tasks = [data.tasks[i] for i in dataset.episode_task[episodes]]
        seeds = dataset.episode_seed[episodes].tolist()
        with forgiving("latent states are not coloured by arrangement"), blaming(simulator):
            return [simulator.arrangement(task, seed) for task, seed in zip(tasks, seeds, strict=True)]
        return []

    def _joined(self, policy: AligningPolicy, data: TransferDataModule) -> dict[str, np.ndarray]:
        if self.score is None or self.pairs == 0:
            return {}
        with forgiving("latent states are not joined"):
            states = self.score.correspondences(data, self.simulators, self.pairs)
            return {domain: encode(policy, domain, seen).numpy() for domain, seen in (states or {}).items()}
        return {}


def latent_figure(
    latents: Mapping[str, np.ndarray],
    joined: Mapping[str, np.ndarray] | None = None,
    kinds: Mapping[str, Sequence[str]] | None = None,
) -> Figure:
    """Scatter plot of the t-SNE projection of latent states, one colour a domain.

    Args:
        latents: By domain, ``(N_d, Z)``.
        joined: States of two of these domains ``(P, Z)``: row i of both is joined by a line.
        kinds: By domain, the kind of situation of each state: a second plot of the same points has a colour for each
            kind and a marker for each domain. Without any there is one plot.
    """
    pairs = dict(joined or {})
    named = {domain: names for domain, names in (kinds or {}).items() if names}
    colours = {domain: COLOURS[i % len(COLOURS)] for i, domain in enumerate(latents)}
    flat = _flatten([*latents.values(), *pairs.values()])
    plots = 2 if named else 1
    figure = Figure(figsize=(6 * plots, 6.5), layout="constrained")
    axes, *more = figure.subplots(1, plots, squeeze=False)[0]
    for (domain, colour), points in zip(colours.items(), flat, strict=False):
        axes.scatter(points[:, 0], points[:, 1], s=12, alpha=0.5, color=colour, label=domain, linewidths=0)
    ends = dict(zip(pairs, flat[len(latents) :], strict=True))
    if ends:
        lines = np.stack(list(ends.values()), axis=1)
        label = f"{len(lines)} pairs of corresponding states"
        axes.add_collection(LineCollection(lines, colors="black", linewidths=0.8, label=label, zorder=3))
    for domain, points in ends.items():
        axes.scatter(points[:, 0], points[:, 1], s=26, color=colours[domain], edgecolors="black", zorder=4)
    axes.set(xticks=[], yticks=[])
    axes.set_title("latent states of the proxy tasks (t-SNE)", fontsize=12)
    axes.legend(**LEGEND, frameon=False, fontsize=10)
    for other in more:
        _draw_kinds(other, dict(zip(latents, flat, strict=False)), named)
    return figure


def _draw_kinds(axes: Axes, points: Mapping[str, np.ndarray], kinds: Mapping[str, Sequence[str]]) -> None:
    """Points ``(N_d, 2)`` by domain, a colour for each kind and a marker for each domain."""
    for i, kind in enumerate(sorted({name for names in kinds.values() for name in names})):
        for marker, (domain, names) in zip(MARKERS, kinds.items(), strict=False):
            chosen = points[domain][np.array(names) == kind]
            colour, label = COLOURS[i % len(COLOURS)], f"{kind}, {domain}"
            axes.scatter(chosen[:, 0], chosen[:, 1], s=14, alpha=0.6, color=colour, marker=marker, label=label)
    axes.set(xticks=[], yticks=[])
    axes.set_title("the same by arrangement", fontsize=12)
    axes.legend(**LEGEND, frameon=False, fontsize=10)


def _flatten(parts: list[np.ndarray]) -> list[np.ndarray]:
    """Parts ``(N_i, Z)``, projected together, as ``(N_i, 2)``."""
    from sklearn.manifold import TSNE  # half a second and 20 MB that no step waits for

    rows = np.concatenate(parts)
    # A principal component more than there are latent numbers can't be had.
    start = "pca" if rows.shape[1] > 1 else "random"
    flat = TSNE(perplexity=min(30.0, (len(rows) - 1) / 3), random_state=0, init=start).fit_transform(rows)
    return np.split(flat, np.cumsum([len(part) for part in parts])[:-1])
