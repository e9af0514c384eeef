"""What --skip-existing replaces: ExWarp's own frames, and never a person's work."""

from __future__ import annotations

import json
import os
import shutil
from fractions import Fraction
from pathlib import Path

import OpenEXR
import pytest

from tests.cli import pictures, shots
from tests.cli.conftest import run_quietly
from tests.cli.street import Street
from tests.matrix import spread

HOW = ("-m", "softsplat", *shots.FORWARD)


@pytest.fixture
def keys(plain_shot, tmp_path) -> Path:
    """Three key frames that a test may change."""
    return Path(shutil.copytree(plain_shot, tmp_path / "keys"))


@pytest.fixture(scope="module")
def finished(plain_shot, tmp_path_factory) -> Path:
    """The frames of a whole run; read only."""
    out = tmp_path_factory.mktemp("finished") / "out"
    run_quietly("upsample", plain_shot, "-o", out, *HOW)
    return out


@pytest.fixture
def out(finished, tmp_path) -> Path:
    """The frames of a whole run, which a test may change."""
    return Path(shutil.copytree(finished, tmp_path / "out"))


def paint(path: Path, **more: object) -> bytes:
    """Save a frame again with other pixels, as a compositor does that keeps all attributes."""
    with OpenEXR.File(str(path), separate_channels=True) as file:
        part = file.parts[0]
        header = dict(part.header) | more
        planes = {name: channel.pixels.copy() for name, channel in part.channels.items()}
    planes["G"][3:9, 5:11] = 0.25
    OpenEXR.File(header, planes).write(str(path))
    return path.read_bytes()


def rated(source: Path) -> bytes:
    """Return the bytes that a run writes for a key frame."""
    return shots.passed_through(source, 120)


def render_again(keys: Path, number: int, seconds: float = 0.25) -> None:
    """Replace a key frame by another render of it."""
    shots.plain(keys / f"shot.{number:04d}.exr", Street(), number + seconds)


class TestRefused:
    """Exit 6 before any work, with the names; --overwrite is the word for replacing."""

    def refused(self, exwarp, keys, out, *words: str, how=HOW) -> None:
        before = {name: (out / name).stat().st_mtime_ns for name in shots.names(out)}
        (out / "shot.0004.exr").unlink(missing_ok=True)  # there is something to make
        result = exwarp("upsample", keys, "-o", out, *how, "--skip-existing", "--progress", "none")
        result.refused(6, *words, "--overwrite")
        del before["shot.0004.exr"]
        after = {name: (out / name).stat().st_mtime_ns for name in shots.names(out)}
        assert after == before

    def test_a_paint_fix_that_keeps_our_attributes(self, exwarp, upsample, keys, out):
        fix = paint(out / "shot.0003.exr")
        self.refused(exwarp, keys, out, "1 file", "shot.0003.exr (changed since ExWarp wrote it)")
        assert (out / "shot.0003.exr").read_bytes() == fix
        upsample(keys, out, *HOW, "--overwrite")
        assert (out / "shot.0003.exr").read_bytes() != fix

    def test_a_paint_fix_without_them(self, exwarp, keys, out):
        shots.colour_only(out / "shot.0007.exr", Street(), 2.0)
        self.refused(exwarp, keys, out, "shot.0007.exr (not written by ExWarp)")

    def test_a_paint_fix_of_a_key_frame(self, exwarp, keys, out):
        paint(out / "shot.0005.exr")
        self.refused(exwarp, keys, out, "shot.0005.exr (not written by ExWarp)")

    def test_a_paint_fix_of_a_key_frame_that_was_rendered_again(self, exwarp, keys, out):
        paint(out / "shot.0005.exr")
        render_again(keys, 2)
        self.refused(exwarp, keys, out, "shot.0005.exr (not written by ExWarp)")

    def test_frames_of_another_method(self, exwarp, keys, out):
        how = ("-m", "s6", *shots.FORWARD)
        word = "made by softsplat and not by s6"
        self.refused(exwarp, keys, out, "8 files", f"({word})", "and 4 more", how=how)

    def test_what_is_no_picture(self, exwarp, keys, out):
        (out / "shot.0006.exr").write_bytes(b"notes of a supervisor")
        self.refused(exwarp, keys, out, "shot.0006.exr (not written by ExWarp)")

    def test_a_hole_mask_that_was_edited(self, exwarp, upsample, keys, out, tmp_path):
        masks = tmp_path / "masks"
        how = (*HOW, "--write-holes", masks)
        upsample(keys, out, *how, "--skip-existing")
        with OpenEXR.File(str(masks / "shot.0003.exr")) as file:
            header, plane = dict(file.header()), file.channels()["holes"].pixels.copy()
        plane[:] = 1
        OpenEXR.File(header, {"holes": plane}).write(str(masks / "shot.0003.exr"))
        self.refused(exwarp, keys, out, "shot.0003.exr (changed since", how=how)

    def test_a_dry_run_refuses_too(self, exwarp, keys, out):
        paint(out / "shot.0003.exr")
        result = exwarp("upsample", keys, "-o", out, *HOW, "--skip-existing", "--dry-run")
        result.refused(6, "shot.0003.exr (changed since ExWarp wrote it)")

    def test_a_byte_that_flipped_and_still_decodes_may_be_an_edit(self, exwarp, keys, out):
        data = bytearray((out / "shot.0003.exr").read_bytes())
        data[data.index(b"Ada")] ^= 1  # the owner
        (out / "shot.0003.exr").write_bytes(data)
        self.refused(exwarp, keys, out, "shot.0003.exr (changed since ExWarp wrote it)")

    @pytest.mark.parametrize("alone", [True, False])
    def test_a_video_of_another_program(self, exwarp, upsample, keys, out, tmp_path, alone):
        video = tmp_path / "a.mp4"
        how = ("-o", video) if alone else ("-o", out, "--video", video)
        quiet = (*HOW, "--skip-existing", "--progress", "none")
        for options in ((), ("--exposure", 1)):  # its own is replaced
            assert exwarp("upsample", keys, *how, *quiet, *options).code == 0
        pictures.clip(video.with_suffix(".mkv"), [pictures.frame(i) for i in range(4)], sound=False)
        foreign = video.with_suffix(".mkv").rename(video).read_bytes()
        result = exwarp("upsample", keys, *how, *quiet)
        result.refused(6, "a.mp4 (not written by ExWarp)")
        assert video.read_bytes() == foreign


