"""Start-up: commands against a Python that imports what they need; `plp fit` part by part, and its memory.

`script/bench start` compares commands. Time from `plp fit` to its first training step, part by part, and memory, alone
and of several runs side by side, are told by

    python -m benchmarks.start [--config r2r …] [--data FOLDER] [--turns 3] [--runs 4] [--json FILE] [words of fit …]

Each turn is a process of its own that trains one step, then begins an episode in every simulator. Seconds are medians:
by the clock, and of the processor in brackets. Memory is the proportional share (PSS) after the first step and once
the simulators are there; a share of what other processes use too is theirs, so that it is less on a busy machine, and
RSS beside it is not. Without `--data` a few demonstrations are collected first; a folder with an experiment's own
measures it as it is.
"""

from __future__ import annotations

import argparse
import itertools
import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, NoReturn

if TYPE_CHECKING:
    from benchmarks.measuring import Options, Row

ROOT = Path(__file__).parents[1]
PLP = ["-m", "plp_lightning"]
EMPTY, IMPORTS = "python", "python, import lightning.pytorch"
PLAIN = {EMPTY: ["-c", "pass"], IMPORTS: ["-c", "import lightning.pytorch"]}
COMMANDS: dict[str, tuple[Sequence[str], str]] = {
    "plp --help": ([*PLP, "--help"], EMPTY),
    "import plp_lightning": (["-c", "import plp_lightning"], EMPTY),
    "plp data inspect --help": ([*PLP, "data", "inspect", "--help"], EMPTY),
    "plp fit --print_config": ([*PLP, "fit", "--config", "configs/smoke.yaml", "--print_config"], IMPORTS),
}
FIRST_STEP = "plp fit --config smoke, to the first step"
FEW = ("--data.trajectories=24", "--data.target_trajectories=6")
PARTS = ("words", "imports", "configuration", "checks", "demonstrations", "trainer", "first step", "simulators")
"""Parts of a start, in order; the last comes after the first step."""


def rows(options: Options) -> Iterator[Row]:
    from benchmarks.measuring import in_turn, ratio, timed  # not where a start is measured

    every = PLAIN | {name: words for name, (words, _) in COMMANDS.items()}
    ways = {name: timed(lambda words=words: run_python(words)) for name, words in every.items()}  # type: ignore[misc]
    with TemporaryDirectory() as folder:
        page, seeds = words_of("smoke", folder), itertools.count()
        ways[FIRST_STEP] = lambda: to_first_step(alone([*page, f"--seed={next(seeds)}"]))[0]
        times = in_turn(ways, options.pick(5, 1))
    for name, (_, beside) in {**COMMANDS, FIRST_STEP: ((), IMPORTS)}.items():
        yield ratio(f"{name} / {beside}", times, name, beside)


def run_python(words: Sequence[str]) -> None:
    subprocess.run([sys.executable, *words], cwd=ROOT, stdout=subprocess.DEVNULL, check=True)


def words_of(name: str, folder: str, data: str | None = None) -> list[str]:
    """Words of ``plp fit`` for a page; without ``data`` a few demonstrations are collected in a folder first."""
    words = ["--config", f"configs/{name}.yaml", f"--data.root={data or folder}", f"--run_root={folder}/runs"]
    return words if data else [*words, *FEW]


def memory() -> dict[str, float]:
    """PSS and RSS of this process, MiB."""
    lines = (line.split() for line in Path("/proc/self/smaps_rollup").read_text().splitlines()[1:])
    found = {line[0]: int(line[1]) / 1024 for line in lines}
    return {"pss": found["Pss:"], "rss": found["Rss:"]}


class Start:
    """Figures of a start, in the process that starts."""

    def __init__(self, began: float) -> None:
        self.clock, self.processor = began, 0.0
        self.told, self.results = dict[str, Any](), dict[str, Any]()

    def note(self, part: str) -> None:
        """Time since the part before."""
        clock, processor = time.time(), sum(os.times()[:2])
        self.told[part] = (clock - self.clock, processor - self.processor)
        self.clock, self.processor = clock, processor

    def after(self, owner: Any, name: str, part: str) -> None:
        """Note a part, and what came of it, once a function has been called."""
        function = getattr(owner, name)

        def noted(*arguments: Any, **settings: Any) -> Any:
            self.results[part] = function(*arguments, **settings)
            self.note(part)
            return self.results[part]

        setattr(owner, name, noted)


def begin(began: float, words: list[str]) -> None:
    """Be ``plp fit`` until its first step is done; then begin episodes, tell, and wait for a line to end."""
    start = Start(began)
    from plp_lightning.cli import main as entry

    start.note("words")
    from plp_lightning.cli import experiments
    from plp_lightning.runs import fit

    start.note("imports")
    from torch.optim.optimizer import register_optimizer_step_post_hook

    start.after(experiments, "read", "configuration")
    start.after(experiments.RunDirectory, "create", "checks")
    start.after(fit, "prepare_demonstrations", "demonstrations")
    start.after(fit, "build_trainer", "trainer")

    def stepped(*_: object) -> NoReturn:
        start.note("first step")
        start.told["at the first step"] = memory()
        for simulator in start.results["configuration"][0].simulators.values():
            simulator.reset(simulator.tasks.names[:1], [0])
        start.note("simulators")
        start.told["with simulators"] = memory()
        answer(start)

    register_optimizer_step_post_hook(stepped)
    entry.main(["fit", *words])


