"""The DataModule: demonstrations of proxy tasks in every domain, of the target task in the source domain."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from functools import cached_property, partial
from pathlib import Path
from typing import Any, Literal, cast

import numpy as np
import torch
from filelock import FileLock
from lightning.pytorch import LightningDataModule

from datamodules.amounts import COLLECTED, COLLECTED_TARGET, Batching, Demonstrations
from datamodules.batches.dataset import DomainDataset, build_dataset, check_values
from datamodules.batches.fixed import FixedLoader, Selection, fits
from datamodules.batches.images import Images, stored_images
from datamodules.batches.loader import FixedBatches, FixedPairs, Loader, Order, PairSource
from datamodules.batches.normalization import Statistics
from datamodules.batches.orders import AlignmentOrder, MixOrder, NoSteps, PairOrder, TaskwiseOrder
from datamodules.errors import MissingTrajectoriesError
from datamodules.problem import TransferProblem, TransferRoles
from datamodules.settings import NonNegativeFloat, Seed
from datamodules.store.atomic import final_path
from datamodules.store.missing import told_missing
from datamodules.store.reader import TrajectoryFile, verify_hashes
from datamodules.store.recorder import join_parts, part_files
from datamodules.streams import Stream, generator
from datamodules.types import Batch, BatchSpec, Collector, DomainSpec

Part = Literal["train", "val"]


class TransferDataModule(LightningDataModule):
    """Trajectories of one experiment, as batches for its phases.

    Alignment data are the proxy tasks in every domain; adaptation data are the target task in the source
    domain, mixed with alignment data. The target task in the target domain is never read.

    Args:
        path: The trajectory file.
        roles: Domains and tasks, and the part that each plays.
        demonstrations: Numbers of demonstrations.
        batching: Contents of a batch.
        seed: Seed of every draw.
        image_memory: GiB that images may take in memory; if they need more, they are read from the file as batches
            ask for them, and as much of them is kept. The batches are the same.
        collector: Makes missing demonstrations; None if they can only come from the file.
        fixed_shapes: Give a GPU batches of fixed shapes, from tables that lie there, as CUDA graphs want them.
    """

    def __init__(
        self,
        path: Path,
        roles: TransferRoles,
        demonstrations: Demonstrations,
        batching: Batching,
        seed: Seed = 0,
        image_memory: NonNegativeFloat = 4.0,
        collector: Collector | None = None,
        fixed_shapes: bool = False,
    ) -> None:
        super().__init__()
        self.path, self.seed, self.image_memory, self.collector = path, seed, image_memory, collector
        self.domains, self.source_domain, self.target_domain = roles.domains, roles.source_domain, roles.target_domain
        self.tasks, self.proxy_tasks = roles.tasks, roles.proxy_tasks
        self.target_task, self.target_tasks = roles.target_task, roles.target_tasks
        self.demonstrations, self.batching, self.val_fraction = demonstrations, batching, demonstrations.val_fraction
        self.fixed_shapes = fixed_shapes
        self.collected = 0  # Demonstrations that :meth:`prepare_data` made here
        self._loader: Loader | FixedLoader | None = None
        self._cursor: Mapping[str, int] | None = None

    def needed(self) -> dict[str, dict[str, int]]:
        """Demonstrations that the experiment needs: ``needed[domain][task]``."""
        wanted, needed = self.demonstrations, dict[str, dict[str, int]]()
        for domain in self.domains:
            total = (domain != self.target_domain and wanted.source_trajectories) or wanted.trajectories
            needed[domain] = self._shares(domain, self.proxy_tasks, total, COLLECTED)
        source = self.source_domain
        needed[source] |= self._shares(source, self.target_tasks, wanted.target_trajectories, COLLECTED_TARGET)
        return needed

    def _shares(self, domain: str, tasks: Sequence[str], total: int | None, collected: int) -> dict[str, int]:
        """Demonstrations of each task: equal shares of a ``total``, or else as many as there are."""
        if total is None and not (self.collector is not None and self.collector.makes(domain)):
            counts = self.counts().get(domain, {})
            return {task: max(1, counts.get(task, 0)) for task in tasks}
        return dict.fromkeys(tasks, -(-(total or collected) // len(tasks)))

    def counts(self) -> dict[str, dict[str, int]]:
        """Demonstrations that the file holds, by domain and task; none if there is no file."""
        if not self.path.exists():
            return {}
        with TrajectoryFile.open(self.path) as file:
            return file.counts()

    def missing(self) -> dict[str, dict[str, int]]:
        """The part of :meth:`needed` that the file lacks; empty if nothing is missing."""
        missing, counts = self.needed(), self.counts()
        for domain, tasks in missing.items():
            lacking = {task: n - counts.get(domain, {}).get(task, 0) for task, n in tasks.items()}
            missing[domain] = {task: n for task, n in lacking.items() if n > 0}
        return {domain: tasks for domain, tasks in missing.items() if tasks}

    def prepare_data(self) -> None:
        """Collect the demonstrations that are missing, one process at a time; what a stopped one left is taken first.

        Raises:
            MissingTrajectoriesError: If some are missing and there is no collector.
            UserError: If the collector would have made those that are there otherwise.
        """
        place = final_path(self.path)
        self.collected = 0
        self._check_origin([self.path])
        if not self.missing():
            return
        place.parent.mkdir(parents=True, exist_ok=True)
        with FileLock(f"{place}.lock"):
            self._check_origin([self.path, *part_files(self.path)])  # others may have made them while this one waited
            join_parts(self.path)
            if missing := self.missing():
                if self.collector is None:
                    raise MissingTrajectoriesError(told_missing(self.path, missing))
                self.collector(self.path, missing)
                self.collected = sum(sum(tasks.values()) for tasks in missing.values())

    def _check_origin(self, files: Sequence[Path]) -> None:
        for file in files:
            if self.collector is not None and file.exists():
                self.collector.check(file)

    @cached_property
    def datasets(self) -> dict[str, DomainDataset]:
        """Trajectories that this run may see, read once, by domain: states ``(N + L, O)``, actions ``(N, A)``.

        Raises:
            TrajectoryFileError: If the file's values are not those that were written, or none that can be trained on:
                not finite, or actions outside [-1, 1].
        """
        verify_hashes(self.path)
        with TrajectoryFile.open(self.path) as file:
            chosen = {domain: self._chosen(file, domain) for domain in self.domains}
            images = stored_images(file, chosen, self.image_memory)
            found = {domain: self._read(file, domain, chosen[domain], images[domain]) for domain in self.domains}
        for domain, dataset in found.items():
            check_values(self.path, domain, dataset)
        return found

    def _chosen(self, file: TrajectoryFile, domain: str) -> np.ndarray:
        task = file.episodes(domain).task
        return np.sort(np.concatenate([np.flatnonzero(task == k)[:n] for k, n in self.needed()[domain].items()]))

    def _read(
        self, file: TrajectoryFile, domain: str, chosen: np.ndarray, images: Mapping[str, Images]
    ) -> DomainDataset:
        arrays = file.read(domain, chosen, images=False)
        episode_task = np.array([self.tasks.index(name) for name in arrays.task])
        numbers = (arrays.offset, episode_task, file.episodes(domain).seed[chosen], arrays.last)
        return build_dataset(file.spec(domain), arrays.state, images, arrays.actions, *numbers)

    @property
    def specs(self) -> list[DomainSpec]:
        """Specs of the domains, in order: sizes of states ``(O,)``, images ``(H, W, C)`` and actions ``(A,)``."""
        return [dataset.spec for dataset in self.datasets.values()]

    @property
    def problem(self) -> TransferProblem:
        """Domains, tasks and scaling that a policy for these data is built for."""
        return TransferProblem(self.specs, self.tasks, self.source_domain, self.target_domain, self.statistics())

    @cached_property
    def fingerprint(self) -> str:
        """SHA-256 of everything that this run trains on."""
        digest = hashlib.sha256()
        for dataset in self.datasets.values():
            for piece in dataset.pieces():
                digest.update(np.ascontiguousarray(piece.numpy()).data)
        return digest.hexdigest()

    def episodes(self, domain: str, tasks: Sequence[str], part: Part) -> np.ndarray:
        """Trajectory ids ``(n,)`` of ``tasks`` in one part of a domain's data; the parts never overlap."""
        wanted = np.array([self.tasks.index(task) for task in tasks])
        ids = self.datasets[domain].episodes_of(wanted)
        order = generator(Stream.VAL_SPLIT, len(ids)).permutation(ids)
        count = max(1, round(self.val_fraction * len(ids))) if self.val_fraction > 0 and len(ids) > 1 else 0
        return np.sort(order[:count] if part == "val" else order[count:])

    def rows(self, tasks: Sequence[str], part: Part, next_observation: bool = False) -> dict[str, np.ndarray]:
        """Rows ``(n,)`` of ``tasks`` by domain, if asked for those with a next observation; no domain without any."""
        found = {d: dataset.rows_of(self.episodes(d, tasks, part)) for d, dataset in self.datasets.items()}
        if next_observation:
            found = {d: rows[self.datasets[d].next_row.numpy()[rows] >= 0] for d, rows in found.items()}
        return {domain: rows for domain, rows in found.items() if len(rows)}

    def statistics(self) -> dict[str, Statistics]:
        """Statistics ``(O,)`` of the raw states that the alignment phase trains on, by domain."""
        rows = self.rows(self.proxy_tasks, "train")
        return {d: Statistics.fit(self.datasets[d].observation.state.numpy()[r]) for d, r in rows.items()}

    def loader(self, batch_spec: BatchSpec) -> Loader:
        """Training batches of a phase: steps ``(B, …)``, and pairs of trajectories if it asks for them."""
        datasets = self._tables(batch_spec)
        return Loader(datasets, self._order(batch_spec), self._pairs(batch_spec, datasets), batch_spec)

    def fixed_loader(self, batch_spec: BatchSpec, device: torch.device) -> FixedLoader:
        """The same batches in fixed shapes, from tables ``(N, …)`` on a device."""
        datasets = {domain: dataset.to(device) for domain, dataset in self._tables(batch_spec).items()}
        return FixedLoader(datasets, self._order(batch_spec), self._pairs(batch_spec, datasets), batch_spec)

    def _pairs(self, batch_spec: BatchSpec, datasets: Mapping[str, DomainDataset]) -> PairSource | None:
        if batch_spec.pairs == "none":
            return None
        order = PairOrder({d: self.episodes_by_task(d) for d in self.domains}, self.batching.pairs, self.seed)
        return PairSource(datasets, order, self.batching.stride if batch_spec.pairs == "thinned" else 1)

    def _order(self, batch_spec: BatchSpec) -> Order:
        least = self.batching.epoch_steps
        if batch_spec.steps == "none":  # so many steps that as many pairs come as the target domain has trajectories
            count = len(self.episodes(self.target_domain, self.proxy_tasks, "train"))
            return NoSteps(max(-(-count // self.batching.pairs), least))
        rows_of = partial(self.rows, part="train", next_observation=batch_spec.next_observation)
        drawn = self.batching.batch_size, self.seed, least
        if batch_spec.steps == "mix":
            return MixOrder(rows_of(self.target_tasks), rows_of(self.proxy_tasks), self.batching.mix_ratio, *drawn)
        rows = rows_of([*self.proxy_tasks, *(self.target_tasks if batch_spec.steps == "all" else ())])
        if self.batching.tasks_per_batch is None:
            return AlignmentOrder(rows, *drawn)
        tasks = {domain: self.datasets[domain].task.numpy()[found] for domain, found in rows.items()}
        return TaskwiseOrder(rows, tasks, self.batching.tasks_per_batch, *drawn)

    def _tables(self, batch_spec: BatchSpec) -> dict[str, DomainDataset]:
        return {d: dataset if batch_spec.images else dataset.without_images() for d, dataset in self.datasets.items()}

    def _held_out_pairs(self, datasets: Mapping[str, DomainDataset]) -> FixedPairs:
        """Trajectories of the target domain that are held out, beside those of the source, held out if it has any."""
        source, target = self.source_domain, self.target_domain
        partners = self.episodes_by_task(source, "train") | self.episodes_by_task(source, "val")
        episodes = {source: partners, target: self.episodes_by_task(target, "val")}
        return FixedPairs(datasets, episodes, self.batching.pairs)

    def episodes_by_task(self, domain: str, part: Part = "train") -> dict[int, np.ndarray]:
        """Trajectory ids ``(n,)`` of a domain's proxy tasks, by task index; tasks without any are left out."""
        found = self.episodes(domain, self.proxy_tasks, part)
        task = self.datasets[domain].episode_task[found]
        return {int(index): found[task == index] for index in np.unique(task)}

    def train_dataloader(self) -> Loader | FixedLoader:
        self._loader, cursor, self._cursor = self._phase_loader(self._phase_spec()), self._cursor, None
        if self.trainer is not None:  # an epoch that it cuts short is over, and the next one begins anew
            limit = self.trainer.limit_train_batches
            steps = int(limit * len(self._loader)) if isinstance(limit, float) else limit
            self._loader.cut(steps, repeats=self.trainer.overfit_batches > 0)  # type: ignore[attr-defined]
        if cursor is not None:
            self._loader.load_state_dict(cursor)
        return self._loader

    def _phase_loader(self, batch_spec: BatchSpec) -> Loader | FixedLoader:
        device = torch.device("cpu") if self.trainer is None else self.trainer.strategy.root_device
        fixed = self.fixed_shapes and device.type == "cuda" and fits(self._tables(batch_spec), device)
        return self.fixed_loader(batch_spec, device) if fixed else self.loader(batch_spec)

    def val_dataloader(self) -> FixedBatches | FixedPairs:
        batch_spec = self._phase_spec()
        tasks = self.target_tasks if batch_spec.steps == "mix" else self.proxy_tasks
        return self._held_out(batch_spec, self.rows(tasks, "val", batch_spec.next_observation))

    def held_out_proxies(self, batch_spec: BatchSpec) -> FixedBatches | FixedPairs:
        """Held-out batches of proxy tasks in the target domain; pairs hold the source's of their task beside them."""
        rows = self.rows(self.proxy_tasks, "val", batch_spec.next_observation)
        return self._held_out(batch_spec, {d: found for d, found in rows.items() if d == self.target_domain})

    def _held_out(self, batch_spec: BatchSpec, rows: Mapping[str, np.ndarray]) -> FixedBatches | FixedPairs:
        datasets = self._tables(batch_spec)
        if batch_spec.steps == "none":
            return self._held_out_pairs(datasets)
        return FixedBatches(datasets, rows, min(table.rows_at_a_time(1024) for table in datasets.values()), batch_spec)

    def transfer_batch_to_device(self, batch: Batch | Selection, device: torch.device, dataloader_idx: int) -> Batch:
        if isinstance(batch, Selection):
            return batch.gather()
        if device.type == "cpu":  # nowhere to move it, so nothing to walk through
            return batch
        return cast("Batch", super().transfer_batch_to_device(batch, device, dataloader_idx))

    def _phase_spec(self) -> BatchSpec:
        return BatchSpec() if self.trainer is None else cast("BatchSpec", self.trainer.lightning_module.batch_spec)

    @property
    def parts(self) -> tuple[Part, ...]:
        """The parts that hold trajectories."""
        return ("train", "val") if self.val_fraction > 0 else ("train",)

    def state_dict(self) -> dict[str, Any]:
        return {} if self._loader is None else dict(self._loader.state_dict())

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        self._cursor = state_dict or None
