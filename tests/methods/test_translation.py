"""What GAMA and CDIL share: two domains, perceived states, and states that are known while a phase lasts."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
import seen
import tiny
import torch
from lightning.pytorch import Trainer

from datamodules.errors import ConfigError
from datamodules.transfer import TransferDataModule
from datamodules.types import DomainSpec, Observation, ObservationKey
from plp_lightning.losses import reconstruction
from plp_lightning.methods import CdilPolicy, GamaPolicy
from plp_lightning.methods.translation import CachedFeatures, PointReconstruction, TranslatingPolicy

TASKS = ("reach", "push", "lift")
BLIND = tiny.spec("blind", 3, 2)
KINDS = pytest.mark.parametrize("kind", [CdilPolicy, GamaPolicy], ids=lambda kind: kind.__name__)


def camera(name: str) -> DomainSpec:
    keys = (ObservationKey("a", (2,)), ObservationKey("camera", (8, 8, 3), "image"))
    return DomainSpec(name, keys, 2, control_hz=10.0)


@KINDS
@pytest.mark.parametrize("names", [("small",), ("small", "large", "third")])
def test_only_two_domains_can_be_translated(kind: type[TranslatingPolicy], names: tuple[str, ...]) -> None:
    problem = tiny.problem([tiny.spec(name, 3, 2) for name in names], TASKS)
    message = f"{kind.__name__} translates between two domains, found {', '.join(names)}; leave all but source and"
    with pytest.raises(ConfigError, match=message):
        kind(problem)  # type: ignore[call-arg]


@KINDS
def test_points_join_the_state_where_there_is_a_camera(kind: Callable[..., TranslatingPolicy]) -> None:
    policy = kind(tiny.problem([BLIND, camera("seeing")], TASKS), hidden=8, image_channels=[4, 3])
    assert policy.perception.sizes == {"blind": 3, "seeing": 8}
    image = torch.randint(0, 256, (5, 8, 8, 3), dtype=torch.uint8)
    observation = Observation(torch.zeros(5, 2), {"camera": image})
    points = policy.perception.image_encoders["seeing"](image)
    assert torch.equal(policy.features("seeing", observation), torch.cat([torch.zeros(5, 2), points], dim=1))
    with pytest.raises(ConfigError, match="no image, but domain 'seeing' has a camera"):
        policy.features("seeing", Observation(torch.zeros(5, 2)))


@KINDS
def test_each_camera_has_eyes_of_its_own_and_a_blind_policy_has_none(kind: Callable[..., TranslatingPolicy]) -> None:
    problem = tiny.problem([camera("left"), camera("right")], TASKS)
    assert set(kind(problem, hidden=8).perception.image_encoders) == {"left", "right"}
    blind = kind(problem, hidden=8, image_channels=[])
    assert blind.perception.sizes == {"left": 2, "right": 2}
    assert blind.features("left", Observation(torch.zeros(5, 2))).shape == (5, 2)
    wanted = r"Policy\.image_channels is 0; expected a whole number, at least 1; change it"
    with pytest.raises(ConfigError, match=wanted):
        kind(problem, image_channels=[4, 0])


def small(data: TransferDataModule) -> GamaPolicy:
    torch.manual_seed(0)
    return GamaPolicy(data.problem, hidden=8, policy_layers=1, map_layers=1, dynamics_layers=1, image_channels=[4, 3])


def test_images_are_drawn_from_their_points_alone(seen_file: Path) -> None:
    data = seen.data_module(seen_file)
    policy = small(data)
    redrawing = PointReconstruction(policy.perception, hidden=8)
    steps = {domain: dataset.take(torch.arange(4)) for domain, dataset in data.datasets.items()}
    state = {domain: policy.features(domain, found.observation) for domain, found in steps.items()}
    drawn = {d: redrawing.decoders[d](s[:, policy.domains[d].state_size :]) for d, s in state.items()}
    images = {d: found.observation.images["camera"] for d, found in steps.items()}
    assert torch.equal(redrawing.losses(state, steps)["reconstruction"], reconstruction(drawn, images))
    assert set(redrawing.losses(state, {"left": steps["left"]})) == {"reconstruction"}
    blind = GamaPolicy(data.problem, hidden=8, image_channels=[])
    assert PointReconstruction(blind.perception, hidden=8).losses(state, steps) == {}


def known(data: TransferDataModule, make_trainer: Callable[..., Trainer]) -> CachedFeatures[GamaPolicy]:
    """A phase that has just perceived all steps of ``data``."""
    phase = CachedFeatures(small(data), epochs=1, optimizer=tiny.adamw(1e-3))
    phase.trainer = make_trainer()
    phase.trainer.datamodule = data  # type: ignore[attr-defined]
    phase.on_fit_start()
    return phase


def test_all_states_are_known_those_seen_last_too(seen_file: Path, make_trainer: Callable[..., Trainer]) -> None:
    data = seen.data_module(seen_file)
    phase = known(data, make_trainer)
    for domain, dataset in data.datasets.items():
        everything = dataset.take(torch.arange(len(dataset)), next_observation=True)
        assert everything.next_observation is not None
        with torch.no_grad():
            states = phase.policy.features(domain, everything.observation)
            following = phase.policy.features(domain, everything.next_observation)
        before, after = phase.before_and_after(domain, everything.row)
        torch.testing.assert_close(before, states)
        torch.testing.assert_close(after, following)
        for first, end in zip(dataset.offset[:-1].tolist(), dataset.offset[1:].tolist(), strict=True):
            assert torch.equal(after[first : end - 1], before[first + 1 : end])
            assert not torch.equal(after[end - 1], before[end - 1])


def test_the_usual_change_is_that_of_proxy_training_steps_and_1_where_nothing_moves(
    seen_file: Path, make_trainer: Callable[..., Trainer]
) -> None:
    data = seen.data_module(seen_file)
    phase = known(data, make_trainer)
    phase.states["left"][:, 1] = 3.0
    dataset, changes = data.datasets["left"], []
    for episode in data.episodes("left", data.proxy_tasks, "train"):
        rows = [*range(*dataset.offset[[episode, episode + 1]].tolist())]
        states = phase.states["left"][[*rows, int(dataset.next_row[rows[-1]])]]
        changes += [*(states[1:] - states[:-1])]
    expected = torch.stack(changes).square().mean(dim=0).sqrt()
    expected[1] = 1.0
    torch.testing.assert_close(phase.usual_change("left"), expected, rtol=1e-4, atol=1e-6)
