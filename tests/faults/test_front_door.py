"""Options are heeded or refused, paths are what they mean, and text of others is text."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import h5py
import pytest
import yaml
from command import SMOKE, TINY, complaint, data_root, plp, smoke_run, tiny_smoke
from lightning.pytorch import Callback

from datamodules.words import expand_home, one_line, visible
from plp_lightning.runs.directory import RunDirectory


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> RunDirectory:
    """A run that uses a class of the user's own."""
    root = tmp_path_factory.mktemp("finished")
    own = ["--callbacks+=test_front_door.Own", "--allow_imports", "test_front_door"]
    answer = plp("fit", *tiny_smoke(root), *own)
    assert answer.code == 0, answer
    return smoke_run(root)


class Own(Callback):
    """A class of a user's own."""


OWN = ["--allow_imports", "test_front_door"]


@pytest.mark.parametrize("verb", ["test", "validate", "predict"])
@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["--checkpoint", "/no/such.ckpt"], "--checkpoint goes with --config FILE"),
        (["extra"], "unrecognized arguments: "),
        (["--seed", "3"], "unrecognized arguments: --seed"),
        (["--phase", "alignmnt", *OWN], "--phase is 'alignmnt'"),
    ],
)
def test_no_option_beside_a_run_is_swallowed(verb: str, words: list[str], told: str, finished: RunDirectory) -> None:
    assert told in complaint(verb, finished.path, *words)
    assert told in complaint(verb, *words, finished.path)


@pytest.mark.parametrize("verb", ["test", "validate", "predict"])
@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["--phase", "alignment"], "--phase chooses a checkpoint of a run directory"),
        (["--which=last"], "--which chooses a checkpoint of a run directory"),
        (["stray"], "'stray' belongs to no option"),
    ],
)
def test_no_option_beside_files_is_swallowed(verb: str, words: list[str], told: str, finished: RunDirectory) -> None:
    assert told in complaint(verb, *SMOKE, "--checkpoint", finished.checkpoint("alignment"), *words)


def test_a_run_with_a_class_of_ones_own_is_tested_validated_and_predicted(
    finished: RunDirectory, tmp_path: Path
) -> None:
    words = [str(finished.path), *OWN]
    assert plp("test", *words, "--episodes", 2, "--output", tmp_path / "test.json").code == 0
    assert plp("validate", *words).code == 0
    assert plp("predict", *words, "--output", tmp_path / "out.npz").code == 0


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["--episodes", "0"], "expected a whole number of at least 1"),
        (["--episodes", "9" * 5000], "expected a whole number of at least 1"),
        (["--episode_seed", "-5"], "expected a whole number from 0 to 4294967295"),
        (["--episode_seed", "4294967296"], "expected a whole number from 0 to 4294967295"),
    ],
)
def test_numbers_out_of_range_are_named(words: list[str], told: str) -> None:
    line = complaint("test", "absent", *words)
    assert told in line
    assert len(line) < 500


@pytest.mark.parametrize(
    "name", ["*", ".", " ", "", "os,sys", "plp_lightning.", "../own", "nothing_here", "own.nothing"]
)
def test_what_is_no_package_cannot_be_trusted(name: str, tmp_path: Path) -> None:
    line = complaint("fit", *tiny_smoke(tmp_path / "runs"), "--allow_imports", name)
    assert f"--allow_imports is {name!r}; expected the name of a package" in line
    assert f"--allow_imports is {name!r}" in complaint("fit", *tiny_smoke(tmp_path), f"--allow_imports={name}")


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["stray.yaml"], "'stray.yaml' belongs to no option"),
        (["--print_config", "--resume", "x"], "--print_config prints the configuration"),
        (["--print_config", "--phase", "alignment"], "--print_config prints the configuration"),
        (["--policy.help=PortablePolicy", "x"], "'x' belongs to no option"),
        (["--policy", "null"], "policy is not set"),
        (["--experiment", ""], "experiment is ''; expected up to 64 letters"),
        (["--run_root", ""], "run_root is empty; expected a path"),
        (["--data.root", ""], "data.root is empty; expected a path"),
        (["--data.file", ""], "data.file is empty; expected a path"),
        (["--run_root", "\x01"], "'\\x01' holds a control character"),
        (["--method", "con\x1b[31m"], "'con\\x1b[31m' holds a control character"),
        (["--run_root", "x" * 5000], "File name too long"),
        (["--data.file", "x" * 5000], "File name too long"),
        (["--data.file", "/"], "/: is a folder"),
        (["--data.file", "/dev/null"], "/dev/null: no such file"),
        (["--data.root", "/dev/null"], "Not a directory"),
        (["--data.batch_size", "x" * 5000], "data.batch_size is xxx"),
    ],
)
def test_what_cannot_be_meant_is_one_short_line(words: list[str], told: str, tmp_path: Path) -> None:
    line = complaint("fit", *tiny_smoke(tmp_path / "runs"), *words)
    assert told in line
    assert len(line) < 600
    assert not (tmp_path / "runs").exists()


