"""Plain video: upsampled by estimated motion, into a video, stills or EXR."""

from __future__ import annotations

import json
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from exwarp_cli import cli
from exwarp_cli.io.video_reader import open_clip
from tests.cli import pictures, shots
from tests.cli.pictures import TEST_RATE, clip, frame, psnr, shown
from tests.cli.shots import changed_by, colour_of, contents, names, read

pytestmark = pytest.mark.usefixtures("unpainted_plots")

KEYS = 5


def panned(count: int, step: float = 1.0, seed: int = 0) -> list[np.ndarray]:
    return [frame(i * step, seed) for i in range(count)]


@pytest.fixture(scope="module")
def keys(tmp_path_factory) -> Path:
    """A clip of five frames with sound; read only."""
    return clip(tmp_path_factory.mktemp("keys") / "pan.mp4", panned(KEYS))


@pytest.fixture(scope="module")
def truth(tmp_path_factory) -> Path:
    """The same at four times the rate, up to the last frame; read only."""
    folder = tmp_path_factory.mktemp("truth")
    return clip(folder / "truth.mov", panned(4 * KEYS - 3, 0.25), 4 * TEST_RATE, sound=False)


@pytest.fixture(scope="module")
def made(keys, truth, tmp_path_factory) -> Path:
    """A folder with out.mp4, made of the clip and scored, and its report; read only."""
    folder = tmp_path_factory.mktemp("made")
    scored = ("--ground-truth", str(truth), "--report", str(folder / "report"))
    out = str(folder / "out.mp4")
    quiet = ("--progress", "none", "--threads", "1")
    assert cli.run(["upsample", str(keys), "-o", out, *scored, *quiet]) == 0
    return folder


@pytest.fixture(scope="module")
def whole(keys, tmp_path_factory) -> Path:
    """Its frames as stills; read only."""
    folder = tmp_path_factory.mktemp("whole")
    assert cli.run(["upsample", str(keys), "-o", str(folder), "--progress", "none"]) == 0
    return folder


