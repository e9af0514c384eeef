"""Output that cannot be written, and options that make no sense."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from exwarp_cli.io.files import TEMPORARY_SUFFIX
from exwarp_cli.io.generated_frames import is_intact
from tests.cli import shots
from tests.cli.street import Street

pytestmark = pytest.mark.usefixtures("unpainted_plots")

TINY = Street(16, 9)


@pytest.fixture(scope="module")
def keys(tmp_path_factory) -> Path:
    return shots.sequence(
        tmp_path_factory.mktemp("colours") / "keys", shots.colour_only, (1, 2), TINY
    )


class TestUnwritable:
    @pytest.mark.parametrize("output", ["file", "file/out", "file/deep/out.####.exr"])
    def test_a_file_in_the_way(self, keys, exwarp, tmp_path, output):
        (tmp_path / "file").write_text("in the way")
        result = exwarp("upsample", keys, "-o", tmp_path / output, "-m", "hold")
        result.refused(5, "cannot write", "file")
        assert (tmp_path / "file").read_text() == "in the way"

    @pytest.mark.skipif(
        not Path("/proc/self").exists(), reason="a folder that not even root may fill"
    )
    def test_a_folder_that_takes_nothing(self, keys, exwarp):
        result = exwarp("upsample", keys, "-o", "/proc/exwarp", "-m", "hold")
        result.refused(5, "cannot write /proc/exwarp")

    @pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
    def test_a_folder_without_the_right(self, keys, exwarp, tmp_path):
        folder = tmp_path / "locked"
        folder.mkdir(mode=0o555)
        exwarp("upsample", keys, "-o", folder, "-m", "hold").refused(5, "locked", "permission")

    @pytest.mark.parametrize("option", ["--write-holes", "--report"])
    def test_other_folders_are_tried_before_the_work(self, keys, exwarp, tmp_path, option):
        (tmp_path / "file").write_text("in the way")
        out = tmp_path / "out"
        result = exwarp("upsample", keys, "-o", out, "-m", "hold", option, tmp_path / "file" / "x")
        result.refused(5, "cannot write", "file")
        assert shots.names(out) == []

    def test_a_folder_where_a_frame_belongs(self, keys, exwarp, tmp_path):
        (tmp_path / "out" / "shot.0003.exr").mkdir(parents=True)
        options = ("-o", tmp_path / "out", "-m", "hold", "--overwrite")
        exwarp("upsample", keys, *options).refused(5, "shot.0003.exr", "in the way")
        assert not [name for name in shots.names(tmp_path / "out") if TEMPORARY_SUFFIX in name]

    @pytest.mark.skipif(os.name == "nt", reason="limits of POSIX")
    def test_a_full_disk(self, tmp_path):
        """A limit on file sizes stands in for the disk: writing fails in the middle of a file."""
        # Few pixels, as kernels are not compiled.
        street = Street(32, 18)
        keys = shots.sequence(tmp_path / "keys", shots.colour_only, (1, 2), street)
        smallest = min(len(data) for data in shots.contents(keys).values())
        code = (
            "import resource, sys; from exwarp_cli import cli; limit = int(sys.argv.pop(1)); "
            "resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit)); cli.main()"
        )
        out = tmp_path / "out"
        command = [sys.executable, "-c", code, str(smallest // 4), "upsample", str(keys)]
        options = ["-o", str(out), "-m", "hold", "--progress", "none"]
        # Numba's cache and bytecode are files as well; Python would cut those off without a word.
        environment = os.environ | {"NUMBA_DISABLE_JIT": "1", "PYTHONDONTWRITEBYTECODE": "1"}
        done = subprocess.run(command + options, capture_output=True, text=True, env=environment)
        assert done.returncode == 5, done.stderr
        errors = [x for x in done.stderr.splitlines() if x.startswith("exwarp: error: ")]
        assert len(errors) == 1 and "cannot write" in errors[0] and "Traceback" not in done.stderr
        assert done.stdout == ""
        for name, data in shots.contents(out).items():
            assert TEMPORARY_SUFFIX not in name and is_intact(data)


class TestExisting:
    def snapshot(self, folder: Path) -> dict[str, tuple[bytes, int]]:
        return {
            path.name: (path.read_bytes(), path.stat().st_mtime_ns) for path in folder.iterdir()
        }

    def test_frames_in_the_way_are_refused_and_left_alone(self, keys, exwarp, tmp_path):
        out = tmp_path / "out"
        shots.colour_only(out / "shot.0003.exr", TINY, 5)
        before = self.snapshot(out)
        result = exwarp("upsample", keys, "-o", out, "-m", "hold")
        result.refused(6, "frame 3 ", "--skip-existing", "--overwrite")
        assert self.snapshot(out) == before

    def test_masks_videos_and_reports_too(self, keys, exwarp, upsample, tmp_path):
        report, video = tmp_path / "report", tmp_path / "a.mp4"
        options = ("-m", "hold", "--report", report, "--video", video)
        upsample(keys, tmp_path / "out", *options)
        before = self.snapshot(report), video.read_bytes()
        for i, option in enumerate((("--report", report), ("--video", video))):
            fresh = tmp_path / f"fresh{i}"
            result = exwarp("upsample", keys, "-o", fresh, "-m", "hold", *option)
            result.refused(6, str(option[1]), "--overwrite")
            assert shots.names(fresh) == []
        assert (self.snapshot(report), video.read_bytes()) == before

    def test_only_frames_of_this_run_count(self, keys, upsample, tmp_path):
        upsample(keys, tmp_path / "out", "-m", "hold", "--frames", "1")
        upsample(keys, tmp_path / "out", "-m", "hold", "--frames", "2")
        assert len(shots.names(tmp_path / "out")) == 8

    def test_overwrite_replaces(self, keys, upsample, tmp_path):
        out = tmp_path / "out"
        upsample(keys, out, "-m", "hold")
        good = shots.contents(out)
        for name in good:
            (out / name).write_bytes(b"old")
        upsample(keys, out, "-m", "hold", "--overwrite")
        assert shots.contents(out) == good

    def test_the_input_is_never_overwritten(self, keys, exwarp):
        before = self.snapshot(keys)
        for output in (keys, keys / "shot.####.exr"):
            result = exwarp("upsample", keys, "-o", output, "-m", "hold", "--overwrite")
            result.refused(5, "input")
        assert self.snapshot(keys) == before


class TestOptions:
    @pytest.mark.parametrize(
        ("options", "words"),
        [
            (("--overwrite", "--skip-existing"), ("contradict",)),
            (("-m", "magic"), ("magic", "s6", "softsplat")),
            (("--compression", "rar"), ("rar", "zip", "piz")),
            (("--frames", "one-two"), ("one-two",)),
            (("--frames", ""), ("--frames",)),
            (("--frames", "1.5"), ("1.5",)),
            (("--fps", "fast"), ("fast",)),
            (("--fps", "0"), ("0",)),
            (("--threads", "0"), ("--threads",)),
            (("--threads", "two"), ("two",)),
            (("--start-frame", "a"), ("--start-frame",)),
            (("--progress", "loud"), ("loud", "plain")),
            (("--video", "a.avi"), ("a.avi", ".mp4")),
            (("--exposure", "much"), ("much",)),
            (("--video", "a.mov", "--video-codec", "av1"), ("av1", "h264", "hevc", "prores")),
            (("--video", "a.mp4", "--video-codec", "prores"), ("ProRes", "a.mp4", ".mov")),
            (("--view-transform", "filmic"), ("filmic", "srgb", "aces1", "aces2")),
            (("--view-transform", "/no.ocio:a:b"), ("/no.ocio:a:b", "OpenImageIO says")),
            (("--no-such-option",), ("--no-such-option", "exwarp upsample --help")),
        ],
    )
    def test_mistakes(self, keys, exwarp, tmp_path, monkeypatch, options, words):
        monkeypatch.chdir(tmp_path)
        options = ("-m", "hold", *options)
        exwarp("upsample", keys, "-o", tmp_path / "out", *options).refused(2, *words)
        assert shots.names(tmp_path) == []

    @pytest.mark.parametrize("output", ["one.exr", "frames.####.png", "movie.webm"])
    def test_outputs_that_are_no_sequence_of_exr_files(self, keys, exwarp, tmp_path, output):
        exwarp("upsample", keys, "-o", tmp_path / output, "-m", "hold").refused(2, output)
        assert shots.names(tmp_path) == []

    def test_masks_where_the_frames_go(self, keys, exwarp, tmp_path):
        out = tmp_path / "out"
        result = exwarp("upsample", keys, "-o", out, "-m", "hold", "--write-holes", out)
        result.refused(2, "--write-holes")
        assert not out.exists()

    def test_what_must_be_given(self, keys, exwarp):
        exwarp("upsample", keys).refused(2, "-o")
        exwarp("upsample", "-o", "x").refused(2, "SEQUENCE")
        exwarp("compare", keys).refused(2, "B")
        exwarp("inspect").refused(2, "SEQUENCE")
