"""Paths of which the system refuses even to say whether they are there.

Folders that may not be entered and shares that went away do the same as names that are too long,
which every system and every user meets alike.
"""

from __future__ import annotations

import errno

import pytest

from exwarp_cli.errors import ExwarpError, InputError, OutputError, to_exwarp_error
from tests.cli.shots import FORWARD

LONG = "a" * 300
HOW = ("-m", "s6", *FORWARD)


@pytest.mark.parametrize(
    "arguments",
    [
        ("inspect", LONG),
        ("features", LONG),
        ("compare", LONG, LONG),
        ("upsample", LONG, "-o", "out"),
        ("farm", "openjd", LONG, "-o", "out"),
        ("bench", LONG, "-o", "out"),
        ("merge-reports", LONG),
        ("merge-reports", LONG, "-o", "out"),
    ],
)
def test_input(exwarp, arguments):
    exwarp(*arguments).refused(3, LONG, "File name too long", "check the path")


@pytest.mark.parametrize("dry", [(), ("--dry-run",)])
@pytest.mark.parametrize("option", ["--report", "--video", "--write-holes"])
def test_output_beside_the_frames(exwarp, plain_shot, tmp_path, option, dry):
    path = tmp_path / (LONG + ".mp4" * (option == "--video"))
    line = ("upsample", plain_shot, "-o", tmp_path / "out", *HOW, option, path, *dry)
    exwarp(*line).refused(5, str(path), "the name is too long", "choose a shorter one")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    "command", [("upsample",), ("upsample", "--dry-run"), ("farm", "openjd"), ("farm", "commands")]
)
def test_output(exwarp, plain_shot, tmp_path, command):
    line = (*command, plain_shot, "-o", tmp_path / LONG, *HOW)
    exwarp(*line).refused(5, LONG, "the name is too long")


def test_a_comparison_s_report(exwarp, plain_truth, tmp_path):
    line = ("compare", plain_truth, plain_truth, "--report")
    exwarp(*line, tmp_path / LONG).refused(5, LONG, "the name is too long")
    (tmp_path / "report.json").mkdir()
    exwarp(*line, tmp_path).refused(6, str(tmp_path), "another --report")


def test_a_farm_receives_the_same_message(exwarp):
    result = exwarp("upsample", LONG, "-o", "out", "--progress", "openjd")
    assert result.code == 3 and "defect" not in result.err
    sentence = result.err.removeprefix("exwarp: error: ")
    assert result.out == f"openjd_fail: {sentence}"


@pytest.mark.parametrize(
    ("number", "kind"),
    [
        (errno.EACCES, InputError),
        (errno.ESTALE, InputError),
        (errno.ENOSPC, OutputError),
        (errno.EROFS, OutputError),
    ],
)
def test_an_error_that_only_writers_get_is_of_the_output(number: int, kind: type[ExwarpError]):
    found = to_exwarp_error(OSError(number, "why", "/a/b"))
    assert type(found) is kind
    assert str(found) == "cannot use /a/b: why; check the path and its rights"


def test_what_names_no_file_is_a_defect():
    assert to_exwarp_error(OSError("why")) is None
    assert to_exwarp_error(OSError(errno.EBADF, "why", 7)) is None
