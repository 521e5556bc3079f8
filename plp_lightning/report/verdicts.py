"""Verdicts of runs, beside the success that these came to."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Sequence

from plp_lightning.evaluation.statistics import success_interval
from plp_lightning.report.document import Cell, Section, Table, row
from plp_lightning.report.records import Record
from plp_lightning.report.words import interval, number

GOOD = 0.8  # Success of a transfer; verdicts ask as much of what is cloned and learnt
ALIGNED, NOTHING, SHORT = "aligned", "nothing falls short, no latent space", "falls short"


def verdicts(records: Sequence[Record]) -> list[Section]:
    """Runs by their verdict, and the share of them that solves the target task; none if no run has a verdict."""
    became: dict[str, list[bool]] = defaultdict(list)
    for run in records:
        if run.success is not None:
            for told in _verdicts(run):
                became[told].append(run.success >= GOOD)
    rows = [_row(told, became[told]) for told in dict.fromkeys([ALIGNED, NOTHING, *sorted(became)]) if told in became]
    text = (
        "Runs by their verdict, which knows nothing of the target task in the target domain, and the share of them "
        f"whose success there came to {GOOD}. Wilson's 95 % interval takes runs for independent; those of one method "
        "on one experiment are not. A run may fall short in several respects."
    )
    table = Table(["verdict", "runs", f"success ≥ {GOOD}", "95 % interval"], rows)
    return [Section("Verdicts", [text], [table])] if rows else []


def _verdicts(run: Record) -> Iterator[str]:
    """A run's verdict, and the facts that fall short, without domains; nothing of a run without facts."""
    if run.facts and run.falls_short:
        yield SHORT
        yield from {f"{SHORT}: {fact.split('/')[0]}" for fact in run.falls_short}
    elif run.facts:
        yield ALIGNED if "mix" in run.facts else NOTHING


def _row(told: str, solved: Sequence[bool]) -> list[Cell]:
    share = number(sum(solved) / len(solved))
    return row(told, str(len(solved)), share, interval(success_interval(sum(solved), len(solved))))
