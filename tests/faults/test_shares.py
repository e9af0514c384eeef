"""Shares that cannot be read: tried again, then reported as what they are, whatever goes on."""

from __future__ import annotations

import errno
import shutil

import pytest

from tests.cli import shots
from tests.faults.running import PLAIN, require_no_leftovers, run
from tests.matrix import FULL

INPUT = 3
NUMBERS = (errno.ESTALE, errno.EIO, errno.EACCES, errno.EMFILE, errno.ENFILE, errno.ETIMEDOUT)
FAULTS = [
    (call, number, after)
    for call in ("look", "read")
    for number in (NUMBERS if FULL else [errno.EMFILE if call == "look" else errno.ESTALE])
    for after in ((0, 1, 3, 5, 8) if FULL else (1,))
]
OPEN_FILES = "limit of open files"
MENDS = {errno.EMFILE: OPEN_FILES, errno.ENFILE: OPEN_FILES, errno.EACCES: "rights"}


def injected(shim, call: str, number: int, name: str, **more: object) -> dict[str, str]:
    """Return what makes reads of a file fail."""
    fault = {"FAULT_CALL": call, "FAULT_ERRNO": number, "FAULT_PATH": name, **more}
    return {"LD_PRELOAD": str(shim), **{key: str(value) for key, value in fault.items()}}


@pytest.mark.parametrize(("call", "number", "after"), FAULTS)
def test_a_task_fails_even_where_it_goes_on_without_frames(
    keys, shim, tmp_path, call, number, after
):
    fault = injected(shim, call, number, "shot.0003.exr", FAULT_AFTER=after)
    how = (*PLAIN[:-2], "--progress", "openjd", "--keep-going")
    outcome = run("upsample", keys, "-o", tmp_path / "out", *how, environment=fault)
    outcome.judge(INPUT)
    (sentence,) = outcome.error_lines
    assert f"cannot read {keys / 'shot.0003.exr'}: " in sentence
    assert MENDS.get(number, "network share") in sentence
    assert "damaged" not in sentence and "copy it again" not in sentence
    require_no_leftovers(tmp_path / "out")


@pytest.mark.parametrize(("call", "number"), [("look", errno.EMFILE), ("read", errno.ESTALE)])
def test_what_passes_after_a_while_changes_nothing(keys, undisturbed, shim, tmp_path, call, number):
    out = tmp_path / "out"
    fault = injected(shim, call, number, "shot.0003.exr", FAULT_AFTER=1, FAULT_TIMES=4)
    run("upsample", keys, "-o", out, *PLAIN, environment=fault).judge(0)
    assert shots.contents(out) == undisturbed


def test_damage_is_still_left_out(keys, tmp_path):
    broken = shutil.copytree(keys, tmp_path / "keys")
    (broken / "shot.0003.exr").write_bytes((broken / "shot.0003.exr").read_bytes()[:900])
    outcome = run("upsample", broken, "-o", tmp_path / "out", *PLAIN, "--keep-going")
    outcome.judge(12)
    assert "shot.0003.exr is truncated, damaged" in outcome.err
