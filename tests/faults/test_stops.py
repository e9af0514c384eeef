"""A command that is stopped ends, with its sentence, whatever it is doing."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time

import pytest

from exwarp_cli import cli, errors
from exwarp_cli.io.files import TEMPORARY_SUFFIX
from exwarp_cli.runtime.stop import STALLED_S
from tests.faults.running import (
    BOUND_S,
    CRASHING,
    PLAIN,
    ended,
    require_no_leftovers,
    require_whole,
    started,
)

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="needs processes of POSIX")

NEVER_ENDS = """
import os, signal, sys, time
from exwarp_cli import supervisor

supervisor.GRACE_S, supervisor.TICK_S = float(sys.argv[1]), 0.2
end = supervisor.fork_command(print)
if end is None:
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    print("works", flush=True)
    time.sleep(100)
print(end.code, end.stopped, end.is_failure)
"""


@pytest.mark.parametrize(
    ("number", "code", "word"),
    [
        (signal.SIGINT, errors.INTERRUPTED, "interrupted"),
        (signal.SIGTERM, cli.TERMINATED, "terminated"),
    ],
)
def test_a_second_signal_ends_it_at_once(keys, rendered, tmp_path, number, code, word):
    """The main thread waits for a file, and reads no flag."""
    out = tmp_path / "out"
    how = ("--video", tmp_path / "a.mp4")
    process = started("hang", 14, "upsample", keys, "-o", out, *PLAIN, *how, module=CRASHING)
    assert process.stderr is not None
    assert any("hangs" in line for line in iter(process.stderr.readline, ""))
    assert any(TEMPORARY_SUFFIX in path.name for path in tmp_path.iterdir())
    process.send_signal(number)
    time.sleep(1.5)
    assert process.poll() is None
    begin = time.monotonic()
    process.send_signal(number)
    outcome = ended(process)
    assert time.monotonic() - begin < STALLED_S
    outcome.judge(code)
    assert word in outcome.error_lines[0] and "--skip-existing" in outcome.error_lines[0]
    require_whole(out, rendered)
    require_no_leftovers(out)
    require_no_leftovers(tmp_path)


@pytest.mark.parametrize(("grace_s", "signals"), [(0.2, 1), (100, 2)])
def test_what_does_not_end_is_ended(grace_s, signals):
    words = [sys.executable, "-c", NEVER_ENDS, str(grace_s)]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "works\n"
        process.send_signal(signal.SIGTERM)
        if signals > 1:
            time.sleep(1.2)
            process.send_signal(signal.SIGTERM)
        output, _ = process.communicate(timeout=BOUND_S)
    assert output == f"{-signal.SIGKILL} {signal.SIGTERM.value} False\n"
