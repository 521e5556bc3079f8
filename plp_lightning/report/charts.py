"""Charts of many runs: success and alignment by method, and success over what a study varies."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence

from matplotlib.axes import Axes
from matplotlib.figure import Figure as Canvas

from plp_lightning.pictures.style import colour, line, marker
from plp_lightning.report.document import Figure
from plp_lightning.report.drawing import DPI, Bar, bar_panels, drawn, look, plain
from plp_lightning.report.reference import Reference
from plp_lightning.report.summaries import Group, Measure, success

SCORES = {
    "top1": ("Top-1 accuracy", "Share of 1000 states whose corresponding state is the nearest in the latent space."),
    "top5": ("Top-5 accuracy", "Share of 1000 states whose corresponding state is among the five nearest."),
    "closeness": ("Closeness", "Share of corresponding states among the closest 5 % of all pairs in the latent space."),
}
"""Alignment scores of the paper's figures; others are drawn under their own names."""
STUDIES = {
    "demonstrations": "Number of demonstrations",
    "goals": "Number of proxy goals",
    "sources": "Number of source domains",
    "mmd": "Weight of MMD",
    "disc": "Weight of the discriminator",
}
"""What the paper's figures vary; other studies are drawn under their own names."""
NUMBERED = re.compile(r"(?P<of>\w+?)_(?P<varied>[a-z]+)_(?P<number>\d+(?:\.\d+)?)")
"""Names of a study's methods and experiments: ``plp_t_goals_5``, ``p2p_medium_sources_2``."""
Points = Mapping[float, Group]
Line = tuple[str, str]  # Method and experiment, without what is numbered


def success_chart(groups: Sequence[Group], compared: Reference) -> list[Figure]:
    """Success in the target domain by experiment and method; none without a simulated run."""
    panels = _panels(groups, success, lambda group: _beside(group, compared))
    if not panels:
        return []
    with look():
        figure = bar_panels(panels, compared.methods(), compared.name)
        image = drawn(figure, "success", "Success of the target task in the target domain.")
    return [Figure("Success", "Mean over runs.", [image])]


def _beside(group: Group, compared: Reference) -> float | None:
    known = compared.value(group.experiment, group.plain_method)
    return known.mean if known else None


def score_charts(groups: Sequence[Group], compared: Reference, wanted: bool) -> list[Figure]:
    """A figure for each alignment score, those of the paper first; those that are ``wanted`` are told if not run."""
    names = sorted({name for group in groups for run in group.records for name in run.alignment})
    order = [*(name for name in SCORES if wanted or name in names), *(name for name in names if name not in SCORES)]
    return [_score_chart(groups, name, compared) for name in order]


def _score_chart(groups: Sequence[Group], name: str, compared: Reference) -> Figure:
    title, text = SCORES.get(name, (name, ""))
    panels = _panels(groups, lambda run: run.alignment.get(name), lambda group: None)
    if not panels:
        return Figure(f"Alignment: {title}", text, [])
    with look():
        figure = bar_panels(panels, compared.methods())
        image = drawn(figure, f"alignment-{_slug(name)}", f"Alignment score by method: {title}.")
    return Figure(f"Alignment: {title}", text, [image])


def _panels(groups: Sequence[Group], measure: Measure, beside: Callable[[Group], float | None]) -> dict[str, list[Bar]]:
    panels: dict[str, list[Bar]] = defaultdict(list)
    for group in groups:
        if (found := group.summary(measure)) is not None:
            values = [value for run in group.records if (value := measure(run)) is not None]
            ends = found.interval and (max(0.0, found.interval[0]), min(1.0, found.interval[1]))
            panels[group.experiment].append(Bar(group.method, found.mean, ends, values, beside(group)))
    return panels


def study_charts(groups: Sequence[Group], wanted: bool) -> list[Figure]:
    """A figure for each study: success over what names of methods or experiments number."""
    found: dict[str, dict[Line, dict[float, Group]]] = defaultdict(lambda: defaultdict(dict))
    for group in groups:
        for varied, line_of, number in _numbered(group):
            found[varied][line_of][number] = group
    studies = {varied: _lines(points) for varied, points in found.items()}
    known = {varied: lines for varied, lines in studies.items() if lines}
    order = [*(name for name in STUDIES if wanted or name in known), *sorted({*known} - {*STUDIES})]
    return [_study_chart(name, known.get(name, {})) for name in order]


def _lines(points: Mapping[Line, Points]) -> dict[str, Points]:
    """Lines of two points or more; a point alone belongs to every variant of its method on its experiment."""
    alone = {line_of: own for line_of, own in points.items() if len(own) == 1}
    lines: dict[str, Points] = {}
    for (method, experiment), own in points.items():
        shared = [p for (m, e), p in alone.items() if e == experiment and method.startswith(f"{m}_")]
        joined = {number: group for part in (*shared, own) for number, group in part.items()}
        if len(joined) > 1:
            lines[f"{method} on {experiment}"] = joined
    return lines


def _numbered(group: Group) -> list[tuple[str, Line, float]]:
    """Thing that a group's names number, of what, and the number."""
    found = []
    if match := NUMBERED.fullmatch(group.method):
        found.append((match["varied"], (match["of"], group.experiment), float(match["number"])))
    if match := NUMBERED.fullmatch(group.experiment):
        found.append((match["varied"], (group.method, match["of"]), float(match["number"])))
    return found


def _study_chart(name: str, lines: Mapping[str, Points]) -> Figure:
    title = STUDIES.get(name, name)
    text = "Mean over runs; bars are standard deviations over seeds, where there are two or more."
    if not lines:
        return Figure(title, text, [])
    with look():
        figure = Canvas(figsize=(5.0, 3.2), layout="constrained", dpi=DPI)
        _draw_study(figure.subplots(), title, lines)
        image = drawn(figure, f"study-{_slug(name)}", f"Success over: {title.lower()}.")
    return Figure(title, text, [image])


def _draw_study(axes: Axes, title: str, lines: Mapping[str, Points]) -> None:
    for i, (of, points) in enumerate(lines.items()):
        found = {number: summary for number, group in sorted(points.items()) if (summary := group.summary())}
        means, spreads = [s.mean for s in found.values()], [s.over_seeds or 0.0 for s in found.values()]
        look_of = {"color": colour(i), "linestyle": line(i), "marker": marker(i), "capsize": 3}
        axes.errorbar(list(found), means, spreads, label=plain(of), **look_of)  # type: ignore[arg-type]
    numbers = sorted({number for points in lines.values() for number in points})
    if numbers[0] > 0 and numbers[-1] >= 10 * numbers[0]:
        axes.set_xscale("log")
    axes.set_xticks(numbers, [f"{number:g}" for number in numbers], minor=False)
    axes.minorticks_off()
    axes.set(ylim=(-0.03, 1.05), xlabel=plain(title), ylabel="success")
    axes.legend()


def _slug(name: str) -> str:
    return re.sub(r"\W+", "-", name, flags=re.ASCII)[:40] or "own"


def slug(*names: str) -> str:
    """Names as a part of a file's name; what can't stand in one is left out."""
    return "-".join(map(_slug, names))
