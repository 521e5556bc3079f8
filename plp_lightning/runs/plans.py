"""Settings of a run: the recipe of its demonstrations, and the amount and times of evaluation."""

# No annotations from __future__ here: the parser evaluates none in the constructors that dataclasses generate.
from collections.abc import Mapping
from dataclasses import dataclass, field

from datamodules.settings import Configured, NonNegativeFloat, NonNegativeInt, PositiveInt
from plp_lightning.evaluation.behaviour import BehaviourMetric


@dataclass(frozen=True)
class CollectionConfig(Configured):
    """Recipe of demonstrations.

    Args:
        processes: Processes that collect; 0 means one for each core.
        hold_steps: Control steps that are recorded after success, so that the end is held.
        noise: Standard deviation of noise on executed actions; the recorded action stays the expert's.
        random_start_steps: Control steps of one random action before the expert takes over, which are not recorded,
            so that demonstrations begin in many places.
        seed: Seed of all initial states. It is no part of a run's seed: runs share their data.
        attempts: Attempts for each wanted demonstration before the expert is called unfit.
    """

    processes: NonNegativeInt = 0
    hold_steps: NonNegativeInt = 5
    noise: NonNegativeFloat = 0.0
    random_start_steps: NonNegativeInt = 0
    seed: NonNegativeInt = 0
    attempts: PositiveInt = 3

    def differences(self, other: Mapping[str, object]) -> dict[str, tuple[object, object]]:
        """Settings in which the demonstrations of another recipe, from a file, differ from this one's: (its own, ours).

        Settings that the other recipe lacks had their defaults.
        """
        known = {RENAMED.get(name, name): value for name, value in other.items()}
        pairs = {name: (known.get(name, getattr(CollectionConfig, name)), getattr(self, name)) for name in DECISIVE}
        return {name: (found, own) for name, (found, own) in pairs.items() if found != own}


DECISIVE = ("hold_steps", "noise", "random_start_steps", "seed")
"""Settings of a recipe that decide what its demonstrations hold."""
RENAMED = {"linger": "hold_steps", "wander": "random_start_steps"}  # Settings that are called otherwise in older files


@dataclass(frozen=True)
class EvaluationPlan(Configured):
    """Amount and times of evaluation in the simulators.

    Args:
        every_n_epochs: Epochs between two evaluations, by phase; 0 leaves it to the end. A phase that is not
            named is evaluated whenever that takes under a tenth of the time trained since the last evaluation, and
            at every tenth of its epochs, or every epoch of fewer than ten, as long as evaluations have taken under a
            fifth of the time trained, or under 10 s: so a curve has ten points or more where they are cheap.
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

    every_n_epochs: dict[str, NonNegativeInt] = field(default_factory=dict)
    episodes: PositiveInt = 20
    final_episodes: PositiveInt = 100
    score_every_n_epochs: NonNegativeInt = 5
    latent_states: NonNegativeInt = 500
    latent_every_n_epochs: NonNegativeInt = 0
    latent_pairs: NonNegativeInt = 20
    reconstructions: NonNegativeInt = 8
    films: NonNegativeInt = 6
    metrics: list[BehaviourMetric] = field(default_factory=list)
