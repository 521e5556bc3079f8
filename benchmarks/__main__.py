"""``script/bench``: benchmarks by name, a row as soon as it is there, and all of them as JSON.

Exit code 1 if a bar is missed or a benchmark has crashed; in the short form, if a ratio is far off.
"""

from __future__ import annotations

import json
import os
import signal
import sys
from argparse import Namespace
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from benchmarks.catalogue import BENCHMARKS, CPU, GPU
from benchmarks.machine import machine
from benchmarks.measuring import SLACK, Options, Row
from benchmarks.running import run
from datamodules.errors import UserError
from datamodules.store.atomic import write_atomically
from plp_lightning.cli.options import OptionParser
from plp_lightning.runs.gpus import gpus


def main(words: Sequence[str]) -> int:
    """Run what is asked for; gives the exit code."""
    try:
        asked = parsed(words)
        options = Options(asked.short, asked.device, asked.robomimic)
        about = machine(asked.device) | {"words": [*words], "short": asked.short}
        return measured(asked.names or default_names(options), options, about, asked.json)
    except UserError as error:
        print(f"bench: {error}", file=sys.stderr)
        return 2


def measured(names: Sequence[str], options: Options, about: dict[str, Any], file: Path | None) -> int:
    """Run benchmarks, show and write each row at once; 1 if a bar is missed or a benchmark did not come to its end."""
    names_of_gpus, slack = "".join(f"{gpu['name']}, " for gpu in about["gpus"]), SLACK if options.short else 1.0
    print(
        f"{about['processor']}, {about['cores']} cores, {names_of_gpus}load {about['load']:.1f}, {about['commit']}",
        flush=True,
    )
    found: list[tuple[str, Row]] = []
    for name in names:
        for row in (row.eased(slack) for row in run(name, options)):
            found.append((name, row))
            print(f"{name:15} {row.line()}", flush=True)
            if file is not None:
                write(file, about, found)
    return int(any(row.verdict in ("missed", "failed") for _, row in found))


def write(file: Path, about: dict[str, Any], found: Sequence[tuple[str, Row]]) -> None:
    """Write all rows as JSON, with what is known of the machine."""
    rows = [{"benchmark": name} | row.to_dict() for name, row in found]
    write_atomically(file, json.dumps(about | {"load_after": os.getloadavg()[0], "rows": rows}, indent=1) + "\n")


def parsed(words: Sequence[str]) -> Namespace:
    """Read the command line; a :class:`UserError` says what is wrong with it."""
    parser = OptionParser("script/bench", description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", choices=[[], *BENCHMARKS], help=", ".join(BENCHMARKS))
    parser.add_argument("--short", action="store_true", help="a minute of it, with wide margins")
    parser.add_argument("--json", type=Path, help="file for all rows, with machine, commit and versions")
    parser.add_argument("--device", choices=["cpu", "cuda"], default="cpu", help="cuda: all that is for a GPU")
    parser.add_argument("--robomimic", default=os.environ.get("PLP_ROBOMIMIC"), help="a Python that has robomimic")
    asked = parser.parse_args([*words])
    if asked.device == "cuda" and not gpus()["usable"]:
        raise UserError("no GPU that torch can use; expected one for --device cuda: run plp doctor, or leave it away")
    return asked


def default_names(options: Options) -> list[str]:
    """Names of the benchmarks that are run when none is named."""
    if options.device == "cuda":
        return [*GPU]
    return [name for name, benchmark in CPU.items() if benchmark.short or not options.short]


if __name__ == "__main__":
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))  # or a benchmark would go on without us
    sys.exit(main(sys.argv[1:]))
