"""A dry run reports what a run would do, writes nothing, and refuses what the run would refuse."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import pytest

from exwarp_cli.domain.timeline import parse_frames
from tests.cli import shots
from tests.cli.conftest import run_quietly
from tests.cli.shots import FORWARD
from tests.cli.street import Street

pytestmark = pytest.mark.usefixtures("unpainted_plots")

HOW = ("-m", "s6", *FORWARD)


@pytest.fixture(scope="module")
def plain_shot(tmp_path_factory) -> Path:
    return shots.sequence(tmp_path_factory.mktemp("plain") / "keys", street=Street(32, 18))


@pytest.fixture(scope="module")
def begun(tmp_path_factory, plain_shot) -> Path:
    """What an earlier run left: frames 1 to 8 without 4, and 6 damaged; read only."""
    out = tmp_path_factory.mktemp("begun") / "out"
    run_quietly("upsample", plain_shot, "-o", out, *HOW, "--frames", "1-2")
    (out / "shot.0004.exr").unlink()
    shots.truncate(out / "shot.0006.exr")
    return out


@pytest.fixture
def foresee(exwarp, plain_shot, tmp_path):
    """Run ``--dry-run --json``, and see that nothing in the folder changes by it."""

    def run(out: Path, *options: object) -> dict[str, Any]:
        before = sorted(tmp_path.rglob("*"))
        dry_run = ("--dry-run", "--json", "--progress", "none")
        result = exwarp("upsample", plain_shot, "-o", out, *(options or HOW), *dry_run)
        assert result.code == 0, result.err
        assert sorted(tmp_path.rglob("*")) == before
        found: dict[str, Any] = json.loads(result.out)
        return found

    return run


def numbers(found: dict[str, Any]) -> dict[str, str]:
    return {name: some["numbers"] for name, some in found["frames"].items() if name != "count"}


class TestTelling:
    def test_a_new_folder(self, foresee, plain_shot, tmp_path):
        options = ("--write-holes", tmp_path / "holes", "--video", tmp_path / "a.mp4")
        found = foresee(tmp_path / "out", *HOW, *options, "--report", tmp_path / "report")
        assert found["schema"] == "exwarp.dry-run/1"
        assert (found["method"], found["setting"], found["frames"]["count"]) == ("s6", "key", 12)
        generated = "2-4,6-8,10-12"
        nothing = {"replace": "", "keep": ""}
        assert numbers(found) == {
            "key": "1-9x4",
            "rendered": "",
            "generated": generated,
            "write": "1-12",
            **nothing,
        }
        assert found["output"] == str(tmp_path / "out" / "shot.####.exr")
        assert found["holes"] == str(tmp_path / "holes" / "shot.####.exr")
        assert found["video"] == str(tmp_path / "a.mp4")
        assert found["report"] == str(tmp_path / "report")
        assert found["input"]["motion"]["source"] == "given"
        assert found["fps"] == {"base": 30, "output": 120, "source": "header", "factor": "4"}
        assert found["cuts"] == {"detect": True, "known": []} and found["chunks"] == []

    def test_what_is_kept_and_what_is_replaced(
        self, foresee, upsample, plain_shot, begun, tmp_path
    ):
        out = Path(shutil.copytree(begun, tmp_path / "out"))
        found = numbers(foresee(out, *HOW, "--skip-existing"))
        assert (found["keep"], found["replace"], found["write"]) == ("1-3,5,7-8", "6", "4,9-12")
        found = numbers(foresee(out, *HOW, "--overwrite"))
        assert (found["keep"], found["replace"], found["write"]) == ("", "1-3,5-8", "4,9-12")
        upsample(plain_shot, out, *HOW, "--skip-existing")
        assert numbers(foresee(out, *HOW, "--skip-existing"))["keep"] == "1-12"

    def test_chunks_and_where_a_chunk_reports(self, foresee, tmp_path):
        spread = ("--workers", 2, "--chunk-size", 2, "--threads", 4)
        found = foresee(tmp_path / "out", *HOW, *spread)
        assert found["chunks"] == ["1-2", "3"]
        assert found["spread"] == "2 workers on this machine, 2 threads each"
        chunk = ("--frames", "2-3", "--report", tmp_path / "report", "--as-chunk")
        found = foresee(tmp_path / "out", *HOW, *chunk)
        assert found["report"] == str(tmp_path / "report" / "chunks" / "2-3")

    def test_cuts_that_are_given(self, foresee, tmp_path):
        found = foresee(tmp_path / "out", *HOW, "--cuts", "2")
        assert found["cuts"] == {"detect": False, "known": [{"frame": 2, "source": "given"}]}

    def test_lines_for_people(self, exwarp, plain_shot, tmp_path):
        result = exwarp("upsample", plain_shot, "-o", tmp_path / "out", *HOW, "--dry-run")
        first, *rest = result.out.splitlines()
        assert "nothing is written: 12 frames, 1-12, in" in first
        assert "  3 rendered: 1-9x4" in rest and "  9 generated: 2-4,6-8,10-12" in rest
        assert "motion given" in result.err and shots.names(tmp_path) == []


CASES: dict[str, tuple[object, ...]] = {
    "all": (),
    "without tail": ("--no-tail",),
    "renumbered": ("--start-frame", -3),
    "some": ("--frames", "1,3"),
    "24 to 60": ("--fps", 24, "--to-fps", 60, "--no-tail"),
    "masks": ("--write-holes", "holes"),
    "a video beside": ("--video", "a.mp4", "--frames", "2"),
    "going on": ("--skip-existing",),
    "going on elsewhere": ("--skip-existing", "--frames", "3"),
    "again": ("--overwrite", "--frames", "1-2"),
    "other layers": ("--skip-existing", "--layers", "all"),
}


@pytest.mark.parametrize("name", CASES)
def test_a_run_does_what_was_foreseen(
    exwarp, upsample, plain_shot, begun, tmp_path, monkeypatch, name
):
    """Frame by frame, with what an earlier run left; and until then nothing changes anywhere."""
    monkeypatch.chdir(tmp_path)
    options = (*HOW, *CASES[name])
    if "--skip-existing" in options or "--overwrite" in options:
        shutil.copytree(begun, "out")
    before = states(tmp_path, plain_shot)
    dry = exwarp("upsample", plain_shot, "-o", "out", *options, "--dry-run", "--json")
    assert dry.code == 0 and states(tmp_path, plain_shot) == before
    found = json.loads(dry.out)
    upsample(plain_shot, "out", *options)
    after = states(tmp_path)
    old, new = (
        {int(path.stem.split(".")[1]): state for path, state in some.items() if path.parts[-2:-1]
         == ("out",)}
        for some in (before, after)
    )  # fmt: skip
    fates = {fate: set(frames_in(found, fate)) for fate in ("write", "replace", "keep")}
    assert new.keys() - old.keys() == fates["write"]
    assert {n for n in old if new[n] != old[n]} == fates["replace"]
    assert old.keys() >= fates["keep"] and fates["keep"] <= new.keys()
    assert sum(map(len, fates.values())) == found["frames"]["count"]
    holes = {int(path.stem.split(".")[1]) for path in after if path.parent.name == "holes"}
    assert holes == (set(frames_in(found, "generated")) if found["holes"] else set())
    assert (tmp_path / "a.mp4" in after) == (found["video"] is not None)


def frames_in(found: dict[str, Any], kind: str) -> list[int]:
    """Return the numbers of some of the frames that a dry run tells of."""
    text = found["frames"][kind]["numbers"]
    numbers = parse_frames(text) if text else []
    assert len(numbers) == found["frames"][kind]["count"]
    return numbers


def states(*folders: Path) -> dict[Path, tuple[int, int, int]]:
    """Return what tells files that were written again, and folders that were touched."""
    found = {path: path.stat() for folder in folders for path in (folder, *folder.rglob("*"))}
    return {path: (s.st_ino, s.st_mtime_ns, s.st_size) for path, s in found.items()}


class TestRefusals:
    """The same sentence and the same exit code as without ``--dry-run``."""

    def alike(self, exwarp, code: int, *arguments: object) -> None:
        dry = exwarp("upsample", *arguments, "--dry-run")
        dry.refused(code)
        wet = exwarp("upsample", *arguments)
        assert (wet.code, wet.err) == (dry.code, dry.err)

    def test_frames_in_the_way(self, exwarp, plain_shot, begun):
        self.alike(exwarp, 6, plain_shot, "-o", begun, *HOW)

    def test_a_report_in_the_way(self, exwarp, plain_shot, tmp_path):
        (tmp_path / "report").mkdir()
        (tmp_path / "report" / "report.json").touch()
        options = ("-o", tmp_path / "out", *HOW, "--report", tmp_path / "report")
        self.alike(exwarp, 6, plain_shot, *options)

    def test_a_file_where_a_folder_should_be(self, exwarp, plain_shot, tmp_path):
        (tmp_path / "file").touch()
        out = tmp_path / "file" / "out"
        self.alike(exwarp, 5, plain_shot, "-o", out, *HOW)

    @pytest.mark.parametrize("place", ["file", "file/report"])
    def test_a_file_where_the_report_should_be(self, exwarp, plain_shot, tmp_path, place):
        (tmp_path / "file").touch()
        options = ("-o", tmp_path / "out", *HOW, "--report", tmp_path / place)
        self.alike(exwarp, 5, plain_shot, *options)
        assert shots.names(tmp_path) == ["file"]

    def test_a_folder_where_the_video_should_be(self, exwarp, plain_shot, tmp_path):
        """Not after all frames are made, and not as something that --overwrite would replace."""
        (tmp_path / "a.mp4").mkdir()
        options = ("-o", tmp_path / "out", *HOW, "--video", tmp_path / "a.mp4")
        for more in ((), ("--overwrite",)):
            self.alike(exwarp, 5, plain_shot, *options, *more)
        assert shots.names(tmp_path) == ["a.mp4"]

    def test_input_and_options(self, exwarp, plain_shot, tmp_path):
        out = tmp_path / "out"
        self.alike(exwarp, 3, tmp_path / "none", "-o", out)
        self.alike(exwarp, 3, plain_shot, "-o", out, *HOW, "--frames", "1-9")
        self.alike(exwarp, 2, plain_shot, "-o", out, "-m", "fastest")
        self.alike(exwarp, 2, plain_shot, "-o", out, *HOW, "--overwrite", "--skip-existing")


class TestDocument:
    def test_a_run_prints_its_report(self, exwarp, plain_shot, tmp_path):
        report = tmp_path / "report"
        options = (*HOW, "--json", "--report", report, "--as-chunk", "--frames", "1-2")
        result = exwarp("upsample", plain_shot, "-o", tmp_path / "out", *options)
        assert result.code == 0, result.err
        written = report / "chunks" / "1-2" / "report.json"
        assert json.loads(result.out) == json.loads(written.read_text())
        assert json.loads(result.out)["frames"]["written"] == 8