def test_a_file_that_links_to_itself_is_told_before_anything_is_written(tmp_path: Path) -> None:
    (tmp_path / "loop.hdf5").symlink_to("loop.hdf5")
    words = [*tiny_smoke(tmp_path / "runs"), "--data.file", str(tmp_path / "loop.hdf5")]
    assert "Too many levels of symbolic links" in complaint("fit", *words)
    assert not (tmp_path / "runs").exists()


def test_help_is_help_in_every_spelling() -> None:
    for word in ("--help", "-h", "--help=policy"):
        answer = plp("fit", *SMOKE, word)
        assert (answer.code, answer.err) == (0, "")
        assert "--resume" in answer.out


def test_the_home_folder_is_meant_wherever_a_path_stands(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    monkeypatch.chdir(tmp_path)
    page = tmp_path / "home" / "mine" / "page.yaml"
    page.parent.mkdir(parents=True)
    page.write_text("run_root: ~/runs\ndata: {file: ~/x.hdf5}")
    answer = plp("fit", *SMOKE, *TINY, "--config", "~/mine/page.yaml", "--data.root=~/data", "--print_config")
    assert answer.code == 0, answer
    config = yaml.safe_load(answer.out)
    home = str(tmp_path / "home")
    assert (config["run_root"], config["data"]["root"]) == (f"{home}/runs", f"{home}/data")
    assert config["data"]["file"] == f"{home}/x.hdf5"
    monkeypatch.setenv("PLP_DATA", "~/there")
    config = yaml.safe_load(plp("fit", *SMOKE, "--print_config").out)
    assert config["data"]["root"] == f"{home}/there"
    assert f"{home}/absent: is no run directory" in complaint("fit", "--resume=~/absent")
    assert f"{home}/absent: is no run directory" in complaint("test", "~/absent")
    assert [path.name for path in tmp_path.iterdir()] == ["home"]


def test_only_a_path_below_a_home_folder_is_expanded() -> None:
    assert [expand_home(text) for text in ("~", "a~/b", "~ /x", "x")] == ["~", "a~/b", "~ /x", "x"]


def test_a_run_is_looked_at_from_any_folder_with_its_own_data(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "here").mkdir()
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    shutil.copytree(data_root(), "demos")
    answer = plp("fit", *SMOKE, *TINY, "--data.root", "demos", "--run_root", "runs")
    assert answer.code == 0, answer
    run = smoke_run(tmp_path / "here" / "runs")
    monkeypatch.chdir(tmp_path / "elsewhere")
    assert plp("validate", run.path).code == 0
    file = tmp_path / "here" / "demos" / "smoke.hdf5"
    with h5py.File(file, "r+") as content:
        content["domains/flat/actions"][0] += 0.25
    assert "do not match" in complaint("validate", run.path)
    file.unlink()
    assert f"{file}: does not hold the run's demonstrations" in complaint("validate", run.path)
    assert f"{file}: does not hold the run's demonstrations" in complaint("predict", run.path)
    answer = plp("test", run.path, "--episodes", 4)
    assert answer.code == 0, answer
    trials, results = json.loads((run.path / "test.json").read_text())["trials"], json.loads(run.results.read_text())
    assert trials["target"]["success"] == results["target"]["success"]
    assert not [*Path.cwd().iterdir()]


@pytest.mark.parametrize("folder", ["[abl=1]", "[", "[red]x[/red]"])
def test_brackets_in_a_path_are_brackets(folder: str, tmp_path: Path) -> None:
    answer = plp("fit", *tiny_smoke(tmp_path / folder))
    assert answer.code == 0, answer
    assert f"run directory: {tmp_path / folder}/" in answer.out
    answer = plp("test", smoke_run(tmp_path / folder).path, "--episodes", 2)
    assert answer.code == 0, answer


def test_escape_codes_of_a_file_do_not_reach_the_terminal(tmp_path: Path) -> None:
    file = tmp_path / "file.hdf5"
    shutil.copy(data_root() / "smoke.hdf5", file)
    with h5py.File(file, "r+") as content:
        record = {"command": "\x1b[31mred\x9b2J [/x]", "n\x1bame": "[bold]"}
        content.attrs["provenance"] = json.dumps(record, ensure_ascii=False)
    for words in (["inspect"], ["validate"], ["inspect", "--json"]):
        answer = plp("data", words[0], file, *words[1:])
        assert "Traceback" not in answer.err
        assert visible(answer.out + answer.err) == answer.out + answer.err
    assert "\x1b" not in complaint("data", "inspect", tmp_path / "absent").replace("\n", "")


def test_words_are_shown_on_one_line() -> None:
    assert one_line("a\x1b[31m\n b\r\x9b" + " x" * 2) == "a\ufffd[31m b\ufffd\ufffd x x"
    assert len(one_line("y" * 10_000)) < 200
