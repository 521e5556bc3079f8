"""``plp completion``: a script by which bash, zsh or fish completes verbs, options, pages and run directories.

It is made once and holds all words, so that no Python is started when a key is pressed. What a verb understands is read
from its help, where run directories are called RUN_DIR and pages PAGE.
"""

from __future__ import annotations

import contextlib
import functools
import io
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from datamodules.formats.registry import format_names
from datamodules.plain_yaml import parse_yaml
from plp_lightning.cli.config import BASE, PAGES, parse
from plp_lightning.cli.options import OptionParser
from plp_lightning.cli.verbs import VERBS, find_verb

SHELLS = ("bash", "zsh", "fish")
RUNS = "runs/*/*/*/seed_*"
OPTION = re.compile(r"^ +(?:-\w, )?(--[\w.]+)(?: \{([^}]*)\})?", re.MULTILINE)
CHOICE = re.compile(r"^  \{([^}]*)\}", re.MULTILINE)
RUN_DIR = re.compile(r"^  RUN_DIR\b", re.MULTILINE)
BASH = """\
# Made by plp completion; to be made again after an update.
_plp() {
  local word=${COMP_WORDS[COMP_CWORD]} before=${COMP_WORDS[COMP_CWORD - 1]} verb=${COMP_WORDS[1]}
  local words= files=1 options= IFS=$' \\t\\n'
  case "$verb" in
@options
  esac
  case "$verb $before" in
@choices
    "sweep --config") words="@sweeps" ;;
    *" --config") words="@pages" ;;
    *" --resume" | *" --from") words=$(compgen -G "@runs") ;;
    *" --"*) ;;
@words
    @of_runs) words=$(compgen -G "@runs") ;;
  esac
  case "$COMP_CWORD $word" in
    "1 "*) words="@verbs" files= ;;
    *" -"*) words=$options files= ;;
  esac
  COMPREPLY=($(compgen -W "$words" -- "$word"))
  IFS=$'\\n'
  [ -z "$files" ] || COMPREPLY+=($(compgen -f -- "$word"))
}
complete -o filenames -F _plp plp
"""
ZSH = "autoload -U +X compinit bashcompinit && compinit -u && bashcompinit\n"
FISH_RUNS = f"(for run in {RUNS}; echo $run; end)"


def run_completion(arguments: Sequence[str]) -> None:
    """``plp completion bash|zsh|fish``."""
    parser = OptionParser("plp completion", description="A script by which a shell completes what plp understands.")
    parser.add_argument("shell", choices=SHELLS, help="the shell that is to read it")
    shell = parser.parse_args(list(arguments)).shell
    options = {verb: dict(_options(verb)) for verb in VERBS}
    print("".join(_fish(options)) if shell == "fish" else ZSH * (shell == "zsh") + _bash(options), end="")


def of_runs(verb: str) -> bool:
    """Tell whether run directories follow a verb."""
    return RUN_DIR.search(_help(verb)) is not None


def configured(verb: str) -> bool:
    """Tell whether a verb takes every key of a page as an option."""
    return "--config PAGE" in _help(verb)


def _words() -> dict[str, Sequence[str]]:
    """Words that may follow, by verb and the word before."""
    first = {f"{verb} {verb}": found[1].split(",") for verb in VERBS if (found := CHOICE.search(_help(verb)))}
    return {**first, "data import": format_names(), "data export": format_names()}


def _options(verb: str) -> Iterator[tuple[str, Sequence[str]]]:
    """Options of a verb, as its help shows them, each with the words that its value is one of."""
    asked = [["data", *words] for words in _data_words()] if verb == "data" else [[verb]]
    asked += [["fit"]] if configured(verb) else []
    for words in asked:
        for name, choices in OPTION.findall(_help(*words)):
            yield name, choices.split(",") if choices else ()
    for key in _keys(parse_yaml(parse(["--config", "smoke"]).config)) if configured(verb) else ():
        yield f"--{key}", ()


def _data_words() -> list[list[str]]:
    moved = [[way, name] for way in ("import", "export") for name in format_names()]
    return [["inspect"], ["validate"], *moved]


@functools.cache
def _help(*words: str) -> str:
    told = io.StringIO()
    with contextlib.redirect_stdout(told), contextlib.suppress(SystemExit):
        find_verb(words[0])([*words[1:], "--help", *(["all"] if words == ("fit",) else [])])
    return told.getvalue()


def _keys(tree: Mapping[str, Any], place: str = "") -> Iterator[str]:
    """Dotted keys of a configuration, as flags have them; those of its domains are its own."""
    for name, value in tree.items():
        key = place if name == "init_args" else f"{place}.{name}".lstrip(".")
        if isinstance(value, Mapping) and value and key != "domains":
            yield from _keys(value, key)
        elif name != "class_path" and key != "domains":
            yield key


def _pages(*folders: str) -> list[str]:
    """Short names of the pages in some folders of this package's."""
    found = [
        page.relative_to(PAGES).with_suffix("") for name in folders for page in sorted((PAGES / name).glob("*.yaml"))
    ]
    return [str(page) for page in found if page != Path(BASE.stem)]


def _bash(options: Mapping[str, Mapping[str, Sequence[str]]]) -> str:
    choices = {(verb, name): own for verb, known in options.items() for name, own in known.items() if own}
    parts = {
        "options": [f'    {verb}) options="{" ".join(known)}" ;;' for verb, known in options.items()],
        "choices": [f'    "{verb} {name}") words="{" ".join(own)}" files= ;;' for (verb, name), own in choices.items()],
        "words": [f'    "{place}") words="{" ".join(own)}" files= ;;' for place, own in _words().items()],
        "sweeps": [" ".join(_pages("sweeps"))],
        "pages": [" ".join(_pages("", "methods", "recipes", "studies"))],
        "of_runs": [" | ".join(f'"{verb} "*' for verb in VERBS if of_runs(verb))],
        "verbs": [" ".join(VERBS)],
        "runs": [RUNS],
    }
    return re.sub(r"@(\w+)", lambda found: "\n".join(parts[found[1]]), BASH)


def _fish(options: Mapping[str, Mapping[str, Sequence[str]]]) -> Iterator[str]:
    """Lines, of which each one completes something in some place."""
    yield "# Made by plp completion; to be made again after an update.\n"
    for verb, known in VERBS.items():
        yield f'complete -c plp -n __fish_use_subcommand -f -a {verb} -d "{known.told}"\n'
        after = f'complete -c plp -n "__fish_seen_subcommand_from {verb}"'
        yield f"{after} -a '{FISH_RUNS}'\n" if of_runs(verb) else ""
        for name, choices in options[verb].items():
            value = _values(verb, name) or " ".join(choices)
            yield f"{after} -l {name[2:]}" + (f" {'-x' if choices else '-r'} -a '{value}'" if value else "") + "\n"

    for place, words in _words().items():
        verb, before = place.split()
        after = f"__fish_seen_subcommand_from {verb}; and test (commandline -opc)[-1] = {before}"
        yield f"complete -c plp -n '{after}' -f -a '{' '.join(words)}'\n"


def _values(verb: str, name: str) -> str:
    """Pages or run directories that an option names, in fish's words."""
    pages = ["sweeps"] if verb == "sweep" else ["", "methods", "recipes", "studies"]
    known = {"--config": " ".join(_pages(*pages)), "--resume": FISH_RUNS, "--from": FISH_RUNS}
    return known.get(name, "")