def answer(start: Start) -> NoReturn:
    """Print what was found; then, if others run beside this one, memory while all of them are there."""
    print("STARTED", json.dumps(start.told), flush=True)
    sys.stdin.readline()
    print("STARTED", json.dumps(memory()), flush=True)
    sys.stdin.readline()
    os._exit(0)


class Run:
    """A start in a process of its own."""

    def __init__(self, words: list[str]) -> None:
        command = [sys.executable, "-m", "benchmarks.start", "--begin", str(time.time()), *words]
        self.process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, cwd=ROOT, stderr=subprocess.DEVNULL
        )

    def read(self) -> dict[str, Any]:
        """Its next answer."""
        assert self.process.stdout is not None
        line = next((line for line in self.process.stdout if line.startswith("STARTED")), None)
        assert line is not None, f"no first step: {' '.join(map(str, self.process.args))}"  # type: ignore[arg-type]
        found: dict[str, Any] = json.loads(line.removeprefix("STARTED"))
        return found

    def go_on(self) -> None:
        """Let it go on after an answer."""
        assert self.process.stdin is not None
        self.process.stdin.write("\n")
        self.process.stdin.flush()


def measure(name: str, data: str | None, turns: int, runs: int, more: list[str]) -> dict[str, Any]:
    """Medians of a page's starts, one at a time, and memory of several side by side."""
    with TemporaryDirectory() as folder:
        words = [*words_of(name, folder, data), *more]
        starts = [alone([*words, f"--seed={seed}"]) for seed in range(turns + 1)]
        together = [Run([*words, f"--seed={100 + seed}"]) for seed in range(runs)]
        for run in together:
            run.read()
        shares = [share(run) for run in together]
        for run in together:
            run.go_on()
            run.process.wait()
    found: dict[str, Any] = {"first_turn": starts[0], "side_by_side": shares}
    for part in PARTS:
        clock, processor = zip(*(start[part] for start in starts[1:]), strict=True)
        found[part] = (median(clock), median(processor))
    for moment in ("at the first step", "with simulators"):
        found[moment] = {kind: median(start[moment][kind] for start in starts[1:]) for kind in ("pss", "rss")}
    return found


def alone(words: list[str]) -> dict[str, Any]:
    run = Run(words)
    found = run.read()
    run.process.kill()
    run.process.wait()
    return found


def to_first_step(parts: Mapping[str, Any]) -> tuple[float, float]:
    """Seconds by the clock and of the processor from the command to the first step."""
    clock, processor = zip(*(parts[part] for part in PARTS[:-1]), strict=True)
    return sum(clock), sum(processor)


def share(run: Run) -> dict[str, Any]:
    run.go_on()
    return run.read()


def show(name: str, found: dict[str, Any]) -> None:
    print(f"\n{name}")
    for part in PARTS:
        print(f"  {part:18} {found[part][0]:6.2f} s  ({found[part][1]:.2f} s)")
        if part == "first step":
            clock, processor = to_first_step(found)
            print(f"  {'to the first step':18} {clock:6.2f} s  ({processor:.2f} s)")
    for moment in ("at the first step", "with simulators"):
        print(f"  {moment:18} PSS {found[moment]['pss']:4.0f} MiB, RSS {found[moment]['rss']:4.0f} MiB")
    shares = [run["pss"] for run in found["side_by_side"]]
    if shares:
        print(
            f"  {len(shares)} side by side    PSS {sum(shares) / len(shares):4.0f} MiB each, {sum(shares):.0f} in all"
        )


def main() -> None:
    """Measure pages, print a table, and leave the figures as JSON."""
    if sys.argv[1:2] == ["--begin"]:
        begin(float(sys.argv[2]), sys.argv[3:])
    parser = argparse.ArgumentParser(description="Time and memory of a start.")
    parser.add_argument("--config", nargs="+", default=["r2r"], help="pages of configs/")
    parser.add_argument("--data", help="folder of the demonstrations; a few are collected if not given")
    parser.add_argument("--turns", type=int, default=3, help="starts one after the other, after one that warms up")
    parser.add_argument("--runs", type=int, default=4, help="runs side by side")
    parser.add_argument("--json", type=Path, help="file for all figures")
    options, more = parser.parse_known_args()
    data = os.path.abspath(options.data) if options.data else None
    found = {name: measure(name, data, options.turns, options.runs, more) for name in options.config}
    for name, figures in found.items():
        show(name, figures)
    if options.json:
        options.json.write_text(json.dumps(found, indent=1))


if __name__ == "__main__":
    main()
