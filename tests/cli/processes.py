"""Commands in processes of their own."""

from __future__ import annotations

import subprocess
import time
from pathlib import Path

import pytest

from tests.cli import shots


def await_files(process: subprocess.Popen[str], folder: Path, count: int) -> None:
    """Wait until a folder has so many entries, temporaries included, or the process is done."""
    for _ in range(12000):
        if process.poll() is not None or len(shots.names(folder)) >= count:
            return
        time.sleep(0.005)
    pytest.fail(f"{folder} never had {count} files")
