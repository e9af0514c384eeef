"""A command keeps to the cores that it is given, with all that works for it, ffmpeg included."""

from __future__ import annotations

import os
import statistics
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.matrix import combinations

MARKET = Path(__file__).parents[2] / "examples" / "market"

SLACK = 0.4
"""How many more threads than cores may want to run, on average: they hand over to each other. On
one core 1.0 to 1.2 were seen, and 1.7 where nothing but the machine held them back."""

CASES = {
    "s6": ("-m", "s6", "--frames", "1-2"),
    "softsplat": (
        *("-m", "softsplat", "--frames", "1-2", "--ground-truth", MARKET / "truth"),
        *("--video", "video.mp4"),
    ),
    "s3": ("-m", "s3", "--frames", "2"),
}

LARGE = """
from exwarp_cli.pipeline import scheduling
from exwarp_cli.runtime import machine
scheduling.processors = lambda: machine.Processors(64, 64, None)
from exwarp_cli import cli
cli.main()
"""
"""The command, where the machine's own cores would not bound it."""

pytestmark = pytest.mark.skipif(
    not Path("/proc/self/task").is_dir(), reason="Linux alone tells which threads want to run"
)


def _runnable(process: int) -> tuple[int, list[int]]:
    """Count the threads that run, or would if a core were free: so other work changes little.

    Returns
    -------
    count : int
    children : list of int
        Processes that it began.
    """
    count, children = 0, []
    for task in Path(f"/proc/{process}/task").iterdir():
        count += (task / "stat").read_text().rpartition(")")[2].split()[0] == "R"
        children += (task / "children").read_text().split()
    return count, [int(child) for child in children]


def _watched(options: tuple[object, ...], folder: Path, threads: int) -> tuple[float, float]:
    """Run the command; return how many of its threads want to run, and of its children's.

    On average, from the first frame on: what is imported before needs no bound.
    """
    out, own, others = folder / "out", [], []
    how = ("upsample", MARKET / "keys", "-o", out, "--progress", "none", "--threads", threads)
    command = [sys.executable, "-c", LARGE, *map(str, (*how, *options))]
    with (folder / "said").open("w+") as said:
        # In one process, so that what it begins are its helpers, and not itself.
        alone = os.environ | {"EXWARP_SUPERVISE": "0"}
        running = subprocess.Popen(command, cwd=folder, stdout=said, stderr=said, env=alone)
        while running.poll() is None:
            time.sleep(0.003)
            if not (out.is_dir() and any(out.iterdir())):
                continue
            try:
                count, children = _runnable(running.pid)
                beside = sum(_runnable(child)[0] for child in children)
            except OSError:  # a thread has just ended
                continue
            own.append(count)
            others.append(beside)
        said.seek(0)
        assert running.returncode == 0, said.read()
    return statistics.mean(own), statistics.mean(others)


@pytest.mark.parametrize(("name", "threads"), combinations(tuple(CASES), (1, 2)))
def test_no_more_threads_work_than_cores_were_given(tmp_path, name, threads):
    own, others = _watched(CASES[name], tmp_path, threads)
    assert own <= threads + SLACK
    assert others <= threads
