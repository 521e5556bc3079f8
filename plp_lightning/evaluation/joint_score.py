"""Several alignment scores as one."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

from torch import Tensor

from datamodules.errors import ConfigError
from datamodules.transfer import TransferDataModule
from datamodules.types import Observation
from plp_lightning.envs.base import Simulator
from plp_lightning.evaluation.scores import AlignmentScore
from plp_lightning.methods.policy import AligningPolicy


class JointScore(AlignmentScore):
    """Gives the scores of all, and the correspondences of the first that knows some.

    Args:
        scores: The scores, one or more.

    Raises:
        ConfigError: If two of them share a name.
    """

    def __init__(self, scores: Sequence[AlignmentScore]) -> None:
        self.scores = tuple(scores)
        _check_names((score, score.names) for score in self.scores)

    def __call__(
        self, policy: AligningPolicy, data: TransferDataModule, simulators: Mapping[str, Simulator]
    ) -> dict[str, float]:
        """Gives the scores of all by name."""
        return _joined((score, score(policy, data, simulators)) for score in self.scores)

    def of_target(
        self, policy: AligningPolicy, data: TransferDataModule, simulators: Mapping[str, Simulator]
    ) -> dict[str, float]:
        return _joined((score, score.of_target(policy, data, simulators)) for score in self.scores)

    def correspondences(
        self, data: TransferDataModule, simulators: Mapping[str, Simulator], count: int
    ) -> dict[str, Observation[Tensor]] | None:
        known = (score.correspondences(data, simulators, count) for score in self.scores)
        return next((found for found in known if found is not None), None)


def _joined(parts: Iterable[tuple[AlignmentScore, Mapping[str, float]]]) -> dict[str, float]:
    found = list(parts)
    _check_names(found)
    return {name: value for _, values in found for name, value in values.items()}


def _check_names(named: Iterable[tuple[AlignmentScore, Iterable[str]]]) -> None:
    owners: dict[str, str] = {}
    for score, names in named:
        owner = type(score).__name__
        for name in names:
            if name in owners:
                raise ConfigError(
                    f"score: {owners[name]} and {owner} both give {name!r}; expected names of their own: drop one"
                )
            owners[name] = owner
