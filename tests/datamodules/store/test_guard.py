from __future__ import annotations

import h5py
import numpy as np
import pytest
from demonstrations import ARM, TASKS, demonstration

from datamodules.errors import TrajectoryFileError
from datamodules.store import guard, schema
from datamodules.store.guard import is_name, open_guarded
from datamodules.store.writer import TrajectoryFile, write_trajectories


@pytest.fixture
def path(tmp_path):
    target = tmp_path / "demos.hdf5"
    write_trajectories(target, [ARM], TASKS, [demonstration(ARM, "push", 1)], {})
    return target


def soft_link(file):
    file["link"] = h5py.SoftLink("/domains")


def dangling_link(file):
    file["link"] = h5py.SoftLink("/nowhere")


def external_link(file):
    file["link"] = h5py.ExternalLink("/etc/passwd", "/")


def cycle(file):
    file["domains/arm/again"] = file["domains"]


def root_cycle(file):
    file["domains/root"] = file["/"]


def second_name(file):
    file["again"] = file["domains/arm/actions"]


def committed_type(file):
    file["type"] = np.dtype("f4")


def external_storage(file):
    file.create_dataset("leak", (16,), "u1", external=[("/etc/passwd", 0, 16)])


def virtual(file):
    layout = h5py.VirtualLayout((4,), "f4")
    layout[:] = h5py.VirtualSource("/tmp/other.hdf5", "x", (4,))
    file.create_virtual_dataset("leak", layout)


def huge(file):
    file.create_dataset("huge", (2**20, 2**20), "f4", chunks=(64, 64), compression="gzip")


def huge_contiguous(file):
    file.create_dataset("huge", (2**40,), "f4")


def scale_offset(file):
    file.create_dataset("odd", data=np.arange(64), scaleoffset=0, chunks=(8,))


def unknown_filter(file):
    plist = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    plist.set_chunk((8,))
    plist.set_filter(32_015, h5py.h5z.FLAG_OPTIONAL, ())
    h5py.h5d.create(file.id, b"odd", h5py.h5t.IEEE_F32LE, h5py.h5s.create_simple((8,)), dcpl=plist)


def references(file):
    file.create_dataset("odd", data=np.array([file.ref], h5py.ref_dtype), dtype=h5py.ref_dtype)


def compound(file):
    file.create_dataset("odd", (2,), np.dtype([("a", "f4"), ("b", h5py.ref_dtype)]))


def ragged(file):
    file.create_dataset("odd", (2,), h5py.vlen_dtype(np.float32))


def reference_attribute(file):
    file["domains"].attrs.create("odd", file.ref, dtype=h5py.ref_dtype)


def spaces(file):
    file.create_group("a b")


def long_name(file):
    file.create_group("a" * 65)


def deep(file):
    file.create_group("/".join("abcdefghi"))


