from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import maze2d
import numpy as np
import pytest
from command import ROOT, TINY, complaint, plp

from datamodules.store.writer import TrajectoryFile
from datamodules.types import BatchSpec
from plp_lightning.cli.config import parse
from plp_lightning.envs.maze.simulator import PointMaze

UMAZE = ROOT / "configs" / "p2p_umaze.yaml"


def import_into(out: Path, source: Path, *options: str, layout: str = "umaze", domain: str = "point") -> list[object]:
    return ["data", "import", "d4rl", source, "--layout", layout, "--domain", domain, "--out", out, *options]


@pytest.fixture
def source(tmp_path):
    """From (1, 1) to (3, 3), back to (1, 2), to (3, 1)."""
    return maze2d.write(tmp_path / "maze2d-umaze-sparse-v1.hdf5", maze2d.walk([0, 4, 1, 6]))


def test_ways_become_demonstrations_of_our_tasks(tmp_path, source):
    answer = plp(*import_into(tmp_path / "new" / "x.hdf5", source))
    assert answer.code == 0, answer
    assert "3 demonstrations of 3 tasks imported; none dropped" in answer.out
    with TrajectoryFile.open(tmp_path / "new" / "x.hdf5") as file:
        assert file.domains == (PointMaze("umaze").spec("point"),)
        assert file.tasks == PointMaze("umaze").tasks.names
        found = [file.trajectory("point", i) for i in range(3)]
    # (1, 1) and (1, 2) are in zone 0, the corner (3, 3) in zone 1.
    assert {(t.task, t.seed, t.success) for t in found} == {
        ("s0_g_3_3", 0, True),
        ("s1_g_1_2", 52, True),
        ("s0_g_3_1", 90, True),
    }
    first = next(t for t in found if t.seed == 0)
    # x grows with the rows, y with the columns, and cell (1, 1) has its middle at 0.8.
    np.testing.assert_allclose(first.observation.state[[0, 1]], [[0.8, 0.8, 0, 8], [0.8, 0.88, 0, 8]], atol=1e-6)
    np.testing.assert_allclose(first.observation.state[-1, :2], [2.8, 2.8], atol=0.08)
    np.testing.assert_array_equal(first.actions[0], [0, 1])


def test_where_demonstrations_come_from_is_recorded(tmp_path, source):
    arrays = maze2d.walk([0, 4, 1, 6])
    arrays["infos/goal"][60:] = [1, 1]  # the second way stops at (1, 2), 1 m from this goal; so does the third
    plp(*import_into(tmp_path / "x.hdf5", maze2d.write(source, arrays)))
    with TrajectoryFile.open(tmp_path / "x.hdf5") as file:
        record = file.provenance
    assert record["imported"] == 1
    assert record["dropped"] == {"shorter than 10 steps": 1, "ends before its goal": 2}
    assert record["source"]["file"] == "maze2d-umaze-sparse-v1.hdf5"
    assert record["source"]["bytes"] == source.stat().st_size
    assert len(record["source"]["sha256"]) == 64
    assert {"command", "versions"} <= set(record)


def test_a_way_that_begins_at_its_goal_is_dropped(tmp_path, source):
    arrays = maze2d.walk([0, 4, 1, 6])
    arrays["infos/goal"][:51] = [1.1, 0.9]
    answer = plp(*import_into(tmp_path / "x.hdf5", maze2d.write(source, arrays)))
    assert "2 demonstrations of 2 tasks imported; 1 dropped: begins at its goal" in answer.out


def test_the_other_domain_of_p2p_sees_and_acts_otherwise(tmp_path, source):
    plp(*import_into(tmp_path / "x.hdf5", source))
    plp(*import_into(tmp_path / "x.hdf5", source, "--swap_axes", "--negate_actions", domain="mirrored"))
    with TrajectoryFile.open(tmp_path / "x.hdf5") as file:
        point, mirrored = file.read("point"), file.read("mirrored")
        assert file.domains[1] == PointMaze("umaze", True, True).spec("mirrored")
    np.testing.assert_array_equal(mirrored.state, point.state[:, [1, 0, 3, 2]])
    np.testing.assert_array_equal(mirrored.actions, -point.actions)


