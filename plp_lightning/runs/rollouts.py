"""Films of a policy's episodes: they run without pictures, failures come first, and the chosen run again."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.colors import to_rgb

from datamodules.errors import ConfigError
from datamodules.store.guard import as_name
from datamodules.types import Observation
from plp_lightning.envs.base import Simulator, Step
from plp_lightning.envs.rollout import Episodes, Observer
from plp_lightning.evaluation.simulation import EvalSetting, Outcome, evaluate
from plp_lightning.methods.policy import Policy, check_known
from plp_lightning.pictures.movies import caption, framed, makes_mp4, write_gif, write_mp4
from plp_lightning.pictures.paths import FAILED, SOLVED
from plp_lightning.pictures.replay import check_filmable, replay
from plp_lightning.runs.experiment import Experiment
from plp_lightning.runs.rehearsal import check_packages

LINES = 2  # that the name of a task may take, which may be a sentence
WIDTH = 256  # least width of a film's pictures, pixels
COLOURS = {"diverged": FAILED, "failed": FAILED, "solved": SOLVED}
"""Colours of the ends that an episode can have, in the order in which they are shown."""
ENDS = [*COLOURS]
WRITERS = {".mp4": write_mp4, ".gif": write_gif}


class Taken(NamedTuple):
    """An episode that was run; task, seed and actions are all that it takes to run it again."""

    number: int  # among all that were run
    task: str
    seed: int
    actions: np.ndarray  # (T, A)
    end: str  # one of ENDS


class ActionRecorder(Observer):
    """Keeps the actions ``(T, A)`` of every episode."""

    def begin(self, tasks: Sequence[str], seeds: Sequence[int], observation: Observation[np.ndarray]) -> None:
        self._began = [*zip(tasks, seeds, strict=True)]
        self._actions: list[list[np.ndarray]] = [[] for _ in tasks]

    def step(self, actions: np.ndarray, step: Step, episodes: np.ndarray) -> None:
        for episode, action in zip(episodes, actions, strict=True):
            self._actions[episode].append(action)

    def end(self, outcome: Episodes) -> None:
        ends = np.where(outcome.invalid, 0, 1 + outcome.success)
        known = zip(self._began, self._actions, ends, strict=True)
        self.taken = [Taken(n, *began, np.array(made), ENDS[end]) for n, (began, made, end) in enumerate(known)]

    def failures_first(self) -> list[Taken]:
        """All episodes, in order of their ends and then of their numbers."""
        return sorted(self.taken, key=lambda taken: ENDS.index(taken.end))


@dataclass(frozen=True)
class Scene:
    """A domain, a task and a seed, of which films are made."""

    simulator: Simulator
    setting: EvalSetting
    target: str  # that the setting's tasks make up
    seed: int
    size: tuple[int, int]  # height and width of pictures, pixels

    @classmethod
    def of(
        cls, experiment: Experiment, domain: str | None, target: str | None, seed: int | None, size: tuple[int, int]
    ) -> Scene:
        """The scene that is asked for; the target task in the target domain, and the run's seed, if none is named.

        Raises:
            ConfigError: If there is no such domain or task, or the domain has no simulator or cannot be filmed.
            UserError: If pictures cannot be drawn on this machine.
        """
        data = experiment.data
        domain = data.target_domain if domain is None else domain
        target = data.target_task if target is None else target
        check_known("domain", [domain], experiment.domains)
        if domain not in experiment.simulators:
            raise ConfigError(f"domain {domain!r} is known by its demonstrations alone; expected one with a simulator")
        simulator = experiment.simulators[domain]
        check_packages({domain: simulator})
        setting = EvalSetting(domain, simulator.tasks.of(target))
        scene = cls(simulator, setting, target, experiment.seed if seed is None else seed, size)
        (task,), (first,) = setting.in_turn("evaluate", scene.seed, 1)
        check_filmable(simulator, domain, task, first, size)
        return scene

    @property
    def name(self) -> str:
        """Beginning of the names of all its films."""
        return f"{as_name(self.setting.domain)}_{as_name(self.target)}_seed_{self.seed}"

    def run(self, policy: Policy, episodes: int) -> tuple[Outcome, list[Taken]]:
        """Run so many episodes, those of an evaluation with this seed, without pictures; failures first."""
        check_known("domain", [self.setting.domain], policy.acts_in)
        check_known("task", self.setting.tasks, policy.tasks)
        recorder = ActionRecorder()
        outcome = evaluate(policy, self.simulator, self.setting, episodes, self.seed, observers=[recorder])
        return outcome, recorder.failures_first()

    def film(self, taken: Taken, folder: Path) -> dict[str, Any]:
        """Write a film ``(H, W, 3)`` of an episode, as GIF and, where that can be made, as mp4; a record of it."""
        played = replay(self.simulator, taken.task, taken.seed, taken.actions, self.size)
        end = taken.end
        if played.success != (end == "solved"):
            end = "solved" if played.success else "failed"
            told = f"{type(self.simulator).__name__}: episode {taken.number} was {taken.end}, and is {end} when it is"
            print(f"plp: {told} run again, as its film shows; expected the same of the same seed", file=sys.stderr)
        above, colour = self._told(taken, end), to_rgb(COLOURS[end])
        frames = [_under(above, framed(image, WIDTH, colour)) for image in played.frames]
        files = self._write(frames, played.rate, folder, end, taken.number)
        about = {"episode": taken.number, "task": taken.task, "end": end, "steps": len(taken.actions)}
        return about | {"files": files}

    def _write(self, frames: Sequence[np.ndarray], rate: float, folder: Path, end: str, number: int) -> list[str]:
        """Write frames in every form that can be made here, and remove films of the episode from another time."""
        names = {(e, form): f"{self.name}_{e}_{number:03}{form}" for e in ENDS for form in WRITERS}
        written = [names[end, form] for form in WRITERS if form != ".mp4" or makes_mp4()]
        for name in written:
            WRITERS[Path(name).suffix](folder / name, frames, rate)
        for name in {*names.values()} - {*written}:
            (folder / name).unlink(missing_ok=True)
        return written

    def _told(self, taken: Taken, end: str) -> list[str]:
        """Text of a caption, a line or more each."""
        ended = f"{end} after {len(taken.actions)} steps"
        return [f"{taken.task} in {self.setting.domain}", f"episode {taken.number}, seed {self.seed}: {ended}"]


def _under(lines: Sequence[str], image: np.ndarray) -> np.ndarray:
    """An image ``(H, W, 3)`` under lines of text."""
    return np.concatenate([*(caption(line, image.shape[1], LINES) for line in lines), image])