@pytest.mark.parametrize(
    ("add", "message"),
    [
        (soft_link, "/link is a soft or external link"),
        (dangling_link, "/link is a soft or external link"),
        (external_link, "/link is a soft or external link"),
        (cycle, "/domains/arm/again is reachable by two names"),
        (root_cycle, "/domains/root is reachable by two names"),
        (second_name, "is reachable by two names"),
        (committed_type, "/type is neither group nor array"),
        (external_storage, "/leak takes its values from other files"),
        (virtual, "/leak takes its values from other files"),
        (huge, r"/huge claims 4194304 MiB but stores 0.000; expected at most 1000 times"),
        (huge_contiguous, r"/huge claims 4194304 MiB but stores 0.000"),
        (scale_offset, r"/odd needs filter 6; expected at most gzip, shuffle, lzf, fletcher32"),
        (unknown_filter, r"/odd needs filter 32015"),
        (references, r"/odd has type object; expected numbers, booleans or strings"),
        (compound, r"/odd has type .*; expected numbers, booleans or strings"),
        (ragged, r"/odd has type object; expected numbers, booleans or strings"),
        (reference_attribute, r"/domains has the attribute 'odd' of a strange type or size"),
        (spaces, r"'/a b' is no allowed name; expected 1 to 64 letters"),
        (long_name, r"is no allowed name"),
        (deep, r"/a/b/c/d/e/f/g/h/i is one object or level too many"),
    ],
)
def test_hostile_files_are_refused(path, add, message):
    with h5py.File(path, "a") as file:
        add(file)
    with pytest.raises(TrajectoryFileError, match=message) as caught:
        TrajectoryFile.open(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert str(caught.value).endswith("get the file from a source you trust")
    assert "\n" not in str(caught.value)


def test_constant_data_compressed_beyond_the_limit_are_refused(path, monkeypatch):
    monkeypatch.setattr(guard, "UNSUSPICIOUS_BYTES", 2**20)
    with h5py.File(path, "a") as file:
        chunk = (1, 2**20)
        file.create_dataset(
            "bomb", data=np.zeros((4, 2**20), "u1"), chunks=chunk, compression="gzip", compression_opts=9
        )
    with pytest.raises(TrajectoryFileError, match=r"/bomb claims 4 MiB but stores 0\.00"):
        open_guarded(path)


def test_too_many_objects_are_refused(path, monkeypatch):
    monkeypatch.setattr(guard, "MAX_OBJECTS", 5)
    with pytest.raises(TrajectoryFileError, match="is one object or level too many; expected 5 objects, 8 levels"):
        open_guarded(path)


def test_large_attributes_are_refused(path, monkeypatch):
    monkeypatch.setattr(guard, "MAX_ATTRIBUTE_BYTES", 100)
    with h5py.File(path, "a") as file:
        file.attrs["numbers"] = np.zeros(100)
    with pytest.raises(TrajectoryFileError, match=r"/ has the attribute 'numbers' of a strange type or size"):
        open_guarded(path)


def test_plain_files_pass(path):
    with h5py.File(path, "a") as file:
        file.create_dataset("more", data=np.arange(99), chunks=(10,), compression="lzf", shuffle=True, fletcher32=True)
        file["words"] = ["a", "b"]
        file["flag"] = True
    with open_guarded(path) as file:
        assert {"/more", "/words", "/flag", "/domains/arm/actions"} <= set(guard.check_objects(file, path))


def test_a_folder_is_called_a_folder(tmp_path):
    with pytest.raises(TrajectoryFileError, match="is a folder; expected a trajectory file"):
        open_guarded(tmp_path)


@pytest.mark.parametrize("name", ["a", "ant-maze_2.0", "..a", "9" * 64])
def test_names(name):
    assert is_name(name)


@pytest.mark.parametrize("name", ["", ".", "..", "a/b", "a b", "ü", "a\n", "9" * 65, "../x"])
def test_no_names(name):
    assert not is_name(name)


def test_a_file_with_far_more_objects_than_it_announces_is_refused_at_once(path, monkeypatch):
    monkeypatch.setattr(schema, "OBJECTS_OF_A_DOMAIN", 20)
    TrajectoryFile.open(path).close()
    with h5py.File(path, "a") as file:
        for number in range(100):
            file.create_group(f"extra{number}")
    walked = []
    monkeypatch.setattr(guard, "_member", lambda *words, real=guard._member: walked.append(words) or real(*words))
    with pytest.raises(TrajectoryFileError, match="is one object or level too many; expected 40 objects"):
        TrajectoryFile.open(path)
    assert len(walked) <= 40


def test_another_projects_file_is_called_one_however_many_objects_it_has(tmp_path, monkeypatch):
    monkeypatch.setattr(schema, "OBJECTS_OF_A_DOMAIN", 20)
    with h5py.File(tmp_path / "x", "w") as file:
        for number in range(100):
            file.create_group(f"demo_{number}")
    with pytest.raises(TrajectoryFileError, match=r"found format None; expected .*: see 'plp data import --help'"):
        TrajectoryFile.open(tmp_path / "x")


def test_a_flood_of_attributes_is_refused(path):
    with h5py.File(path, "a", track_order=True) as file:
        for number in range(1100):
            file["domains"].attrs[f"a{number}"] = 1
    with pytest.raises(TrajectoryFileError, match="/domains has 1100 attributes; expected at most 1000"):
        TrajectoryFile.open(path)


@pytest.mark.parametrize(
    ("text", "told"), [("\x1b[2Jgone", r"\x1b[2Jgone"), ("a\x07\u202eb", r"a\x07\u202eb"), ("ü\n", "ü\n")]
)
def test_messages_cannot_steer_a_terminal(text, told):
    assert str(TrajectoryFileError(f"found {text}")) == f"found {told}"
