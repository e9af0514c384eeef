"""Output that no reader takes: closed, full and broken streams, and other encodings."""

from __future__ import annotations

import io
import os
import subprocess
import sys
from pathlib import Path

import pytest

from exwarp_cli.errors import OutputError
from exwarp_cli.models import session
from tests.cli import shots
from tests.matrix import spread

COMMAND = [sys.executable, "-m", "exwarp_cli"]
FULL = Path("/dev/full")

PRINTED = [("--help",), ("policy", "cycles"), ("policy", "cycles", "--json")]
"""Printed by click, by rich, and as JSON."""


def shell(line: str, *arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run a line of sh, in which ``"$@"`` is the command."""
    return subprocess.run(
        ["sh", "-c", line, "sh", *COMMAND, *arguments],
        capture_output=True, text=True, errors="surrogateescape", timeout=120, check=False,
        env={**os.environ, **environment},
    )  # fmt: skip


@pytest.mark.parametrize("arguments", PRINTED)
def test_a_closed_stream_takes_everything(arguments):
    found = shell('"$@" >&-', *arguments)
    assert (found.returncode, found.stderr) == (0, "")


@pytest.mark.parametrize("closed", ["2>&-", ">&- 2>&-", "<&- >&- 2>&-"])
def test_exit_codes_are_those_of_other_streams(closed):
    found = shell(f'"$@" {closed}', "inspect", "nothing-of-that-name")
    assert (found.returncode, found.stdout, found.stderr) == (3, "", "")


@pytest.mark.parametrize("arguments", PRINTED)
def test_who_breaks_off_hears_nothing_of_it(arguments):
    with subprocess.Popen(
        [*COMMAND, *arguments], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None and process.stderr is not None
        process.stdout.close()
        assert process.stderr.read() == ""
        assert process.wait(120) == OutputError.exit_code == 5


@pytest.mark.skipif(not FULL.exists(), reason="the system has no full device")
@pytest.mark.parametrize("arguments", PRINTED)
def test_a_full_disk_is_reported(arguments):
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


def test_a_farm_s_unread_lines_hide_no_failure(exwarp, monkeypatch):
    """The reason of the failure goes to stderr, and the exit code stays."""

    class Unread(io.StringIO):
        def write(self, text: str, /) -> int:
            raise OutputError

    monkeypatch.setattr(sys, "stdout", Unread())
    result = exwarp("inspect", "nothing-of-that-name", "--json")
    assert result.code == 3
    result = exwarp("upsample", "nothing-of-that-name", "-o", "out", "--progress", "openjd")
    assert result.code == 3 and "nothing-of-that-name" in result.err


RUN = ("-m", "hold", "--motion", "forward")


@pytest.mark.skipif(not FULL.exists(), reason="the system has no full device")
@pytest.mark.parametrize("progress", spread(["json", "bar"], 1))
def test_messages_that_a_full_disk_loses_do_not_end_the_work(plain_shot, tmp_path, progress):
    run = ("upsample", str(plain_shot), "-o", str(tmp_path / "out"), *RUN, "--progress", progress)
    found = shell(f'"$@" 2>{FULL}', *run)
    assert found.returncode == 0
    assert found.stdout.startswith("12 frames in ")
    assert len(shots.names(tmp_path / "out")) == 12


@pytest.mark.skipif(not FULL.exists(), reason="the system has no full device")
def test_an_exit_code_outlives_its_message():
    found = shell(f'"$@" 2>{FULL}', "inspect", "nothing-of-that-name")
    assert (found.returncode, found.stdout, found.stderr) == (3, "", "")


@pytest.mark.parametrize("progress", spread(["openjd", "plain"], 1))
def test_a_reader_that_ends_early_does_not_end_the_work(plain_shot, tmp_path, progress):
    """As behind ``2>&1 | head -1``."""
    run = ("upsample", str(plain_shot), "-o", str(tmp_path / "out"), *RUN, "--progress", progress)
    line = f'( "$@" 2>&1; echo $? >{tmp_path / "code"} ) | head -1'
    found = shell(line, *run)
    assert found.stdout.count("\n") == 1
    assert (tmp_path / "code").read_text() == "0\n"
    assert len(shots.names(tmp_path / "out")) == 12


def test_libraries_are_quiet_and_messages_are_kept():
    """Inside the block only what Python prints arrives, after it everything does."""
    script = (
        "import os, sys\n"
        "from exwarp_cli import standard_streams\n"
        "standard_streams.prepare_streams()\n"
        "with standard_streams.silence_libraries():\n"
        "    os.write(2, b'[W:onnxruntime] no device\\n')\n"
        "    print('message', file=sys.stderr, flush=True)\n"
        "os.write(2, b'later\\n')\n"
    )
    found = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, timeout=60, check=True
    )
    assert found.stderr == "message\nlater\n"


def test_warnings_of_the_network_runtime_stay_off_the_terminal(monkeypatch, tmp_path, capfd):
    """The runtime writes to the descriptor itself: as it is imported, and as it opens a network."""
    (tmp_path / "onnxruntime.py").write_text(
        "import os\n"
        "os.write(2, b'[W:onnxruntime] GPU device discovery failed\\n')\n"
        "__version__ = '1.2.3'\n"
        "set_default_logger_severity = lambda level: None\n"
        "disable_telemetry_events = lambda: None\n"
        "class ExecutionMode: ORT_SEQUENTIAL = 0\n"
        "class SessionOptions:\n"
        "    def add_session_config_entry(self, key, value): pass\n"
        "def InferenceSession(*args, **named):\n"
        "    os.write(2, b'Error in cpuinfo\\n')\n"
        "    return 'session'\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setitem(sys.modules, "onnxruntime", None)  # so that the copy goes afterwards
    monkeypatch.delitem(sys.modules, "onnxruntime")
    assert session.load_runtime().__version__ == "1.2.3"
    assert session.open_session(tmp_path / "network.onnx", b"", 1, "cpu") == "session"
    assert capfd.readouterr().err == ""
