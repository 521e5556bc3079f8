"""Files of YAML, read with care; no torch is needed for it."""

from __future__ import annotations

import copy
from functools import lru_cache
from pathlib import Path
from typing import Any

import yaml

from datamodules.errors import ConfigError
from datamodules.plain_yaml import parse_yaml

Tree = dict[str, Any]  # A configuration as YAML has it
LARGEST = 1 << 20  # Bytes of a file of settings


def read_yaml(path: Path) -> Tree:
    """Keys and values of a file; a :class:`ConfigError` says if it can't be read or holds something else."""
    try:
        with path.open("rb") as file:
            content = parse_yaml(_decoded(path, file.read(LARGEST + 1)))
    except OSError as error:
        raise ConfigError(f"{path}: can't be read ({error.strerror}); name an existing YAML file") from None
    except yaml.YAMLError as error:
        raise ConfigError(f"{path}: is no YAML ({' '.join(str(error).split())}); mend the file") from None
    if content is not None and not isinstance(content, dict):
        raise ConfigError(f"{path}: holds a {type(content).__name__}; expected keys and values, as in configs/r2r.yaml")
    return content or {}


def read_value(text: str) -> Any:
    """Value of a flag; what is no YAML is a word."""
    try:
        return parse_yaml(text)
    except yaml.YAMLError:
        return text


def read_page_or_word(text: str) -> Any:
    """Value of a page or of a word of the command line; ``{a, b}`` and ``a:`` are words."""
    value = copy.deepcopy(_parsed(text))
    if isinstance(value, dict) and value and "\n" not in text and all(x is None for x in value.values()):
        return text
    return value


_parsed = lru_cache(maxsize=8)(parse_yaml)
"""A parser asks for the value of a whole page twice."""


def _decoded(path: Path, content: bytes) -> str:
    if len(content) > LARGEST:
        raise ConfigError(f"{path}: holds more than {LARGEST} bytes; expected a page of settings: name another file")
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        found = f"byte {content[error.start]:#04x} in line {line}"
        raise ConfigError(f"{path}: is no UTF-8 text ({found}); save it in that encoding") from None
