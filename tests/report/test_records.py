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
    assert (first.seed, second.seed) == (0, 1)
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
