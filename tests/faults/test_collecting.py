"""Nothing that was collected is lost: whatever ends a collection, the next one goes on to the same file."""

from __future__ import annotations

import os
import shutil
import signal
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import pytest
import tiny
from command import SMOKE, complaint, data_root, dies, plp

from datamodules import transfer
from datamodules.errors import TrajectoryFileError, UserError
from datamodules.store import recorder
from datamodules.store.reader import TrajectoryFile
from datamodules.store.recorder import Recorder, part_files, parts_folder
from datamodules.store.writer import write_trajectories
from plp_lightning.envs.base import Domain
from plp_lightning.envs.synthetic import LinearPoint
from plp_lightning.runs import collection
from plp_lightning.runs.collection import ExpertCollector, Job, demonstrate
from plp_lightning.runs.plans import CollectionConfig
from plp_lightning.runs.progress import JobProgress
from plp_lightning.stopping import PreemptedError

COLLECTION = CollectionConfig(processes=1)
LIGHT = ["--data.trajectories", "14", "--data.target_trajectories", "2", "--collection.processes", "1"]
MISSING: dict[str, dict[str, int]] = {"flat": {"goal_0": 2, "goal_1": 2, "goal_3": 2}}


def hashes(path: Path) -> Mapping[str, str]:
    """Of all arrays and of the header."""
    with TrajectoryFile.open(path) as file:
        return file.hashes


def arrays(path: Path) -> dict[str, str]:
    return {name: value for name, value in hashes(path).items() if name != "header"}