class TestReplaced:
    """What ExWarp wrote itself is made again where it is stale or damaged."""

    def again(self, upsample, keys, out, how=HOW) -> set[int]:
        return shots.changed_by(lambda: upsample(keys, out, *how, "--skip-existing"), out)

    def fresh(self, upsample, keys, tmp_path, how=HOW) -> dict[str, bytes]:
        upsample(keys, tmp_path / "fresh", *how)
        return shots.contents(tmp_path / "fresh")

    def test_a_key_frame_that_was_rendered_again(self, upsample, keys, out, tmp_path):
        render_again(keys, 2)
        # The frames after key frame 3 carry light on from it.
        assert self.again(upsample, keys, out) == {2, 3, 4, 5, 6, 7, 8, 10, 11, 12}
        assert shots.contents(out) == self.fresh(upsample, keys, tmp_path)

    def test_it_is_known_by_the_frames_before_it_alone(self, upsample, keys, out, tmp_path):
        render_again(keys, 2)
        for number in (6, 7, 8):
            (out / f"shot.{number:04d}.exr").unlink()
        self.again(upsample, keys, out)
        assert shots.contents(out) == self.fresh(upsample, keys, tmp_path)

    @pytest.mark.parametrize(
        "split", spread([("3", "2", "1"), ("1", "2", "3"), ("1-3",), ("1", "2-3"), ("2-3", "1")], 2)
    )
    def test_any_split_replaces_the_same(self, upsample, keys, out, tmp_path, split):
        for number in (1, 2, 3):
            render_again(keys, number)
        for frames in split:
            upsample(keys, out, *HOW, "--skip-existing", "--frames", frames)
        assert shots.contents(out) == self.fresh(upsample, keys, tmp_path)

    @pytest.mark.parametrize("method", ["s6", "softsplat", "hold"])
    def test_the_last_key_frame_without_a_tail(self, upsample, keys, tmp_path, method):
        how, out = ("-m", method, *shots.FORWARD, "--no-tail"), tmp_path / "out"
        upsample(keys, out, *how)
        render_again(keys, 3)
        assert 9 in self.again(upsample, keys, out, how)
        assert shots.contents(out) == self.fresh(upsample, keys, tmp_path, how)

    def test_a_kill_between_leaves_it_known(self, upsample, keys, out, tmp_path, monkeypatch):
        """The old copy of a key frame goes before the frames that name it."""
        from exwarp_cli.pipeline.slot_renderer import SlotRenderer

        render_again(keys, 2)
        render, count = SlotRenderer.render, 0

        def killed(self, *args, **more):
            nonlocal count
            count += 1
            if count > 5:
                raise KeyboardInterrupt
            return render(self, *args, **more)

        monkeypatch.setattr(SlotRenderer, "render", killed)
        with pytest.raises(AssertionError):
            upsample(keys, out, *HOW, "--skip-existing", "--threads", 1)
        monkeypatch.setattr(SlotRenderer, "render", render)
        assert (out / "shot.0005.exr").read_bytes() == rated(keys / "shot.0002.exr")
        self.again(upsample, keys, out)
        assert shots.contents(out) == self.fresh(upsample, keys, tmp_path)

    @pytest.mark.parametrize("left", [0.1, 0.5, 0.99])
    def test_a_key_frame_whose_copy_was_broken_off(self, upsample, keys, out, left):
        good = shots.contents(out)
        copy = out / "shot.0005.exr"
        data = copy.read_bytes()
        part = data[: int(len(data) * left)]
        copy.write_bytes(part + bytes(len(data) - len(part)))
        assert self.again(upsample, keys, out) == {5}
        copy.write_bytes(part)
        assert self.again(upsample, keys, out) == {5}
        assert shots.contents(out) == good

    @pytest.mark.parametrize("content", [b"", bytes(5000)], ids=["empty", "zeros"])
    def test_what_a_power_cut_leaves(self, upsample, keys, out, content):
        good = shots.contents(out)
        for number in (3, 5):
            (out / f"shot.{number:04d}.exr").write_bytes(content)
        assert self.again(upsample, keys, out) == {3, 5}
        assert shots.contents(out) == good

    def test_a_key_frame_that_lies_where_a_new_frame_belongs(self, upsample, keys, out):
        """As after a run at another rate."""
        good = shots.contents(out)
        shutil.copy(keys / "shot.0002.exr", out / "shot.0003.exr")
        assert self.again(upsample, keys, out) == {3}
        assert shots.contents(out) == good

    def test_only_the_frames_of_this_run_are_looked_at(self, upsample, keys, out):
        paint(out / "shot.0011.exr")
        (out / "shot.0003.exr").unlink()
        how = (*HOW, "--frames", "1-2")
        assert self.again(upsample, keys, out, how) == {3}

    def test_the_frames_after_the_last_key_frame_are_of_the_run_that_wrote_them(
        self, exwarp, upsample, keys, out
    ):
        """They are made by s6 for softsplat, and are not taken for frames of a run with s6."""
        assert self.again(upsample, keys, out, (*HOW, "--fps", 25)) == {*range(1, 13)}
        how = ("-m", "s6", *shots.FORWARD, "--frames", "3", "--skip-existing")
        exwarp("upsample", keys, "-o", out, *how).refused(6, "shot.0010.exr (made by softsplat")