class TestVideo:
    def test_frames_between_come_where_the_motion_leads(self, made):
        found = shown(made / "out.mp4")
        assert len(found) == 4 * KEYS
        between = [i for i in range(4, 12) if i % 4]
        assert min(psnr(frame(i / 4), found[i]) for i in between) > 38
        faded = frame(1) / 2 + frame(2) / 2
        assert psnr(frame(1.5), faded) < 30  # what a cross-fade has
        assert min(psnr(frame(i), found[4 * i]) for i in range(KEYS)) > 36

    def test_rate_and_sound_go_along(self, made):
        clip = open_clip(made / "out.mp4")
        assert clip.rate == 4 * TEST_RATE
        assert clip.look.sound is not None and clip.look.sound.codecs == ("aac",)
        assert clip.look.colour.transfer == "bt709"
        assert names(made) == ["out.mp4", "report"]

    def test_of_an_odd_rate_to_another(self, upsample, tmp_path):
        source = clip(tmp_path / "pan.mp4", panned(4), "24000/1001", sound=False)
        upsample(source, tmp_path / "out.mp4", "--to-fps", "59.94")
        made = open_clip(tmp_path / "out.mp4")
        assert made.rate == Fraction(60000, 1001)
        assert made.count == 10  # 4 intervals of 2.5
        found = shown(tmp_path / "out.mp4")
        assert psnr(frame(2), found[5]) > 36  # passed through
        assert psnr(frame(1.6), found[4]) > 30

    def test_sound_of_a_part_begins_with_it(self, upsample, keys, tmp_path):
        upsample(keys, tmp_path / "part.mp4", "-m", "hold", "--frames", "2")
        assert len(shown(tmp_path / "part.mp4")) == 4
        tone = pictures.ffmpeg("-i", tmp_path / "part.mp4", "-map", "0:a", "-f", "s16le", "-")
        whole = pictures.ffmpeg("-i", keys, "-map", "0:a", "-f", "s16le", "-")
        assert 0.15 < len(tone) / len(whole) < 0.6  # one frame of five; codecs cut in blocks
        upsample(keys, tmp_path / "gaps.mp4", "-m", "hold", "--frames", "1,3")
        assert open_clip(tmp_path / "gaps.mp4").look.sound is None

    def test_sound_is_left_out_where_the_rate_is_not_its_own(self, upsample, keys, tmp_path):
        options = ("-m", "hold", "--fps", 12, "--progress", "plain")
        said = upsample(keys, tmp_path / "slow.mp4", *options).err
        made = open_clip(tmp_path / "slow.mp4")
        assert made.rate == 48 and made.look.sound is None
        assert f"the sound of {keys}, as --fps 12 is not its own rate of 24" in said

    def test_sound_of_another_codec_is_encoded_again_and_said(self, upsample, keys, tmp_path):
        source = tmp_path / "pcm.mov"
        pictures.ffmpeg("-i", keys, "-c:v", "copy", "-c:a", "pcm_s16le", source)
        said = upsample(source, tmp_path / "out.mp4", "-m", "hold", "--progress", "plain").err
        assert f"sound track 1 (pcm_s16le) of {source} is encoded again as aac" in said

    def test_timecode_of_a_part_begins_with_it(self, upsample, keys, tmp_path):
        source = tmp_path / "tc.mov"
        pictures.ffmpeg("-i", keys, "-c", "copy", "-timecode", "01:00:00:22", source)
        upsample(source, tmp_path / "out.mov", "-m", "hold", "--frames", "2-4")
        code = open_clip(tmp_path / "out.mov").look.timecode
        assert code is not None and code.text == "01:00:00:92"  # frame 23 of 24, at 96

    def test_beside_frames(self, upsample, keys, tmp_path):
        """Also beside those that are there."""
        out, video = tmp_path / "out", tmp_path / "out.mov"
        how = (keys, out, "--video", video, "--no-tail", "--factor", 2)
        upsample(*how)
        was = shown(video)
        assert len(names(out)) == len(was) == 2 * KEYS - 1
        assert open_clip(video).look.sound is not None
        video.unlink()
        assert changed_by(lambda: upsample(*how, "--skip-existing"), out) == set()
        assert np.array_equal(shown(video), was)

    def test_a_good_one_is_kept(self, upsample, keys, tmp_path):
        out = tmp_path / "out.mp4"
        how = (keys, out, "-m", "hold", "--factor", 2)
        upsample(*how)
        written = out.stat().st_mtime_ns
        again = upsample(*how, "--skip-existing")
        assert "is there already" in again.out and out.stat().st_mtime_ns == written
        upsample(*how, "--skip-existing", "--exposure", 1)
        assert out.stat().st_mtime_ns != written

    def test_rendered_frames_can_become_one_alone(self, upsample, plain_shot, tmp_path):
        upsample(plain_shot, tmp_path / "out.mp4", "-m", "s6", "--motion", "next=u,-v")
        assert names(tmp_path) == ["out.mp4"]
        assert open_clip(tmp_path / "out.mp4").count == 12


class TestFrames:
    def test_become_png_named_after_the_clip(self, keys, whole):
        assert names(whole) == [f"pan.{n:04d}.png" for n in range(1, 4 * KEYS + 1)]
        decoded = shown(keys)
        for i in range(KEYS):
            passed = pictures.codes_of(whole / f"pan.{4 * i + 1:04d}.png")
            assert passed.dtype == np.uint8 and (passed == decoded[i]).all()

    def test_are_half_and_linear_in_exr(self, upsample, keys, tmp_path):
        upsample(keys, tmp_path / "a.###.exr", "--frames", 2, "--compression", "piz")
        header, planes = read(tmp_path / "a.006.exr")
        assert set(planes) == set("RGB") and planes["R"].dtype == np.float16
        assert header["framesPerSecond"] == 4 * TEST_RATE
        code = frame(1.0) / 255
        linear = np.where(code <= 0.04045, code / 12.92, ((code + 0.055) / 1.055) ** 2.4)
        assert np.abs(colour_of(tmp_path / "a.005.exr") - linear).max() < 0.02

    def test_are_the_same_in_parts_and_resumed(self, upsample, keys, whole, tmp_path):
        parts = tmp_path / "parts"
        for part in ("4-5", "1-3"):
            upsample(keys, parts, "--frames", part)
        assert contents(whole) == contents(parts)
        shots.truncate(parts / "pan.0006.png")
        (parts / "pan.0009.png").unlink()
        made = changed_by(lambda: upsample(keys, parts, "--skip-existing"), parts)
        assert made == {6, 9} and contents(whole) == contents(parts)

    def test_of_a_causal_method_know_nothing_of_what_comes(self, upsample, tmp_path):
        ends = {"on": frame(2), "back": frame(0)}
        for name, end in ends.items():
            (tmp_path / name).mkdir()
            source = clip(tmp_path / name / "pan.mkv", [*panned(2), end], sound=False)
            upsample(source, tmp_path / f"{name}.out", "-m", "s6", "--frames", "1-2")
        for number in range(1, 9):
            codes = (
                pictures.codes_of(tmp_path / f"{name}.out/pan.{number:04d}.png") for name in ends
            )
            assert np.array_equal(*codes)

    def test_the_first_interval_of_a_causal_method_repeats(self, upsample, keys, tmp_path):
        upsample(keys, tmp_path / "out", "-m", "s6", "--report", tmp_path / "report")
        document = json.loads((tmp_path / "report" / "report.json").read_text())
        assert document["frames"]["dropped"] == 3 and document["decisions"]["warp_share"] is None
        moved = pictures.codes_of(tmp_path / "out" / "pan.0007.png")
        assert psnr(frame(1.5), moved) > 30


