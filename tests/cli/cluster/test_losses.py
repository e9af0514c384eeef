"""Workers, coordinators and schedulers that are killed on the way."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import psutil
import pytest

from exwarp_cli.io.files import TEMPORARY_SUFFIX, host_name
from tests.cli import shots
from tests.cli.cluster.dask_cluster import DaskCluster
from tests.cli.cluster.results import agree
from tests.cli.conftest import run_quietly
from tests.cli.shots import FORWARD, SMALL

pytestmark = pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")


KEYS = 6
"""Key frames: so many that most frames are still to come when the first are there."""

HOW = ("-m", "s6", *FORWARD)


@pytest.fixture(scope="module")
def keys(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("long") / "keys"
    return shots.sequence(folder, shots.plain, range(1, KEYS + 1), SMALL)


@pytest.fixture(scope="module")
def whole(tmp_path_factory, keys) -> Path:
    """What one process makes: frames, a video and a report; read only."""
    root = tmp_path_factory.mktemp("whole")
    beside = ("--video", root / "a.mp4", "--report", root / "report")
    run_quietly("upsample", keys, "-o", root / "frames", *HOW, *beside)
    return root


class TestLosses:
    def test_a_worker_that_is_killed_on_the_way(self, keys, whole, tmp_path, monkeypatch):
        other, scratch = tmp_path / "other", tmp_path / "scratch"
        beside = ("--video", other / "a.mp4", "--report", other / "report", "--chunk-size", 3)
        scratch.mkdir()
        monkeypatch.setenv("TMPDIR", str(scratch))
        with start(keys, other / "frames", *HOW, *beside, "--workers", 2) as process:
            await_frames(other / "frames", 2, process)
            victim = worker_processes(process)[0]
            victim.kill()
            out, err = process.communicate(timeout=120)
        assert process.returncode == 0, err
        assert "was lost; frames" in err and "are done again" in err
        assert f"{4 * KEYS} frames in" in out
        assert [line for line in err.splitlines() if not line.startswith("exwarp: ")] == []
        assert not [name for name in shots.names(scratch) if "exwarp" in name or "dask" in name]
        agree(whole, other)

    @pytest.mark.parametrize(
        ("stop", "workers"),
        [
            (signal.SIGINT, 2),
            (signal.SIGTERM, 1),
            (signal.SIGKILL, 1),
        ],
    )
    def test_ending_leaves_no_worker(self, exwarp, keys, whole, tmp_path, stop, workers):
        """Interrupted, not even a worker that hangs, or what it had begun."""
        out = tmp_path / "out"
        with start(keys, out, *HOW, "--workers", workers, "--chunk-size", 1) as process:
            await_frames(out, 2, process)
            family = worker_processes(process)
            if stop == signal.SIGINT:
                family[0].suspend()
                hung = f"{host_name()}-{family[0].pid}-99"
                (out / f".shot.0009.exr.{hung}{TEMPORARY_SUFFIX}").touch()
                os.killpg(process.pid, stop)
            else:
                process.send_signal(stop)
            _, err = process.communicate(timeout=60)
        expected = {signal.SIGINT: 130, signal.SIGTERM: 143, signal.SIGKILL: -signal.SIGKILL}
        assert process.returncode == expected[stop], err
        assert len(family) == workers and psutil.wait_procs(family, timeout=10)[1] == []
        if stop != signal.SIGKILL:
            assert "--skip-existing goes on" in err and "Traceback" not in err
            assert not [name for name in shots.names(out) if TEMPORARY_SUFFIX in name]
        assert exwarp("upsample", keys, "-o", out, *HOW, "--skip-existing").code == 0
        assert shots.contents(out) == shots.contents(whole / "frames")

    def test_a_scheduler_that_is_killed(self, exwarp, keys, tmp_path):
        out = tmp_path / "out"
        with DaskCluster(tmp_path / "dask") as cluster, ThreadPoolExecutor() as beside:
            cluster.start_worker()
            killed = beside.submit(lambda: (await_frames(out, 1), cluster.kill_scheduler()))
            options = (*HOW, "--progress", "none", "--cluster", cluster.address)
            done = exwarp("upsample", keys, "-o", out, *options, "--chunk-size", 2)
            killed.result()
        done.refused(9, "the Dask scheduler went away")


def start(keys: Path, out: Path, *options: object) -> subprocess.Popen[str]:
    """Start the command in a session of its own, as a terminal would."""
    command = [sys.executable, "-m", "exwarp_cli", "upsample", keys, "-o", out, *options]
    return subprocess.Popen(
        [str(word) for word in command],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )


def await_frames(folder: Path, count: int, process: subprocess.Popen[str] | None = None) -> None:
    """Wait until so many frames are there, while more are to come."""
    deadline = time.monotonic() + 120
    while sum(name.endswith(".exr") for name in shots.names(folder)) < count:
        assert process is None or process.poll() is None
        assert time.monotonic() < deadline
        time.sleep(0.002)


def worker_processes(process: subprocess.Popen[str]) -> list[psutil.Process]:
    """Return the processes that do the work."""
    family = psutil.Process(process.pid).children(recursive=True)
    return [one for one in family if "spawn_main" in " ".join(one.cmdline())]
