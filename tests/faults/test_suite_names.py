"""Names that robosuite or Meta-World don't know are told in one line, with the one that is nearest."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
import yaml
from command import complaint

from datamodules.errors import ConfigError
from plp_lightning.envs import MetaWorld, Robosuite
from plp_lightning.envs.suites.facts import Facts
from plp_lightning.envs.suites.robosuite_world import library_env
from plp_lightning.envs.suites.setup import Setup
from plp_lightning.envs.suites.variant import Variant

DOOR: dict[str, Any] = {"tasks": ["door-open-v3", "door-close-v3"]}


def page(folder: Path, simulator: str, **settings: Any) -> str:
    """A page of two such domains; its file."""
    domain = {"simulator": {"class_path": simulator, "init_args": settings}}
    data = {"source_domain": "a", "target_domain": "b", "target_task": settings["tasks"][0]}
    (folder / "page.yaml").write_text(yaml.safe_dump({"domains": {"a": domain, "b": domain}, "data": data}))
    return str(folder / "page.yaml")


@pytest.mark.parametrize(
    ("settings", "told"),
    [
        (DOOR | {"tasks": ["door-opn-v3", "door-close-v3"]}, "no task 'door-opn-v3'.*did you mean 'door-open-v3'"),
        (DOOR | {"cameras": ["corner22"]}, "no camera 'corner22'.*did you mean 'corner2'"),
        (DOOR | {"state": ["hand_pos", "objct_pos"]}, "no state key 'objct_pos'.*did you mean 'object_pos'"),
        (DOOR | {"state": ["hand_pos", "hand_pos"]}, "each key once"),
        (DOOR | {"tasks": ["door-open-v3_x2", "door-close-v3"]}, "door-open-v3_x2.*expected 0 to 1.*set regions"),
        (DOOR | {"tasks": ["door-open-v3"] * 2}, "each once"),
        (DOOR | {"image_size": 4}, "image_size is 4.*8 to 512"),
    ],
)
def test_metaworld_is_asked_for_what_it_lacks(settings: dict[str, Any], told: str, tmp_path: Path) -> None:
    line = complaint("fit", "--config", page(tmp_path, "MetaWorld", **settings), "--run_root", tmp_path / "runs")
    assert re.search(told, line), line
    assert not (tmp_path / "runs").exists()


def test_a_part_of_what_has_no_extent_is_told(tmp_path: Path) -> None:
    world = MetaWorld(["window-close-v3_x1"], threads=1)
    with pytest.raises(ConfigError, match=r"begins at one x alone.*leave out x1"):
        world.reset(["window-close-v3_x1"], [0])


def test_robosuite_is_asked_for_what_it_lacks_in_one_line_of_its_own_process(tmp_path: Path) -> None:
    line = complaint("fit", "--config", page(tmp_path, "Robosuite", tasks=["Lift_x0", "Stck"], robot="Sawyr"))
    assert "no robot 'Sawyr' in robosuite" in line
    assert "did you mean 'Sawyer'?" in line


@pytest.mark.parametrize(
    ("task", "robot", "controller", "make", "told"),
    [
        ("Stck", "Panda", None, {}, "no task 'Stck'.*did you mean 'Stack'"),
        ("Stack", "Pandda", None, {}, "no robot 'Pandda'.*did you mean 'Panda'"),
        ("Stack", "Panda", "OSC_POS", {}, "no controller 'OSC_POS'.*did you mean 'OSC_POS"),
        ("Stack", "Panda", None, {"table_hight": 2}, "makes no Stack with Panda.*table_hight"),
        ("TwoArmLift", "Panda", None, {}, "makes no TwoArmLift with Panda.*choose other robots"),
        ("Lift", "Tiago", None, {}, "Tiago moves about.*expected a robot that stands: choose .*Panda, "),
        ("NutAssemblySingle", "Panda", None, {}, "NutAssemblySingle is about another object.*name tasks of one"),
    ],
)
def test_what_robosuite_cannot_make_is_told(
    task: str, robot: str, controller: str | None, make: dict[str, Any], told: str
) -> None:
    with pytest.raises(ConfigError, match=told):
        library_env(Setup((robot,), controller, 20, 0.02, tuple(make.items())), task)


def test_tasks_that_take_other_actions_are_no_tasks_of_one_domain() -> None:
    one, other = (Facts({"a": 1, "b": size}, (), ("eye",), actions) for size, actions in ((1, 7), (2, 4)))
    with pytest.raises(ConfigError, match="take 7 and 4 actions"):
        one.common(other)
    assert one.common(Facts({"a": 1, "b": 2}, (), (), 7)).sizes == {"a": 1}


@pytest.mark.parametrize(
    ("task", "name", "cell"),
    [
        ("Lift", "Lift", (None, None)),
        ("Lift_x1y0", "Lift", (1, 0)),
        ("door-open-v3_y1", "door-open-v3", (None, 1)),
        ("pick_up_x", "pick_up_x", (None, None)),
    ],
)
def test_a_name_says_where_its_episodes_begin(task: str, name: str, cell: tuple[int | None, int | None]) -> None:
    assert Variant.of(task, 2) == Variant(name, cell, 2)
    assert Robosuite([task], "Panda").tasks.names == (task,)
