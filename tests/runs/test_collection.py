from __future__ import annotations

import re
import signal
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
import seen
import tiny

from datamodules.errors import UserError
from datamodules.store.writer import TrajectoryFile, write_trajectories
from datamodules.streams import episode_seed
from datamodules.types import Observation, Trajectory
from plp_lightning.envs.base import Domain, Expert, Simulator, Step
from plp_lightning.envs.synthetic import LinearPoint, LinearPointExpert, SeenPoint
from plp_lightning.runs import collection
from plp_lightning.runs.collection import ExpertCollector, Job, demonstrate
from plp_lightning.runs.plans import CollectionConfig
from plp_lightning.runs.progress import JobProgress
from plp_lightning.stopping import PreemptedError

NOISY = CollectionConfig(processes=1, noise=0.2)
IDLE = LinearPointExpert(gain=0.0)


class Fickle(Expert):
    """Gives up on every seed that leaves ``rest`` when divided by three."""

    def __init__(self, rest: int = 0) -> None:
        self.rest, self.inner = rest, LinearPointExpert()

    def begin(self, simulator: Simulator, tasks: Sequence[str], seeds: Sequence[int]) -> None:
        self.inner.begin(simulator, tasks, seeds)
        self.lazy = np.array(seeds) % 3 == self.rest

    def act(self, observation: Observation[np.ndarray], episodes: np.ndarray) -> np.ndarray:
        return np.where(self.lazy[episodes, None], 0, self.inner.act(observation, episodes))


class Recording(LinearPoint):
    """Keeps the actions that it was given."""

    def step(self, actions: np.ndarray, episodes: np.ndarray) -> object:
        self.executed = [*getattr(self, "executed", []), actions[0]]
        return super().step(actions, episodes)


def made(
    expert: Expert, job: Job, settings: CollectionConfig = NOISY, simulator: Simulator | None = None
) -> list[Trajectory]:
    collection._begin_process({"flat": Domain(simulator or LinearPoint(1, 3), expert)}, 1)
    return [trajectory for wave in demonstrate(job, settings) for trajectory in wave]


def job(count: int, known: frozenset[int] = frozenset()) -> Job:
    return Job("flat", "goal_1", count, known)


def indices(trajectories: Sequence[Trajectory]) -> list[int]:
    first = episode_seed("collect", NOISY.seed, "flat", "goal_1", 0)
    return [t.seed - first for t in trajectories]


def content(path: Path) -> list[tuple[str, str, int, bytes, bytes]]:
    with TrajectoryFile.open(path) as file:
        found = [file.trajectory(d.name, e) for d in file.domains for e in range(len(file.episodes(d.name).seed))]
    return [(t.domain, t.task, t.seed, t.observation.state.tobytes(), t.actions.tobytes()) for t in found]


def collected(path: Path, missing: Mapping[str, Mapping[str, int]], processes: int) -> list[tuple[str, ...]]:
    ExpertCollector(tiny.domains(), replace(NOISY, processes=processes))(path, missing)
    return content(path)


def test_demonstrations_do_not_depend_on_the_number_of_processes(tmp_path: Path) -> None:
    missing = {"flat": {"goal_0": 3, "goal_3": 2}, "tall": {"goal_0": 2}}
    one = collected(tmp_path / "one.hdf5", missing, 1)
    assert one == collected(tmp_path / "two.hdf5", missing, 2)
    assert [(domain, task) for domain, task, *_ in one] == [
        *[("flat", "goal_0")] * 3,
        *[("flat", "goal_3")] * 2,
        *[("tall", "goal_0")] * 2,
    ]
    with TrajectoryFile.open(tmp_path / "two.hdf5") as file:
        assert file.tasks == tiny.TASKS
        assert file.provenance["recipe"] == {**asdict(NOISY), "processes": 2}
        expert = {"class_path": "plp_lightning.envs.synthetic.LinearPointExpert", "init_args": {"gain": 2.0}}
        assert file.provenance["experts"] == {"flat": expert, "tall": expert}


def test_growing_a_file_gives_what_collecting_at_once_gives(tmp_path: Path) -> None:
    collected(tmp_path / "grown.hdf5", {"flat": {"goal_0": 2}}, 1)
    grown = collected(tmp_path / "grown.hdf5", {"flat": {"goal_0": 3}}, 1)
    assert grown == collected(tmp_path / "once.hdf5", {"flat": {"goal_0": 5}}, 1)


