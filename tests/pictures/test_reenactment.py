"""States that no camera has seen are drawn by simulators, exactly as they were, or a line says why not."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tiny
from command import checkpoint, plp, same, smoke_run, tiny_smoke

from datamodules.errors import UserError
from datamodules.store.writer import write_trajectories
from datamodules.transfer import TransferDataModule
from plp_lightning.envs.base import Simulator
from plp_lightning.envs.synthetic import LinearPoint
from plp_lightning.pictures.reenactment import Reenactment
from plp_lightning.runs import collection
from plp_lightning.runs.collection import Job, demonstrate
from plp_lightning.runs.plans import CollectionConfig

ROWS = np.array([40, 3, 3 + 40, 12])


class Watched(LinearPoint):
    """Its pictures are the places of the point: two bytes of a share for each axis."""

    def render(self, episodes: np.ndarray, size: tuple[int, int]) -> np.ndarray:
        place = np.frombuffer(self.point[episodes].astype(">f8").tobytes(), np.uint8).reshape(len(episodes), 1, 16)
        return np.repeat(place[..., None], 3, axis=3)


class Blind(LinearPoint):
    """Cannot be looked at."""

    render: Any = None


class Dark(LinearPoint):
    """Cannot be drawn here."""

    def render(self, episodes: np.ndarray, size: tuple[int, int]) -> np.ndarray:
        raise UserError("no light")


class Broken(LinearPoint):
    """Fails when it is drawn."""

    def render(self, episodes: np.ndarray, size: tuple[int, int]) -> np.ndarray:
        raise ValueError("no bulb")


def collected(path: Path, settings: CollectionConfig) -> TransferDataModule:
    """Demonstrations of both tiny domains by these settings."""
    domains = tiny.domains()
    collection._begin_process(domains, 1)
    jobs = [Job(domain, task, 4, frozenset()) for domain in domains for task in tiny.TASKS]
    made = [trajectory for job in jobs for wave in demonstrate(job, settings) for trajectory in wave]
    specs = [domain.world.spec(name) for name, domain in domains.items()]
    write_trajectories(path, specs, tiny.TASKS, made, {"command": "tests"})
    data = tiny.data_module(path)
    data.setup("fit")
    return data


def drawn(
    data: TransferDataModule, simulator: Simulator, noise: float = 0, lasts: int = 1, start: int = 0
) -> list[np.ndarray]:
    return Reenactment({"flat": simulator}, noise, lasts, start).images(data, "flat", ROWS)


@pytest.mark.parametrize(("noise", "lasts", "start"), [(0.0, 1, 0), (0.3, 1, 0), (0.3, 3, 0), (0.0, 1, 4), (0.3, 2, 4)])
def test_pictures_are_those_of_the_states_in_their_order(noise: float, lasts: int, start: int, tmp_path: Path) -> None:
    data = collected(tmp_path / "a.hdf5", CollectionConfig(noise=noise, noise_steps=lasts, random_start_steps=start))
    simulator = Watched(1, state_size=3)
    pictures = drawn(data, simulator, noise, lasts, start)
    places = np.array([np.frombuffer(picture[0, :, 0].tobytes(), ">f8") for picture in pictures])
    states = data.datasets["flat"].observation.state[ROWS].numpy()
    np.testing.assert_array_equal((places @ simulator.lift.T + simulator.shift).astype(np.float32), states)


@pytest.mark.parametrize("kind", [Watched, Dark])
def test_what_pictures_took_is_given_back(kind: type[LinearPoint], tmp_path: Path) -> None:
    data, simulator = collected(tmp_path / "a.hdf5", CollectionConfig()), kind(1, state_size=3)
    vars(simulator)["_studio"] = object()
    drawn(data, simulator)
    assert "_studio" not in vars(simulator)


@pytest.mark.parametrize("wrong", [(0.0, 1, 4), (0.3, 2, 4), (0.3, 1, 0), (0.0, 1, 0)])
def test_demonstrations_that_lead_elsewhere_are_not_drawn(
    wrong: tuple[float, int, int], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data = collected(tmp_path / "a.hdf5", CollectionConfig(noise=0.3, random_start_steps=4))
    assert drawn(data, LinearPoint(1, state_size=3), *wrong) == []
    told = capsys.readouterr().err
    assert told.startswith("plp: LinearPoint: a demonstration of 'flat' leads elsewhere when it is run again; expected")
    assert told.count("\n") == 1


REASONS = {
    Dark: "plp: no light; nearest states are not drawn",
    Broken: "plp: Broken raised ValueError at test_reenactment.py",
    Blind: "nearest states are not drawn: domain 'flat' has no camera, nor a simulator that renders",
}


@pytest.mark.parametrize("kind", REASONS)
def test_what_can_not_be_drawn_is_told_in_a_line(
    kind: type[LinearPoint], trajectory_file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data = tiny.data_module(trajectory_file)
    data.setup("fit")
    assert drawn(data, kind(1, state_size=3)) == []
    told = "".join(capsys.readouterr())
    assert told.startswith(REASONS[kind])
    assert told.count("\n") == 1


def test_who_has_demonstrations_alone_is_not_told_of_pictures(
    trajectory_file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data = tiny.data_module(trajectory_file)
    data.setup("fit")
    assert Reenactment({}).images(data, "flat", ROWS) == []
    assert "".join(capsys.readouterr()) == ""


def test_a_run_leaves_them_in_every_phase_and_learns_the_same(tmp_path: Path) -> None:
    often = ["--evaluation.latent_states", "20", "--evaluation.latent_every_n_epochs", "1"]
    for name, words in {"drawn": often, "plain": []}.items():
        answer = plp("fit", *tiny_smoke(tmp_path / name), *words)
        assert (answer.code, answer.err) == (0, "")
    one, other = (smoke_run(tmp_path / name) for name in ("drawn", "plain"))
    for phase in one.done_phases():
        assert (one.phase(phase) / "neighbours.png").stat().st_size > 0
        assert same(checkpoint(one, phase)["state_dict"], checkpoint(other, phase)["state_dict"])
