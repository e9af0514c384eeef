"""Disks and clocks that fail: one sentence, whole files, and a run that can go on."""

from __future__ import annotations

import errno
import shutil
import subprocess
import time

import pytest

from tests.cli import shots
from tests.cli.processes import await_files
from tests.faults.running import (
    PLAIN,
    ended,
    require_no_leftovers,
    require_whole,
    run,
    run_here,
    started,
)
from tests.matrix import FULL, spread

OUTPUT = 5
CALLS = {
    "write": (errno.ENOSPC, errno.EDQUOT, errno.EIO, errno.EFBIG),
    "fsync": (errno.ENOSPC, errno.EDQUOT, errno.EIO, errno.ESTALE),
    "rename": (errno.EIO, errno.EROFS, errno.ENOENT, errno.ESTALE),
    "open": (errno.EROFS, errno.EACCES, errno.ENOSPC, errno.EMFILE),
}
LATE = {"write": 40, "fsync": 23, "rename": 23, "open": 40}
"""How many go well before one of the last; of a frame there is one fsync and one rename."""

FAULTS = [
    [(call, number, after)]
    for call, numbers in CALLS.items()
    for number in numbers
    for after in (0, 1, 5, 17, LATE[call])
]
if not FULL:  # one of each, each in the run that goes on after the one before
    FAULTS = [[(call, numbers[0], 9) for call, numbers in CALLS.items()]]


class TestFaults:
    @pytest.mark.parametrize("faults", FAULTS, ids=str)
    def test_a_call_fails(self, keys, rendered, undisturbed, shim, tmp_path, faults):
        out = tmp_path / "out"
        command = ("upsample", keys, "-o", out, *PLAIN, "--skip-existing")
        for call, number, after in faults:
            fault = {"FAULT_CALL": call, "FAULT_ERRNO": str(number), "FAULT_AFTER": str(after)}
            injected = {"LD_PRELOAD": str(shim), "FAULT_PATH": f"{out}/", **fault}
            outcome = run(*command, environment=injected)
            outcome.judge(OUTPUT)
            assert str(out) in outcome.error_lines[0]
            require_whole(out, rendered)
            require_no_leftovers(out)
        run_here(*command)
        assert shots.contents(out) == undisturbed

    @pytest.mark.parametrize("most", [700, 3000, 5000] if FULL else [3000])
    def test_files_may_not_be_large(self, keys, rendered, undisturbed, tmp_path, most):
        out = tmp_path / "out"
        run("upsample", keys, "-o", out, *PLAIN, largest_file=most).judge(OUTPUT)
        require_whole(out, rendered)
        require_no_leftovers(out)
        run_here("upsample", keys, "-o", out, *PLAIN, "--skip-existing")
        assert shots.contents(out) == undisturbed

    def test_a_report_finds_no_room(self, keys, undisturbed, shim, tmp_path):
        out, report = tmp_path / "out", tmp_path / "report"
        fault = {"FAULT_CALL": "write", "FAULT_ERRNO": str(errno.ENOSPC), "FAULT_AFTER": "0"}
        injected = {"LD_PRELOAD": str(shim), "FAULT_PATH": f"{report}/", **fault}
        options = (*PLAIN, "--report", report)
        run("upsample", keys, "-o", out, *options, environment=injected).judge(OUTPUT)
        assert shots.names(report) == []
        assert shots.contents(out) == undisturbed


class TestDisks:
    def test_full(self, keys, rendered, undisturbed, small_disk, tmp_path):
        out = small_disk / "out"
        outcome = run("upsample", keys, "-o", out, *PLAIN)
        outcome.judge(OUTPUT)
        assert "no space is left" in outcome.error_lines[0]
        require_whole(out, rendered)
        require_no_leftovers(out)
        shutil.copytree(out, tmp_path / "out")
        run_here("upsample", keys, "-o", tmp_path / "out", *PLAIN, "--skip-existing")
        assert shots.contents(tmp_path / "out") == undisturbed

    def test_full_of_a_video(self, keys, undisturbed, small_disk, tmp_path):
        out, video = tmp_path / "out", small_disk / "film.mp4"
        (small_disk / "filler").write_bytes(bytes(128 * 1024))
        run("upsample", keys, "-o", out, *PLAIN, "--video", video).judge(OUTPUT)
        assert shots.names(small_disk) == ["filler"]

    def test_becomes_read_only(self, keys, rendered, small_disk):
        out = small_disk / "out"
        process = started("upsample", keys, "-o", out, *PLAIN)
        await_files(process, out, 5)
        # Refused while a file is being written.
        again = ["mount", "-o", "remount,ro", str(small_disk)]
        while process.poll() is None:
            if subprocess.run(again, capture_output=True, check=False).returncode == 0:
                break
        ended(process).judge(OUTPUT)
        require_whole(out, rendered)

    def test_goes_away(self, keys, tmp_path):
        out = tmp_path / "out"
        process = started("upsample", keys, "-o", out, *PLAIN)
        await_files(process, out, 5)
        out.rename(tmp_path / "elsewhere")
        outcome = ended(process)
        outcome.judge(OUTPUT)
        assert str(out) in outcome.error_lines[0]
        assert not out.exists()


class TestInput:
    def test_goes_away(self, keys, rendered, tmp_path):
        given, out = tmp_path / "keys", tmp_path / "out"
        shutil.copytree(keys, given)
        process = started("upsample", given, "-o", out, *PLAIN)
        await_files(process, out, 5)
        given.rename(tmp_path / "elsewhere")
        ended(process).judge(0, 3)  # 0 where all was read before
        require_whole(out, rendered)
        require_no_leftovers(out)

    def test_comes_slowly(self, keys, undisturbed, shim, tmp_path):
        slow = {"LD_PRELOAD": str(shim), "FAULT_PATH": f"{keys}/", "FAULT_SLOW_MS": "8"}
        out = tmp_path / "out"
        run("upsample", keys, "-o", out, *PLAIN, environment=slow).judge(0)
        assert shots.contents(out) == undisturbed


class TestTwo:
    @pytest.mark.parametrize("option", ["--skip-existing", "--overwrite"])
    @pytest.mark.parametrize("later", [0.0, 0.3, 1.0] if FULL else [0.3])
    def test_write_the_same_range(self, keys, undisturbed, tmp_path, option, later):
        out = tmp_path / "out"
        first = started("upsample", keys, "-o", out, *PLAIN, option)
        time.sleep(later)
        second = started("upsample", keys, "-o", out, *PLAIN, option)
        ended(first).judge(0)
        ended(second).judge(0)
        assert shots.contents(out) == undisturbed


class TestClock:
    @pytest.mark.parametrize("back", spread(["100000000", "3600"], 1))
    def test_goes_backwards(self, keys, undisturbed, shim, tmp_path, back):
        odd = {"LD_PRELOAD": str(shim), "FAULT_CLOCK": back}
        out, report = tmp_path / "out", tmp_path / "report"
        out.mkdir()
        for name in sorted(undisturbed)[: len(undisturbed) // 2]:
            (out / name).write_bytes(undisturbed[name])
        how = (*PLAIN, "--report", report, "--skip-existing")
        run("upsample", keys, "-o", out, *how, environment=odd).judge(0)
        assert shots.contents(out) == undisturbed
