"""``plp completion``: a script by which bash, zsh or fish completes verbs, options, pages and run directories.

It is made once and holds all words, so that no Python is started when a key is pressed.
"""

from __future__ import annotations

import contextlib
import io
import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from datamodules.formats.registry import format_names
from datamodules.plain_yaml import parse_yaml
from plp_lightning.cli.config import BASE, PAGES, help_parser, parse
from plp_lightning.cli.listing import KINDS
from plp_lightning.cli.main import VERBS, find_verb
from plp_lightning.cli.options import OptionParser
from plp_lightning.cli.schema import KINDS as SCHEMAS

SHELLS = ("bash", "zsh", "fish")
RUNS = "runs/*/*/*/seed_*"
WORDS: Mapping[str, Sequence[str]] = {
    "list": KINDS,
    "schema": SCHEMAS,
    "completion": SHELLS,
    "data": ("inspect", "validate", "import", "export", *format_names()),
}
"""Words that follow a verb; after others, files and folders do."""
CONFIGURED = ("fit", "collect", "sweep")
"""Verbs that take every key of a page as an option."""
OPTION = re.compile(r"^ +(?:-\w, )?(--[\w.]+)(?:[ =](?:\{([^}]*)\}))?", re.MULTILINE)

BASH = """\
# {about}
_plp() {{
  local word=${{COMP_WORDS[COMP_CWORD]}} before=${{COMP_WORDS[COMP_CWORD-1]}} verb=${{COMP_WORDS[1]}} words= files=
  local IFS=$' \\t\\n'
  if [ "$COMP_CWORD" = 1 ]; then
    words="{verbs}"
  else
    case "$verb $before" in
{values}
      "sweep --config") files=1 words="{sweeps}" ;;
      *" --config") files=1 words="{pages}" ;;
      *" --"[a-z]*) case "$word" in -*) ;; *) files=1 ;; esac ;;
    esac
    case "$words$files:$verb:$word" in
{options}
{following}
      :*) files=1 ;;
    esac
    case "$before" in --resume | --from) words=$(compgen -G "{runs}") ;; esac
    case "$verb" in {assessing}) [ "${{word#-}}" = "$word" ] && words=$(compgen -G "{runs}") ;; esac
  fi
  COMPREPLY=($(compgen -W "$words" -- "$word"))
  if [ -n "$files" ]; then
    IFS=$'\\n'
    COMPREPLY+=($(compgen -f -- "$word"))
  fi
}}
complete -o filenames -F _plp plp
"""


def run_completion(arguments: Sequence[str]) -> None:
    """``plp completion bash|zsh|fish``."""
    parser = OptionParser("plp completion", description="A script by which a shell completes plp's words.")
    parser.add_argument("shell", choices=SHELLS, help="the shell that reads it: docs/completion.md")
    shell = parser.parse_args(list(arguments)).shell
    print(_fish() if shell == "fish" else _bash(shell), end="")
