"""What a user reads while kernels are compiled on the first run."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time

import pytest

from exwarp_cli.runtime.compilation import COMPILED, COMPILING, INTERVAL, Compilation


@pytest.fixture
def compare(plain_shot, tmp_path):
    """Run a command with a kernel cache of its own; return the lines on stderr with their times."""
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / "cache")}

    def run(progress: str) -> list[tuple[float, str]]:
        words = ["compare", plain_shot, plain_shot, "--metrics", "psnr", "--progress", progress]
        with subprocess.Popen(
            [sys.executable, "-m", "exwarp_cli", *map(str, words)],
            env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
        ) as process:  # fmt: skip
            assert process.stderr is not None
            lines = [(time.time(), line.rstrip("\n")) for line in process.stderr]
        assert process.returncode == 0, lines
        return lines

    return run


def test_the_first_run_announces_compilation_at_once_and_the_next_is_silent(compare, tmp_path):
    before = time.time()
    (announced, first), *_, (_, last) = compare("none")
    assert first == f"exwarp: {COMPILING}"
    assert last.startswith(f"exwarp: {COMPILED}") and last.endswith("s; later runs need not")
    kept = min(path.stat().st_mtime for path in (tmp_path / "cache").rglob("*.kernel"))
    assert before < announced < kept + 1.0
    assert compare("none") == []


def test_programs_get_compilation_as_messages(compare):
    lines = [json.loads(text) for _, text in compare("json")]
    texts = [line["text"] for line in lines if line["event"] == "message"]
    assert texts[0] == COMPILING and texts[-1].startswith(COMPILED)


@pytest.mark.parametrize("is_terminal", [True, False])
def test_only_a_terminal_shows_how_far_compilation_is(monkeypatch, is_terminal):
    monkeypatch.setattr("sys.stderr.isatty", lambda: is_terminal)
    now, texts = 0.0, list[str]()
    compilation = Compilation(lambda: now)
    with compilation.messages_to(texts.append):
        for _ in range(3):
            compilation.begin()
            now += INTERVAL - 1.0
            compilation.end()
    between = ["compiled 2 kernels in 4 s so far"] if is_terminal else []
    assert texts == [COMPILING, *between, "compiled 3 kernels in 6 s; later runs need not"]
