"""Which proxy tasks align the domains, if not all of them shall."""

from __future__ import annotations

from datamodules.errors import ConfigError
from datamodules.streams import Stream, generator
from plp_lightning.envs.base import Simulator


def some_proxy_tasks(simulator: Simulator, target: str, goals: int | None) -> tuple[str, ...]:
    """Proxy tasks of so many goals, from all of their starts.

    Args:
        simulator: Who knows the tasks.
        target: What is to be transferred.
        goals: How many goals; None takes all.

    Raises:
        ConfigError: If there are not as many.
    """
    proxy_tasks = simulator.proxy_tasks(target)
    if goals is None:
        return proxy_tasks
    known = list(dict.fromkeys(simulator.target_of(task) for task in proxy_tasks))
    if not 1 <= goals <= len(known):
        raise ConfigError(f"--data.proxy_goals is {goals}; expected 1 to {len(known)}, as many as proxies have goals")
    # The same for every run, so that fewer goals are among more.
    order = generator(Stream.PROXY_GOALS).permutation(len(known))
    chosen = {known[i] for i in order[:goals]}
    return tuple(task for task in proxy_tasks if simulator.target_of(task) in chosen)
