"""The contextual policy: what it is shown, what it remembers, what it learns."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import seen
import tiny
import torch
from lightning.pytorch import Trainer
from torch import Tensor

from datamodules.batches import rounding
from datamodules.errors import ConfigError, UserError
from datamodules.transfer import TransferDataModule
from datamodules.types import BatchSpec, Observation, PackedTrajectories
from plp_lightning.envs.rollout import rollout
from plp_lightning.losses import behavioural_cloning
from plp_lightning.methods import ContextualCloning, ContextualPolicy
from plp_lightning.methods.contextual.cloning import prompt_episodes
from plp_lightning.methods.contextual.policy import first_frames, last_frames
from plp_lightning.methods.optimization import CosineDecay
from plp_lightning.methods.policy import AligningPolicy
from plp_lightning.networks import ImageEncoding

SMALL, LARGE = tiny.spec("small", 3, 2), tiny.spec("large", 7, 5)
WHOLE = BatchSpec("none", pairs="whole")


def contextual(data: TransferDataModule, max_length: int = 1200, dropout: float = 0.2) -> ContextualPolicy:
    """A small policy that knows its demonstrations, always with the same weights."""
    torch.manual_seed(0)
    policy = ContextualPolicy(
        data.problem,
        16,
        4,
        1,
        2,
        feed_forward=32,
        dropout=dropout,
        max_length=max_length,
        image_encoder=ImageEncoding((4, 6), 1024),
    )
    policy.prompts.choose(data.datasets[data.source_domain], prompt_episodes(data))
    return policy.eval()


@pytest.fixture
def data(trajectory_file: Path) -> TransferDataModule:
    return tiny.data_module(trajectory_file)


def whole(data: TransferDataModule, domain: str, episode: int) -> tuple[Observation[Tensor], Tensor]:
    """Observations and actions of a trajectory."""
    rows = torch.arange(*data.datasets[domain].offset[episode : episode + 2])
    return data.datasets[domain].observation.take(rows), data.datasets[domain].action[rows]


def alone(observation: Observation[Tensor], action: Tensor) -> PackedTrajectories:
    frame = torch.arange(len(action))[None]
    return PackedTrajectories(observation, frame, torch.ones_like(frame, dtype=torch.bool), action)


def test_it_shows_one_training_demonstration_of_each_task_the_targets_included(data: TransferDataModule) -> None:
    prompts, chosen = contextual(data).prompts, prompt_episodes(data)
    assert sorted(chosen) == list(range(len(tiny.TASKS)))
    order = [5, data.tasks.index(tiny.TARGET), 0]
    found = prompts.of(torch.tensor(order))
    for p, task in enumerate(order):
        assert chosen[task] in data.episodes("flat", [data.tasks[task]], "train")
        observation, action = whole(data, "flat", chosen[task])
        rows = found.frame[p][found.mask[p]]
        assert torch.equal(found.observation.state[rows], observation.state)
        assert torch.equal(found.action[rows], action)


def test_the_demonstration_of_median_length_is_shown(data: TransferDataModule) -> None:
    for task, episode in prompt_episodes(data).items():
        ids = data.episodes("flat", [data.tasks[task]], "train")
        lengths = np.diff(data.datasets["flat"].offset)
        assert lengths[episode] == sorted(lengths[ids])[len(ids) // 2]


def test_a_checkpoint_carries_the_demonstrations(data: TransferDataModule) -> None:
    policy, fresh = contextual(data), ContextualPolicy(data.problem, 16, 4, 1, 2, feed_forward=32)
    with pytest.raises(UserError, match=r"no demonstration of task 'goal_0' in domain 'flat' to show.*: train with"):
        fresh.actor("tall", ["goal_0"])
    fresh.load_state_dict(policy.state_dict())
    observation = Observation(np.zeros((2, 5), dtype=np.float32))
    acts = [p.eval().actor("tall", ["goal_3", "goal_1"])(observation, np.arange(2)) for p in (policy, fresh)]
    assert np.array_equal(*acts)


def test_steps_of_episodes_give_what_the_whole_history_gives(data: TransferDataModule) -> None:
    policy, tasks, lengths = contextual(data), ["goal_3", "goal_1", "goal_3", "goal_6"], np.array([5, 9, 2, 9])
    states = torch.randn(4, 9, 5, generator=torch.Generator().manual_seed(0))
    chosen = prompt_episodes(data)
    expected = []
    for state, task in zip(states, tasks, strict=True):
        shown = alone(*whole(data, "flat", chosen[data.tasks.index(task)]))
        expected.append(policy(shown, alone(Observation(state), torch.zeros(9, 2))).detach())
    act = policy.actor("tall", tasks)
    for t in range(9):
        running = np.flatnonzero(lengths > t)
        found = act(Observation(states[running, t].numpy()), running)
        wanted = np.stack([expected[i][t].numpy() for i in running])
        np.testing.assert_allclose(found, wanted, rtol=1e-4, atol=1e-5)


def test_a_loose_step_is_the_first_of_an_episode(data: TransferDataModule) -> None:
    policy, tasks = contextual(data), ["goal_3", "goal_1", "goal_3"]
    observation = Observation(np.random.default_rng(0).normal(size=(3, 5)).astype(np.float32))
    first = policy.actor("tall", tasks)(observation, np.arange(3))
    np.testing.assert_allclose(policy.act(observation, "tall", tasks), first, rtol=1e-4, atol=1e-6)


def test_what_is_shown_is_all_that_tells_the_task(data: TransferDataModule) -> None:
    policy = contextual(data)
    observation = Observation(np.zeros((2, 5), dtype=np.float32))
    one, other = policy.act(observation, "tall", ["goal_1", "goal_5"])
    assert not np.allclose(one, other)
    episodes = prompt_episodes(data)
    policy.prompts.choose(data.datasets["flat"], {**episodes, 5: episodes[1]})
    one, other = policy.act(observation, "tall", ["goal_1", "goal_5"])
    np.testing.assert_allclose(one, other, rtol=1e-5, atol=1e-6)


def test_it_acts_in_the_target_domain_and_aligns_nothing(data: TransferDataModule) -> None:
    policy = contextual(data)
    assert policy.acts_in == ("tall",)
    assert not isinstance(policy, AligningPolicy)


def test_long_demonstrations_lose_their_beginning_long_episodes_their_end() -> None:
    mask = torch.tensor([[True, True, True], [True, False, False]])
    state = torch.tensor([[0.0], [1.0], [2.0], [3.0]])
    sequences = PackedTrajectories(Observation(state), torch.tensor([[0, 1, 2], [3, 0, 0]]), mask, 10 * state)
    for cut, kept in ((last_frames(sequences, 2), [1, 2, 3]), (first_frames(sequences, 2), [0, 1, 3])):
        assert cut.observation.state.flatten().tolist() == kept
        assert cut.action.flatten().tolist() == [10 * x for x in kept]
        assert cut.mask.tolist() == [[True, True], [True, False]]
        assert cut.frame[cut.mask].tolist() == [0, 1, 2]
    assert last_frames(sequences, 3) is sequences
    assert first_frames(sequences, 3) is sequences


def test_episodes_longer_than_its_memory_are_an_error(data: TransferDataModule) -> None:
    act = contextual(data, max_length=2).actor("tall", ["goal_0"])
    observation = Observation(np.zeros((1, 5), dtype=np.float32))
    for _ in range(2):
        act(observation, np.arange(1))
    with pytest.raises(ConfigError, match=r"max_length is 2; expected at least the steps of an episode.*raise it"):
        act(observation, np.arange(1))


@pytest.mark.parametrize(
    ("settings", "told"),
    [
        ({"hidden": 10, "heads": 4}, r"hidden is 10; expected a multiple of heads, which is 4"),
        ({"dropout": 1.0}, r"ContextualPolicy\.dropout is 1\.0; expected a share from 0 to below 1"),
        ({"max_length": 0}, r"max_length is 0; expected a whole number, at least 1"),
        ({"heads": 0}, r"heads is 0; expected a whole number, at least 1"),
        (
            {"decoder_blocks": 0},
            r"decoder_blocks is 0; expected a whole number from 1 to 1000",
        ),
    ],
)
def test_wrong_sizes_are_told(settings: dict[str, float], told: str) -> None:
    with pytest.raises(ConfigError, match=told):
        ContextualPolicy(tiny.problem([SMALL, LARGE], ("reach",)), **settings)  # type: ignore[arg-type]


def test_a_third_domain_is_told() -> None:
    with pytest.raises(ConfigError, match=r"found the domains small, third, large; .* expected these two, drop"):
        ContextualPolicy(tiny.problem([SMALL, tiny.spec("third", 3, 2), LARGE], ("reach",)))


def test_the_loss_is_the_mean_over_all_steps_of_all_pairs(data: TransferDataModule) -> None:
    policy = contextual(data)
    batch = next(iter(data.loader(WHOLE)))
    loss, frames = ContextualCloning(policy)._loss(batch)
    shown, episodes = batch.pairs["flat"], batch.pairs["tall"]
    errors = []
    for p in range(len(episodes.mask)):
        one, other = (s.frame[p][s.mask[p]] for s in (shown, episodes))
        own = alone(shown.observation.take(one), shown.action[one])
        action = policy(own, alone(episodes.observation.take(other), episodes.action[other]))
        errors += [behavioural_cloning({"tall": action}, {"tall": episodes.action[other]})] * len(other)
    torch.testing.assert_close(loss, torch.stack(errors).mean(), rtol=1e-4, atol=1e-6)
    assert frames == len(errors)


def test_rows_that_fill_a_batch_up_change_no_gradient(
    data: TransferDataModule, monkeypatch: pytest.MonkeyPatch
) -> None:
    batch, found, rows = next(iter(data.loader(WHOLE))), [], list[int]()
    for _ in range(2):
        phase = ContextualCloning(contextual(data))
        phase.policy.seen.register_forward_hook(lambda module, args, out: rows.append(len(out)))
        loss, _ = phase._loss(batch)
        loss.backward()
        found.append({name: parameter.grad for name, parameter in phase.named_parameters()})
        monkeypatch.setattr(rounding, "wants_rows_that_recur", lambda sequences: True)
    assert rows[1] > rows[0]
    torch.testing.assert_close(*found, rtol=1e-4, atol=1e-6)


def test_images_are_read_frame_by_frame(tmp_path: Path) -> None:
    seen.write(tmp_path / "seen.hdf5")
    data = seen.data_module(tmp_path / "seen.hdf5")
    policy = contextual(data)
    assert ContextualCloning(policy).batch_spec.images
    pairs = next(iter(data.loader(WHOLE))).pairs
    before = policy(pairs["left"], pairs["right"])
    before.sum().backward()
    assert all(parameter.grad is not None for parameter in policy.parameters())
    image = pairs["right"].observation.images["camera"]
    assert image is not None
    image[pairs["right"].frame[0][2]] = 0
    changed = (policy(pairs["left"], pairs["right"]) != before).any(dim=1)
    assert changed[pairs["right"].frame[0][pairs["right"].mask[0]]].tolist()[:3] == [False, False, True]
    assert not changed[pairs["right"].frame[1][pairs["right"].mask[1]]].any()
    blind = ContextualPolicy(data.problem, 16, 4, 1, 1, image_encoder=ImageEncoding(()))
    assert not ContextualCloning(blind).batch_spec.images


def test_it_learns_to_do_what_it_is_shown(trajectory_file: Path, make_trainer: Callable[..., Trainer]) -> None:
    data = tiny.data_module(trajectory_file, val_fraction=0.1)
    policy = contextual(data, dropout=0.0).train()
    make_trainer(epochs=60).fit(
        ContextualCloning(policy, optimizer=tiny.adamw(5e-3), lr_scheduler=CosineDecay), datamodule=data
    )
    tasks = [*tiny.PROXIES] * 3
    episodes = rollout(
        tiny.domains()["tall"].simulator, policy.eval().actor("tall", tasks), tasks, list(range(len(tasks)))
    )
    assert episodes.success.mean() >= 0.9
