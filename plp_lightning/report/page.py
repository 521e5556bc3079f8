"""A report as one HTML file that asks for nothing: images, style and all are in it."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from pathlib import Path

from jinja2 import Environment, StrictUndefined

from datamodules.words import visible
from plp_lightning.report.document import NOT_RUN, Section

TEMPLATE = Path(__file__).parent / "page.html.j2"


def html(title: str, sections: Sequence[Section]) -> str:
    """The whole report; texts are escaped, whatever stands in them."""
    environment = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    environment.filters["base64"] = lambda content: base64.b64encode(content).decode("ascii")
    template = environment.from_string(TEMPLATE.read_text(encoding="utf-8"))
    return visible(template.render(title=title, sections=sections, not_run=NOT_RUN))
