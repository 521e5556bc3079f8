"""A command loads what it needs: packages that take seconds or hundreds of MB stay away from those without a use."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
SIMULATORS = {"robosuite", "metaworld", "gymnasium", "gymnasium_robotics", "cv2"}
PHYSICS = {"mujoco", "numba", "llvmlite"}
LATER = {"sklearn", "av", "onnx", "onnxruntime", "pyarrow", "pandas", "imageio"}
LEARNING = {"torch", "lightning", "torchmetrics"}
DRAWING = {"matplotlib", "scipy"}


def loaded(*words: str) -> set[str]:
    """Packages that are loaded once ``plp`` has answered."""
    run = "import sys\nfrom plp_lightning.cli.main import main\ntry: main(sys.argv[1:])\nexcept SystemExit: pass\n"
    tell = "print('\\nLOADED', *{name.split('.')[0] for name in sys.modules})"
    done = subprocess.run(
        [sys.executable, "-c", run + tell, *words], cwd=ROOT, capture_output=True, text=True, check=True
    )
    told = done.stdout.splitlines()[-1].split()
    assert told[0] == "LOADED"
    return {*told}


@pytest.mark.parametrize("word", ["--version", "--help"])
def test_words_about_itself_load_nothing(word: str) -> None:
    assert not loaded(word) & {"numpy", "yaml", *SIMULATORS, *PHYSICS, *LATER, *LEARNING, *DRAWING}


@pytest.mark.parametrize("verb", ["report", "data"])
def test_help_of_light_verbs_loads_no_learning_and_no_physics(verb: str) -> None:
    assert not loaded(verb, "--help") & {*SIMULATORS, *PHYSICS, *LATER, *LEARNING}


def test_all_help_of_fit_loads_no_physics() -> None:
    found = loaded("fit", "--help", "all")
    assert "torch" in found
    assert not found & {*SIMULATORS, *PHYSICS, *LATER}


@pytest.mark.parametrize("page", ["r2r", "v2v_reach"])
def test_reading_a_page_loads_no_package_of_robots(page: str) -> None:
    found = loaded("fit", "--config", f"configs/{page}.yaml", "--print_config")
    assert "torch" in found
    assert not found & {*SIMULATORS, *LATER}