class TestAlpha:
    @pytest.fixture
    def clear(self, tmp_path) -> Path:
        """Two frames of one colour in ProRes 4444: the left half opaque, the right one half so."""
        path = tmp_path / "keys" / "clear.mov"
        path.parent.mkdir()
        codes = "r=48316:g=48316:b=48316:a='if(lt(X,32),65535,32896)'"
        grey = f"color=white:s=64x48:r=24,format=rgba64le,geq={codes}"
        coded = ("-c:v", "prores_ks", "-profile:v", "4444", "-pix_fmt", "yuva444p10le")
        pictures.ffmpeg("-f", "lavfi", "-i", grey, "-frames:v", 2, *coded, path)
        return path

    def test_is_kept_in_frames(self, upsample, clear, tmp_path):
        upsample(clear, tmp_path / "out")
        upsample(clear, tmp_path / "exr" / "a.####.exr", "-m", "blend")
        for number in range(1, 9):
            codes = pictures.codes_of(tmp_path / "out" / f"clear.{number:04d}.png")
            assert codes.dtype == np.uint16 and codes.shape[-1] == 4
            assert (codes[8:40, 8, 3] == 65535).all()  # 1023 of 10 bits is opaque
            for column, alpha in ((8, 1.0), (56, 128 / 255)):
                assert np.allclose(
                    codes[8:40, column] / 65535, (188 / 255,) * 3 + (alpha,), atol=0.02
                )
        light = colour_of(tmp_path / "exr" / "a.0002.exr")
        assert np.allclose(light[8:40, 56], (0.25, 0.25, 0.25, 0.5), atol=0.02)

    def test_is_said_to_be_lost_where_the_target_has_none(self, upsample, clear, tmp_path):
        plain = ("-m", "hold", "--progress", "plain")
        said = upsample(clear, tmp_path / "out.mp4", *plain).err
        assert f"the alpha of {clear} is left out of the video, which has none" in said
        said = upsample(clear, tmp_path / "a.####.jpg", *plain).err
        assert f"the alpha of {clear} is left out, as .jpg files have none" in said
        assert "alpha" not in upsample(clear, tmp_path / "a.####.png", *plain).err
        folder = f"{tmp_path / 'new.jpg'}/"  # of PNG frames
        assert "alpha" not in upsample(clear, folder, "--dry-run", *plain).err


