"""What surrounds a run - its reader, its scheduler, its notebook - does not change what it does."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from command import ROOT, data_root, finished_smoke, smoke_run, tiny_smoke

SCHEDULER = {
    **{
        "SLURM_PROCID": "1",
        "SLURM_NTASKS": "9",
        "SLURM_JOB_ID": "7",
        "SLURM_JOB_NAME": "x",
        "SLURM_NODELIST": "n[1-2]",
    },
    **{"SLURM_LOCALID": "1", "SLURM_NODEID": "1", "SLURM_NTASKS_PER_NODE": "3", "RANK": "3", "LOCAL_RANK": "1"},
    **{"WORLD_SIZE": "9", "MASTER_ADDR": "nowhere", "MASTER_PORT": "x", "TORCHELASTIC_RUN_ID": "1", "GROUP_RANK": "1"},
    **{"NODE_RANK": "2", "JSM_NAMESPACE_RANK": "1", "LSB_JOBID": "1", "LSB_DJOB_RANKFILE": "/nowhere"},
    "MPLBACKEND": "module://matplotlib_inline.backend_inline",
}


def shell(command: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """A line of a shell in which ``plp`` is the command."""
    plp = f'plp() {{ "{sys.executable}" -m plp_lightning "$@"; }}; '
    variables = os.environ | {"PYTHONPATH": str(ROOT)} | environment
    return subprocess.run(["bash", "-c", plp + command], env=variables, capture_output=True, text=True, check=False)


@pytest.mark.parametrize(
    ("command", "code", "told"),
    [
        ("plp --help | true; exit ${PIPESTATUS[0]}", 0, ""),
        ("plp --help | head -1; exit ${PIPESTATUS[0]}", 0, ""),
        ("plp --help >&-", 0, ""),
        ("plp fit --nonsense 2>&-", 2, ""),
        ("plp --help >/dev/full", 2, "plp: standard output: No space left on device; "),
        ("plp data inspect $FILE >/dev/full", 2, "plp: standard output: No space left on device; "),
        ("plp data inspect $FILE | true; exit ${PIPESTATUS[0]}", 0, ""),
        ("LC_ALL=C PYTHONIOENCODING=ascii plp data inspect $FILE >/dev/null", 0, ""),
    ],
)
def test_output_that_nobody_takes_is_no_traceback(command: str, code: int, told: str) -> None:
    done = shell(command, FILE=str(data_root() / "smoke.hdf5"))
    assert done.returncode == code, done
    assert done.stderr.startswith(told)
    assert done.stderr.count("\n") == (1 if told else 0)


@pytest.mark.parametrize(
    "command",
    [
        "plp export $RUN --to safetensors",
        "plp report $RUN --out=$OUT",
        "plp data export robomimic $FILE --domain flat --out $OUT/x.hdf5",
    ],
)
def test_what_is_in_a_file_is_not_lost_with_the_screen(command: str, tmp_path: Path) -> None:
    run, out = finished_smoke(tmp_path).path, tmp_path / "out"
    done = shell(f"{command} >/dev/full", FILE=str(data_root() / "smoke.hdf5"), RUN=str(run), OUT=str(out))
    assert (done.returncode, done.stderr.count("\n")) == (0, 1), done
    assert done.stderr.startswith("plp: standard output: No space left on device; ")
    assert out.exists() or (run / "policy.safetensors").exists()


def test_a_run_in_a_schedulers_task_ends_though_nobody_reads(tmp_path: Path) -> None:
    words = " ".join(f"'{word}'" for word in tiny_smoke(tmp_path))
    done = shell(
        f"plp fit {words} --alignment.epochs 1 --adaptation.epochs 1 | true; exit ${{PIPESTATUS[0]}}", **SCHEDULER
    )
    assert done.returncode == 0, done
    run = smoke_run(tmp_path)
    assert run.status()["state"] == "done"
    assert run.results.exists()
    for phase in ("alignment", "adaptation"):
        assert (run.phase(phase) / "metrics.csv").exists()
        assert [*run.phase(phase).glob("events*")]
