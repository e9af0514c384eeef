"""Whatever a library does to the process that works, the command ends with its sentence."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.cli import shots
from tests.cli.processes import await_files
from tests.faults.running import (
    CRASHING,
    PLAIN,
    Outcome,
    ended,
    require_whole,
    run,
    run_here,
    started,
)
from tests.matrix import FULL
from tests.unit.tiny_models import endless, save

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="needs processes of POSIX")

INPUT, DEFECT, MEMORY, INCOMPLETE = 3, 1, 11, 12

CRASHES = ("SIGSEGV", "SIGABRT", "SIGBUS", "SIGILL", "SIGFPE")
AGAIN = (
    ("SIGSEGV", ("--threads", "2")), ("hang", ("--overwrite",)),
    ("SIGSEGV", ("--threads", "1")), ("SIGSEGV", ("--overwrite",)),
    ("hang", ("--threads", "1")), ("hang", ("--threads", "2")),
)  # fmt: skip
"""How a decoder fails at one file time and again, and options of the command that begins again."""

GOING = (*PLAIN, "--keep-going")
BAD = "shot.0004.exr"


TWO_AT_ONCE = """
import os, sys, threading, time
from pathlib import Path
from exwarp_cli.errors import DamagedFileError
from exwarp_cli.supervisor import fork_command
from exwarp_cli.runtime.read_registry import report_reading, enable_restart

def read_well():
    with report_reading(Path("a.exr")), report_reading(Path("model.onnx"), required=True):
        begun.set()
        time.sleep(60)

end = fork_command(lambda line: print(line, flush=True))
if end is not None:
    sys.exit(end.code)
enable_restart()
for name in ("a.exr", "b.exr"):
    try:
        with report_reading(Path(name)):
            pass
    except DamagedFileError as error:
        print(error, flush=True)
        if name == "b.exr":
            sys.exit(0)
begun = threading.Event()
threading.Thread(target=read_well, daemon=True).start()
begun.wait()
with report_reading(Path("b.exr")):
    os.abort()
