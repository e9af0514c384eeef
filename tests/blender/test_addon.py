"""The add-on for Blender: its buttons set a scene up, and its command upsamples the render."""

from __future__ import annotations

import shlex
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).with_name("addon_shot")


@pytest.mark.parametrize(
    ("step", "last", "frames", "first", "rate"), [("1", 5, 20, 1, "24"), ("4", 17, 16, 4, "6")]
)
def test_its_command_upsamples_what_it_set_up(script, tmp_path, step, last, frames, first, rate):
    done = script(SCRIPT, tmp_path / "render", step, last)
    assert done.returncode == 0, done.stderr
    lines = dict(line.split(":", 1) for line in done.stdout.splitlines() if ":" in line)
    assert "Motion blur is on" in lines["before"] and "no Vector pass" in lines["before"]
    assert lines["after"].strip() == ""
    words = shlex.split(lines["command"])
    assert words[:2] == ["exwarp", "upsample"] and words[words.index("--fps") + 1] == rate
    command = [sys.executable, "-m", "exwarp_cli", *words[1:], "--threads", "1", "--no-gate"]
    run = subprocess.run(command, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
    assert "motion calibrated" in run.stderr
    written = sorted((tmp_path / "render_exwarp").glob("*.exr"))
    assert len(written) == frames
    assert written[0].name == f"ball.{first:04}.exr"
