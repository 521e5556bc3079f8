"""GPUs of this machine: as the bus and NVIDIA's driver know them, and as far as torch can use them.

Nothing is imported here that may be broken: driver and torch are asked in processes of their own.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

from datamodules.errors import UserError

LIMIT = 120.0  # s that a broken driver may keep an answer waiting
VISIBLE = "CUDA_VISIBLE_DEVICES"
BUS = Path("/sys/bus/pci/devices")
NVIDIA, DISPLAY = "0x10de", "0x03"  # vendor, and how the class of display controllers begins
DRIVER = ["nvidia-smi", "--query-gpu=name,memory.total", "--format=csv,noheader,nounits"]
TORCH = """
import json, warnings, torch
with warnings.catch_warnings(record=True) as told:
    warnings.simplefilter("always")
    found = [torch.cuda.get_device_properties(i) for i in range(torch.cuda.device_count())]
    for i in range(len(found)):
        (torch.zeros(1, device=f"cuda:{i}") + 1).item()
devices = [{"name": gpu.name, "memory_gib": round(gpu.total_memory / 2**30, 1)} for gpu in found]
warned = next((str(warning.message) for warning in told), None)
print(json.dumps({"cuda": torch.version.cuda or torch.version.hip, "devices": devices, "warning": warned}))
"""


def gpus() -> dict[str, Any]:
    """Names and memory (GiB) of GPUs: ``usable`` by torch, and ``present`` in the machine; why none can be used.

    Returns:
        ``usable``, ``present``, ``cuda``, the version that torch is built for or None, and ``reason``, empty if a GPU
        can be used or there is none.

    Raises:
        UserError: If torch can't be imported or can't compute.
    """
    present, refused = _present()
    told = _asked_torch()
    built = told["warning"] if told["cuda"] else "torch is built without CUDA"
    reason = "" if told["devices"] or not present else refused or built or f"torch sees none; {VISIBLE} {_visible()}"
    return {"usable": told["devices"], "present": present, "cuda": told["cuda"], "reason": reason}


def _present() -> tuple[list[dict[str, Any]], str]:
    """GPUs by the driver's word, or by the bus if it has none; and what the driver said instead."""
    out, error = _answer(DRIVER)
    rows = [line.rpartition(",") for line in out.splitlines() if "," in line]
    listed = [{"name": name, "memory_gib": _gib(memory)} for name, _, memory in rows]
    if listed:
        return listed, ""
    nameless = [{"name": f"NVIDIA {name}", "memory_gib": None} for name in _on_the_bus()]
    return nameless, f"its driver does not answer ({error or 'it lists no GPU'})"


def _gib(mebibytes: str) -> float | None:
    number = mebibytes.strip()
    return round(int(number) / 1024, 1) if number.isdecimal() else None


def _on_the_bus() -> list[str]:
    """Display controllers of NVIDIA's by their place."""
    found = []
    for device in sorted(BUS.glob("*")):
        try:
            vendor, kind = ((device / name).read_text().strip() for name in ("vendor", "class"))
        except OSError:
            continue
        if vendor == NVIDIA and kind.startswith(DISPLAY):
            found.append(f"at {device.name}")
    return found


def _asked_torch() -> dict[str, Any]:
    """CUDA of torch, the devices that it can compute on, and what it warns of."""
    out, error = _answer([sys.executable, "-c", TORCH])
    if error:
        raise UserError(f"torch does not work ({error}); install it again: script/setup, or pip install -e .")
    told: dict[str, Any] = json.loads(out.splitlines()[-1])
    return told


def _visible() -> str:
    return f"is {os.environ[VISIBLE]!r}" if VISIBLE in os.environ else "is not set"


def _answer(command: list[str]) -> tuple[str, str]:
    """Output of a command, and the last thing it complains of if it fails."""
    try:
        done = subprocess.run(command, capture_output=True, text=True, errors="replace", timeout=LIMIT, check=False)
    except OSError as error:
        return "", f"{command[0]}: {error.strerror}"
    except subprocess.TimeoutExpired:
        return "", f"no answer within {LIMIT:.0f} s"
    told = [*(done.stderr.strip() or done.stdout.strip()).splitlines(), ""]
    return ("", told[-2] if len(told) > 1 else f"exit code {done.returncode}") if done.returncode else (done.stdout, "")
