"""The scenes' scripts, run by a Python that has Blender's module."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
SCRIPTS = ROOT / "examples" / "scenes"

Script = Callable[..., subprocess.CompletedProcess[str]]


@pytest.fixture(scope="session")
def blender() -> str:
    """Path of the Python; the tests are skipped where there is none."""
    python = os.environ.get("EXWARP_BLENDER") or str(ROOT / ".blender" / "bin" / "python")
    try:
        subprocess.run([python, "-c", "import bpy, OpenEXR"], check=True, capture_output=True)
    except (OSError, subprocess.CalledProcessError):
        pytest.skip(
            f"{python} has no Blender module; 'make blender' makes it, or EXWARP_BLENDER names "
            "another Python"
        )
    return python


@pytest.fixture(scope="session")
def script(blender) -> Script:
    """Run a scene's script by its name, or any by its path; both go without the suffix."""

    def run(name: str | Path, *options: object) -> subprocess.CompletedProcess[str]:
        command = [blender, str(SCRIPTS / f"{name}.py"), *map(str, options)]
        return subprocess.run(command, capture_output=True, text=True, timeout=600, check=False)

    return run