class TestFields:
    def test_an_option_says_how_they_are_read(self, exwarp, upsample, tmp_path):
        source = tmp_path / "fields.mov"
        fields = ("-vf", "tinterlace=interleave_top", "-c:v", "mpeg2video", "-flags", "+ildct+ilme")
        pictures.ffmpeg("-f", "lavfi", "-i", "testsrc2=s=64x48:r=50:d=0.2", *fields, source)
        result = exwarp("upsample", source, "-o", tmp_path / "out.mp4")
        result.refused(3, "is interlaced", "--scan deinterlace, or --scan progressive")
        exwarp("inspect", source).refused(3, "--scan deinterlace")
        exwarp("compare", source, source).refused(3, "--scan deinterlace")
        for scan in ("progressive", "deinterlace"):
            upsample(source, tmp_path / scan, "--scan", scan, "-m", "hold")
            assert exwarp("inspect", source, "--scan", scan).code == 0
            assert exwarp("compare", source, source, "--scan", scan).code == 0
        woven, single = (
            pictures.codes_of(tmp_path / scan / "fields.0005.png")
            for scan in ("progressive", "deinterlace")
        )
        assert not np.array_equal(woven, single)

    def test_frames_read_in_another_way_are_not_kept(self, upsample, tmp_path):
        source = tmp_path / "fields.mov"
        fields = ("-vf", "tinterlace=interleave_top", "-c:v", "mpeg2video", "-flags", "+ildct+ilme")
        pictures.ffmpeg("-f", "lavfi", "-i", "testsrc2=s=64x48:r=50:d=0.1", *fields, source)
        out = tmp_path / "out"
        upsample(source, out, "--scan", "progressive", "-m", "blend")
        again = ("--scan", "deinterlace", "-m", "blend", "--skip-existing")
        assert changed_by(lambda: upsample(source, out, *again), out) == set(range(1, 9))


