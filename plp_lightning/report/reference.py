"""Values to compare runs with: those of the paper, or of a file of one's own."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Annotated, Any

import yaml
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError, model_validator
from scipy import stats

from datamodules.errors import ConfigError

Place = tuple[int, list[tuple[float, str]]]
Share = Annotated[float, Field(ge=0, le=1)]


def _printable(text: str) -> str:
    if not text.isprintable():
        raise ValueError("text that can be printed, on one line")
    return text


Text = Annotated[str, AfterValidator(_printable)]


class Value(BaseModel):
    """Success rate of a method on an experiment: a number, ``[mean, std]``, or a mapping of what is known."""

    model_config = ConfigDict(extra="forbid")
    mean: Share
    std: Annotated[float, Field(ge=0, le=1)] | None = None  # over runs
    low: Share | None = None  # ends of its 95 % interval
    high: Share | None = None

    @model_validator(mode="before")
    @classmethod
    def _short(cls, given: Any) -> Any:
        if isinstance(given, list) and len(given) == 2:
            return {"mean": given[0], "std": given[1]}
        return {"mean": given} if isinstance(given, int | float) else given

    def interval(self, runs: int | None) -> tuple[float, float] | None:
        """95 % interval: as given, or Student's t of the mean of so many runs, cut to [0, 1]; None if unknown."""
        if self.low is not None and self.high is not None:
            return self.low, self.high
        if self.std is None or runs is None or runs < 2:
            return None
        width = float(stats.t.ppf(0.975, runs - 1)) * self.std / math.sqrt(runs)
        return max(0.0, self.mean - width), min(1.0, self.mean + width)


Values = dict[Text, dict[Text, Value]]


class ReferenceTable(BaseModel):
    """A table of experiments × methods; ``values`` are those that it has otherwise than the rest of the reference."""

    model_config = ConfigDict(extra="forbid")
    title: Text
    experiments: list[Text]
    methods: list[Text]
    values: Values = {}
    note: Text = ""


class Reference(BaseModel):
    """Success rates by experiment and method, in the order in which experiments and methods are reported."""

    model_config = ConfigDict(extra="forbid")
    name: Text = "the reference"
    source: Text = ""
    runs: Annotated[int, Field(ge=1)] | None = None  # behind each value
    recipe: Text | None = None  # that it was measured by, whose runs stand beside its values
    values: Values
    tables: list[ReferenceTable] = []

    def value(self, experiment: str, method: str, table: ReferenceTable | None = None) -> Value | None:
        """Success rate of a method on an experiment, as a table of the reference has it if one is named."""
        own = table.values.get(experiment, {}).get(method) if table else None
        return own or self.values.get(experiment, {}).get(method)

    def rank(self, experiment: str, method: str) -> tuple[Place, Place]:
        """Place in the order of the reference; names that it does not know come last, their numbers as numbers."""
        return _place(experiment, [*self.values]), _place(method, [*self.values.get(experiment, {})])

    def methods(self) -> list[str]:
        """Every method, in order."""
        return list(dict.fromkeys(name for methods in self.values.values() for name in methods))


NOTHING = Reference(values={})
"""Compares with nothing."""


def _place(name: str, order: list[str]) -> Place:
    return order.index(name) if name in order else len(order), [*map(_part, re.findall(r"\d+(?:\.\d+)?|\D+", name))]


def _part(part: str) -> tuple[float, str]:
    """A number or a word of a name, so that 28 comes before 140."""
    return (float(part), "") if part[0].isdecimal() else (math.inf, part)


@cache
def paper() -> Reference:
    """Values of the paper (https://arxiv.org/abs/2407.16912)."""
    return reference(yaml.safe_load((Path(__file__).parent / "paper.yaml").read_text(encoding="utf-8")), "paper.yaml")


def reference(content: Mapping[str, Any], file: Path | str) -> Reference:
    """Values out of a file's content.

    Raises:
        ConfigError: If something in it is none of what a reference holds.
    """
    try:
        return Reference.model_validate(content)
    except ValidationError as error:
        first = error.errors(include_url=False, include_context=False)[0]
        key = ".".join(map(str, first["loc"])) or "it"
        said = "is missing" if first["type"] == "missing" else f"is {first['input']!r:.60} ({first['msg'].lower()})"
        expected = "expected name, runs and values: {experiment: {method: [mean, std]}}, as docs/report.md has them"
        raise ConfigError(f"{file}: {key} {said}; {expected}") from None
