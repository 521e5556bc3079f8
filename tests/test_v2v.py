"""V2V through the command line, in miniature: collected by its experts, trained, scored and pictured."""

from __future__ import annotations

import json

import pytest
from command import ROOT, TINY, plp
from matplotlib.image import imread
from PIL import Image
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from datamodules.store.writer import TrajectoryFile
from plp_lightning.cli.config import parse
from plp_lightning.envs.rendering import backend
from plp_lightning.runs.directory import RunDirectory
from plp_lightning.runs.metrics_file import read_rows

pytestmark = pytest.mark.skipif(
    not (backend.works("egl") or backend.works("osmesa")), reason="neither EGL nor OSMesa is installed"
)
SMALL = [
    "--data.target_trajectories",
    "1",
    "--data.val_fraction",
    "0",
    "--adaptation.epochs",
    "1",
    "--alignment.epochs",
    "1",
]
SMALL += ["--policy.image_encoder.channels", "[4, 8]", "--policy.image_encoder.features", "16"]
SMALL += ["--evaluation.final_episodes", "2", "--collection.hold_steps", "1", "--alignment.terms.tcc", "TCC"]
PAGES = {
    "v2v_reach": (("left", "right"), 2, 60, []),
    "v2v_open": (("rear", "front"), 4, 140, ["--score.init_args.guided_episodes", "1"]),
}
"""Domains, demonstrations of proxy tasks, horizon, and further options."""


@pytest.fixture(scope="module", params=PAGES)
def run(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> RunDirectory:
    """One demonstration of each task, one epoch of each phase."""
    domains, proxy_tasks, horizon, further = PAGES[request.param]
    root = str(tmp_path_factory.mktemp(request.param))
    words = ["--config", str(ROOT / "configs" / f"{request.param}.yaml"), *TINY, *SMALL, *further]
    words += ["--data.root", root, "--run_root", root, "--data.trajectories", str(proxy_tasks)]
    for name in domains:
        words += [f"--domains.{name}.simulator.image_size", "32", f"--domains.{name}.simulator.horizon", str(horizon)]
    answer = plp("fit", *words)
    assert answer.code == 0, answer
    assert answer.err == ""
    return RunDirectory(parse(words).run_path)


def test_demonstrations_hold_images_and_no_target_task_of_the_target_domain(run: RunDirectory) -> None:
    experiment = parse(["--config", str(run.config)])
    data = experiment.data
    with TrajectoryFile.open(data.path) as file:
        counts = file.counts()
        images = {domain: file.trajectory(domain, 0).observation.images["image"] for domain in data.domains}
    proxy_tasks = dict.fromkeys(data.proxy_tasks, 1)
    assert {d: {t: n for t, n in tasks.items() if n} for d, tasks in counts.items()} == {
        data.source_domain: proxy_tasks | {data.target_task: 1},
        data.target_domain: proxy_tasks,
    }
    for image in images.values():
        assert image is not None
        assert image.shape[1:] == (32, 32, 3)
        assert image.std() > 10


def test_states_of_opening_are_scored_at_the_end_of_phases_alone(run: RunDirectory) -> None:
    scores = json.loads(run.results.read_text())["alignment"]
    window = run.path.parts[-4] == "v2v_open"
    assert {*scores} == ({"closeness", "closeness_target"} if window else {"closeness"})
    assert all(0 <= value <= 1 for value in scores.values())
    logged = {metric for _, metric, _ in read_rows(run.phase("alignment") / "metrics.csv")}
    assert "alignment/closeness" in logged
    assert "alignment/closeness_target" not in logged


@pytest.mark.parametrize(("phase", "names"), [("alignment", {"film", "reconstructions"}), ("adaptation", {"film"})])
def test_phases_leave_their_pictures(phase: str, names: set[str], run: RunDirectory) -> None:
    events = EventAccumulator(str(run.phase(phase)))
    events.Reload()
    assert {*events.Tags()["images"]} == {f"{phase}/{name}" for name in names}
    for name in names:
        (shown,) = events.Images(f"{phase}/{name}")
        assert imread(run.phase(phase) / f"{name}.png").shape[:2] == (shown.height, shown.width)
    with Image.open(run.phase(phase) / "film.gif") as film:
        assert film.n_frames > 2
