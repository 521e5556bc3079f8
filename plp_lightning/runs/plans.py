"""Settings of a run: how its demonstrations are made, the weights that phases hand on, and when to evaluate."""

# No annotations from __future__ here: the parser evaluates none in the constructors that dataclasses generate.
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from typing import Literal, NamedTuple, TypeVar

from datamodules.errors import ConfigError
from datamodules.settings import Configured, NonNegativeFloat, NonNegativeInt, PositiveInt, Share
from plp_lightning.evaluation.behaviour import BehaviourMetric

T = TypeVar("T")
D = TypeVar("D")


@dataclass(frozen=True)
class CollectionConfig(Configured):
    """Settings by which demonstrations are made.

    Args:
        processes: Processes that collect; 0 means one for each core, at most 16 or ``PLP_PROCESSES``.
        hold_steps: Control steps that are recorded after success, so that the end is held.
        noise: Standard deviation of noise on executed actions; the recorded action stays the expert's.
        noise_steps: Control steps for which a draw of the noise lasts. Where a force moves a mass, noise that is drawn
            anew at every step averages out; what lasts leads away from the path.
        random_start_steps: Control steps of one random action before the expert takes over, which are not recorded,
            so that demonstrations begin in many places.
        seed: Seed of all initial states. It is no part of a run's seed: runs share their data.
        attempts: Attempts for each wanted demonstration before the expert is called unfit.
    """

    processes: NonNegativeInt = 0
    hold_steps: NonNegativeInt = 5
    noise: NonNegativeFloat = 0.0
    noise_steps: PositiveInt = 1
    random_start_steps: NonNegativeInt = 0
    seed: NonNegativeInt = 0
    attempts: PositiveInt = 3

    def differences(self, other: Mapping[str, object]) -> dict[str, tuple[object, object]]:
        """Settings by which a file's demonstrations were made that differ from these: (its own, ours).

        Those that the file lacks had their defaults.
        """
        known = {RENAMED.get(name, name): value for name, value in other.items()}
        pairs = {name: (known.get(name, getattr(CollectionConfig, name)), getattr(self, name)) for name in DECISIVE}
        return {name: (found, own) for name, (found, own) in pairs.items() if found != own}


DECISIVE = ("hold_steps", "noise", "noise_steps", "random_start_steps", "seed")
"""Settings that decide what demonstrations hold."""
RENAMED = {"linger": "hold_steps", "wander": "random_start_steps"}  # Settings that are called otherwise in older files


Epoch = Literal["last", "best"]


class Handover(NamedTuple):
    """Weights that one phase hands on."""

    average_over: float = 0.0
    epoch: Epoch = "last"


USUAL = Handover()


@dataclass(frozen=True)
class HandoverPlan(Configured):
    """Weights that phases hand on: to evaluation, to the next phase, to exported policies.

    Either setting is one for all phases, or one by phase; phases that are not named have the default.

    Args:
        average_over: Share of a phase's steps that its weights are averaged over; 0 leaves them as they are.
        epoch: Epoch that is handed on: the ``last``, or the ``best`` by the phase's loss on proxy tasks that are held
            out in the target domain. Nothing of the target task has a say in it.
    """

    average_over: Share | dict[str, Share] = USUAL.average_over
    epoch: Epoch | dict[str, Epoch] = USUAL.epoch

    def of(self, phase: str) -> Handover:
        """Settings of one phase."""
        over, epoch = self.average_over, self.epoch
        return Handover(_of_phase(over, phase, USUAL.average_over), _of_phase(epoch, phase, USUAL.epoch))

    def check(self, phases: Collection[str], val_fraction: float) -> None:
        """Refuse, by a :class:`ConfigError`, phases that the method has not, and a best epoch that nothing tells."""
        for key, value in (("average_over", self.average_over), ("epoch", self.epoch)):
            if unknown := [name for name in (value if isinstance(value, dict) else ()) if name not in phases]:
                told = f"handover.{key} names phase {unknown[0]!r}"
                raise ConfigError(f"{told}; expected some of: {', '.join(phases)}: rename it or leave it away")
        if val_fraction == 0 and any(self.of(name).epoch == "best" for name in phases):
            told = "handover.epoch is best, and data.val_fraction is 0"
            raise ConfigError(
                f"{told}; expected held-out demonstrations that tell the best: raise it, or take the last"
            )


@dataclass(frozen=True)
class EvaluationPlan(Configured):
    """Amount and times of evaluation in the simulators.

    Args:
        every_n_epochs: Epochs between two evaluations, of all phases or by phase; 0 leaves it to the end. Names of
            phases that a method has not are passed over, as a page serves many methods. A phase that is not named is
            evaluated whenever that takes under a tenth of the time trained since the last evaluation, and at every
            tenth of its epochs, or every epoch of fewer than ten, as long as evaluations have taken under a fifth of
            the time trained, or under 10 s: so a curve has ten points or more where they are cheap.
        episodes: Episodes of each trial in these.
        final_episodes: Episodes of each trial at the end of a phase.
        score_every_n_epochs: Epochs between two alignment scores.
        latent_states: States of each domain in the picture of the latent space; 0 draws none.
        latent_every_n_epochs: Epochs between two of these pictures; 0 draws one at the end of a phase only.
        latent_pairs: Corresponding states that are joined in them.
        reconstructions: Images of each domain in the picture of reconstructions; 0 draws none.
        films: Episodes of the target task in each domain's film, failures first; 0 films none.
        metrics: Metrics of behaviour beside success, of every trial.
    """

    every_n_epochs: NonNegativeInt | dict[str, NonNegativeInt] = field(default_factory=dict)
    episodes: PositiveInt = 20
    final_episodes: PositiveInt = 100
    score_every_n_epochs: NonNegativeInt = 5
    latent_states: NonNegativeInt = 500
    latent_every_n_epochs: NonNegativeInt = 0
    latent_pairs: NonNegativeInt = 20
    reconstructions: NonNegativeInt = 8
    films: NonNegativeInt = 6
    metrics: list[BehaviourMetric] = field(default_factory=list)

    def every(self, phase: str) -> int | None:
        """Epochs between two evaluations of a phase; None: as often as they are cheap."""
        return _of_phase(self.every_n_epochs, phase, None)


def _of_phase(setting: T | dict[str, T], phase: str, default: D) -> T | D:
    """A phase's value of a setting that is one for all phases, or one by phase."""
    return setting.get(phase, default) if isinstance(setting, dict) else setting
