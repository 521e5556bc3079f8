"""The speed at which R2R-Lift steps, beside robosuite's own loop and bare physics, and how often the expert succeeds.

Run from the repository: ``python benchmarks/lift_stepping.py [--steps 1500] [--episodes 4]``. All ways of
stepping take turns on the same states and actions, so that a busy machine slows all of them alike.
"""

from __future__ import annotations

import argparse
import logging
import time
from collections.abc import Callable, Sequence
from functools import partial

import mujoco
import numpy as np

from plp_lightning.envs.base import available_cores
from plp_lightning.envs.experts.lift import LiftExpert
from plp_lightning.envs.lift.building import robosuite_env
from plp_lightning.envs.lift.osc import SUBSTEPS
from plp_lightning.envs.lift.simulator import Lift
from plp_lightning.envs.lift.tasks import Robot
from plp_lightning.envs.native import STATE

ROBOSUITE_SHARE = 4
"""Of the 27 episodes, those that the slow loop of robosuite steps in each round."""
BARE = "bare mj_step"
ROBOSUITE = "robosuite env.step"


def bare_steps(model: mujoco.MjModel, data: mujoco.MjData, states: np.ndarray) -> None:
    """Advance every state by the physics of one control step, with the controls that it holds."""
    for state in states:
        mujoco.mj_setState(model, data, state, STATE)
        mujoco.mj_step(model, data, nstep=SUBSTEPS)


def stepping(robot: Robot, steps: int) -> dict[str, float]:
    """Episode steps per second of wall time for each way of stepping, on random actions."""
    lifts = {f"fast path, {n} thread(s)": Lift(robot, threads=n) for n in sorted({1, available_cores()})}
    rows = np.arange(27)
    for lift in lifts.values():
        lift.reset(lift.tasks.names, list(rows))
    env = robosuite_env(robot, joint_noise=0.05)
    env.reset()
    physics = next(iter(lifts.values()))._physics
    models = {BARE: physics.lift.model, f"{BARE}, with visuals": env.sim.model._model}
    scratch = {name: mujoco.MjData(model) for name, model in models.items()}
    rng, seconds, counts = np.random.default_rng(0), dict[str, float](), dict[str, int]()

    def measure(name: str, count: int, call: Callable[[], object]) -> None:
        start = time.perf_counter()
        call()
        seconds[name] = seconds.get(name, 0.0) + time.perf_counter() - start
        counts[name] = counts.get(name, 0) + count

    for turn in range(-2, max(1, steps // len(rows))):
        if turn == 0:  # the rounds before compile and fill caches
            seconds.clear()
            counts.clear()
        actions, states = rng.uniform(-1, 1, (len(rows), 4)), physics.states.copy()
        for name, model in models.items():
            measure(name, len(rows), partial(bare_steps, model, scratch[name], states))
        for name, lift in lifts.items():
            measure(name, len(rows), partial(lift.step, actions, rows))
        measure(ROBOSUITE, ROBOSUITE_SHARE, lambda actions=actions: list(map(env.step, actions[:ROBOSUITE_SHARE])))  # type: ignore[misc]
    return {name: counts[name] / seconds[name] for name in seconds}


def expert_lengths(lift: Lift, tasks: Sequence[str], seeds: Sequence[int]) -> list[int]:
    """Control steps that the expert needs for each episode that it solves."""
    observation, expert = lift.reset(tasks, seeds), LiftExpert()
    expert.begin(lift, tasks, seeds)
    live, lengths = np.arange(len(tasks)), list[int]()
    for t in range(lift.horizon):
        step = lift.step(expert.act(observation, live), live)
        lengths += [t + 1] * int(step.success.sum())
        going = ~(step.success | step.invalid)
        live, observation = live[going], step.observation.take(going)
        if len(live) == 0:
            break
    return lengths


def main() -> None:
    """Measure both robots and print rates, ratios and the expert's success."""
    parser = argparse.ArgumentParser(description="Rates of stepping R2R-Lift and success of its expert.")
    parser.add_argument("--steps", type=int, default=1500, help="episode steps for each way of stepping")
    parser.add_argument("--episodes", type=int, default=4, help="expert episodes for each of the 27 tasks")
    options = parser.parse_args()
    logging.getLogger("robosuite_logs").disabled = True
    robots: tuple[Robot, ...] = ("Sawyer", "UR5e")
    for robot in robots:
        rates = stepping(robot, options.steps)
        for name, rate in rates.items():
            cost, gain = rates[BARE] / rate, rate / rates[ROBOSUITE]
            print(f"{robot:7} {name:27} {rate:6.0f} steps/s  {cost:5.2f} x bare cost  {gain:5.2f} x robosuite's rate")
        lift = Lift(robot)
        seeds = list(range(options.episodes)) * len(lift.tasks.names)
        lengths = expert_lengths(lift, [task for task in lift.tasks.names for _ in range(options.episodes)], seeds)
        print(f"{robot:7} expert solves {len(lengths)}/{len(seeds)}, in {np.mean(lengths):.1f} steps on average")


if __name__ == "__main__":
    main()
