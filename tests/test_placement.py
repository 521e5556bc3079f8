"""What launchers tell a process of its place among others."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from datamodules.errors import ConfigError
from plp_lightning.placement import Place, is_first, place, stand_alone, take_place

TORCHRUN = {"RANK": "1", "LOCAL_RANK": "1", "WORLD_SIZE": "2", "LOCAL_WORLD_SIZE": "2", "MASTER_ADDR": "localhost"}
TORCHRUN |= {"MASTER_PORT": "29500", "TORCHELASTIC_USE_AGENT_STORE": "True"}
SRUN = {"SLURM_PROCID": "1", "SLURM_LOCALID": "1", "SLURM_STEP_NUM_TASKS": "2", "SLURM_JOB_ID": "20007"}


@pytest.fixture(autouse=True)
def alone() -> Iterator[None]:
    yield
    stand_alone()


@pytest.mark.parametrize(
    ("variables", "expected"),
    [
        ({}, None),
        (TORCHRUN, Place(1, 2, "localhost", 29500, True)),
        (SRUN, Place(1, 2, "127.0.0.1", 20007, False)),
        (SRUN | {"MASTER_PORT": "7"}, Place(1, 2, "127.0.0.1", 7, False)),
        (SRUN | TORCHRUN, Place(1, 2, "localhost", 29500, True)),
        (SRUN | {"SLURM_STEP_NUM_TASKS": "1"}, None),  # a task of its own
        ({"SLURM_PROCID": "0", "SLURM_NTASKS": "2"}, None),  # a batch script, which srun did not start
        (TORCHRUN | {"WORLD_SIZE": "1"}, None),
    ],
)
def test_launchers_are_understood(variables: dict[str, str], expected: Place | None) -> None:
    take_place(variables.copy())
    assert place() == expected
    assert is_first() == (variables.get("RANK", variables.get("SLURM_PROCID", "0")) == "0")


@pytest.mark.parametrize(
    "variables",
    [TORCHRUN | {"LOCAL_WORLD_SIZE": "1"}, SRUN | {"SLURM_STEP_NUM_NODES": "2"}, TORCHRUN | {"MASTER_PORT": "x"}],
)
def test_what_no_run_can_be_is_refused(variables: dict[str, str]) -> None:
    take_place(variables.copy())
    with pytest.raises(ConfigError, match="expected"):
        place()


def test_numbers_are_taken_out_of_the_environment_and_forgotten() -> None:
    variables = TORCHRUN | SRUN | {"HOME": "here"}
    take_place(variables)
    assert not {"RANK", "LOCAL_RANK", "WORLD_SIZE", "SLURM_PROCID", "SLURM_LOCALID"} & variables.keys()
    assert variables["HOME"] == "here"
    stand_alone()
    assert place() is None
    assert is_first()
