"""Workers, coordinators and schedulers that are killed on the way."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest

from exwarp_cli.io.files import TEMPORARY_SUFFIX, host_name
from tests.cli import shots
from tests.cli.cluster.dask_cluster import DaskCluster
from tests.cli.cluster.results import KEYS, agree
from tests.cli.shots import FORWARD

pytestmark = pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")


class TestLosses:
    def test_a_worker_that_is_killed_on_the_way(self, upsample, keys, tmp_path, monkeypatch):
        one, other = tmp_path / "one", tmp_path / "other"
        beside = [(root / "a.mp4", root / "report") for root in (one, other)]
        how = ("-m", "softsplat", *FORWARD)
        upsample(keys, one / "frames", *how, "--video", beside[0][0], "--report", beside[0][1])
        more = ("--video", beside[1][0], "--report", beside[1][1], "--chunk-size", 3)
        scratch = tmp_path / "scratch"
        scratch.mkdir()
        monkeypatch.setenv("TMPDIR", str(scratch))
        with start(keys, other / "frames", *how, *more, "--workers", 2) as process:
            await_frames(process, other / "frames", 2)
            victim = worker_processes(process)[0]
            victim.kill()
            out, err = process.communicate(timeout=120)
        assert process.returncode == 0, err
        assert "was lost; frames" in err and "are done again" in err
        assert f"{4 * KEYS} frames in" in out
        assert [line for line in err.splitlines() if not line.startswith("exwarp: ")] == []
        assert not [name for name in shots.names(scratch) if "exwarp" in name or "dask" in name]
        agree(one, other)

    @pytest.mark.parametrize(
        "stop",
        [
            signal.SIGINT,
            pytest.param(signal.SIGTERM, marks=pytest.mark.slow),
            pytest.param(signal.SIGKILL, marks=pytest.mark.slow),
        ],
    )
    def test_ending_leaves_no_worker(self, exwarp, keys, tmp_path, stop):
        out = tmp_path / "out"
        how = ("-m", "s6", *FORWARD)
        with start(keys, out, *how, "--workers", 2, "--chunk-size", 1) as process:
            await_frames(process, out, 2)
            family = worker_processes(process)
            os.killpg(process.pid, stop) if stop == signal.SIGINT else process.send_signal(stop)
            _, err = process.communicate(timeout=60)
        expected = {signal.SIGINT: 130, signal.SIGTERM: 143, signal.SIGKILL: -signal.SIGKILL}
        assert process.returncode == expected[stop], err
        assert psutil.wait_procs(family, timeout=10)[1] == []
        if stop != signal.SIGKILL:
            assert "--skip-existing goes on" in err and "Traceback" not in err
            assert not [name for name in shots.names(out) if TEMPORARY_SUFFIX in name]
        assert exwarp("upsample", keys, "-o", out, *how, "--skip-existing").code == 0
        assert exwarp("upsample", keys, "-o", tmp_path / "whole", *how).code == 0
        assert shots.contents(out) == shots.contents(tmp_path / "whole")

    @pytest.mark.slow
    def test_what_a_hung_worker_leaves_is_removed(self, keys, tmp_path):
        out = tmp_path / "out"
        with start(keys, out, "-m", "s6", *FORWARD, "--workers", 1) as process:
            await_frames(process, out, 1)
            (worker,) = worker_processes(process)
            worker.suspend()
            begun = out / f".shot.0009.exr.{host_name()}-{worker.pid}-99{TEMPORARY_SUFFIX}"
            begun.touch()
            process.send_signal(signal.SIGINT)
            _, err = process.communicate(timeout=60)
        assert process.returncode == 130, err
        assert not worker.is_running() and not begun.exists()

    @pytest.mark.slow
    def test_a_scheduler_that_is_killed(self, keys, tmp_path):
        out = tmp_path / "out"
        how = ("-m", "softsplat", *FORWARD)
        with DaskCluster(tmp_path / "dask") as cluster:
            cluster.start_worker()
            options = (*how, "--cluster", cluster.address, "--chunk-size", 2)
            with start(keys, out, *options) as process:
                await_frames(process, out, 1)
                cluster.kill_scheduler()
                _, err = process.communicate(timeout=120)
        assert [line for line in err.splitlines() if not line.startswith("exwarp: ")] == []
        assert process.returncode == 9 and "the Dask scheduler went away" in err


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


def await_frames(process: subprocess.Popen[str], folder: Path, count: int) -> None:
    """Wait until so many frames are there, while more are to come."""
    deadline = time.monotonic() + 120
    while sum(name.endswith(".exr") for name in shots.names(folder)) < count:
        assert process.poll() is None and time.monotonic() < deadline
        time.sleep(0.002)


def worker_processes(process: subprocess.Popen[str]) -> list[psutil.Process]:
    """Return the processes that do the work."""
    family = psutil.Process(process.pid).children(recursive=True)
    return [one for one in family if "spawn_main" in " ".join(one.cmdline())]