"""


def failing(how: str, after: object, *arguments: object, **environment: str) -> Outcome:
    return run(how, after, *arguments, module=CRASHING, environment=environment)


class TestCrash:
    @pytest.mark.parametrize("how", CRASHES if FULL else CRASHES[:1])
    def test_a_decoder_crashes(self, keys, rendered, undisturbed, tmp_path, how):
        out = tmp_path / "out"
        # So many decodes measure vectors and depth, and make the first frames.
        outcome = failing(how, 18, "upsample", keys, "-o", out, *PLAIN)
        outcome.judge(INPUT)
        assert how in outcome.error_lines[0] and "--skip-existing" in outcome.error_lines[0]
        assert f"{keys}/shot.000" in outcome.error_lines[0]
        require_whole(out, rendered)
        assert shots.names(out)
        run_here("upsample", keys, "-o", out, *PLAIN, "--skip-existing")
        assert shots.contents(out) == undisturbed

    def test_a_decoder_never_comes_back(self, keys, rendered, tmp_path):
        out = tmp_path / "out"
        command = ("upsample", keys, "-o", out, *PLAIN)
        outcome = failing("hang", 5, *command, EXWARP_FILE_TIMEOUT="1.5")
        outcome.judge(INPUT)
        assert (
            "EXWARP_FILE_TIMEOUT" in outcome.error_lines[0] and "shot.000" in outcome.error_lines[0]
        )
        require_whole(out, rendered)

    def test_the_system_runs_out_of_memory(self, keys, rendered, tmp_path):
        out = tmp_path / "out"
        outcome = failing("SIGKILL", 5, "upsample", keys, "-o", out, *PLAIN)
        outcome.judge(MEMORY)
        assert f"while it read {keys}/shot.000" in outcome.error_lines[0]
        require_whole(out, rendered)

    def test_before_anything_is_written(self, keys, tmp_path):
        command = ("--config", "none", "upsample", keys, "-o", tmp_path / "out", *PLAIN)
        outcome = failing("SIGSEGV", 0, *command)
        outcome.judge(INPUT)
        assert "shot.0001.exr" in outcome.error_lines[0]

    @pytest.mark.parametrize("command", ["compare", *(["features", "inspect"] if FULL else [])])
    def test_other_commands_too(self, keys, command):
        given = {"compare": (keys, keys), "features": (keys, "--motion", "forward")}
        failing("SIGSEGV", 0, command, *given.get(command, (keys,))).judge(INPUT)

    def test_alone(self, keys, tmp_path):
        """As a debugger wants it, and as it is where processes cannot be parted."""
        command = ("upsample", keys, "-o", tmp_path / "out", *PLAIN)
        outcome = failing("SIGSEGV", 3, *command, EXWARP_SUPERVISE="0")
        assert outcome.code == -signal.SIGSEGV


@pytest.fixture(scope="module")
def without(keys, tmp_path_factory):
    """What is written where that file cannot be read."""
    folder = tmp_path_factory.mktemp("without")
    shutil.copytree(keys, folder / "keys")
    (folder / "keys" / BAD).write_bytes(b"no image")
    run_here("upsample", folder / "keys", "-o", folder / "out", *GOING, code=INCOMPLETE)
    return shots.contents(folder / "out")


class TestKeepGoing:
    """A library fails at one file, time and again."""

    @pytest.mark.parametrize(("how", "options"), AGAIN if FULL else AGAIN[:2])
    def test_it_begins_again_without_it(self, keys, without, tmp_path, how, options):
        out, report = tmp_path / "out", tmp_path / "report"
        out.mkdir()
        if "--overwrite" in options:
            (out / "shot.0001.exr").write_bytes(b"of another user")
        else:
            options = (*options, "--report", report)
        command = ("upsample", keys, "-o", out, *GOING, *options)
        outcome = failing(how, f"{keys.name}/{BAD}", *command, EXWARP_FILE_TIMEOUT="1.5")
        assert outcome.code == INCOMPLETE, outcome.err
        assert outcome.err.count("; beginning again without it") == 1
        assert shots.contents(out) == without
        if "--report" in options:
            left = json.loads((report / "report.json").read_text())["left_out"]
            assert [one["frames"] for one in left] == [[13, 14, 15, 16]]
            assert BAD in left[0]["reason"] and "render or copy it again" in left[0]["reason"]

    def test_without_a_file_to_blame(self, keys, rendered, tmp_path):
        """It fails at whatever comes after some time, and so at more and more files."""
        out = tmp_path / "out"
        outcome = failing("SIGSEGV", 5, "upsample", keys, "-o", out, *GOING)
        outcome.judge(INPUT, INCOMPLETE)
        require_whole(out, rendered)

    def test_it_begins_again_without_all_files_that_were_being_read(self):
        """But with a model, without which there is nothing to go on with."""
        process = subprocess.Popen(
            [sys.executable, "-c", TWO_AT_ONCE], stdout=subprocess.PIPE, stderr=subprocess.PIPE,
            text=True,
        )  # fmt: skip
        outcome = ended(process)
        assert outcome.code == 0, outcome.err
        line, *refused = outcome.out.splitlines()
        why = "a library crashed (SIGABRT) while it read a.exr or model.onnx or b.exr"
        assert line == f"{why}; beginning again without them"
        assert refused == 2 * [f"{why}; render or copy it again"]

    def test_who_is_interrupted_does_not_begin_again(self, keys, tmp_path):
        words = ("upsample", keys, "-o", tmp_path / "out", *GOING)
        process = started(*words)
        await_files(process, tmp_path / "out", 4)
        process.send_signal(signal.SIGINT)
        outcome = ended(process)
        assert outcome.code in (130, 0) and "again" not in outcome.err.replace("run again", "")


def child_of(process: subprocess.Popen[str]) -> int:
    """Return the number of the process that works."""
    for _ in range(1000):
        listed = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()
        if listed:
            return int(listed[0])
        time.sleep(0.002)
    pytest.fail("there was none")


class TestModel:
    def test_one_that_never_comes_to_an_end_is_named(self, keys, tmp_path):
        """And nothing of it is written."""
        path = save(tmp_path / "endless.onnx", endless())
        command = (
            "upsample",
            keys,
            "-o",
            tmp_path / "out",
            *PLAIN,
            "-m",
            "s3",
            "--extrapolator",
            path,
        )
        outcome = run(*command, environment={"EXWARP_FILE_TIMEOUT": "1.5"})
        outcome.judge(INPUT)
        assert f"reading {path} took longer" in outcome.error_lines[0]
        assert not (tmp_path / "out").exists()


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

    def test_a_defect_of_the_program_is_reported_as_one(self, keys, tmp_path):
        """No file is being read while frames are waited for."""
        process = started("upsample", keys, "-o", tmp_path / "out", *PLAIN)
        os.kill(child_of(process), signal.SIGSEGV)  # while it imports
        outcome = ended(process)
        outcome.judge(DEFECT)
        assert "defect" in outcome.error_lines[0]
