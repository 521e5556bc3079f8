from __future__ import annotations

import json

import pytest

from datamodules.errors import ConfigError
from plp_lightning.report.records import read_records

RESULT = {
    "experiment": "p2p_medium",
    "method": "plp",
    "target_task": "goal_1_6",
    "seed": 0,
    "target": {"success": 0.5, "interval": [0.4, 0.6], "before": 0.1},
    "proxy": {"success": 0.9},
    "alignment": {"top5": 0.8},
    "seconds": {"collection": 100.0, "alignment": 20.0, "adaptation": 3.0},
}


def write(folder, **changes):
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "results.json"
    path.write_text(json.dumps(RESULT | changes))
    return path


def test_every_run_below_a_folder_is_read_once(tmp_path):
    write(tmp_path / "a")
    path = write(tmp_path / "b" / "c", seed=1)
    (tmp_path / "a" / "status.json").write_text('{"state": "done"}')
    first, second = read_records([tmp_path, path, tmp_path / "a"])
    assert (first.run.seed, second.run.seed) == (0, 1)
    assert (first.success, first.low, first.high, first.before) == (0.5, 0.4, 0.6, 0.1)
    assert (first.proxy, first.source, first.alignment) == (0.9, None, {"top5": 0.8})
    assert first.seconds == 23.0  # collecting is another matter: the next run finds the file


def test_the_same_run_twice_is_told(tmp_path):
    write(tmp_path / "a")
    write(tmp_path / "b")
    with pytest.raises(ConfigError, match="hold the same run p2p_medium/plp/goal_1_6/0; name one of them"):
        read_records([tmp_path])


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("{", "no JSON"),
        ("[]", "not a run's results"),
        (json.dumps(RESULT | {"target": {"success": "x"}}), "not a run's results"),
        (json.dumps(RESULT | {"experiment": "\x1b[31mred"}), "not a run.s results .*cannot be printed"),
        ("[" * 100_000, "no JSON"),
        (json.dumps(RESULT | {"alignment": None}), "not a run's results"),
    ],
)
def test_a_damaged_file_is_named(tmp_path, content, message):
    path = tmp_path / "results.json"
    path.write_text(content)
    with pytest.raises(ConfigError, match=f"results.json: {message}"):
        read_records([path])


def test_nothing_to_report_is_told(tmp_path):
    with pytest.raises(ConfigError, match=r"found no results\.json below it"):
        read_records([tmp_path])
    with pytest.raises(ConfigError, match="no such file or folder"):
        read_records([tmp_path / "runs"])


def settings(**changes):
    return {"settings": {"alignment.lr": 0.001, "data.target_task": "goal_1_6"} | changes}


@pytest.mark.parametrize(
    ("one", "other", "told"),
    [
        ({"alignment.lr": 0.002}, {}, r"alignment\.lr \(0\.002 and 0\.001\)"),
        ({}, {"alignment.mmd_weight": 0.5}, r"alignment\.mmd_weight \(the default and 0\.5\)"),
        (dict.fromkeys("abcd", 1), {}, r"a \(1 and the default\), b .*, c .* and 1 more"),
        ({"trainer.precision": "bf16-mixed"}, {}, r"trainer\.precision \(bf16-mixed and the default\)"),
    ],
)
def test_runs_whose_settings_differ_are_not_averaged(one, other, told, tmp_path):
    first, second = write(tmp_path / "a", **settings(**one)), write(tmp_path / "b", seed=1, **settings(**other))
    wanted = f"{first} and {second} are runs of plp on p2p_medium, but differ in {told}; .*: report them apart"
    with pytest.raises(ConfigError, match=wanted):
        read_records([tmp_path])
    (alone,) = read_records([second])
    assert alone.settings == settings(**other)["settings"]


def test_seeds_goals_places_threads_and_what_is_looked_at_may_differ(tmp_path):
    write(tmp_path / "a", **settings())
    changes = {"data.target_task": "goal_6_6", "data.root": "/data", "threads": 2, "domains.point.simulator.threads": 4}
    changes |= {"evaluation.final_episodes": 20, "score.0.samples": 9, "trainer.accelerator": "gpu"}
    write(tmp_path / "b", target_task="goal_6_6", seed=3, **settings(**changes))
    write(tmp_path / "c", method="plp_t", **settings(**{"alignment.lr": 5.0}))  # of another method
    write(tmp_path / "d", seed=1)  # from before settings were written down
    assert [record.settings is None for record in read_records([tmp_path])] == [False, False, False, True]


def test_further_numbers_of_an_outcome_are_read(tmp_path):
    target = RESULT["target"] | {"episodes": 9, "invalid": 0, "steps_to_success": 12.5, "path_ratio": None}
    (record,) = read_records([write(tmp_path, target=target)])
    assert record.behaviour == {"steps_to_success": 12.5}


def test_older_results_of_cdil_tell_nothing_of_before_adaptation(tmp_path):
    write(tmp_path / "a", method="cdil")
    write(tmp_path / "b", method="cdil", seed=1, **settings())
    assert [record.before for record in read_records([tmp_path])] == [None, 0.1]


def test_whatever_else_lies_beside_runs_is_passed_over(tmp_path) -> None:
    for name, text in {
        "a/results.json": json.dumps(RESULT),
        "b/wandb.json": "{",
        "c.json": "\xff",
        "d.json": "3",
    }.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes(text.encode("latin-1"))
    (tmp_path / "folder.json").mkdir()
    assert len(read_records([tmp_path])) == 1


def test_results_that_a_run_did_not_write_are_refused(tmp_path) -> None:
    (tmp_path / "results.json").write_text(json.dumps(RESULT))
    (tmp_path / "status.json").write_text(json.dumps({"results_sha256": "0" * 64}))
    with pytest.raises(ConfigError, match="has changed since the run wrote it"):
        read_records([tmp_path])


@pytest.mark.parametrize(
    ("status", "told"),
    [
        ([], r"all of it is \[\]; expected what plp fit writes"),
        ({"state": 3}, "state is 3; expected what plp fit writes"),
        ({"state": "done", "config_sha256": "", "plan_sha256": ""}, "results_sha256 is missing; expected the hash"),
    ],
)
def test_results_beside_a_damaged_status_are_refused(tmp_path, status, told) -> None:
    (tmp_path / "results.json").write_text(json.dumps(RESULT))
    (tmp_path / "status.json").write_text(json.dumps(status))
    with pytest.raises(ConfigError, match=f"status.json: {told}"):
        read_records([tmp_path])


def test_runs_that_simulated_nothing_are_read(tmp_path) -> None:
    unsimulated = {key: value for key, value in RESULT.items() if key not in ("target", "proxy")}
    (tmp_path / "results.json").write_text(json.dumps(unsimulated | {"held_out": {"flat": 0.25, "tall": 0.5}}))
    (record,) = read_records([tmp_path])
    assert (record.success, record.low, record.high, record.before, record.proxy) == (None,) * 5
    assert (record.held_out, record.alignment) == ({"flat": 0.25, "tall": 0.5}, {"top5": 0.8})
    (tmp_path / "results.json").write_text(json.dumps(unsimulated))
    with pytest.raises(ConfigError, match="not a run's results"):
        read_records([tmp_path])
