"""Pages that the package brings have short names; simulators that are not installed are told before a run begins."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path

import pytest
import yaml
from command import complaint, plp

from plp_lightning.cli.config import find_page
from plp_lightning.runs import rehearsal


def test_a_page_of_the_package_has_a_short_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    answer = plp("fit", "--config", "smoke", "--config", "methods/plp_t", "--print_config")
    assert answer.code == 0, answer
    told = yaml.safe_load(answer.out)
    assert (told["experiment"], told["method"], told["data"]["target_task"]) == ("smoke", "plp_t", "goal_3")


def test_a_file_of_that_name_wins(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "smoke").write_text("seed: 7")
    assert find_page("smoke") == Path("smoke")
    assert "nowhere: can't be read" in complaint("fit", "--config", "nowhere")


@pytest.mark.parametrize(
    ("page", "lacking"),
    [("r2r", "robosuite"), ("p2p_umaze", "mujoco"), ("p2a_umaze", "gymnasium_robotics"), ("v2v_reach", "metaworld")],
)
def test_simulators_that_are_not_installed_are_told(
    page: str, lacking: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(rehearsal, "find_spec", lambda name: None if name == lacking else find_spec(name))
    told = complaint("fit", "--config", page, "--run_root", tmp_path / "runs", "--data.root", tmp_path / "data")
    assert f"needs {lacking}, which is not installed; install the simulators with: pip install" in told
    assert not [*tmp_path.iterdir()]


@pytest.mark.parametrize("flag", [["--score", "NeighbourhoodScore"], ["--score=NeighbourhoodScore"]])
def test_one_class_is_a_list_of_one(flag: list[str]) -> None:
    told = yaml.safe_load(plp("fit", "--config", "smoke", *flag, "--print_config").out)
    assert [score["class_path"].rsplit(".")[-1] for score in told["score"]] == ["NeighbourhoodScore"]
    assert yaml.safe_load(plp("fit", "--config", "smoke", "--score", "null", "--print_config").out)["score"] == []