class TestDamage:
    def test_a_glitch_loses_its_group_of_pictures_alone(self, exwarp, tmp_path):
        good = clip(tmp_path / "pan.ts", [frame(i / 4, seed=i) for i in range(24)], sound=False)
        whole, data = shown(good), bytearray(good.read_bytes())
        noise = np.random.default_rng(1).integers(0, 256, 200, np.uint8).tobytes()
        data[len(data) // 2 : len(data) // 2 + 200] = noise
        good.write_bytes(data)
        quiet = ("-m", "blend", "--factor", 2, "--progress", "none")
        result = exwarp("upsample", good, "-o", tmp_path / "out", *quiet, "--keep-going")
        kept = {int(name[4:8]) for name in names(tmp_path / "out")}
        keys = {(number + 1) // 2 for number in kept if number % 2}
        lost = set(range(1, 25)) - keys
        first = min(lost)
        assert first > 1 and len(lost) <= 5  # groups have 4 frames
        assert f"frame {first} of 24 is damaged" in result.err
        for number in keys:
            codes = pictures.codes_of(tmp_path / "out" / f"pan.{2 * number - 1:04d}.png")
            assert np.array_equal(codes, whole[number - 1]), number
        stopped = exwarp("upsample", good, "-o", tmp_path / "stopped", *quiet)
        stopped.refused(3, f"frame {first} of 24 is damaged")


class TestCuts:
    def test_nothing_is_taken_across(self, upsample, tmp_path):
        source = clip(tmp_path / "two.mp4", [*panned(3), *panned(3, seed=7)], sound=False)
        report = tmp_path / "report"
        said = upsample(source, tmp_path / "out", "--report", report).out
        assert "cut before key frame 4 (detected)" in said
        document = json.loads((report / "report.json").read_text())
        assert document["cuts"] == [{"frame": 4, "source": "detected"}]
        for name, seed, first in (("before", 0, 0), ("after", 7, 12)):
            alone = clip(tmp_path / f"{name}.mp4", panned(3, seed=seed), sound=False)
            upsample(alone, tmp_path / name)
            for i in range(1, 13):
                codes = pictures.codes_of(tmp_path / "out" / f"two.{first + i:04d}.png")
                expected = pictures.codes_of(tmp_path / name / f"{name}.{i:04d}.png")
                assert np.array_equal(codes, expected), (name, i)


class TestSaying:
    def test_that_motion_is_estimated(self, upsample, keys, tmp_path):
        said = upsample(keys, tmp_path / "out.mp4", "--frames", 1, "--progress", "plain").err
        assert "5 key frames at 24 fps (file), no AOVs" in said
        assert "motion estimated: from colour" in said

    def test_in_the_report(self, made):
        report = made / "report"
        document = json.loads((report / "report.json").read_text())
        assert document["method"] == "exwarp" and document["fps"]["source"] == "file"
        assert document["input"]["motion"]["source"] == "estimated"
        assert document["input"]["producer"] == "video"
        assert document["quality"]["all"]["frames"] == 3 * (KEYS - 1)
        assert document["quality"]["all"]["psnr_db"] > 25
        page = (report / "report.html").read_text()
        assert "from colour by optical flow" in page

    def test_what_a_clip_is(self, exwarp, keys):
        said = exwarp("inspect", keys)
        assert said.code == 0, said.err
        for words in ("5 frames (1-5), 64x48, 24 fps (file)", "sound aac", "estimates motion"):
            assert words in said.out
        document = json.loads(exwarp("inspect", keys, "--json").out)
        assert document["motion"] is None and document["pictures"]["kind"] == "video"


class TestRefusals:
    @pytest.mark.parametrize(
        ("options", "code", "words"),
        [
            (("-m", "causal"), 3, "colour alone; use --method softsplat or s6"),
            (("-m", "s3"), 3, "depth, normals and materials"),
            (("--gbuffers", "slots"), 2, "--gbuffers is for rendered EXR frames"),
            (("--motion", "blender"), 2, "--motion is for rendered EXR frames"),
            (("--view", "left"), 2, "--view is for rendered EXR frames"),
            (("--layers", "all"), 2, "--layers is for EXR"),
            (("--compression", "piz", "-o", "a.####.png"), 2, "--compression is for EXR"),
            (("-o", "out.webm"), 2, "neither .mp4 nor .mov"),
            (("-o", "out.mp4", "--video", "b.mp4"), 2, "-o names a video already"),
            (("-o", "out.####.gif"), 2, "a pattern such as out.####.png"),
        ],
    )
    def test_are_one_sentence(self, exwarp, keys, tmp_path, monkeypatch, options, code, words):
        monkeypatch.chdir(tmp_path)
        quiet = ("--progress", "none")
        exwarp("upsample", keys, "-o", "out", *quiet, *options).refused(code, words)
        assert names(tmp_path) == []

    @pytest.mark.parametrize(
        ("name", "words"),
        [
            ("voice.wav", "voice.wav is sound, which has no frames; name a video or frames"),
            ("voice.mp4", "voice.mp4 holds no picture, only sound; name a video or frames"),
            ("scene.blend", "scene.blend is of a kind that is not read; convert it to one of"),
        ],
    )
    def test_files_without_a_picture_are_named_as_what_they_are(
        self, exwarp, tmp_path, name, words
    ):
        if name.startswith("voice"):
            pictures.ffmpeg("-f", "lavfi", "-i", "sine=d=0.1", tmp_path / name)
        else:
            (tmp_path / name).write_bytes(b"BLENDER")
        exwarp("upsample", tmp_path / name, "-o", tmp_path / "out").refused(3, words)
        exwarp("inspect", tmp_path / name).refused(3, words)

    def test_the_input_itself_is_not_overwritten(self, exwarp, tmp_path):
        source = clip(tmp_path / "pan.mp4", panned(2), sound=False)
        was = source.read_bytes()
        exwarp("upsample", source, "-o", source, "--overwrite").refused(5, "is the input itself")
        exwarp("upsample", source, "-o", tmp_path / "other.mp4", "-m", "hold", "--fps", 30)
        exwarp("upsample", source, "-o", tmp_path / "other.mp4").refused(6, "another -o")
        assert source.read_bytes() == was

    def test_a_clip_that_ends_early_leaves_no_video(self, exwarp, tmp_path):
        source = clip(tmp_path / "pan.mkv", panned(12), sound=False)
        data = source.read_bytes()
        source.write_bytes(data[: len(data) * 2 // 3])
        quiet = ("-m", "hold", "--progress", "none")
        result = exwarp("upsample", source, "-o", tmp_path / "out.mp4", *quiet)
        if result.code:  # the container may hide it, as a shorter video
            result.refused(3, "cannot read the video")
            assert names(tmp_path) == ["pan.mkv"]
        else:
            assert 4 <= len(shown(tmp_path / "out.mp4")) < 48


def test_a_cross_fade_needs_no_motion(upsample, keys, tmp_path):
    upsample(keys, tmp_path / "out.mp4", "-m", "blend")
    found = shown(tmp_path / "out.mp4")
    faded = frame(1) / 2 + frame(2) / 2
    assert psnr(faded, found[6]) > 28