class TestFramesOfEarlierBuilds:
    """They name neither the run's method nor the digests of key frames."""

    @pytest.fixture(autouse=True)
    def earlier(self, monkeypatch):
        from exwarp_cli.pipeline.slot_renderer import SlotRenderer

        attributes = SlotRenderer._attributes

        def fewer(self, *args):
            new = ("exwarp:keyFrames", "exwarp:requestedMethod")
            return {k: v for k, v in attributes(self, *args).items() if k not in new}

        monkeypatch.setattr(SlotRenderer, "_attributes", fewer)

    @pytest.fixture
    def out(self, earlier, keys, upsample, tmp_path) -> Path:
        upsample(keys, tmp_path / "out", *HOW)
        return tmp_path / "out"

    def test_the_method_of_each_frame_counts(self, exwarp, upsample, keys, out):
        how = ("--skip-existing", "--fps", 25)
        upsample(keys, out, *HOW, *how)
        result = exwarp("upsample", keys, "-o", out, "-m", "s6", *shots.FORWARD, *how)
        result.refused(6, "6 files", "shot.0002.exr (made by softsplat and not by s6)")

    def test_a_key_frame_as_old_as_they_is_replaced(self, upsample, keys, out):
        render_again(keys, 2)
        upsample(keys, out, *HOW, "--skip-existing")
        assert (out / "shot.0005.exr").read_bytes() == rated(keys / "shot.0002.exr")

    def test_a_newer_key_frame_is_not(self, exwarp, keys, out):
        paint(out / "shot.0005.exr")
        for path in out.iterdir():
            if path.name != "shot.0005.exr":
                os.utime(path, (10**9, 10**9))
        result = exwarp("upsample", keys, "-o", out, *HOW, "--skip-existing")
        result.refused(6, "shot.0005.exr (not written by ExWarp)")


