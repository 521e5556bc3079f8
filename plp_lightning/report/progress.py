"""Charts of single runs over their epochs, out of their ``metrics.csv``."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

from matplotlib.axes import Axes
from matplotlib.figure import Figure as Canvas
from matplotlib.ticker import MaxNLocator

from datamodules.errors import ConfigError
from plp_lightning.pictures.style import colour, line
from plp_lightning.report.charts import slug
from plp_lightning.report.document import Figure, Image
from plp_lightning.report.drawing import DPI, drawn, look, plain
from plp_lightning.report.records import Record
from plp_lightning.report.summaries import Group
from plp_lightning.runs.curves import read_rows

SUCCESS = {"eval/target_success": "target domain", "eval/source_success": "source domain"}
SCORE = "alignment/"
MOST_EPOCHS = 1e9
Curve = list[tuple[float, float]]  # Epochs that are done, and the value
Tell = Callable[[str], None]


class Course(NamedTuple):
    """Curves of one run over all its phases, and the epochs at which phases begin."""

    curves: dict[str, Curve]
    begins: list[float]


def progress_charts(groups: Sequence[Group], tell: Tell) -> Figure:
    """Success and alignment scores over the epochs of all phases, an image an experiment."""
    images = []
    for experiment in dict.fromkeys(group.experiment for group in groups):
        courses = {
            group: [course for run in group.records if (course := _course(run, tell)).curves]
            for group in groups
            if group.experiment == experiment
        }
        if any(courses.values()):
            images.append(_image(experiment, {group: found for group, found in courses.items() if found}))
    text = (
        "A line a run, phases one after the other from grey line to grey line; the last point is the final evaluation. "
        "Success of the target task is solid in the target domain and dashed in the source domain."
    )
    return Figure("Over epochs", text, images)


def _course(run: Record, tell: Tell) -> Course:
    """Curves of a run that has some left; whatever is damaged is told and left away."""
    curves: dict[str, Curve] = {}
    begins, done = list[float](), 0.0
    for file in [run.folder / phase / "metrics.csv" for phase in run.phases] if run.folder else ():
        begins.append(done)
        try:
            done = _add(curves, read_rows(file), done)
        except (ConfigError, OSError, ValueError) as error:
            tell(f"{error if isinstance(error, ConfigError) else f'{file}: {error}'}; its curves are left away")
            return Course({}, [])
    ends = {"eval/target_success": (run.before, run.success), "eval/source_success": (None, run.source)}
    for name, (before, after) in ends.items() if done else ():
        points = [(begins[-1], before)] * (len(begins) > 1) + [(done, after)]
        known = [(epoch, value) for epoch, value in points if value is not None]
        curves[name] = sorted((dict(curves.get(name, [])) | dict(known)).items())  # of more episodes
    return Course({name: curve for name, curve in curves.items() if curve}, begins)


def _add(curves: dict[str, Curve], rows: Sequence[Sequence[str]], before: float) -> float:
    """Lengthen curves by a phase's rows; gives the epochs that are done after it."""
    epochs = {int(step): _epoch(value) for step, name, value in rows if name == "epoch"}
    for step, name, value in rows:
        if (name in SUCCESS or name.startswith(SCORE)) and int(step) in epochs:
            curves.setdefault(name, []).append((before + epochs[int(step)] + 1, float(value)))
    return before + max(epochs.values(), default=-1) + 1


def _epoch(text: str) -> float:
    if not 0 <= float(text) < MOST_EPOCHS:
        raise ValueError(f"found epoch {text}")
    return float(text)


def _image(experiment: str, courses: dict[Group, list[Course]]) -> Image:
    scores = sorted({n for found in courses.values() for course in found for n in course.curves if n.startswith(SCORE)})
    panels = {"success": [*SUCCESS], **{name.removeprefix(SCORE): [name] for name in scores}}
    with look():
        figure = Canvas(figsize=(4.2 * len(panels) + 1.6, 3.2), layout="constrained", dpi=DPI)
        for axes, (title, names) in zip(figure.subplots(1, len(panels), squeeze=False)[0], panels.items(), strict=True):
            _draw(axes, title, names, courses)
        axes.legend(loc="center left", bbox_to_anchor=(1.02, 0.5))
        anchor = next(iter(courses)).anchor
        return drawn(figure, slug("epochs", experiment), f"{experiment}: over epochs.", anchor)


def _draw(axes: Axes, title: str, names: Sequence[str], courses: dict[Group, list[Course]]) -> None:
    for i, (group, found) in enumerate(courses.items()):
        styles = ("-", "--") if len(names) > 1 else (line(i),)
        for course in found:
            for style, name in zip(styles, names, strict=True):
                epochs, values = (
                    [x for x, _ in course.curves.get(name, [])],
                    [y for _, y in course.curves.get(name, [])],
                )
                axes.plot(epochs, values, style, color=colour(i), alpha=0.8, linewidth=1.1, marker=".", markersize=3)
            for begin in course.begins[1:]:
                axes.axvline(begin, color="0.8", linewidth=0.8, zorder=0)
        axes.plot([], [], line(i), color=colour(i), label=plain(group.method))
    axes.set(ylim=(-0.03, 1.05), xlabel="epochs")
    axes.set_title(plain(title))
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
