"""Every page that is shipped is valid under the schema that editors read, and typical faults are not."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from command import ROOT, complaint, plp

from datamodules.plain_yaml import parse_yaml
from plp_lightning.cli.schema import KINDS, schema

jsonschema = pytest.importorskip("jsonschema")
PAGES = [
    *sorted(path for path in (ROOT / "configs").rglob("*.yaml")),
    *sorted((ROOT / "docs" / "examples").glob("*.yaml")),
    *sorted((ROOT / "benchmarks").rglob("*.yaml")),
]


@pytest.fixture(scope="module")
def validators() -> dict[str, Any]:
    made = {kind: schema(kind) for kind in KINDS}
    for one in made.values():
        jsonschema.Draft202012Validator.check_schema(one)
    return {kind: jsonschema.Draft202012Validator(one) for kind, one in made.items()}


@pytest.mark.parametrize("path", PAGES, ids=lambda path: str(path.relative_to(ROOT)))
def test_a_page_that_is_shipped_is_valid(path: Path, validators: dict[str, Any]) -> None:
    kind = "sweep" if path.parent.name == "sweeps" else "page"
    assert [error.message for error in validators[kind].iter_errors(parse_yaml(path.read_text()))] == []


@pytest.mark.parametrize(
    "text",
    [
        "dta: {file: x}",
        "data: {batch_sise: 3}",
        "data: {batch_size: many}",
        "data: {batch_size: 0}",
        "data: {batch_size: 2.5}",
        "data: {val_fraction: 1.0}",
        "data: {tasks_per_batch: most}",
        "data: {proxy_tasks: left}",
        "seed: -1",
        "seed: 4294967296",
        "threads: 0",
        "polcy: {init_args: {hidden: 3}}",
        "polcy: {class_path: PortablePolicy}",
        "policy: {class_path: PortablePolice}",
        "policy: {class_path: PortablePolicy, init_args: {hiden: 3}}",
        "policy: {class_path: MMD}",
        "policy: {hidden: 3}",
        "policy: {init_args: {hidden: -3}}",
        "policy: {init_args: {image_encoder: {features: 0}}}",
        "policy: {init_args: {image_encoder: {class_path: ImageEncoding, init_args: {colour: red}}}}",
        "alignment: {init_args: {terms: {mmd: {class_path: MND}}}}",
        "alignment: {init_args: {terms: {mmd: {class_path: MMD, init_args: {weight: heavy}}}}}",
        "alignment: {init_args: {terms: {mmd: {class_path: MMD, init_args: {bandwidths: [1, -1]}}}}}",
        "alignment: {init_args: {terms: {mmd: {class_path: MMD, init_args: {similarity: squared}}}}}",
        "alignment: {init_args: {optimizer: {class_path: FusedAdamW, init_args: {lr: -1}}}}",
        "domains: {a: {simulator: {class_path: Lift, init_args: {robot: Jaco}}}}",
        "domains: {a: {simulater: {class_path: Lift}}}",
        "domains: {a: {expert: {class_path: Lift}}}",
        "evaluation: {metrics: [{class_path: MMD}]}",
        "score: [{class_path: PairAccuracy, init_args: {samples: few}}]",
        "trainer: {callbacks: []}",
        "trainer: {enable_progress_bar: false}",
        "trainer: {max_epochs: 0}",
        "run_root: 3",
    ],
)
def test_a_fault_is_found(text: str, validators: dict[str, Any]) -> None:
    assert not validators["page"].is_valid(parse_yaml(text))


@pytest.mark.parametrize(
    "text",
    [
        "$schema: plp.schema.json",
        "policy: BCPolicy",
        "policy: {class_path: my_package.policies.Mine, init_args: {anything: [1]}}",
        "policy: {class_path: plp_lightning.methods.bc.policy.BCPolicy, init_args: {layers: 3}}",
        "policy: {init_args: {image_encoder: {features: 8}}}",
        "callbacks+: {class_path: EarlyStopping, init_args: {monitor: val/bc}}",
        "evaluation: {metrics+: [{class_path: my.Metric}]}",
        "alignment: {init_args: {terms: {mmd: null}}}",
        "warming: {class_path: Alignment, init_args: {epochs: 3}}",
        "data: {tasks_per_batch: half, val_fraction: 0.0}",
        "trainer: {logger: [{class_path: CSVLogger, init_args: {save_dir: logs}}]}",
    ],
)
def test_what_pages_may_say_is_valid(text: str, validators: dict[str, Any]) -> None:
    assert [error.message for error in validators["page"].iter_errors(parse_yaml(text))] == []


@pytest.mark.parametrize("text", ["method: [plp]", "seeds: [-1]", "parts: [{root: x}]", "experiments: p2p_umaze"])
def test_a_fault_of_a_sweep_is_found(text: str, validators: dict[str, Any]) -> None:
    assert not validators["sweep"].is_valid(parse_yaml(text))


def test_keys_tell_what_editors_show(validators: dict[str, Any]) -> None:
    whole = validators["page"].schema
    share = whole["properties"]["data"]["properties"]["val_fraction"]
    assert (share["type"], share["minimum"], share["exclusiveMaximum"], share["default"]) == ("number", 0, 1, 0.05)
    assert "kept from training" in share["description"]
    names = whole["$defs"]["name-of-AlignmentTerm"]["anyOf"]
    assert {"MMD", "TCC"} <= {name.get("const") for name in names if name.get("description")}


def test_a_page_of_yours_is_checked_with_your_classes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(ROOT / "docs" / "examples")
    answer = plp("schema", "--allow_imports", "coral", "--out", tmp_path / "plp.schema.json")
    assert (answer.code, answer.out) == (0, "")
    check = jsonschema.Draft202012Validator(json.loads((tmp_path / "plp.schema.json").read_text()))
    wrong = "alignment: {init_args: {terms: {coral: {class_path: coral.Coral, init_args: {wait: 1.0}}}}}"
    assert check.is_valid(parse_yaml(wrong.replace("wait", "weight")))
    assert not check.is_valid(parse_yaml(wrong))


def test_what_is_no_place_and_what_is_no_package_are_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert "No such file or directory" in complaint("schema", "--out", tmp_path / "no" / "place" / "x.json")
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "broken_words.py").write_text("1 / 0")
    told = complaint("schema", "--allow_imports", "broken_words")
    assert "--allow_imports broken_words: can't be imported: ZeroDivisionError" in told
