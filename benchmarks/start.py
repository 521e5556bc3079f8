"""Start-up: commands of ``plp``, each a process of its own, against a Python that imports what they need."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

from benchmarks.measuring import Options, Row, in_turn, ratio, timed

ROOT = Path(__file__).parents[1]
PLP = ["-m", "plp_lightning"]
EMPTY, IMPORTS = "python", "python, import lightning.pytorch"
COMMANDS: dict[str, tuple[Sequence[str], str]] = {
    "plp --help": ([*PLP, "--help"], EMPTY),
    "import plp_lightning": (["-c", "import plp_lightning"], EMPTY),
    "plp data inspect --help": ([*PLP, "data", "inspect", "--help"], EMPTY),
    "plp fit --print_config": ([*PLP, "fit", "--config", "configs/smoke.yaml", "--print_config"], IMPORTS),
}


def started(words: Sequence[str]) -> None:
    subprocess.run([sys.executable, *words], cwd=ROOT, stdout=subprocess.DEVNULL, check=True)


def rows(options: Options) -> Iterator[Row]:
    plain = {EMPTY: ["-c", "pass"], IMPORTS: ["-c", "import lightning.pytorch"]}
    every = plain | {name: words for name, (words, _) in COMMANDS.items()}
    ways = {name: timed(lambda words=words: started(words)) for name, words in every.items()}  # type: ignore[misc]
    times = in_turn(ways, options.pick(5, 1))
    for name, (_, beside) in COMMANDS.items():
        yield ratio(f"{name} / {beside}", times, name, beside)
