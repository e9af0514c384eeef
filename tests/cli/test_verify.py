"""--verify, and the checksums of files in the report."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import pytest

from exwarp_cli.pipeline import frame_writer
from tests.cli.shots import KEYS, contents, names
from tests.matrix import spread

pytestmark = pytest.mark.usefixtures("unpainted_plots")

QUIET = ("--progress", "none", "--threads", 1)
FRAMES = 4 * KEYS


@pytest.fixture
def spoil(monkeypatch):
    """Have files change on the way to the disk: in what is read back of it."""
    real = frame_writer.drop_cached

    def spoil(*wanted: str, cut: bool = False) -> None:
        def dropping(path: Path) -> None:
            if path.name in wanted:
                data = bytearray(path.read_bytes())
                data[len(data) // 2] ^= 1
                path.write_bytes(data[:-7] if cut else data)
            real(path)

        monkeypatch.setattr(frame_writer, "drop_cached", dropping)

    return spoil


def files_in(report: Path) -> list[dict]:
    return json.loads((report / "report.json").read_text())["files"]


def digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


class TestChecksums:
    @pytest.mark.parametrize("method", spread(["s6", "softsplat", "hold"], 2))
    def test_the_report_has_those_of_all_files(self, upsample, shot, tmp_path, method):
        keys, *rest = shot["key"]
        out, report = tmp_path / "out", tmp_path / "report"
        more = ("--report", report, "--write-holes", tmp_path / "holes")
        upsample(keys, out, "-m", method, *rest, *more)
        files = files_in(report)
        frames = {one["file"]: one["sha256"] for one in files if one["kind"] == "frame"}
        assert frames == {name: digest(out / name) for name in names(out)}
        masks = {one["file"]: one["sha256"] for one in files if one["kind"] == "holes"}
        assert masks == {n: digest(tmp_path / "holes" / n) for n in names(tmp_path / "holes")}
        assert len(frames) == FRAMES and masks

    def test_also_of_frames_of_an_earlier_run(self, upsample, shot, tmp_path):
        keys, *rest = shot["key"]
        report = ("--report", tmp_path / "report")
        upsample(keys, tmp_path / "out", "-m", "s6", *rest)
        (tmp_path / "out" / "shot.0006.exr").unlink()
        upsample(keys, tmp_path / "out", "-m", "s6", *rest, "--skip-existing", *report)
        frames = {one["file"]: one["sha256"] for one in files_in(tmp_path / "report")}
        assert frames == {n: digest(tmp_path / "out" / n) for n in names(tmp_path / "out")}

    def test_chunks_have_theirs(self, exwarp, upsample, shot, tmp_path):
        keys, *rest = shot["key"]
        report = ("--report", tmp_path / "report", "--as-chunk")
        for frames in ("1-2", "3-5"):
            upsample(keys, tmp_path / "out", "-m", "s6", *rest, "--frames", frames, *report)
        assert exwarp("merge-reports", tmp_path / "report").code == 0
        assert [one["frame"] for one in files_in(tmp_path / "report")] == list(range(1, 21))

    def test_checksums_that_are_not_asked_for_are_not_computed(
        self, upsample, shot, tmp_path, monkeypatch
    ):
        keys, *rest = shot["key"]
        monkeypatch.setattr(frame_writer, "sum_of", None)
        monkeypatch.setattr(frame_writer, "sum_in", None)
        upsample(keys, tmp_path / "out", "-m", "s6", *rest)


class TestVerify:
    def test_it_counts_what_it_read(self, exwarp, shot, tmp_path):
        keys, *rest = shot["key"]
        more = ("--verify", "--report", tmp_path / "report", "--write-holes", tmp_path / "holes")
        result = exwarp("upsample", keys, "-o", tmp_path / "out", "-m", "s6", *rest, *QUIET, *more)
        assert result.code == 0, result.err
        count = FRAMES + len(names(tmp_path / "holes"))
        assert f"{count} files read back, all as written" in result.out
        assert json.loads((tmp_path / "report" / "report.json").read_text())["verified"] == count

    def test_it_changes_no_byte(self, upsample, shot, tmp_path):
        keys, *rest = shot["key"]
        upsample(keys, tmp_path / "one", "-m", "softsplat", *rest)
        upsample(keys, tmp_path / "two", "-m", "softsplat", *rest, "--verify")
        assert contents(tmp_path / "one") == contents(tmp_path / "two")

    @pytest.mark.parametrize("cut", [False, True])
    def test_what_differs_is_named_and_removed(self, exwarp, shot, tmp_path, spoil, cut):
        """Frame 5 is a copy of a key frame, frames 7 and 8 are made."""
        keys, *rest = shot["key"]
        given = ("upsample", keys, "-o", tmp_path / "out", "-m", "s6", *rest, *QUIET)
        spoil("shot.0005.exr", "shot.0007.exr", "shot.0008.exr", cut=cut)
        exwarp(*given, "--verify").refused(5, "frames 5,7-8 in", "removed", "--skip-existing")
        assert len(names(tmp_path / "out")) == FRAMES - 3
        spoil()
        assert exwarp(*given, "--verify", "--skip-existing").code == 0
        assert exwarp(*given[:3], tmp_path / "again", *given[4:]).code == 0
        assert contents(tmp_path / "out") == contents(tmp_path / "again")

    def test_frames_of_an_earlier_run(self, exwarp, upsample, shot, tmp_path, spoil):
        keys, *rest = shot["key"]
        upsample(keys, tmp_path / "out", "-m", "s6", *rest)
        spoil("shot.0007.exr")
        given = ("upsample", keys, "-o", tmp_path / "out", "-m", "s6", *rest, *QUIET)
        exwarp(*given, "--skip-existing", "--verify").refused(5, "frame 7 in")

    def test_hole_masks(self, exwarp, shot, tmp_path, monkeypatch, spoil):
        keys, *rest = shot["key"]
        given = ("upsample", keys, "-o", tmp_path / "out", "-m", "s6", *rest, *QUIET)
        masks = ("--write-holes", tmp_path / "holes" / "m.####.exr")
        spoil("m.0006.exr")
        exwarp(*given, *masks, "--verify").refused(5, "hole mask 6 in")

    @pytest.mark.parametrize("alone", [False, True])
    def test_videos(self, exwarp, shot, tmp_path, spoil, alone):
        keys, *rest = shot["key"]
        film = tmp_path / "film.mp4"
        where = ("-o", film) if alone else ("-o", tmp_path / "out", "--video", film)
        given = ("upsample", keys, *where, "-m", "s6", *rest, *QUIET, "--verify")
        result = exwarp(*given)
        assert result.code == 0, result.err
        spoil("film.mp4")
        exwarp(*given, "--overwrite").refused(5, "the video film.mp4 in")
        assert not film.exists()

    def test_processes_verify_what_they_wrote(self, exwarp, shot, tmp_path):
        pytest.importorskip("distributed")
        keys, *rest = shot["key"]
        more = ("--verify", "--workers", 2, "--threads", 2, "--progress", "none")
        report = ("--report", tmp_path / "report", "--video", tmp_path / "a.mp4")
        out = tmp_path / "out"
        result = exwarp("upsample", keys, "-o", out, "-m", "s6", *rest, *more, *report)
        assert result.code == 0, result.err
        assert f"{FRAMES} files read back" in result.out
        assert {one["file"] for one in files_in(tmp_path / "report")} == set(names(out))