def test_an_interruption_keeps_the_tasks_that_are_complete(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    advance, missing = JobProgress.advance, {"flat": {"goal_0": 2, "goal_1": 2, "goal_3": 2}}

    def stop_at_the_third(self: JobProgress, count: int = 1, note: str = "") -> None:
        if note.endswith("goal_3"):
            raise PreemptedError(signal.SIGTERM)
        advance(self, count, note)

    monkeypatch.setattr(JobProgress, "advance", stop_at_the_third)
    with pytest.raises(PreemptedError):
        collected(tmp_path / "stopped.hdf5", missing, 1)
    monkeypatch.undo()
    assert [task for _, task, *_ in content(tmp_path / "stopped.hdf5")] == ["goal_0"] * 2 + ["goal_1"] * 2
    gone_on = collected(tmp_path / "stopped.hdf5", {"flat": {"goal_3": 2}}, 1)
    assert gone_on == collected(tmp_path / "once.hdf5", missing, 1)


def test_many_known_demonstrations_are_no_failed_attempts() -> None:
    known = frozenset(t.seed for t in made(LinearPointExpert(), job(60)))
    assert indices(made(LinearPointExpert(), job(2, known))) == [60, 61]


def test_only_successes_are_kept_in_the_order_of_their_seeds() -> None:
    first = episode_seed("collect", NOISY.seed, "flat", "goal_1", 0)
    found = made(Fickle(rest=(first + 1) % 3), job(6), CollectionConfig())
    assert indices(found) == [0, 2, 3, 5, 6, 8]
    assert all(t.success for t in found)


def test_the_first_demonstrations_are_the_same_however_many_are_wanted() -> None:
    few, many = (made(Fickle(), job(count)) for count in (3, 10))
    assert indices(few) == indices(many)[:3]
    for one, other in zip(few, many, strict=False):
        np.testing.assert_array_equal(one.observation.state, other.observation.state)
        np.testing.assert_array_equal(one.actions, other.actions)


def test_an_unfit_expert_is_told_of_after_so_many_attempts() -> None:
    message = (
        "expert of domain 'flat' solved task 'goal_1' 0 times in 16 attempts; 2 demonstrations were asked for; "
        "mend the expert or raise --collection.attempts"
    )
    with pytest.raises(UserError, match=f"^{re.escape(message)}$"):
        made(IDLE, job(2), CollectionConfig(attempts=3))
    with pytest.raises(UserError, match="solved task 'goal_1' 0 times in 32 attempts"):
        made(IDLE, job(2), CollectionConfig(attempts=10))


def test_the_message_of_an_unfit_expert_comes_out_of_its_process(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="expert of domain 'flat' solved task 'goal_0' 0 times"):
        ExpertCollector({"flat": Domain(LinearPoint(1), IDLE)}, NOISY)(tmp_path / "a.hdf5", {"flat": {"goal_0": 1}})
    assert list(tmp_path.glob("*.hdf5")) == []


def test_a_domain_without_expert_is_named(tmp_path: Path) -> None:
    domains = {"flat": Domain(LinearPoint(1), LinearPointExpert()), "tall": Domain(LinearPoint(2))}
    with pytest.raises(UserError, match=r"domain 'tall' has no expert; add one or import .*a\.hdf5"):
        ExpertCollector(domains, NOISY)(tmp_path / "a.hdf5", {"flat": {"goal_0": 1}, "tall": {"goal_0": 1}})


@pytest.mark.parametrize(
    ("setting", "value"),
    [("hold_steps", 6), ("noise", 0.3), ("noise_steps", 4), ("random_start_steps", 2), ("seed", 1)],
    ids=str,
)
def test_demonstrations_of_another_recipe_are_refused(tmp_path: Path, setting: str, value: float) -> None:
    path = tmp_path / "a.hdf5"
    domains = {"flat": Domain(LinearPoint(1), LinearPointExpert())}
    ExpertCollector(domains, NOISY)(path, {"flat": {"goal_0": 1}})
    other = replace(NOISY, **{setting: value})
    was = getattr(NOISY, setting)
    with pytest.raises(UserError, match=rf"collected with --collection.{setting} {was}; expected {value}: restore"):
        ExpertCollector(domains, other).check(path)
    ExpertCollector({"tall": domains["flat"]}, other).check(path)  # another experiment's domain


def test_recipes_that_make_the_same_demonstrations_share_a_file(tmp_path: Path) -> None:
    path = tmp_path / "a.hdf5"
    domains = {"flat": Domain(LinearPoint(1), LinearPointExpert())}
    ExpertCollector(domains, NOISY)(path, {"flat": {"goal_0": 1}})
    ExpertCollector(domains, replace(NOISY, processes=2, attempts=9)).check(path)


def test_a_recipe_among_earlier_ones_counts_too(tmp_path: Path) -> None:
    path = tmp_path / "a.hdf5"
    domains = {"flat": Domain(LinearPoint(1), LinearPointExpert())}
    ExpertCollector(domains, replace(NOISY, hold_steps=2))(path, {"flat": {"goal_0": 1}})
    ExpertCollector(domains, NOISY)(path, {"flat": {"goal_1": 1}})
    with pytest.raises(UserError, match=r"--collection.hold_steps 2; expected 5"):
        ExpertCollector(domains, NOISY).check(path)


@pytest.mark.parametrize("provenance", [{"command": "import"}, {"experts": "a person", "recipe": "patience"}])
def test_demonstrations_from_elsewhere_are_taken_as_they_are(tmp_path: Path, provenance: Mapping[str, str]) -> None:
    path, domains = tmp_path / "a.hdf5", {"flat": Domain(LinearPoint(1, 3), LinearPointExpert())}
    specs = [domain.simulator.spec(name) for name, domain in domains.items()]
    write_trajectories(path, specs, LinearPoint(1, 3).tasks.names, made(LinearPointExpert(), job(1)), provenance)
    ExpertCollector(domains, NOISY).check(path)


def test_noise_shakes_what_is_executed_and_not_what_is_recorded() -> None:
    simulator, expert = Recording(1, 3), LinearPointExpert()
    (shaken,) = made(expert, job(1), CollectionConfig(noise=0.3, hold_steps=0), simulator)[:1]
    collection._begin_process({"flat": Domain(simulator, expert)}, 1)
    simulator.executed = []
    again = collection._attempt(job(1), [shaken.seed], CollectionConfig(noise=0.3, hold_steps=0))[0]
    executed = np.stack(simulator.executed)
    np.testing.assert_array_equal(again.actions, shaken.actions)
    expert.begin(simulator, ["goal_1"], [shaken.seed])
    for state, action in zip(shaken.observation.state[:-1], shaken.actions, strict=True):
        asked = expert.act(Observation(state[None]), np.array([0]))[0]
        np.testing.assert_allclose(action, asked, atol=1e-6)
    assert executed.shape == shaken.actions.shape
    assert (np.abs(executed - shaken.actions) > 1e-4).mean() > 0.8
    assert np.abs(executed).max() <= 1


def test_experts_take_over_where_they_were_driven_to() -> None:
    simulator, expert = Recording(1, 3), LinearPointExpert()
    still, driven = (made(expert, job(3), CollectionConfig(random_start_steps=n, hold_steps=0)) for n in (0, 4))
    collection._begin_process({"flat": Domain(simulator, expert)}, 1)
    again = collection._attempt(job(1), [driven[0].seed], CollectionConfig(random_start_steps=4, hold_steps=0))[0]
    executed = np.stack(simulator.executed)
    np.testing.assert_array_equal(again.actions, driven[0].actions)
    np.testing.assert_array_equal(executed[:4], np.repeat(executed[:1], 4, axis=0))
    np.testing.assert_array_equal(executed[4:], again.actions)
    state = simulator.reset(["goal_1"], [again.seed]).state
    for action in executed[:4]:
        state = simulator.step(action[None], np.array([0])).observation.state
    np.testing.assert_array_equal(again.observation.state[0], state[0])
    starts = [np.ptp([t.observation.state[0] for t in found], axis=0) for found in (still, driven)]
    assert (starts[1] > starts[0]).any()


def test_without_noise_the_recorded_actions_lead_through_the_recorded_states() -> None:
    simulator = LinearPoint(1, 3)
    for trajectory in made(LinearPointExpert(), job(2), CollectionConfig(noise=0.0)):
        states = [simulator.reset(["goal_1"], [trajectory.seed]).state[0]]
        for action in trajectory.actions:
            states.append(simulator.step(action[None], np.array([0])).observation.state[0])
        np.testing.assert_array_equal(trajectory.observation.state, np.stack(states))


@pytest.mark.parametrize(("noise", "random_start_steps"), [(0.0, 0), (0.2, 0), (0.2, 3)])
def test_what_was_seen_after_the_last_action_is_kept_whenever_an_episode_ends(
    noise: float, random_start_steps: int
) -> None:
    class Watched(LinearPoint):
        """Keeps the newest state of each episode."""

        def step(self, actions: np.ndarray, episodes: np.ndarray) -> Step:
            step = super().step(actions, episodes)
            newest.update(zip(episodes.tolist(), step.observation.state, strict=True))
            return step

    newest: dict[int, np.ndarray] = {}
    settings = CollectionConfig(noise=noise, random_start_steps=random_start_steps, hold_steps=2)
    found = made(LinearPointExpert(), job(6), settings, Watched(1, 3))
    assert len({len(trajectory) for trajectory in found}) > 1
    ends = {tuple(state.tolist()) for state in newest.values()}
    for trajectory in found:
        assert trajectory.last_known
        assert tuple(trajectory.observation.state[-1].tolist()) in ends


def test_the_last_image_is_kept_with_the_last_state() -> None:
    simulator = SeenPoint(1, state_size=3, image_size=9)
    for trajectory in [t for t in seen.demonstrations(2) if t.domain == "left"]:
        simulator.reset([trajectory.task], [trajectory.seed])
        last = [simulator.step(action[None], np.array([0])).observation for action in trajectory.actions][-1]
        np.testing.assert_array_equal(trajectory.observation.state[-1], last.state[0])
        np.testing.assert_array_equal(trajectory.observation.images["camera"][-1], last.images["camera"][0])


@pytest.mark.parametrize("hold_steps", [0, 4])
def test_so_many_steps_are_recorded_after_success(hold_steps: int) -> None:
    simulator = LinearPoint(1, 3)
    for trajectory in made(LinearPointExpert(), job(3), CollectionConfig(hold_steps=hold_steps)):
        simulator.reset(["goal_1"], [trajectory.seed])
        solved = [simulator.step(a[None], np.array([0])).success[0] for a in trajectory.actions]
        assert solved.index(True) == len(solved) - 1 - hold_steps
