"""``plp schema``: a JSON Schema (https://json-schema.org/draft/2020-12) of pages, by which editors complete and check.

All of it is read from the parsers of ``plp fit`` and ``plp sweep``, and so from signatures and docstrings. Pages are
laid over one another, so no key is required.
"""

from __future__ import annotations

import importlib
import json
from collections.abc import Sequence
from pathlib import Path

from jsonargparse import ArgumentParser

from datamodules.errors import ConfigError
from datamodules.plain_yaml import parse_yaml
from datamodules.store.atomic import write_atomically
from plp_lightning.cli.classes import ALLOWED_IMPORTS
from plp_lightning.cli.config import PAGES, allow_imports, build_parser
from plp_lightning.cli.hints import Definitions, Schema
from plp_lightning.cli.options import OptionParser
from plp_lightning.plugins import find_in_working_folder, plugins
from plp_lightning.runs.experiment import PhaseFactory
from plp_lightning.sweeps.page import SweepPage

DIALECT = "https://json-schema.org/draft/2020-12/schema"
KINDS = ("page", "sweep")


def run_schema(arguments: Sequence[str]) -> None:
    """``plp schema [page|sweep] [--out FILE]``."""
    parser = OptionParser("plp schema", description="A JSON Schema of pages, for editors.")
    parser.add_argument(
        "kind", nargs="?", choices=KINDS, default="page", help="page of plp fit (default), or a sweep's"
    )
    parser.add_argument("--out", type=Path, help="file to write; the screen if not given")
    parser.add_argument("--allow_imports", action="append", default=[], help="package of yours whose classes it knows")
    options = parser.parse_args(list(arguments))
    text = json.dumps(schema(options.kind, options.allow_imports), indent=1) + "\n"
    if options.out is None:
        print(text, end="")
    else:
        write_atomically(options.out, text)


def schema(kind: str, packages: Sequence[str] = ()) -> Schema:
    """The schema of a page or of a sweep's page.

    Args:
        kind: One of :data:`KINDS`.
        packages: Packages of the user's, which are imported so that their classes are known.

    Raises:
        ConfigError: If one of them can't be imported.
    """
    find_in_working_folder(packages)
    allow_imports([*ALLOWED_IMPORTS, *plugins(), *packages])
    for package in packages:
        _load(package)
    known = Definitions()
    whole = _page(known) if kind == "page" else _sweep(known)
    properties = {"$schema": {"type": "string"}, **whole.pop("properties")}
    return {"$schema": DIALECT, "title": f"a {kind} of plp", **whole, "properties": properties, "$defs": known.made}


def _load(package: str) -> None:
    """Import a package of the user's, whose classes are known then."""
    try:
        importlib.import_module(package)
    except Exception as error:  # a package of others has errors of its own
        told = f"--allow_imports {package}: can't be imported: {type(error).__name__}: {error}"
        raise ConfigError(f"{told}; expected a package that can be: mend it or leave it away") from None


def _page(known: Definitions) -> Schema:
    """Keys that no method of ours has are phases of other methods, which name their class."""
    parser = build_parser(_phases())
    other = {"allOf": [known.schema(PhaseFactory)], "required": ["class_path"]}
    return {**known.keys(parser), "additionalProperties": other}


def _phases() -> list[str]:
    """Names of the phases of all methods that this package brings."""
    pages = [PAGES / "base.yaml", *sorted((PAGES / "methods").glob("*.yaml"))]
    names = (name for page in pages for name in parse_yaml(page.read_text()).get("phases", ()))
    return list(dict.fromkeys(names))


def _sweep(known: Definitions) -> Schema:
    parser = ArgumentParser(exit_on_error=False)
    parser.add_class_arguments(SweepPage)
    own = known.keys(parser)
    part = {**own, "properties": {key: value for key, value in own["properties"].items() if key != "root"}}
    return {**own, "properties": {**own["properties"], "parts": {"type": "array", "items": part}}}
