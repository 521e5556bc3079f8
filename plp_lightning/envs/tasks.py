"""Tasks of a family of domains by name, targets made of them, and the proxies of a target."""

from __future__ import annotations

import operator
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from difflib import get_close_matches

from datamodules.errors import ConfigError
from datamodules.streams import Stream, generator


@dataclass(frozen=True)
class Tasks:
    """The tasks of a family; apart from physics, so that listing them costs nothing.

    Args:
        family: Name of the family, for messages.
        names: All tasks in their canonical order.
        targets: Targets of several tasks by name, such as a goal from each start zone; every task is a target too.
        is_proxy: True if the first task may align the domains when the second is transferred; by default all others.

    Example:
        >>> tasks = Tasks("colours", ("red", "green", "blue"))
        >>> tasks.proxies("green")
        ('red', 'blue')
    """

    family: str
    names: tuple[str, ...]
    targets: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    is_proxy: Callable[[str, str], bool] = operator.ne

    def check(self, names: Sequence[str]) -> None:
        """Refuse the first of ``names`` that is no task.

        Raises:
            ConfigError: If there is one.
        """
        for name in dict.fromkeys(names):
            if name not in self.names:
                self._refuse("task", name, self.names)

    def of(self, target: str) -> tuple[str, ...]:
        """Tasks that make up a target.

        Raises:
            ConfigError: If there is no such target.
        """
        found = self.targets.get(target, (target,))
        if found[0] not in self.names:
            self._refuse("target", target, [*self.targets, *self.names])
        return found

    def target_of(self, task: str) -> str:
        """The target of several tasks that ``task`` is one of; itself if there is none."""
        return next((target for target, tasks in self.targets.items() if task in tasks), task)

    def proxies(self, target: str, goals: int | None = None) -> tuple[str, ...]:
        """Tasks that may align the domains when ``target`` is to be transferred, none of its own.

        Args:
            target: Target that is to be transferred.
            goals: Number of targets, with all their tasks each; None takes all. Fewer are always among more.

        Raises:
            ConfigError: If there is no such target, or there are not as many.
        """
        first = self.of(target)[0]
        proxies = tuple(task for task in self.names if self.is_proxy(task, first))
        if goals is None:
            return proxies
        known = list(dict.fromkeys(map(self.target_of, proxies)))
        if not 1 <= goals <= len(known):
            expected = f"expected 1 to {len(known)}, as many as proxies have goals"
            raise ConfigError(f"--data.proxy_goals is {goals}; {expected}")
        # The same for every run, so that fewer goals are among more.
        chosen = {known[i] for i in generator(Stream.PROXY_GOALS).permutation(len(known))[:goals]}
        return tuple(task for task in proxies if self.target_of(task) in chosen)

    def _refuse(self, kind: str, name: str, known: Sequence[str]) -> None:
        near = get_close_matches(name, known, n=1, cutoff=0.0)[0]
        few = len(known) <= 8
        choice = f"one of: {', '.join(known)}" if few else f"one of the {len(known)} from {known[0]} to {known[-1]}"
        raise ConfigError(f"no {kind} {name!r} in {self.family}; expected {choice}; did you mean {near!r}?")
