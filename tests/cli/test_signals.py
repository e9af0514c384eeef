"""Stopped by a signal: one sentence, and what is there is whole."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from exwarp_cli.io.files import TEMPORARY_SUFFIX
from exwarp_cli.io.generated_frames import is_intact
from tests.cli import shots
from tests.cli.processes import await_files
from tests.cli.street import Street

pytestmark = pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")

KEYS = 12


@pytest.fixture(scope="module")
def keys(tmp_path_factory) -> Path:
    return shots.sequence(
        tmp_path_factory.mktemp("long") / "keys", shots.plain, range(1, KEYS + 1), Street(48, 27)
    )


def arguments(keys: Path, root: Path, *more: str) -> list[str]:
    where = ["-o", str(root / "out"), "--write-holes", str(root / "holes")]
    how = ["-m", "softsplat", "--motion", "forward", "--threads", "1", "--progress", "none"]
    return ["upsample", str(keys), *where, *how, *more]


def start(*options: str) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "exwarp_cli", *options]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


class TestTermination:
    @pytest.mark.parametrize(
        ("number", "code", "word"),
        [(signal.SIGTERM, 143, "terminated"), (signal.SIGINT, 130, "interrupted")],
    )
    def test_one_sentence_and_whole_frames(self, keys, tmp_path, number, code, word):
        with start(*arguments(keys, tmp_path, "--video", str(tmp_path / "a.mp4"))) as process:
            await_files(process, tmp_path / "out", 6)
            process.send_signal(number)
            out, err = process.communicate(timeout=60)
        assert process.returncode == code and out == ""
        # a blank line may come first: it parts the sentence from the terminal's own "^C"
        others = [line for line in err.splitlines() if line and not line.startswith("exwarp: ")]
        assert others == [] and "Traceback" not in err
        errors = [line for line in err.splitlines() if line.startswith("exwarp: error: ")]
        assert len(errors) == 1 and word in errors[0] and "--skip-existing" in errors[0]
        rendered = {shots.passed_through(path, 120) for path in keys.iterdir()}
        for name, data in shots.contents(tmp_path / "out").items():
            assert TEMPORARY_SUFFIX not in name and (data in rendered or is_intact(data))
        assert set(shots.names(tmp_path)) == {"out", "holes"}
