"""Whatever a library does to the process that works, the command ends with its sentence."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.cli import shots
from tests.cli.processes import await_files
from tests.faults.running import PLAIN, Outcome, ended, require_whole, run, started

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="needs processes of POSIX")

INPUT, DEFECT, MEMORY = 3, 1, 11


def failing(how: str, after: int, *arguments: object, **environment: str) -> Outcome:
    words = [sys.executable, "-m", "tests.faults.crashing", how, str(after), *map(str, arguments)]
    process = subprocess.Popen(
        words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        env=os.environ | environment,
    )  # fmt: skip
    return ended(process)


class TestCrash:
    @pytest.mark.parametrize("how", ["SIGSEGV", "SIGABRT", "SIGBUS", "SIGILL", "SIGFPE"])
    def test_a_decoder_crashes(self, keys, rendered, undisturbed, tmp_path, how):
        out = tmp_path / "out"
        outcome = failing(how, 5, "upsample", keys, "-o", out, *PLAIN)
        outcome.judge(INPUT)
        assert how in outcome.told[0] and "--skip-existing" in outcome.told[0]
        assert f"{keys}/shot.000" in outcome.told[0]
        require_whole(out, rendered)
        assert shots.names(out)
        run("upsample", keys, "-o", out, *PLAIN, "--skip-existing").judge(0)
        assert shots.contents(out) == undisturbed

    def test_a_decoder_never_comes_back(self, keys, rendered, tmp_path):
        out = tmp_path / "out"
        told = ("upsample", keys, "-o", out, *PLAIN)
        outcome = failing("hang", 5, *told, EXWARP_FILE_TIMEOUT="1.5")
        outcome.judge(INPUT)
        assert "EXWARP_FILE_TIMEOUT" in outcome.told[0] and "shot.000" in outcome.told[0]
        require_whole(out, rendered)

    def test_the_system_runs_out_of_memory(self, keys, rendered, tmp_path):
        out = tmp_path / "out"
        outcome = failing("SIGKILL", 5, "upsample", keys, "-o", out, *PLAIN)
        outcome.judge(MEMORY)
        require_whole(out, rendered)

    def test_before_anything_is_written(self, keys, tmp_path):
        outcome = failing("SIGSEGV", 0, "upsample", keys, "-o", tmp_path / "out", *PLAIN)
        outcome.judge(INPUT)
        assert "shot.0001.exr" in outcome.told[0]

    @pytest.mark.parametrize("command", ["inspect", "features", "compare"])
    def test_other_commands_too(self, keys, command):
        given = {"compare": (keys, keys), "features": (keys, "--motion", "forward")}
        failing("SIGSEGV", 0, command, *given.get(command, (keys,))).judge(INPUT)

    def test_alone(self, keys, tmp_path):
        """As a debugger wants it, and as it is where processes cannot be parted."""
        told = ("upsample", keys, "-o", tmp_path / "out", *PLAIN)
        outcome = failing("SIGSEGV", 3, *told, EXWARP_SUPERVISE="0")
        assert outcome.code == -signal.SIGSEGV


def child_of(process: subprocess.Popen[str]) -> int:
    """Return the number of the process that works."""
    for _ in range(1000):
        listed = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()
        if listed:
            return int(listed[0])
        time.sleep(0.002)
    pytest.fail("there was none")


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="others do not tell")
class TestParent:
    def test_who_works_dies_with_it(self, keys, tmp_path):
        process = started("upsample", keys, "-o", tmp_path / "out", *PLAIN)
        await_files(process, tmp_path / "out", 4)
        child = child_of(process)
        process.kill()
        process.communicate()
        for _ in range(500):
            status = Path(f"/proc/{child}/stat")
            if not status.exists() or status.read_text().rpartition(")")[2].split()[0] in "ZX":
                return
            time.sleep(0.01)
        pytest.fail("it lived on")

    def test_a_defect_of_the_program_is_told_as_one(self, keys, tmp_path):
        """No file is being read while frames are waited for."""
        process = started("upsample", keys, "-o", tmp_path / "out", *PLAIN)
        os.kill(child_of(process), signal.SIGSEGV)  # while it imports
        outcome = ended(process)
        outcome.judge(DEFECT)
        assert "defect" in outcome.told[0]
