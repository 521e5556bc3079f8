"""What is kept in the cache folder is never believed: damaged or of other versions, it is made anew, silently."""

from __future__ import annotations

import errno
import os
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import NoReturn

import mujoco
import numpy as np
import pytest
from command import processes

from plp_lightning.envs import kept as keeping
from plp_lightning.envs.kept import cache_folder, kept, origin
from plp_lightning.envs.lift import building
from plp_lightning.envs.lift import model as lift
from plp_lightning.envs.lift.model import LiftModel

CODE = Path(lift.__file__).parent
CONTENT = bytes(range(256)) * 40


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("PLP_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


@pytest.fixture(autouse=True)
def _fresh_models() -> Iterator[None]:
    LiftModel.build.cache_clear()
    yield
    LiftModel.build.cache_clear()


def must_not() -> NoReturn:
    raise AssertionError("it was made again")


def _change(path: Path, at: int) -> None:
    content = bytearray(path.read_bytes())
    content[at] ^= 1
    path.write_bytes(content)


DAMAGES: dict[str, Callable[[Path], object]] = {
    "first byte": lambda path: _change(path, 0),
    "last byte": lambda path: _change(path, -1),
    "half": lambda path: os.truncate(path, path.stat().st_size // 2),
    "digest alone": lambda path: os.truncate(path, 32),
    "less than a digest": lambda path: os.truncate(path, 5),
    "empty": lambda path: os.truncate(path, 0),
    "longer": lambda path: path.write_bytes(path.read_bytes() + b"0"),
    "another": lambda path: path.write_bytes(b"\x80" * 100),
    "no file": Path.unlink,
    "dead link": lambda path: (path.unlink(), path.symlink_to("nowhere")),
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_what_is_damaged_is_made_anew(folder: Path, damage: str) -> None:
    assert kept("x", lambda: CONTENT) == CONTENT
    DAMAGES[damage](folder / "x")
    assert kept("x", lambda: CONTENT) == CONTENT
    assert kept("x", must_not) == CONTENT
    assert [path.name for path in folder.iterdir()] == ["x"]


def test_nothing_stays_of_one_that_could_not_be_made(folder: Path) -> None:
    with pytest.raises(AssertionError):
        kept("x", must_not)
    assert [*folder.iterdir()] == []


def test_without_a_home_nothing_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("PLP_CACHE")
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setattr(os.path, "expanduser", lambda path: path)
    assert kept("x", lambda: CONTENT) == CONTENT
    assert not Path("~").exists()


def test_folders_of_their_own_are_heeded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert cache_folder() == tmp_path / "cache"
    monkeypatch.delenv("PLP_CACHE")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "own"))
    assert cache_folder() == tmp_path / "own" / "plp"
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setenv("HOME", str(tmp_path))
    assert cache_folder() == tmp_path / ".cache" / "plp"


@pytest.mark.parametrize("where", ["a file in its place", "a folder in the place of its file"])
def test_a_place_that_takes_nothing_is_done_without(folder: Path, where: str) -> None:
    if where == "a file in its place":
        folder.write_text("mine")
    else:
        (folder / "x").mkdir(parents=True)
    assert kept("x", lambda: CONTENT) == CONTENT
    assert kept("x", lambda: CONTENT[:7]) == CONTENT[:7]


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EACCES])
@pytest.mark.parametrize("call", ["fsync", "replace"])
def test_a_disk_that_takes_nothing_is_done_without(
    folder: Path, monkeypatch: pytest.MonkeyPatch, call: str, number: int
) -> None:
    def full(*_: object) -> NoReturn:
        raise OSError(number, os.strerror(number))

    with monkeypatch.context() as patch:
        patch.setattr(os, call, full)
        assert kept("x", lambda: CONTENT) == CONTENT
    assert [*folder.iterdir()] == []


def _count(folder: Path) -> bytes:
    (folder / f"made by {os.getpid()}").touch()
    return CONTENT


def _take(folder: Path, own: str) -> None:
    os.environ["PLP_CACHE"] = own
    assert kept("x", lambda: _count(folder)) == CONTENT


def test_one_of_several_processes_makes_it(tmp_path: Path, folder: Path) -> None:
    made = tmp_path / "made"
    made.mkdir()
    several = [processes.Process(target=_take, args=(made, str(folder))) for _ in range(3)]
    for process in several:
        process.start()
    for process in several:
        process.join(60)
        assert process.exitcode == 0
    assert len([*made.iterdir()]) == 1


def test_a_model_that_was_kept_is_the_model_that_is_compiled(folder: Path) -> None:
    built = LiftModel.build("Sawyer")
    LiftModel.build.cache_clear()
    read = LiftModel.build("Sawyer")
    assert len([*folder.iterdir()]) == 1
    assert read is not built
    compiled = building._bare_model(read.xml)
    numbers = np.ndarray | int | float
    names = [x for x in dir(compiled) if not x.startswith("_") and isinstance(getattr(compiled, x), numbers)]
    assert len(names) > 300
    for name in names:
        np.testing.assert_array_equal(getattr(read.model, name), getattr(compiled, name), name)
    for name in ("timestep", "integrator", "disableflags", "iterations", "gravity", "impratio", "cone"):
        np.testing.assert_array_equal(getattr(read.model.opt, name), getattr(compiled.opt, name), name)
    assert {type(part) for part in read.arm} == {int, np.ndarray}


def test_models_of_another_mujoco_have_other_names(monkeypatch: pytest.MonkeyPatch) -> None:
    before = origin("robosuite", CODE)
    assert origin("robosuite", CODE) == before
    monkeypatch.setattr(keeping, "version", lambda package: "0.0")
    assert origin("robosuite", CODE) != before


def test_models_of_another_robosuite_have_other_names(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    names = {origin("robosuite", CODE)}
    (tmp_path / "robot.xml").write_text("one")
    monkeypatch.setattr(keeping, "find_spec", lambda name: SimpleNamespace(submodule_search_locations=[str(tmp_path)]))
    names.add(origin("robosuite", CODE))
    (tmp_path / "robot.xml").write_text("other")
    names.add(origin("robosuite", CODE))
    (tmp_path / "robot.pyc").write_text("python's own")
    names.add(origin("robosuite", CODE))
    monkeypatch.setattr(keeping, "find_spec", lambda name: None)
    names.add(origin("robosuite", CODE))
    assert len(names) == 4


@pytest.mark.parametrize("python", ["/bin/false", "/no/python", ""])
def test_a_build_that_fails_apart_is_tried_here(monkeypatch: pytest.MonkeyPatch, python: str) -> None:
    monkeypatch.setattr(sys, "executable", python)
    monkeypatch.setattr(building, "build", lambda robot: robot.encode())
    assert lift._built_apart("UR5e") == b"UR5e"


SEEN = """<mujoco><worldbody>
  <body><joint/><geom size="1" group="0"/><geom size="1" group="1"/></body>
</worldbody></mujoco>"""


@pytest.mark.parametrize("python", [sys.executable, "/bin/false", "/no/python"])
def test_a_model_to_be_seen_is_the_same_wherever_it_is_compiled(monkeypatch: pytest.MonkeyPatch, python: str) -> None:
    here = mujoco.MjModel.from_xml_string(SEEN)
    monkeypatch.setattr(sys, "executable", python)
    found = lift.LiftModel(here, None, None, None, 0, SEEN).visible()
    assert found.geom_group.tolist() == [lift.HIDDEN, 1]
    assert (found.nq, found.geom_size.tolist()) == (here.nq, here.geom_size.tolist())
