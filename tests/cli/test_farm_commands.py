"""``exwarp farm commands``: a line a chunk, for anything that runs lines."""

from __future__ import annotations

import shlex
import subprocess
from pathlib import Path

import pytest

from tests.cli import shots
from tests.cli.documents import document_of
from tests.cli.farm_engine import EXWARP, HOSTILE, environment
from tests.cli.shots import FORWARD, SMALL
from tests.matrix import combinations

NAME = "it's {a} shot: é #1"


@pytest.fixture
def shot(tmp_path, monkeypatch) -> Path:
    """Five key frames in the current folder."""
    monkeypatch.chdir(tmp_path)
    return shots.sequence(tmp_path / NAME, shots.plain, range(1, 6), SMALL)


class TestLines:
    def test_a_line_a_chunk_with_whole_paths(self, shot, exwarp, tmp_path):
        result = exwarp("farm", "commands", NAME, "-o", "out", "--chunk-size", 2, *FORWARD)
        assert result.code == 0 and result.err == ""
        lines = [shlex.split(line) for line in result.out.splitlines()]
        assert [line[-1] for line in lines] == ["1-2", "3-4", "5"]
        for line in lines:
            assert line[:4] == ["exwarp", "upsample", "--isolated", str(shot)]
            assert line[4:6] == ["--output", f"{tmp_path / 'out'}/"]
            assert "--skip-existing" in line

    def test_chunks_keep_going_where_that_is_asked(self, shot, exwarp):
        for asked in (True, False):
            more = ("--keep-going",) if asked else ()
            result = exwarp("farm", "commands", NAME, "-o", "out", *more, *FORWARD)
            assert ("--keep-going" in result.out) == asked

    def test_what_comes_afterwards_is_printed(self, shot, exwarp, tmp_path):
        more = ("--report", "report", "--video", "a.mp4")
        result = exwarp("farm", "commands", NAME, "-o", "out", *more, *FORWARD)
        assert "--as-chunk" in result.out and "--video" not in result.out
        merging, filming = result.err.splitlines()
        assert f"merge-reports --isolated {tmp_path / 'report'} --overwrite" in merging
        assert f"--video {tmp_path / 'a.mp4'} --frames 1-5" in filming

    def test_json(self, shot, exwarp):
        options = (NAME, "-o", "out", "--report", "r", "--chunk-size", 3, *FORWARD)
        found = document_of(exwarp("farm", "commands", *options, "--json"), "exwarp.chunks/1")
        lines = exwarp("farm", "commands", *options).out.splitlines()
        assert [chunk["frames"] for chunk in found["chunks"]] == ["1-3", "4-5"]
        assert [chunk["command"] for chunk in found["chunks"]] == [shlex.split(x) for x in lines]
        assert [words[1] for words in found["afterwards"]] == ["merge-reports"]

    def test_a_name_of_two_lines_is_no_line(self, shot, exwarp):
        result = exwarp("farm", "commands", NAME, "-o", "a\nb", *FORWARD)
        result.refused(2, "line end", "--json")
        assert exwarp("farm", "commands", NAME, "-o", "a\nb", *FORWARD, "--json").code == 0

    @pytest.mark.parametrize(
        ("name", "option"),
        combinations(["a\tb", "a\x1b[1mb", "a\x85b", "a\u2028b", "a\u202eb"], ["-o", "--report"]),
    )
    def test_nor_is_one_that_a_terminal_obeys(self, shot, exwarp, name, option):
        """Of colours ``click`` would leave the rest: another name."""
        given = (NAME, "-o", "out", *FORWARD, option, name)
        exwarp("farm", "commands", *given).refused(2, "control character", "--json")
        found = document_of(exwarp("farm", "commands", *given, "--json"), "exwarp.chunks/1")
        assert any(name in word for word in found["chunks"][0]["command"])

    @pytest.mark.parametrize(
        "name", [HOSTILE, "~a", "-a", "a\xa0b", "a\u200db", "a;b&c|d>e", "%!\\"]
    )
    def test_a_shell_reads_the_words_that_were_meant(self, shot, exwarp, tmp_path, name):
        result = exwarp("farm", "commands", NAME, "-o", f"{name}/", "--report", name, *FORWARD)
        (line,), (after,) = result.out.splitlines(), result.err.splitlines()
        for text in (line, after.partition("when all are done: ")[2]):
            script = f"set -- {text}\nprintf '%s\\0' \"$@\""
            words = subprocess.run(
                ["/bin/sh", "-c", script], capture_output=True, check=True
            ).stdout
            assert str(tmp_path / name) in words.decode().split("\0")

    @pytest.mark.slow
    def test_a_shell_runs_them_in_any_order(self, shot, exwarp, upsample, tmp_path):
        options = ("-m", "blend", "--threads", 1)
        upsample(NAME, "whole", "-m", "blend")
        program = ("--command", EXWARP, "--chunk-size", 3)
        result = exwarp("farm", "commands", NAME, "-o", "out", *options, *program)
        for line in reversed(result.out.splitlines()):
            done = subprocess.run(
                ["/bin/sh", "-c", line], env=environment(tmp_path), capture_output=True, timeout=120
            )
            assert done.returncode == 0, done.stderr
        assert shots.contents(tmp_path / "out") == shots.contents(tmp_path / "whole")
