"""``plp rollout``: films of a run's policy."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from plp_lightning.cli.assessing import assessment_options, read_assessment
from plp_lightning.cli.options import pixels, positive, seed
from plp_lightning.evaluation.simulation import Outcome
from plp_lightning.pictures.movies import makes_mp4
from plp_lightning.runs.assessment import Assessment
from plp_lightning.runs.printing import shown
from plp_lightning.runs.rollouts import Scene, Taken

SIZE = (256, 256)


def run_rollout(arguments: Sequence[str]) -> None:
    """``plp rollout``: success of a run's policy in one domain, and films of its episodes, failures first."""
    assessment, options = _asked(arguments)
    scene = Scene.of(assessment.experiment, options.domain, options.task, options.seed, tuple(options.size))
    folder = options.out or assessment.folder / "rollouts"
    folder.mkdir(parents=True, exist_ok=True)
    among = options.among or assessment.experiment.evaluation.final_episodes
    outcome, taken = scene.run(assessment.policy, max(among, options.episodes))
    _print_outcome(scene, outcome)
    films = [_filmed(scene, episode, folder) for episode in taken[: options.episodes]]
    about = {"domain": scene.setting.domain, "task": scene.target, "seed": scene.seed}
    assessment.write(folder / f"{scene.name}.json", {**about, **outcome.to_dict(), "films": films})
    if not makes_mp4():
        print("plp: films are GIF alone; for mp4 as well: pip install 'plp-lightning[video]'", file=sys.stderr)


def _asked(arguments: Sequence[str]) -> tuple[Assessment, argparse.Namespace]:
    parser = assessment_options("rollout", arguments, "Films of a trained policy, failures first, as mp4 and GIF.")
    parser.add_argument("--domain", help="domain that it acts in; the target domain if not given")
    parser.add_argument("--task", help="task that it does; the target task if not given")
    parser.add_argument("--episodes", type=positive, default=4, help="episodes that are filmed; 4 if not given")
    parser.add_argument("--among", type=positive, help="episodes to choose them from; as in plp test if not given")
    parser.add_argument("--seed", type=seed, help="seed of the initial states; the run's if not given")
    told = "height and width of the pictures, pixels; 256 256 if not given"
    parser.add_argument("--size", type=pixels, nargs=2, metavar=("H", "W"), default=SIZE, help=told)
    parser.add_argument("--out", type=Path, help="folder for the films; rollouts in the run directory if not given")
    return read_assessment(parser, arguments)


def _print_outcome(scene: Scene, outcome: Outcome) -> None:
    (low, high), counts = outcome.interval, f"{outcome.episodes} episodes, {outcome.invalid} invalid"
    told = f"{scene.target} in {scene.setting.domain}: success {outcome.success:.2f} ({low:.2f} – {high:.2f})"
    print(shown(f"{told} of {counts}"))


def _filmed(scene: Scene, episode: Taken, folder: Path) -> dict[str, Any]:
    film = scene.film(episode, folder)
    first, *others = film["files"]
    files = ", ".join([str(folder / first), *(Path(name).suffix for name in others)])
    print(shown(f"episode {film['episode']}, {film['task']}, {film['end']} after {film['steps']} steps: {files}"))
    return film
