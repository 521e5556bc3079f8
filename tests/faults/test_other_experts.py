"""Demonstrations of other experts than the configured ones are refused: who changes a setting means its effect."""

from __future__ import annotations

from pathlib import Path

import pytest
import tiny

from datamodules.errors import UserError
from datamodules.store.writer import write_trajectories
from plp_lightning.envs.base import Domain
from plp_lightning.envs.synthetic import LinearPoint, LinearPointExpert
from plp_lightning.runs.collection import ExpertCollector
from plp_lightning.runs.plans import CollectionConfig

COLLECTION = CollectionConfig(processes=1)


class OtherExpert(LinearPointExpert):
    """Demonstrates as the other does."""


def one_domain(expert: LinearPointExpert) -> dict[str, Domain]:
    return {"flat": Domain(LinearPoint(1, 3), expert)}


@pytest.fixture(scope="module")
def by_gain_3(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("experts") / "a.hdf5"
    ExpertCollector(one_domain(LinearPointExpert(gain=3.0)), COLLECTION)(path, {"flat": {"goal_0": 1}})
    return path


def test_demonstrations_of_an_expert_with_other_settings_are_refused(by_gain_3: Path) -> None:
    ExpertCollector(one_domain(LinearPointExpert(gain=3.0)), COLLECTION).check(by_gain_3)
    message = r"collected with --domains.flat.expert.gain 3.0; expected 2.0: restore the setting or name another"
    with pytest.raises(UserError, match=message):
        ExpertCollector(one_domain(LinearPointExpert()), COLLECTION).check(by_gain_3)


def test_demonstrations_of_an_expert_of_another_class_are_refused(by_gain_3: Path) -> None:
    message = r"collected with --domains.flat.expert LinearPointExpert; expected OtherExpert: restore"
    with pytest.raises(UserError, match=message):
        ExpertCollector(one_domain(OtherExpert(gain=3.0)), COLLECTION).check(by_gain_3)


@pytest.mark.parametrize(
    ("record", "accepted"),
    [
        ("LinearPointExpert", True),  # as older files have it
        ("NoneType", True),  # … of a domain without an expert
        ("OtherExpert", False),
        ({"class_path": "moved.LinearPointExpert", "init_args": {}}, True),  # settings that were new later
        ({"class_path": "moved.LinearPointExpert", "init_args": {"gain": 2.0, "gone": 1}}, True),
        ({"class_path": "moved.LinearPointExpert", "init_args": {"gain": 1.0}}, False),
    ],
)
def test_records_of_experts_are_compared_as_far_as_they_go(tmp_path: Path, record: object, accepted: bool) -> None:
    path, collector = tmp_path / "a.hdf5", ExpertCollector(one_domain(LinearPointExpert()), COLLECTION)
    why = {"recipe": {"noise": 0.0}, "experts": {"flat": record}}
    made = [t for t in tiny.demonstrations(3) if t.domain == "flat"]
    write_trajectories(path, [LinearPoint(1, 3).spec("flat")], tiny.TASKS, made, why)
    if accepted:
        collector.check(path)
    else:
        with pytest.raises(UserError, match=r"collected with --domains\.flat\.expert"):
            collector.check(path)
