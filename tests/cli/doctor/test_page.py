"""What ``exwarp doctor`` prints of a healthy installation, and of one that is not."""

from __future__ import annotations

import json
import os
import pty
import re
import struct
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from exwarp_cli import __version__
from exwarp_cli.pipeline.doctor import checkup, environment
from exwarp_cli.pipeline.doctor.checkup import SCHEMA, CheckResult
from exwarp_cli.runtime.machine import Folder
from tests.cli.doctor.judging import ESCAPE, NAMES, failed, no_folder, warned


class TestHealthy:
    def test_page(self, exwarp):
        result = exwarp("doctor")
        assert result.code == 0, result.out
        lines = result.out.splitlines()
        assert lines[0].startswith(f"exwarp {__version__} on ")
        checks = [line for line in lines[1:-1] if not line.startswith(" ")]
        assert len(checks) == len(NAMES)
        for name, line in zip(NAMES, checks, strict=True):
            title = name.replace("_", " ")
            assert re.match(rf"(ok|warning) +{title}  ", line, re.IGNORECASE), line
        assert "s6, softsplat, exwarp, causal and chunks are right" in result.out
        assert lines[-1].startswith("everything ")
        assert ESCAPE not in result.out

    def test_verbose(self, exwarp):
        brief = exwarp("doctor", "--skip-self-test").out
        long = exwarp("doctor", "--skip-self-test", "--verbose").out
        assert brief.splitlines()[-1].startswith("everything that ")
        assert "skipped  self test" in brief
        assert len(brief.splitlines()) < 30 < len(long.splitlines())
        for word in ("matplotlib ", "llvmlite ", "extrapolator.onnx: as shipped", "CPUs: "):
            assert word in long and word not in brief

    def test_json(self, exwarp):
        result = exwarp("doctor", "--skip-self-test", "--json")
        document = json.loads(result.out)
        assert result.code == 0
        assert {"schema", "version", "outcome", "failed", "warnings", "seconds"} < set(document)
        assert document["schema"] == SCHEMA and document["version"] == __version__
        assert list(document["checks"]) == NAMES
        for check in document["checks"].values():
            assert set(check) == {"outcome", "found", "remarks", "seconds", "facts"}
        facts = {name: check["facts"] for name, check in document["checks"].items()}
        assert document["checks"]["self_test"]["outcome"] == "skipped"
        assert facts["video"]["encoders"]["libx264"] is True
        assert facts["network"]["devices"]["cpu"] is True
        assert set(facts["models"]["files"].values()) == {"as shipped"}
        assert facts["machine"]["cpus"]["there"] == os.cpu_count()

    def test_terminal(self):
        """Coloured, and no wider than 80 columns."""
        command = (sys.executable, "-m", "exwarp_cli", "doctor", "--skip-self-test")
        code, shown = in_terminal(*command)
        assert code == 0, shown
        assert re.search(rf"{ESCAPE}\[32mok +{ESCAPE}\[0m  models ", shown), shown
        plain = re.sub(rf"{ESCAPE}\[[\d;]*m", "", shown)
        assert [line for line in plain.splitlines() if len(line.rstrip()) > 80] == []


def in_terminal(*command: str) -> tuple[int, str]:
    """Run a command in a terminal of 80 columns."""
    main, side = pty.openpty()
    fcntl = pytest.importorskip("fcntl")
    termios = pytest.importorskip("termios")
    fcntl.ioctl(side, termios.TIOCSWINSZ, struct.pack("HHHH", 24, 80, 0, 0))
    hidden = ("NO_COLOR", "COLUMNS", "LINES", "FORCE_COLOR", "TTY_COMPATIBLE")
    env = {name: value for name, value in os.environ.items() if name not in hidden}
    env["TERM"] = "xterm-256color"
    with subprocess.Popen(command, stdin=side, stdout=side, stderr=side, env=env) as process:
        os.close(side)
        shown = b""
        while True:
            try:
                data = os.read(main, 65536)
            except OSError:  # how Linux tells the end of a terminal
                break
            if not data:
                break
            shown += data
    os.close(main)
    return process.returncode, shown.decode().replace("\r\n", "\n")


class TestConfiguration:
    def test_files_and_variables(self, examined, monkeypatch, tmp_path):
        (tmp_path / "exwarp.toml").write_text("[upsample]\nmethod = 's6'\n")
        monkeypatch.setenv("EXWARP_UPSAMPLE_FPS", "24")
        code, document = examined("temp_folder")
        assert code == 0
        facts = document["checks"]["configuration"]["facts"]
        assert [Path(file["path"]).name for file in facts["files"]] == ["exwarp.toml"]
        settings = {(*one["command"], one["option"]): one["text"] for one in facts["settings"]}
        assert settings[("upsample", "method")] == "s6" and settings[("upsample", "fps")] == "24"
        assert facts["environment"]["EXWARP_UPSAMPLE_FPS"] == "24"

    def test_a_broken_file(self, examined, tmp_path):
        (tmp_path / "exwarp.toml").write_text("[upsample\n")
        failed(examined("temp_folder"), "configuration", "exwarp.toml")

    def test_a_variable_that_nothing_knows(self, examined, monkeypatch):
        monkeypatch.setenv("EXWARP_UPSAMPLE_METOD", "s6")
        warned(examined("temp_folder"), "configuration", "EXWARP_UPSAMPLE_METOD")


def test_the_page_tells_what_failed(exwarp, monkeypatch):
    monkeypatch.setattr(checkup, "CHECKS", {"temp_folder": checkup.CHECKS["temp_folder"]})
    monkeypatch.setattr(environment, "tempfile", SimpleNamespace(gettempdir=no_folder))
    result = exwarp("doctor")
    assert result.code == 10
    assert "failed   temp folder    none\n" in result.out
    assert " - no folder for temporary files can be written; name one in TMPDIR\n" in result.out
    assert result.err == (
        "exwarp: error: 1 of 2 checks failed (temp folder); do what the line under it says\n"
    )


def test_the_page_tells_of_warnings(exwarp, monkeypatch):
    monkeypatch.setattr(checkup, "CHECKS", {"temp_folder": checkup.CHECKS["temp_folder"]})
    monkeypatch.setattr(environment, "look_at", lambda path: Folder(path, None, 1 << 20))
    result = exwarp("doctor")
    assert result.code == 0 and result.err == ""
    assert "warning  temp folder    " in result.out and "; make room, or name" in result.out
    assert result.out.endswith("everything that is needed works; see the warnings on temp folder\n")


def test_a_check_without_remarks_is_good():
    assert (
        CheckResult("fine").outcome == "ok"
        and CheckResult("left out", skipped=True).outcome == "skipped"
    )
