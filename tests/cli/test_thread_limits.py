"""A low limit of threads or processes, as by ``ulimit -u`` and in containers."""

from __future__ import annotations

import errno
import os
import subprocess
import sys
import threading

import pytest

from exwarp_cli.errors import OutOfMemoryError
from exwarp_cli.io.exr import reader

SENTENCE = "exwarp: error: the system lets this user start no more threads or processes; raise the"


@pytest.fixture
def no_threads(monkeypatch):
    """Let no thread start."""

    def refuse(thread: threading.Thread) -> None:
        raise RuntimeError("can't start new thread")

    monkeypatch.setattr(threading.Thread, "start", refuse)


@pytest.mark.parametrize("progress", ["plain", "json"])
def test_no_more_threads_are_no_defect(exwarp, plain_shot, tmp_path, no_threads, progress):
    run = ("upsample", plain_shot, "-o", tmp_path / "out", "-m", "s6", "--motion", "forward")
    result = exwarp(*run, "--progress", progress)
    assert result.code == 11
    assert result.err.splitlines()[-1].startswith(SENTENCE)
    if progress == "json":
        assert '"event": "fail"' in result.err and '"exit_code": 11' in result.err


def test_no_more_processes_are_no_defect(plain_shot):
    script = (
        "import errno, os, sys\n"
        "def refuse():\n"
        "    raise BlockingIOError(errno.EAGAIN, os.strerror(errno.EAGAIN))\n"
        "os.fork = refuse\n"
        "from exwarp_cli.cli import main\n"
        "main()\n"
    )
    found = subprocess.run(
        [sys.executable, "-c", script, "inspect", str(plain_shot)],
        capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip
    assert found.returncode == 11
    assert found.stderr.startswith(SENTENCE) and found.stderr.count("\n") == 1


def test_a_file_that_a_limit_keeps_closed_is_not_damaged(plain_shot, monkeypatch):
    """Libraries in C++ start threads as they open a file, and use the words of the system."""

    def refuse(path: str) -> None:
        raise RuntimeError(os.strerror(errno.EAGAIN))

    monkeypatch.setattr(reader.oiio.ImageInput, "open", staticmethod(refuse))
    with pytest.raises(OutOfMemoryError):
        reader.ExrFile(next(plain_shot.iterdir()), by_openimageio=True)
