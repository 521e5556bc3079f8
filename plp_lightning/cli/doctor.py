"""``plp doctor``: packages, renderers, GPUs and cores of this machine, and advice on what is missing.

It is there for broken machines, so a part that can't be looked at is a row that says why.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Sequence
from typing import Any, get_args

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from datamodules.errors import UserError
from plp_lightning.cli.options import OptionParser
from plp_lightning.envs.cores import available_cores
from plp_lightning.envs.rendering.backend import Backend
from plp_lightning.envs.rendering.speed import frames_per_second
from plp_lightning.runs.gpus import gpus
from plp_lightning.runs.versions import PACKAGES, versions

THREADS = ("OMP_NUM_THREADS", "LP_NUM_THREADS")  # Variables that say how many threads a library starts in each process


def run_doctor(arguments: Sequence[str]) -> None:
    """``plp doctor``: packages, renderers with frames per second, GPUs, cores."""
    parser = OptionParser("plp doctor", description="What works on this machine, and what to install for the rest.")
    parser.add_argument("--json", action="store_true", help="print JSON instead of tables")
    options = parser.parse_args(list(arguments))
    findings = _findings()
    if options.json:
        print(json.dumps(findings, indent=2))
    else:
        _show(findings)


def _findings() -> dict[str, Any]:
    packages = _tried(versions)
    renderers = {backend: _speed(backend) for backend in get_args(Backend)}
    lacking = [name for name in PACKAGES if name not in packages]
    advice = [f"{', '.join(lacking)}: not installed; run pip install -e '.[sim]'"] if lacking else []
    if not any("frames_per_second" in found for found in renderers.values()):
        advice += [found["error"] for found in renderers.values()]
    graphics = _tried(gpus)
    if "error" in graphics:
        advice.append(graphics["error"])
    elif graphics["reason"]:
        names = ", ".join(gpu["name"] for gpu in graphics["present"])
        remedy = "for torch with CUDA run PLP_TORCH=gpu script/setup; a container needs docker run --gpus all"
        advice.append(f"{names}: torch cannot use it: {graphics['reason']}; {remedy}")
    return {
        "packages": packages,
        "missing": lacking,
        "renderers": renderers,
        "gpus": graphics,
        "cores": {"available": available_cores(), "machine": os.cpu_count()},
        "threads": {name: os.environ.get(name) for name in THREADS},
        "advice": advice,
    }


def _speed(backend: Backend) -> dict[str, Any]:
    return _tried(lambda: {"frames_per_second": round(frames_per_second(backend))})


def _tried(probe: Callable[[], dict[str, Any]]) -> dict[str, Any]:
    """Findings of a probe, or the error that it raises."""
    try:
        return probe()
    except UserError as error:
        return {"error": str(error)}
    except Exception as error:
        return {"error": f"{type(error).__name__}: {' '.join(str(error).split())[:200]}"}


def _told(graphics: dict[str, Any]) -> str:
    usable = [f"{gpu['name']}, {gpu['memory_gib']} GiB" for gpu in graphics.get("usable", [])]
    built = f"torch has CUDA {graphics['cuda']}" if graphics.get("cuda") else "torch has no CUDA"
    return f"{'; '.join(usable) or 'none'} ({graphics.get('error') or graphics['reason'] or built})"


def _show(findings: dict[str, Any]) -> None:
    console = Console(soft_wrap=True)
    packages, renderers = Table("package", "version"), Table("renderer", "64 × 64 images")
    for name, version in findings["packages"].items():
        packages.add_row(name, escape(str(version)))
    for name in findings["missing"]:
        packages.add_row(name, "[red]missing[/]")
    for name, found in findings["renderers"].items():
        works = "frames_per_second" in found
        renderers.add_row(name, f"{found['frames_per_second']} frames/s a thread" if works else escape(found["error"]))
    console.print(packages, renderers)
    console.print(escape(f"GPUs: {_told(findings['gpus'])}"), highlight=False)
    cores = findings["cores"]
    console.print(f"cores: {cores['available']} for this process, {cores['machine']} in the machine", highlight=False)
    for name, value in findings["threads"].items():
        console.print(f"{name}: {value or 'not set'}", highlight=False)
    for line in findings["advice"] or ["all is well"]:
        console.print(escape(line), highlight=False, style="bold")
