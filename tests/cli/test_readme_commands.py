"""The commands of the README are commands: each parses, and a farm's lines work one by one."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import click
import pytest

from exwarp_cli import cli
from tests.cli import shots
from tests.cli.shots import FORWARD, SMALL

README = Path(__file__).parents[2] / "README.md"
END = {">", "|", "&&", ";"}
"""Words after which a shell begins something else."""


def blocks(text: str) -> list[list[str]]:
    """Return the lines of each block of shell commands."""
    return [block.splitlines() for block in re.findall(r"```sh\n(.*?)```", text, re.DOTALL)]


def words_of(line: str) -> list[str]:
    """Split a line of a shell as far as its first command goes."""
    words = shlex.split(line, comments=True)
    ends = [i for i, word in enumerate(words) if word in END]
    return words[: ends[0]] if ends else words


def commands() -> list[str]:
    """Return the lines that call exwarp."""
    lines = [line for block in blocks(README.read_text(encoding="utf-8")) for line in block]
    return [line for line in lines if line.startswith("exwarp ")]


def parse(words: list[str]) -> list[str]:
    """Parse a command line without running it; return the names of its commands."""
    context = click.Context(cli.exwarp, info_name="exwarp")
    group: click.Command = cli.exwarp
    names, rest = [], words[1:]
    while isinstance(group, click.Group):
        name, found, rest = group.resolve_command(context, rest)
        assert name is not None and found is not None
        names.append(name)
        context, group = click.Context(found, context, name), found
    group.make_context(names[-1], rest, context.parent)
    return names


def test_there_are_commands_to_read():
    assert len(commands()) > 20
    assert words_of("exwarp farm commands a -o b > c.txt  # why") == [
        "exwarp", "farm", "commands", "a", "-o", "b",
    ]  # fmt: skip


@pytest.mark.parametrize("line", commands())
def test_each_command_parses(line, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for folder in ("shot", "out", "rendered_at_120", "report"):
        (tmp_path / folder).mkdir()
    for file in ("clip.mp4", "medieval.pth.tar"):
        (tmp_path / file).touch()
    assert parse(words_of(line))


def test_what_is_no_option_does_not_parse():
    with pytest.raises(click.UsageError, match="--chunk-minutes"):
        parse(["exwarp", "farm", "openjd", "shot", "-o", "out", "--chunk-minutes", "1"])


class TestFarm:
    """A shot, and in turn what a farm's user calls."""

    @pytest.fixture
    @staticmethod
    def call(exwarp, tmp_path, monkeypatch):
        monkeypatch.chdir(tmp_path)
        shots.sequence(tmp_path / "shot", shots.plain, range(1, 3), SMALL)

        def run(line: str) -> object:
            return exwarp(*words_of(line)[1:], *FORWARD)

        return run

    def test_a_job_is_written_again_when_its_frames_are_there(self, call, tmp_path):
        """In another form, or with other chunks: it goes on, and keeps what is good."""
        assert call("exwarp farm openjd shot/ -o out/ --report report/").code == 0
        assert call("exwarp upsample shot/ -o out/ --threads 1").code == 0
        line = "exwarp farm openjd shot/ -o out/ --chunk-seconds 600 --bundle job/"
        call(line).refused(6, "out has frame", "--skip-existing to keep good ones")
        assert call(f"{line} --skip-existing").code == 0
        assert {path.name for path in (tmp_path / "job").iterdir()} == {
            "template.yaml", "parameter_values.yaml",
        }  # fmt: skip

    @pytest.mark.parametrize(
        "block",
        [b for b in blocks(README.read_text(encoding="utf-8")) if "exwarp farm" in "".join(b)],
        ids=lambda block: " ".join(block[0].split()[:3]),
    )
    def test_the_lines_of_a_block_work_one_after_the_other(self, call, block):
        for line in block:
            if line.startswith("exwarp farm"):
                assert call(line).code == 0
            if "openjd run" in line:
                assert call("exwarp upsample shot/ -o out/ --threads 1").code == 0
