"""Shells complete what ``plp`` understands, by the script that it makes, without starting it."""

from __future__ import annotations

import shlex
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest
from command import complaint, plp

from plp_lightning.cli.completion import FISH_RUNS, SHELLS, configured, of_runs
from plp_lightning.cli.options import OptionParser
from plp_lightning.cli.verbs import VERBS, Verb


@pytest.fixture(scope="module")
def scripts(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a script for each shell, a page and a run directory."""
    folder = tmp_path_factory.mktemp("completion")
    for shell in SHELLS:
        answer = plp("completion", shell)
        assert answer.code == 0, answer
        (folder / f"plp.{shell}").write_text(answer.out)
    (folder / "arms.yaml").touch()
    (folder / "runs" / "arms" / "plp" / "left" / "seed_0").mkdir(parents=True)
    return folder


def in_bash(folder: Path, line: str) -> list[str]:
    """Words that bash offers at the end of a line."""
    words = line.split(" ")
    code = f"source plp.bash; COMP_WORDS=({shlex.join(words)}); COMP_CWORD={len(words) - 1}; _plp"
    return asked(folder, ["bash", "-c", f'{code}; printf "%s\\n" "${{COMPREPLY[@]}}"'])


def asked(folder: Path, command: list[str]) -> list[str]:
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=True)
    assert not done.stderr
    return done.stdout.split("\n")[:-1]


@pytest.mark.parametrize(
    ("line", "offered"),
    [
        ("plp fi", {"fit"}),
        ("plp export runs/arms/plp/left/seed_0 --to ", {"onnx", "torch", "safetensors"}),
        ("plp fit --config p2p_m", {"p2p_medium"}),
        ("plp fit --config p2p_medium --config methods/plp_t_n", {"methods/plp_t_noaction"}),
        ("plp fit --config ar", {"arms.yaml"}),
        ("plp sweep --config sweeps/tab", {f"sweeps/table{i}" for i in range(1, 7)}),
        ("plp fit --data.target_", {"--data.target_domain", "--data.target_task", "--data.target_trajectories"}),
        ("plp fit --alignment.terms.mmd.w", {"--alignment.terms.mmd.weight"}),
        ("plp collect --train_", {"--train_expert"}),
        ("plp fit --resume ", {"runs/arms/plp/left/seed_0"}),
        ("plp test runs/a", {"runs/arms/plp/left/seed_0", "runs/arms"}),
        ("plp list sim", {"simulators"}),
        ("plp data import min", {"minari"}),
        ("plp completion ", {*SHELLS}),
    ],
)
def test_bash_offers_what_plp_understands(line: str, offered: set[str], scripts: Path) -> None:
    assert offered <= {*in_bash(scripts, line)}
    assert len(in_bash(scripts, line)) <= len(offered) + 6  # files beside


def test_all_verbs_are_offered_and_each_has_its_options(scripts: Path) -> None:
    assert {*in_bash(scripts, "plp ")} == {*VERBS}
    for verb in {*VERBS} - {"completion", "doctor"}:
        assert len(in_bash(scripts, f"plp {verb} --")) > 1, verb


def run_look(arguments: Sequence[str]) -> None:
    """A verb that nobody has told of elsewhere."""
    parser = OptionParser("plp look")
    parser.add_argument("how", choices=["twice", "once"])
    parser.add_argument("run", metavar="RUN_DIR")
    parser.add_argument("--config", metavar="PAGE")
    parser.parse_args(list(arguments))


def test_a_new_verb_is_completed_by_what_it_says_itself(scripts: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "plp_lightning.cli.looking", sys.modules[__name__])
    monkeypatch.setitem(VERBS, "look", Verb("looking", "look at runs"))
    (scripts / "plp.bash").rename(scripts / "kept.bash")
    (scripts / "plp.bash").write_text(plp("completion", "bash").out)
    found = [in_bash(scripts, line) for line in ("plp look ", "plp look once ru", "plp look --data.target_t")]
    (scripts / "kept.bash").replace(scripts / "plp.bash")
    assert {"twice", "once"} <= {*found[0]}
    assert "runs/arms/plp/left/seed_0" in found[1]
    assert {"--data.target_task", "--data.target_trajectories"} <= {*found[2]}
    assert f"__fish_seen_subcommand_from look\" -a '{FISH_RUNS}'" in plp("completion", "fish").out


@pytest.mark.parametrize("verb", VERBS)
def test_runs_are_called_by_one_name_in_all_help(verb: str, monkeypatch: pytest.MonkeyPatch) -> None:
    parsers = list[OptionParser]()
    monkeypatch.setattr(OptionParser, "print_help", lambda self, file=None: parsers.append(self))
    plp(verb, "--help")
    for action in [action for parser in parsers for action in parser._actions]:
        if not action.option_strings and action.dest.startswith("run"):
            assert action.metavar == "RUN_DIR"


def test_runs_and_pages_are_known_where_they_are_asked_for() -> None:
    assert {*filter(of_runs, VERBS)} == {"validate", "test", "predict", "rollout", "export", "report"}
    assert {*filter(configured, VERBS)} == {"fit", "collect", "sweep"}


def test_a_press_of_the_key_starts_no_program(scripts: Path) -> None:
    code = "source plp.bash; COMP_WORDS=(plp fit --se); COMP_CWORD=2; PATH=; _plp; echo ${COMPREPLY[0]}"
    assert asked(scripts, ["bash", "-c", code]) == ["--seed"]


@pytest.mark.skipif(not shutil.which("fish"), reason="there is no fish")
@pytest.mark.parametrize(
    ("line", "offered"),
    [
        ("plp fi", "fit"),
        ("plp fit --alignment.terms.mmd.w", "--alignment.terms.mmd.weight"),
        ("plp fit --config p2p_m", "p2p_medium"),
        ("plp fit --resume ru", "runs/arms/plp/left/seed_0"),
        ("plp list sim", "simulators"),
        ("plp export --to on", "onnx"),
    ],
)
def test_fish_offers_the_same(line: str, offered: str, scripts: Path) -> None:
    found = asked(scripts, ["fish", "--no-config", "-c", f"source plp.fish; complete -C {shlex.quote(line)}"])
    assert offered in [word.partition("\t")[0] for word in found]


@pytest.mark.skipif(not shutil.which("zsh"), reason="there is no zsh")
def test_zsh_reads_the_script(scripts: Path) -> None:
    code = "source ./plp.zsh; COMP_WORDS=(plp fi); COMP_CWORD=1; emulate ksh; _plp; print -l $COMPREPLY"
    assert "fit" in asked(scripts, ["zsh", "-f", "-c", code])


def test_another_shell_is_told() -> None:
    assert "invalid choice: 'tcsh'" in complaint("completion", "tcsh")