def test_actions_beyond_the_motors_limit_are_clipped(tmp_path, source):
    arrays = maze2d.walk([0, 4])
    arrays["actions"][7] = [-1.5, 3.0]
    plp(*import_into(tmp_path / "x.hdf5", maze2d.write(source, arrays)))
    with TrajectoryFile.open(tmp_path / "x.hdf5") as file:
        np.testing.assert_array_equal(file.read("point").actions[7], [-1, 1])


def test_importing_twice_changes_no_demonstration(tmp_path, source):
    for _ in range(2):
        plp(*import_into(tmp_path / "x.hdf5", source))
    with TrajectoryFile.open(tmp_path / "x.hdf5") as file:
        assert len(file.episodes("point").task) == 3


def test_mistakes_are_told_in_one_line(tmp_path, source):
    out = tmp_path / "x.hdf5"
    assert "is a wall of this maze" not in complaint(*import_into(out, tmp_path / "none.hdf5"))
    told = complaint(*import_into(out, source, layout="medium"))
    assert "found the walk of step 19 in cell (1, 3), a wall of this maze; expected" in told
    assert "choose another --layout" in told
    assert "invalid choice: 'large'" in complaint(*import_into(out, source, layout="large"))
    arrays = maze2d.walk([0, 4])
    arrays["infos/goal"][:] = 1e30
    assert "found the goal of step 0 in cell (4, 4), a wall" in complaint(
        *import_into(out, maze2d.write(source, arrays))
    )
    arrays["infos/goal"][:] = 1
    told = complaint(*import_into(out, maze2d.write(source, arrays)))
    assert "none of 1 ways can be used (1 dropped: begins at its goal)" in told
    assert not out.exists()


def test_a_file_of_another_domain_stays_as_it_is(tmp_path, source):
    out = tmp_path / "x.hdf5"
    plp(*import_into(out, source))
    before = out.read_bytes()
    assert "domain 'point' has env" in complaint(*import_into(out, source, "--swap_axes"))
    assert out.read_bytes() == before


def test_import_needs_neither_torch_nor_a_simulator(tmp_path, source):
    arguments = [str(word) for word in import_into(tmp_path / "x.hdf5", source)]
    code = (
        "import sys; from plp_lightning.cli.main import main; main(sys.argv[1:]); "
        "print([name for name in ('torch', 'lightning', 'mujoco') if name in sys.modules])"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, *arguments], cwd=ROOT, capture_output=True, text=True, check=True
    )
    assert done.stdout.splitlines()[-1] == "[]"


def test_collect_completes_an_imported_file(tmp_path):
    """The imported domain stays; the other domain, and what the file lacks, come from the experts."""
    out = tmp_path / "p2p_umaze.hdf5"
    pairs = maze2d.write(tmp_path / "maze2d.hdf5", maze2d.walk(maze2d.all_pairs()))
    plp(*import_into(out, pairs))
    options = ["--config", UMAZE, *TINY, "--data.root", tmp_path]
    experiment = parse([str(option) for option in options])
    assert set(experiment.data.missing()) == {"mirrored"}

    answer = plp("collect", *options)
    assert answer.code == 0, answer
    assert experiment.data.missing() == {}
    with TrajectoryFile.open(out) as file:
        imported, everything = file.read("point"), file.provenance
        assert {spec.name for spec in file.domains} == {"mirrored", "point"}
    assert everything["earlier"][0]["source"]["file"] == "maze2d.hdf5"

    dataset = experiment.data.datasets["point"]
    assert dataset.spec == PointMaze("umaze").spec("point")
    assert len(dataset.episode_task) == 18  # one of each proxy task
    rows = {row.tobytes() for row in imported.state}
    assert all(row.tobytes() in rows for row in dataset.observation.state.numpy())
    batch = next(iter(experiment.data.loader(BatchSpec(pairs="thinned"))))
    assert batch.steps["point"].action.abs().max() <= 1
    assert set(batch.pairs) == {"mirrored", "point"}
    assert plp("data", "validate", out).code == 0
