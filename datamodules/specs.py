"""Comparison of what two places say of one domain: a trajectory file, a simulator, a checkpoint."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any


def difference(found: Mapping[str, Any], expected: Mapping[str, Any], place: str, env: bool = True) -> str:
    """Tell the first difference between two specs, as :meth:`DomainSpec.to_dict` gives them; empty if there is none.

    Args:
        found: What ``place`` says: state keys with shapes ``(O,)``, actions ``(A,)`` and so on. Fields that it lacks,
            as earlier versions may have left them out, are not compared; limits that are not there are none.
        expected: What it should say.
        place: In a word or two, where ``found`` comes from, such as ``file``.
        env: Whether the simulators' own words for themselves have to be the same.
    """
    unlimited = dict.fromkeys(("action_low", "action_high"))
    found = {**unlimited, **found}
    for field, wanted in {**unlimited, **expected}.items():
        given = found.get(field, wanted)
        if field == "observation":
            told = _key_difference({key["name"]: key for key in given}, {key["name"]: key for key in wanted}, place)
        else:
            told = "" if given == wanted else f"{field} {given!r} in the {place}; expected {wanted!r}"
        if told and (env or field != "env"):
            return told
    return ""


def _key_difference(found: Mapping[str, Any], expected: Mapping[str, Any], place: str) -> str:
    if list(found) != list(expected):
        return f"keys {', '.join(found)} in the {place}; expected {', '.join(expected)}"
    for name, wanted in expected.items():
        for part, value in wanted.items():
            if found[name].get(part, value) != value:
                return f"key {name!r} with {part} {found[name][part]!r} in the {place}; expected {value!r}"
    return ""
