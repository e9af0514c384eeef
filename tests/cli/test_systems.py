"""Runs where the system lacks what only Linux, or only POSIX, has: the same bytes come out.

Stands in for Windows and macOS, on which nothing was tested: the functions that Python does not
have there are taken away before ExWarp is imported.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from tests.cli.conftest import run_quietly
from tests.cli.shots import contents
from tests.matrix import spread

ROOT = Path(__file__).resolve().parents[2]

# What Python's documentation gives as absent, of what ExWarp would use.
NOT_ON_MACOS = (
    "os.sched_getaffinity", "os.posix_fadvise", "os.posix_fallocate",
)  # fmt: skip
NOT_ON_WINDOWS = (
    *NOT_ON_MACOS, "os.fork", "os.getuid", "os.geteuid", "os.preadv", "os.pread", "os.sysconf",
    "os.sysconf_names", "os.register_at_fork", "os.O_NONBLOCK", "os.waitid", "os.killpg",
    "os.getpgid", "os.setsid", "signal.pthread_sigmask", "signal.SIGHUP", "signal.SIGKILL",
    "mmap.MADV_DONTNEED", "resource", "fcntl", "pwd",
)  # fmt: skip
SYSTEMS = {"macos": NOT_ON_MACOS, "windows": NOT_ON_WINDOWS}

# Python runs it before all else, in the processes of a command as well.
WITHOUT = """
import importlib, sys
for name in {names!r}:
    module, _, attribute = name.partition(".")
    if not attribute:
        sys.modules[module] = None  # importing it fails
    elif hasattr(importlib.import_module(module), attribute):
        delattr(importlib.import_module(module), attribute)
"""


def run(system: str, *line: object) -> subprocess.CompletedProcess[str]:
    """Run a command line in a process of its own that lacks what a system lacks."""
    with tempfile.TemporaryDirectory() as folder:
        Path(folder, "sitecustomize.py").write_text(WITHOUT.format(names=SYSTEMS[system]))
        environment = os.environ | {"PYTHONPATH": os.pathsep.join((folder, str(ROOT)))}
        command = [sys.executable, "-m", "exwarp_cli", *map(str, line)]
        return subprocess.run(command, env=environment, capture_output=True, text=True, check=False)


@pytest.fixture(scope="module")
def on_linux(plain_shot, plain_truth, tmp_path_factory) -> dict[str, bytes]:
    """What `upsample` writes with all that Linux has, in this process."""
    out = tmp_path_factory.mktemp("linux")
    run_quietly(*line(plain_shot, plain_truth, out))
    return written(out)


def line(keys: Path, truth: Path, out: Path) -> tuple[object, ...]:
    """Return a command line that writes frames and a video into a folder."""
    rest = ("--ground-truth", truth, "--video", out / "shot.mp4", "--keep-bytes", "--verify")
    return ("upsample", keys, "-o", out / "frames", *rest)


def upsampled(system: str, keys: Path, truth: Path, out: Path) -> dict[str, bytes]:
    """Return the frames that a run writes, and check that it says nothing but what it should."""
    result = run(system, *line(keys, truth, out), "--progress", "none")
    assert result.returncode == 0, result.stderr
    assert "Traceback" not in result.stderr
    return written(out)


def written(out: Path) -> dict[str, bytes]:
    """Return the frames of a folder, beside which there must be a video."""
    assert (out / "shot.mp4").stat().st_size > 0
    frames = contents(out / "frames")
    return {name: data for name, data in frames.items() if name.endswith(".exr")}


@pytest.mark.parametrize("system", ["macos", "windows"])
def test_frames_are_those_of_linux(system, on_linux, plain_shot, plain_truth, tmp_path):
    assert upsampled(system, plain_shot, plain_truth, tmp_path) == on_linux


@pytest.mark.parametrize("system", spread(["windows", "macos"], 1))
def test_a_video_is_read(system, plain_shot, upsample, tmp_path):
    video = tmp_path / "shot.mp4"
    upsample(plain_shot, tmp_path / "frames", "-m", "hold", "--video", video)
    line = ("upsample", video, "-o", tmp_path / "out", "-m", "hold", "--progress", "none")
    result = run(system, *line)
    assert result.returncode == 0, result.stderr


@pytest.mark.parametrize("system", spread(["windows", "macos"], 1))
def test_a_folder_in_use_is_left_alone_and_a_run_goes_on(system, plain_shot, upsample, tmp_path):
    upsample(plain_shot, tmp_path / "out", "--frames", "1-2")
    line = ("upsample", plain_shot, "-o", tmp_path / "out", "--progress", "none")
    refused = run(system, *line)
    assert refused.returncode == 6 and "already" in refused.stderr
    kept = run(system, *line, "--skip-existing")
    assert kept.returncode == 0 and "kept of an earlier run" in kept.stdout + kept.stderr


@pytest.mark.parametrize("system", spread(["windows", "macos"], 1))
def test_processes_share_the_work(system, plain_shot, plain_truth, tmp_path):
    line = ("bench", plain_shot, "--ground-truth", plain_truth, "-o", tmp_path / "bench")
    few = ("--systems", "hold", "--metrics", "psnr", "--jobs", 2, "--progress", "none")
    result = run(system, *line, *few)
    assert result.returncode == 0, result.stderr
    assert (tmp_path / "bench" / "bench.json").is_file()


@pytest.mark.parametrize("system", ["macos", "windows"])
def test_bad_input_is_still_one_sentence(system, tmp_path):
    result = run(system, "upsample", tmp_path / "nothing.####.exr", "-o", tmp_path / "out")
    assert result.returncode == 3
    (line,) = result.stderr.splitlines()
    assert line.startswith("exwarp: error: ")


@pytest.mark.parametrize("system", spread(["windows", "macos"], 1))
def test_the_doctor_finds_nothing_wrong(system):
    result = run(system, "doctor")
    assert result.returncode == 0, result.stdout + result.stderr
