"""Records → a report: all its sections in order."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from plp_lightning.report.appendix import on_the_way, runs
from plp_lightning.report.charts import score_charts, study_charts, success_chart
from plp_lightning.report.comparison import reference_tables
from plp_lightning.report.document import Section
from plp_lightning.report.kept import Row
from plp_lightning.report.progress import progress_charts
from plp_lightning.report.records import Record
from plp_lightning.report.reference import Reference
from plp_lightning.report.snapshots import snapshots
from plp_lightning.report.summaries import Group, groups_of
from plp_lightning.report.tables import (
    differences,
    interquartile_means,
    measured,
    side_by_side,
    success_rates,
)
from plp_lightning.report.verdicts import verdicts

TITLE = "Report"
Tell = Callable[[str], None]


def table_sections(records: Sequence[Record], rows: Sequence[Row], compared: Reference) -> list[Section]:
    """Everything but the figures; ``rows`` are those of runs on the way."""
    groups = groups_of(records, compared)
    scores = "Alignment scores on proxy tasks, mean over runs."
    errors = "Error of held-out actions by domain, mean over runs."
    behaviour = "Measures of behaviour, of the target task in the target domain, mean over runs."
    return [
        success_rates(groups, compared),
        *reference_tables(groups, compared),
        *interquartile_means(groups),
        *differences(groups),
        *side_by_side(groups, compared),
        *verdicts(records),
        *measured(groups, "alignment", "Alignment", scores),
        *measured(groups, "behaviour", "Behaviour", behaviour),
        *measured(groups, "held_out", "Held-out actions", errors, digits=4),
        runs(groups),
        *on_the_way(rows),
    ]


def figure_section(records: Sequence[Record], compared: Reference, tell: Tell) -> Section:
    """Every figure that runs have something for; those of the paper too, if it is compared with, as not run.

    ``tell`` hears of each file that is left away because it is damaged.
    """
    groups = groups_of(records, compared)
    wanted = bool(compared.tables) and bool({group.experiment for group in groups} & {*compared.values})
    figures = [
        *success_chart(groups, compared),
        *score_charts(groups, compared, wanted),
        *study_charts(groups, wanted),
        progress_charts(groups, tell),
        *snapshots(groups, wanted, tell),
    ]
    return Section("Figures", figures=[figure for figure in figures if figure.images or wanted])


def with_figures(tables: Sequence[Section], figures: Section) -> list[Section]:
    """Sections of tables, then figures, then the runs behind them."""
    first = next(i for i, section in enumerate(tables) if section.title == "Runs")
    return [*tables[:first], *[figures] * bool(figures.figures), *tables[first:]]


def ordered(groups: Sequence[Group]) -> list[Record]:
    """All records of groups, in their order."""
    return [record for group in groups for record in group.records]
