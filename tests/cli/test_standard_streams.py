"""What is printed where nobody takes it: closed, full and broken streams, and other encodings."""

from __future__ import annotations

import io
import os
import subprocess
import sys
from pathlib import Path

import pytest

from exwarp_cli.errors import OutputError

COMMAND = [sys.executable, "-m", "exwarp_cli"]
FULL = Path("/dev/full")

TOLD = [("--help",), ("policy", "cycles"), ("policy", "cycles", "--json")]
"""Printed by click, by rich, and as JSON."""


def shell(line: str, *arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run a line of sh, in which ``"$@"`` is the command."""
    return subprocess.run(
        ["sh", "-c", line, "sh", *COMMAND, *arguments],
        capture_output=True, text=True, errors="surrogateescape", timeout=120, check=False,
        env={**os.environ, **environment},
    )  # fmt: skip


@pytest.mark.parametrize("arguments", TOLD)
def test_a_closed_stream_takes_everything(arguments):
    found = shell('"$@" >&-', *arguments)
    assert (found.returncode, found.stderr) == (0, "")


@pytest.mark.parametrize("closed", ["2>&-", ">&- 2>&-", "<&- >&- 2>&-"])
def test_exit_codes_are_those_of_other_streams(closed):
    found = shell(f'"$@" {closed}', "inspect", "nothing-of-that-name")
    assert (found.returncode, found.stdout, found.stderr) == (3, "", "")


@pytest.mark.parametrize("arguments", TOLD)
def test_who_breaks_off_hears_nothing_of_it(arguments):
    with subprocess.Popen(
        [*COMMAND, *arguments], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None and process.stderr is not None
        process.stdout.close()
        assert process.stderr.read() == ""
        assert process.wait(120) == OutputError.exit_code == 5


@pytest.mark.skipif(not FULL.exists(), reason="the system has no full device")
@pytest.mark.parametrize("arguments", TOLD)
def test_a_full_disk_is_told(arguments):
    found = shell(f'"$@" >{FULL}', *arguments)
    assert found.returncode == 5
    sentence = "exwarp: error: cannot write to the standard output: No space left on device"
    assert found.stderr == f"{sentence}; send it elsewhere\n"


def test_characters_that_a_terminal_lacks_are_spelled_out():
    plain = shell('"$@"', "upsample", "--help", PYTHONIOENCODING="utf-8")
    found = shell('"$@"', "upsample", "--help", PYTHONIOENCODING="latin-1")
    assert found.returncode == 0 and "…" in plain.stdout
    assert found.stdout == plain.stdout.replace("…", r"\u2026")


def test_names_that_are_no_unicode_are_printed_as_they_are(plain_shot, tmp_path):
    out = os.fsencode(tmp_path) + b"/caf\xe9"
    options = ("-m", "s6", "--motion", "forward", "--dry-run", "--progress", "none")
    found = shell(
        '"$@"', "upsample", str(plain_shot), "-o", os.fsdecode(out), *options,
        PYTHONIOENCODING="utf-8",
    )  # fmt: skip
    assert found.returncode == 0, found.stderr
    assert out in os.fsencode(found.stdout)


def test_a_farm_s_lines_that_nobody_reads_hide_no_failure(exwarp, monkeypatch):
    """What the command fails of is told on stderr, and its exit code stays."""

    class Unread(io.StringIO):
        def write(self, text: str, /) -> int:
            raise OutputError

    monkeypatch.setattr(sys, "stdout", Unread())
    result = exwarp("inspect", "nothing-of-that-name", "--json")
    assert result.code == 3
    result = exwarp("upsample", "nothing-of-that-name", "-o", "out", "--progress", "openjd")
    assert result.code == 3 and "nothing-of-that-name" in result.err
