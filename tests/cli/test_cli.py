"""The command line itself: verbs, help, version, exit codes, and what light verbs don't import."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from command import ROOT, complaint, data_root, plp, tiny_smoke

from plp_lightning.cli.config import option_values
from plp_lightning.cli.verbs import VERBS, find_verb

LIGHT = """
import sys
from plp_lightning.cli.main import main
main(["--help"])
main(["data", "inspect", sys.argv[1]])
main(["data", "validate", sys.argv[1]])
heavy = {"torch", "lightning", "mujoco", "jsonargparse"} & set(sys.modules)
sys.exit(f"imported {heavy}" if heavy else 0)
"""


def python(*arguments: object, cwd: Path) -> subprocess.CompletedProcess[str]:
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    command = [sys.executable, *map(str, arguments)]
    return subprocess.run(command, cwd=cwd, env=environment, capture_output=True, text=True, check=False)


def test_light_verbs_do_not_import_torch(tmp_path: Path) -> None:
    done = python("-c", LIGHT, data_root() / "smoke.hdf5", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "fit for training" in done.stdout


def test_module_answers_like_the_command(tmp_path: Path) -> None:
    done = python("-m", "plp_lightning", "ftt", cwd=tmp_path)
    assert (done.returncode, done.stderr) == (2, "plp: unknown verb 'ftt'; did you mean 'fit'?\n")


def test_help_lists_every_verb_and_version_is_one_line() -> None:
    assert all(f"  {verb} " in plp("--help").out for verb in VERBS)
    assert plp().out == plp("--help").out
    assert plp("--version").out.startswith("plp ")
    assert plp("--version").out.count("\n") == 1


@pytest.mark.parametrize("verb", VERBS)
def test_every_verb_has_help(verb: str) -> None:
    assert callable(find_verb(verb))
    answer = plp(verb, "--help")
    assert answer.code == 0
    assert {*re.findall(r"usage: plp (\w+)", answer.out)} == {verb}


def test_help_of_fit_names_every_group_of_options() -> None:
    out = plp("fit", "--help").out
    for option in ("--resume", "--phase", "--from", "--data.batch_size", "--alignment", "--trainer.accelerator"):
        assert option in out


def test_values_are_read_in_both_spellings_and_in_order() -> None:
    words = ["--config=a", "--config", "b", "--seed", "1", "--config=c"]
    assert option_values(words, "config") == ["a", "b", "c"]
    assert option_values(["--config"], "config") == []
    assert option_values([], "config") == []


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["zzz"], "unknown verb 'zzz'; see plp --help"),
        (["data"], "required: verb"),
        (["data", "inspct", "x"], "invalid choice: 'inspct'"),
        (["data", "inspect", "x", "--jsn"], "unrecognized arguments: --jsn"),
        (["data", "inspect", "absent.hdf5"], "absent.hdf5: no such file"),
        (["fit"], "not set; give an experiment, such as --config"),
        (["fit", "--config"], "argument --config: expected one argument"),
        (["fit", "--resume"], "argument --resume: expected one argument"),
        (["fit", "--resume", "absent"], "absent: is no run directory"),
        (["test"], "nothing to look at; name a run directory"),
        (["test", "absent"], "absent: is no run directory"),
        (["test", "absent", "--episodes", "0"], "--episodes: found '0'; expected a whole number of at least 1"),
        (["predict", "absent", "--which", "first"], "invalid choice: 'first'"),
    ],
)
def test_mistakes_are_told_in_one_line(arguments: list[str], told: str) -> None:
    assert told in complaint(*arguments)


@pytest.mark.parametrize(
    ("extra", "told"),
    [
        (["--phase", "alignmnt"], "the phases of method 'plp' are alignment, adaptation"),
        (["--phase", "adaptation,alignment"], "name some that follow one another"),
        (["--phase", "alignment,alignment"], "name some that follow one another"),
        (["--phase", "alignment,"], "--phase is ''; the phases of method 'plp' are alignment, adaptation"),
        (["--phase", "alignment,adaptation", "--from", "absent"], "stands in for the phases before --phase"),
        (["--phase", "adaptation"], "name the run that holds it with --from RUN_DIR"),
        (["--from", "absent"], "stands in for the phases before --phase"),
        (["--phase", "alignment", "--from", "absent"], "stands in for the phases before --phase"),
        (["--phase", "adaptation", "--from", "absent"], "absent: is no run directory"),
    ],
)
def test_phases_that_cannot_run_leave_no_run_behind(extra: list[str], told: str, tmp_path: Path) -> None:
    assert told in complaint("fit", *tiny_smoke(tmp_path), *extra)
    assert not list(tmp_path.iterdir())