@pytest.fixture(scope="module")
def unbroken(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("unbroken") / "a.hdf5"
    ExpertCollector(tiny.domains(), COLLECTION)(path, MISSING)
    return path


@pytest.fixture
def broken(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A collection that was cut off after each of its first two waves had been kept, as by a kill."""
    advance, path = JobProgress.advance, tmp_path / "a.hdf5"

    def stop(self: JobProgress, count: int = 1, note: str = "") -> None:
        if note.endswith("goal_3"):
            raise PreemptedError(signal.SIGTERM)
        advance(self, count, note)

    with monkeypatch.context() as patch:
        patch.setattr(JobProgress, "advance", stop)
        patch.setattr(collection, "KEPT_SECONDS", -1.0)
        patch.setattr(recorder, "QUICK_BYTES", -1)
        with pytest.raises(PreemptedError):
            ExpertCollector(tiny.domains(), COLLECTION)(path, MISSING)
    assert not path.exists()
    assert len(part_files(path)) == 2
    return path


def test_what_was_cut_off_goes_on_to_the_file_of_an_unbroken_collection(broken: Path, unbroken: Path) -> None:
    data = tiny.data_module(broken, trajectories=7, target_trajectories=2, domain_names=("flat",))
    data.collector = ExpertCollector(tiny.domains(), COLLECTION)
    data.needed = lambda: dict(MISSING)  # type: ignore[method-assign]
    data.prepare_data()
    assert data.collected == 2
    assert hashes(broken) == hashes(unbroken)
    assert [file.name for file in broken.parent.iterdir() if file.suffix != ".lock"] == ["a.hdf5"]


def test_a_kill_before_the_parts_are_joined_loses_nothing(tmp_path: Path) -> None:
    command = ["collect", *SMOKE, *LIGHT, "--data.root", str(tmp_path)]
    # The first joining takes what an earlier collection left: nothing.
    assert dies(command, "datamodules.store.recorder:join_parts", 2, signal.SIGKILL) == -signal.SIGKILL
    path = tmp_path / "smoke.hdf5"
    assert not path.exists()
    kept = sum(sum(map(sum, map(dict.values, TrajectoryFile.open(p).counts().values()))) for p in part_files(path))
    answer = plp(*command)
    assert (answer.code, answer.err) == (0, "")
    assert kept == 30
    assert answer.out.splitlines()[-1] == f"{path}: complete"
    assert not parts_folder(path).exists()
    again = tmp_path / "again"
    assert plp(*command, "--data.root", again).code == 0
    assert arrays(path) == arrays(again / "smoke.hdf5")


def test_a_kill_after_the_parts_were_joined_doubles_nothing(broken: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with monkeypatch.context() as patch:
        patch.setattr(recorder, "_remove", lambda parts: None)
        recorder.join_parts(broken)
    joined = hashes(broken)
    assert part_files(broken)
    recorder.join_parts(broken)
    assert hashes(broken) == joined
    assert not parts_folder(broken).exists()


def test_a_part_that_was_damaged_is_named(broken: Path) -> None:
    part = part_files(broken)[0]
    content = bytearray(part.read_bytes())
    with TrajectoryFile.open(part) as file:
        actions = file.read("flat").actions.tobytes()
    content[content.index(actions) + 3] ^= 0x40
    part.write_bytes(content)
    with pytest.raises(TrajectoryFileError, match=rf"{part}: found values .* or remove this part to go on without"):
        recorder.join_parts(broken)
    assert not broken.exists()
    part.unlink()
    recorder.join_parts(broken)
    with TrajectoryFile.open(broken) as file:
        assert file.counts()["flat"]["goal_1"] == 2


def test_parts_of_another_recipe_or_another_domain_are_refused(broken: Path) -> None:
    data = tiny.data_module(broken)
    data.collector = ExpertCollector(tiny.domains(), replace(COLLECTION, noise=0.5))
    with pytest.raises(UserError, match=r"\.parts/.*collected with --collection.noise 0.0; expected 0.5"):
        data.prepare_data()
    specs = [LinearPoint(1, state_size=9).spec("flat")]
    with (
        pytest.raises(TrajectoryFileError, match="domain 'flat' has key 'position' with shape"),
        Recorder(broken, specs, tiny.TASKS, {}),
    ):
        pytest.fail("it begins")
    with TrajectoryFile.open(broken) as file:
        assert sum(file.counts()["flat"].values()) == 4


def test_the_bug_of_an_expert_is_one_line_and_the_rest_is_kept(tmp_path: Path) -> None:
    (tmp_path / "clumsy.py").write_text(CLUMSY)
    page = tmp_path / "page.yaml"
    page.write_text("domains:\n  tall:\n    expert: {class_path: clumsy.Clumsy}\n")
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(tmp_path)
        told = complaint(
            "collect", *SMOKE, "--config", page, *LIGHT, "--data.root", tmp_path, "--allow_imports", "clumsy"
        )
    assert "demonstrating task 'goal_0' in domain 'tall' failed: ZeroDivisionError: division by zero" in told
    assert f"({tmp_path / 'clumsy.py'}:8)" in told
    assert "demonstrations made before are kept; go on with the same command" in told
    with TrajectoryFile.open(tmp_path / "smoke.hdf5") as file:
        assert file.counts()["flat"]["goal_0"] > 0


CLUMSY = """
from plp_lightning.envs.synthetic import LinearPointExpert


class Clumsy(LinearPointExpert):
    def act(self, observation, episodes):
        # A mistake of its author.
        return 1 / 0
"""


def test_who_waited_for_another_collector_does_not_count_its_demonstrations(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    complete = data_root() / "smoke.hdf5"

    class Busy:
        """Gives the lock when another process has collected."""

        def __init__(self, path: str) -> None: ...

        def __enter__(self) -> None:
            shutil.copy(complete, tmp_path)

        def __exit__(self, *raised: object) -> None: ...

    monkeypatch.setattr(transfer, "FileLock", Busy)
    answer = plp("collect", *SMOKE, "--data.root", tmp_path)
    assert (answer.code, answer.out) == (0, f"{tmp_path / 'smoke.hdf5'}: complete\n")


@pytest.mark.parametrize("links", [{"smoke.hdf5": "smoke.hdf5"}, {"smoke.hdf5": "b", "b": "smoke.hdf5"}])
def test_a_link_to_itself_is_refused_before_anything_is_collected(tmp_path: Path, links: Mapping[str, str]) -> None:
    for name, target in links.items():
        (tmp_path / name).symlink_to(target)
    told = complaint("collect", *SMOKE, "--data.root", tmp_path)
    assert f"{tmp_path / 'smoke.hdf5'}: is a link that leads back to itself" in told
    assert sorted(file.name for file in tmp_path.iterdir()) == sorted(links)


def test_a_folder_in_the_place_of_the_file_is_called_one(tmp_path: Path) -> None:
    assert f"{tmp_path}: is a folder" in complaint("collect", *SMOKE, "--data.file", tmp_path)


def test_complete_demonstrations_need_no_writing(tmp_path: Path) -> None:
    shutil.copy(data_root() / "smoke.hdf5", tmp_path)
    before = sorted(os.listdir(tmp_path))
    assert plp("collect", *SMOKE, "--data.root", tmp_path).out.endswith("complete\n")
    assert sorted(os.listdir(tmp_path)) == before


# -- what has to be there --------------------------------------------------------------------------------


def test_a_lack_tells_how_much_is_there(tmp_path: Path) -> None:
    path = tmp_path / "smoke.hdf5"
    specs = [domain.simulator.spec(name) for name, domain in tiny.domains().items()]
    write_trajectories(path, specs, tiny.TASKS, tiny.demonstrations(3), {})
    data = tiny.data_module(path, trajectories=70)
    with pytest.raises(UserError, match=r"task 'goal_0' in domain 'flat'\), of which it holds 3 of 10"):
        data.prepare_data()
    data.collector = ExpertCollector({name: Domain(d.simulator) for name, d in tiny.domains().items()}, COLLECTION)
    with pytest.raises(UserError, match=r"no expert; .* which holds 3 of the 10 of task 'goal_0'"):
        data.prepare_data()


# -- which demonstrations --------------------------------------------------------------------------------


def seeds(job: Job) -> list[int]:
    return [t.seed for wave in demonstrate(job, COLLECTION) for t in wave]


def test_waves_are_small_and_change_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    collection._begin_process(tiny.domains(), 1)
    job = Job("flat", "goal_1", 100, frozenset())
    waves = [len(wave) for wave in demonstrate(job, COLLECTION)]
    assert max(waves) == collection.WAVE
    found = seeds(job)
    monkeypatch.setattr(collection, "WAVE", 1000)
    assert found == seeds(job)


def test_a_job_may_be_cut_between_any_two_waves(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(collection, "WAVE", 4)
    collection._begin_process(tiny.domains(), 1)
    whole = seeds(Job("flat", "goal_1", 20, frozenset()))
    for kept in (4, 8, 16):
        rest = seeds(Job("flat", "goal_1", 20 - kept, frozenset(whole[:kept])))
        assert whole[:kept] + rest == whole
