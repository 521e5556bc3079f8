"""Pages as beginners write them: each mistake is one line, in the words of the page."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml
from command import complaint

PAGE: dict[str, Any] = {
    "domains": {
        "lab": {"simulator": {"class_path": "Gymnasium", "init_args": {"env": "Reacher-v5", "tasks": ["near", "far"]}}},
        "shop": {},
    },
    "data": {"file": "data/mine.hdf5", "source_domain": "lab", "target_domain": "shop", "target_task": "far"},
}
JARGON = ("Parser key", "NoneType", "<class", "Callable", "Namespace", "subclass", "dict with", "typing", "Union")
"""What the parser says of Python's types, which no page has."""


def changed(key: str, value: Any) -> dict[str, Any]:
    """The page with another value at a dotted key."""
    page: dict[str, Any] = yaml.safe_load(yaml.safe_dump(PAGE))
    *way, last = key.split(".")
    place = page
    for name in way:
        place = place.setdefault(name, {})
    place[last] = value
    return page


def told(page: dict[str, Any], folder: Path) -> str:
    file = folder / "mine.yaml"
    file.write_text(yaml.safe_dump(page, sort_keys=False))
    return complaint("fit", "--config", file, "--run_root", folder / "runs")


@pytest.mark.parametrize("value", [None, 3, [1], {"nonsense": 1}], ids=repr)
@pytest.mark.parametrize(
    "key",
    [
        *("domains", "domains.lab", "domains.lab.expert", "data", "score", "callbacks", "policy"),
        *("policy.init_args.image_encoder", "alignment", "alignment.init_args.terms", "alignment.init_args.terms.mmd"),
        *("alignment.init_args.optimizer", "evaluation.metrics", "trainer"),
        *(f"domains.lab.simulator.init_args.{name}" for name in ("tasks", "keys")),
    ],
)
def test_a_value_of_another_kind_is_told_in_the_words_of_a_page(key: str, value: Any, tmp_path: Path) -> None:
    answer = told(changed(key, value), tmp_path)
    assert not [word for word in JARGON if word in answer], answer
    assert len(answer) < 250


@pytest.mark.parametrize(
    ("key", "value", "expected"),
    [
        ("domains.lab", None, "domains.lab is None; expected simulator and expert, or {} where there is neither"),
        ("domains.lab.simulator.init_args.tasks", 3, "domains.simulator.tasks is 3; expected list[text], dict["),
        ("domains.lab.simulator.init_args.tasks", None, "is a Gymnasium without tasks"),
        ("policy", {"hidden": 64}, "expected its settings below init_args: policy.init_args.hidden"),
        ("alignment", {"epochs": 3}, "expected its settings below init_args: alignment.init_args.epochs"),
        ("data.target_task", None, "data.target_task not set; set it on the page, or by --data.target_task VALUE"),
        (
            "domain",
            {"lab": {"simulator": {"class_path": "Gymnasium"}}},
            "unknown key 'domain'; did you mean 'domains'?",
        ),
        ("alignment.init_args.optimizer", "Adma", "alignment.optimizer: unknown class 'Adma'; "),
        ("data.target_tusk", "far", "unknown key 'data.target_tusk'; did you mean 'data.target_task'?"),
    ],
)
def test_a_mistake_is_told_with_what_to_do(key: str, value: Any, expected: str, tmp_path: Path) -> None:
    assert expected in told(changed(key, value), tmp_path)


@pytest.mark.parametrize("up", range(1, 5))
def test_a_folder_above_a_run_is_told_with_the_run(up: int, tmp_path: Path) -> None:
    run = tmp_path / "runs" / "arms" / "plp" / "reach" / "seed_0"
    run.mkdir(parents=True)
    (run / "config.yaml").touch()
    assert complaint("test", run.parents[up - 1]).endswith(f"name one made by plp fit, such as {run}\n")


def test_a_folder_with_no_run_below_is_told_alone(tmp_path: Path) -> None:
    assert complaint("test", tmp_path).endswith("(it has no config.yaml); name one made by plp fit\n")


def test_demonstrations_that_are_nowhere_are_told_so(tmp_path: Path) -> None:
    page = changed("domains.shop", PAGE["domains"]["lab"])
    assert "import demonstrations into" in (answer := told(page, tmp_path))
    assert answer.endswith("mine.hdf5, which is not there\n")
    assert not (tmp_path / "runs").exists(), "the page is mended and run again"


def test_a_verb_without_a_page_asks_for_one() -> None:
    assert "give an experiment, such as --config configs/r2r.yaml" in complaint("fit")