class TestStills:
    @pytest.fixture
    def pan(self, tmp_path) -> Path:
        return pictures.stills(tmp_path / "pan", map(pictures.frame, range(3)))

    def run(self, exwarp, keys, out):
        return exwarp("upsample", keys, "-o", out, "-m", "blend", "--skip-existing")

    def test_a_png_that_was_edited_is_kept(self, exwarp, upsample, pan, tmp_path):
        out = tmp_path / "out"
        upsample(pan, out, "-m", "blend")
        pictures.write_still(out / "pan.0003.png", pictures.frame(7))
        self.run(exwarp, pan, out).refused(6, "pan.0003.png (not written by ExWarp)")

    def test_a_png_whose_text_another_program_kept(self, exwarp, upsample, pan, tmp_path):
        import OpenImageIO as oiio

        out = tmp_path / "out"
        upsample(pan, out, "-m", "blend")
        image = oiio.ImageBuf(str(out / "pan.0003.png"))
        oiio.ImageBufAlgo.fill(image, (1.0, 0.0, 0.0), oiio.ROI(0, 9, 0, 9, 0, 1, 0, 3))
        assert image.write(str(out / "pan.0003.png"))
        self.run(exwarp, pan, out).refused(6, "pan.0003.png (changed since ExWarp wrote it)")

    @pytest.mark.parametrize("suffix", [".dpx", ".tga"])
    def test_formats_that_keep_the_program_s_name(self, exwarp, upsample, tmp_path, suffix):
        keys = pictures.stills(tmp_path / "k", map(pictures.frame, range(3)), suffix)
        out = tmp_path / "out"
        upsample(keys, out, "-m", "blend")
        good = shots.contents(out)
        (out / f"pan.0003{suffix}").unlink()
        assert self.run(exwarp, keys, out).code == 0 and shots.contents(out) == good
        pictures.write_still(out / f"pan.0003{suffix}", pictures.frame(7))
        self.run(exwarp, keys, out).refused(6, f"pan.0003{suffix} (not written by ExWarp)")

    def test_formats_that_keep_nothing(self, exwarp, upsample, tmp_path):
        keys = pictures.stills(tmp_path / "k", map(pictures.frame, range(3)), ".bmp")
        out = tmp_path / "out"
        upsample(keys, out, "-m", "blend")
        self.run(exwarp, keys, out).refused(6, "pan.0002.bmp (not written by ExWarp)")


class TestCounts:
    def test_what_was_kept_made_and_replaced(self, upsample, keys, out, tmp_path):
        (out / "shot.0002.exr").unlink()
        shots.truncate(out / "shot.0007.exr")
        report = tmp_path / "report"
        result = upsample(keys, out, *HOW, "--skip-existing", "--report", report)
        assert "10 kept of an earlier run, 1 made, 1 replaced" in result.out
        frames = json.loads((report / "report.json").read_text())["frames"]
        assert (frames["resumed"], frames["made"], frames["replaced"]) == (10, 1, 1)

    def test_overwriting_replaces(self, upsample, keys, out):
        result = upsample(keys, out, *HOW, "--overwrite")
        assert "0 kept of an earlier run, 0 made, 12 replaced" in result.out

    def test_time_saved_is_that_of_what_was_made(self, upsample, tmp_path):
        def timed(path: Path, street: Street, time: float) -> None:
            head = shots.header(framesPerSecond=Fraction(30), RenderTime="0:01:40")
            shots.write(path, {"": shots.plain_planes(street, time)}, head)

        keys = shots.sequence(tmp_path / "keys", timed, range(1, 4), shots.SMALL)
        out = tmp_path / "out"
        upsample(keys, out, *HOW)
        (out / "shot.0002.exr").unlink()
        found = json.loads(upsample(keys, out, *HOW, "--skip-existing", "--json").out)[
            "render_time"
        ]
        assert 90 < found["saved_s"] < 100  # one frame, and not nine
        assert 0.4 < found["saved_share"] < 0.5  # of it and its key frame


def test_key_frames_that_exwarp_made_itself_may_be_painted_again(upsample, keys, out, tmp_path):
    """A second run on the frames of a first one, between which an artist works."""
    slow = tmp_path / "slow"
    slow.mkdir()
    for number in range(1, 4):
        shutil.copy(out / f"shot.{number + 1:04d}.exr", slow / f"shot.{number:04d}.exr")
    paint(slow / "shot.0002.exr")
    upsample(slow, tmp_path / "twice", "-m", "hold", "--factor", 2)
    paint(slow / "shot.0002.exr", owner="Bea")
    upsample(slow, tmp_path / "twice", "-m", "hold", "--factor", 2, "--skip-existing")
    passed = tmp_path / "twice" / "shot.0003.exr"
    assert passed.read_bytes() == shots.passed_through(slow / "shot.0002.exr", 240)
