"""Settings that cannot be are one line and exit code 2, before anything is written."""

from __future__ import annotations

from pathlib import Path

import pytest
from command import complaint, tiny_smoke

IMPOSSIBLE = [
    ("--policy.encoder_state", "null", "PortablePolicy.encoder_state is null; expected a value"),
    ("--policy.decoder_state", "null", "PortablePolicy.decoder_state is null; expected a value"),
    ("--seed", "4294967296", "seed is 4294967296; expected a whole number from 0 to 4294967295"),
    ("--seed", "99999999999999999999", "expected a whole number from 0 to 4294967295"),
    ("--seed", "-1", "expected a whole number from 0 to 4294967295"),
    ("--threads", "100000", "threads is 100000; expected a whole number from 1 to 1024"),
    ("--threads", "0", "threads is 0; expected a whole number from 1 to 1024"),
    ("--phases", "[alignment, alignment]", "phases names 'alignment' twice; expected each phase once"),
    ("--trainer.log_every_n_steps", "0", "trainer.log_every_n_steps is 0; expected a whole number, at least 1"),
    ("--trainer.accumulate_grad_batches", "0", "trainer.accumulate_grad_batches is 0; expected"),
    ("--trainer.check_val_every_n_epoch", "0", "trainer.check_val_every_n_epoch is 0; expected"),
    ("--trainer.devices", "65", "trainer.devices is 65, more than the 64 rows of a batch (data.batch_size)"),
    ("--trainer.devices", "-1", "trainer.devices is -1; expected the number of a machine's devices to use, 1 or more"),
    ("--trainer.devices", "0", "trainer.devices is 0; expected the number of"),
    ("--trainer.devices", "[0, 1]", "trainer.devices is [0, 1]; expected the number of"),
    ("--trainer.devices", "0,1", "trainer.devices is 0,1; expected the number of"),
    ("--trainer.strategy", "ddp", "trainer.strategy is ddp; expected auto: how devices work together follows from"),
    ("--trainer.num_nodes", "2", "trainer.num_nodes is 2; expected 1: a run is on one machine"),
]


@pytest.mark.parametrize(("flag", "value", "told"), IMPOSSIBLE)
def test_impossible_settings_are_named(flag: str, value: str, told: str, tmp_path: Path) -> None:
    assert told in complaint("fit", *tiny_smoke(tmp_path / "runs"), flag, value)
    assert not (tmp_path / "runs").exists()


@pytest.mark.parametrize(
    "key", ["policy.hidden", "policy.latent", "data.batch_size", "evaluation.episodes", "alignment.epochs", "seed"]
)
def test_null_is_no_number(key: str, tmp_path: Path) -> None:
    assert "expected a" in complaint("fit", *tiny_smoke(tmp_path / "runs"), f"--{key}", "null")
    assert not (tmp_path / "runs").exists()
