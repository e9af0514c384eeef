"""README and docs: commands parse, farm lines work, links lead somewhere, settings are right."""

from __future__ import annotations

import importlib.util
import re
import shlex
import subprocess
from pathlib import Path

import click
import imageio_ffmpeg
import pytest

from exwarp_cli import cli
from tests.cli import shots
from tests.cli.shots import FORWARD, SMALL

ROOT = Path(__file__).parents[2]
README = ROOT / "README.md"
DOCS = sorted((ROOT / "docs").rglob("*.md"))
DOCUMENTS = [
    README,
    *DOCS,
    *(ROOT / name for name in ("CONTRIBUTING.md", "models/README.md", "examples/README.md")),
    *sorted((ROOT / "examples" / "scenes").glob("*.md")),
]
END = {">", "|", "&&", ";"}
"""Words after which a shell begins something else."""


def blocks(path: Path) -> list[list[str]]:
    """Return the lines of each block of shell commands, without indentation."""
    text = path.read_text(encoding="utf-8")
    return [
        [line.strip() for line in block.splitlines()]
        for block in re.findall(r"```sh\n(.*?)```", text, re.DOTALL)
    ]


def words_of(line: str) -> list[str]:
    """Split a line of a shell as far as its first command goes."""
    words = shlex.split(re.split(r"\s#", line)[0])  # within a word, # is no comment: shot.####.exr
    ends = [i for i, word in enumerate(words) if word in END]
    return words[: ends[0]] if ends else words


def commands(program: str) -> list[str]:
    """Return the distinct lines of README and docs that call a program."""
    lines = [line for path in (README, *DOCS) for block in blocks(path) for line in block]
    return list(dict.fromkeys(line for line in lines if line.startswith(f"{program} ")))


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
    assert len(commands("exwarp")) > 40
    assert words_of("exwarp farm commands a -o b > c.txt  # why") == [
        "exwarp", "farm", "commands", "a", "-o", "b",
    ]  # fmt: skip


@pytest.mark.parametrize("line", commands("exwarp"))
def test_each_command_parses(line, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for folder in ("shot", "out", "rendered_at_120", "truth", "render", "report"):
        (tmp_path / folder).mkdir()
    for file in ("clip.mp4", "map.toml"):
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
        [b for b in blocks(ROOT / "docs" / "farm.md") if "exwarp farm" in "".join(b)],
        ids=lambda block: " ".join(block[0].split()[:3]),
    )
    def test_the_lines_of_a_block_work_one_after_the_other(self, call, block):
        for line in block:
            if line.startswith("exwarp farm"):
                assert call(line).code == 0
            if "openjd run" in line:
                assert call("exwarp upsample shot/ -o out/ --threads 1").code == 0


def test_the_recipe_for_motion_blur_runs(tmp_path):
    line = next(iter(commands("ffmpeg")))
    ffmpeg = imageio_ffmpeg.get_ffmpeg_exe()
    source = ["-f", "lavfi", "-i", "testsrc=size=64x36:rate=192:duration=0.25"]
    subprocess.run([ffmpeg, *source, tmp_path / "out.mp4"], check=True, capture_output=True)
    subprocess.run([ffmpeg, *words_of(line)[1:]], check=True, capture_output=True, cwd=tmp_path)
    assert (tmp_path / "blurred.mp4").stat().st_size > 0


def test_the_page_of_settings_is_that_of_the_code():
    path = ROOT / "docs" / "settings_page.py"
    spec = importlib.util.spec_from_file_location("settings_page", path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    page = (ROOT / "docs" / "settings.md").read_text(encoding="utf-8")
    assert module.settings_page() == page, "run: python docs/settings_page.py"


def anchors(path: Path) -> set[str]:
    """Return the anchors of a document's headings, as GitHub and mkdocs form them."""
    headings = re.findall(r"(?m)^#+ +(.*)$", path.read_text(encoding="utf-8"))
    kept = (re.sub(r"[^\w\- ]", "", heading.lower()).strip() for heading in headings)
    return {re.sub(r" ", "-", heading) for heading in kept}


@pytest.mark.parametrize("path", DOCUMENTS, ids=lambda path: str(path.relative_to(ROOT)))
def test_links_lead_somewhere(path):
    text = re.sub(r"```.*?```", "", path.read_text(encoding="utf-8"), flags=re.DOTALL)
    broken = []
    for link in re.findall(r"\]\(([^)\s]+)\)", text):
        if "://" in link:
            continue
        name, _, anchor = link.partition("#")
        target = (path.parent / name).resolve() if name else path
        if not target.exists() or (anchor and anchor not in anchors(target)):
            broken.append(link)
    assert not broken


def test_every_page_is_in_the_site():
    menu = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
    pages = [str(path.relative_to(ROOT / "docs")) for path in DOCS]
    assert [page for page in pages if page not in menu] == []


def test_no_page_of_the_site_links_outside_it():
    """What GitHub finds beside docs/, the site does not have."""
    assert [path.name for path in DOCS if "](../../" in path.read_text(encoding="utf-8")] == []


def test_the_readme_is_short():
    assert len(README.read_text(encoding="utf-8").splitlines()) <= 140
