"""A video of rendered frames shows the colours and the pixels that their headers describe."""

import base64
import io
import json
import re
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from exwarp_cli.io.video_reader import open_clip
from exwarp_cli.io.video_writer import read_video_note
from exwarp_cli.io.view_transform import find_view_transform
from tests.blender_layers import HALF, layer
from tests.cli import pictures, shots
from tests.unit.test_video import decode, ffmpeg

pytestmark = pytest.mark.usefixtures("unpainted_plots")

WIDTH, HEIGHT = 64, 32  # libx265 of ffmpeg 9 crashes at widths of 40 and 48

ACESCG = (0.713, 0.293, 0.165, 0.830, 0.128, 0.044, 0.32168, 0.33767)
REC709_TO_ACESCG = [  # as OpenColorIO's built-in transforms have it
    [0.61309740, 0.33952315, 0.04737945],
    [0.07019372, 0.91635388, 0.01345240],
    [0.02061559, 0.10956977, 0.86981463],
]
SHOWN = (0.6, 0.1, 0.05)
"""Scene-linear, Rec. 709."""


def code(linear: float) -> int:
    """The sRGB code of a value above the curve's toe (IEC 61966-2-1)."""
    return round(255 * (1.055 * linear ** (1 / 2.4) - 0.055))


def flat(folder: Path, colour: Any, **attributes: Any) -> Path:
    """Write three frames of one colour."""
    image = np.broadcast_to(np.append(colour, 1.0), (HEIGHT, WIDTH, 4))
    plain = {k: v for k, v in shots.HEADER.items() if k != "chromaticities"}
    for number in (1, 2, 3):
        path = folder / f"s.{number:04d}.exr"
        shots.write(path, {"": layer("", "RGBA", image, HALF)}, plain | attributes)
    return folder


@pytest.mark.parametrize(
    ("colour", "attributes"),
    [
        (SHOWN, {}),
        (SHOWN, {"chromaticities": shots.HEADER["chromaticities"]}),
        (np.array(REC709_TO_ACESCG) @ SHOWN, {"chromaticities": ACESCG}),
    ],
    ids=["none", "rec709", "acescg"],
)
def test_primaries_of_the_header_are_converted(upsample, tmp_path, colour, attributes):
    keys, video = flat(tmp_path / "keys", colour, **attributes), tmp_path / "a.mp4"
    upsample(keys, tmp_path / "out", "-m", "hold", "--video", video)
    expected = [code(value) for value in SHOWN]
    assert np.abs(decode(video, WIDTH, HEIGHT) - np.array(expected, float)).max() <= 3


def test_grey_stays_grey(upsample, tmp_path):
    video = tmp_path / "a.mp4"
    keys = flat(tmp_path / "keys", [0.2] * 3, chromaticities=ACESCG)
    upsample(keys, tmp_path / "out", "-m", "hold", "--video", video)
    assert np.abs(decode(video, WIDTH, HEIGHT) - float(code(0.2))).max() <= 1


def test_an_adopted_neutral_becomes_grey(upsample, tmp_path):
    """Light of that chromaticity, here the white of D50, is white on the display."""
    x, y = 0.3457, 0.3585
    to_xyz = np.array(  # of Rec. 709, as IEC 61966-2-1 prints it
        [[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]
    )
    colour = 0.2 * np.linalg.inv(to_xyz) @ [x / y, 1.0, (1 - x - y) / y]
    rec709 = shots.HEADER["chromaticities"]
    keys = flat(tmp_path / "keys", colour, chromaticities=rec709, adoptedNeutral=(x, y))
    upsample(keys, tmp_path / "out", "-m", "hold", "--video", tmp_path / "a.mp4")
    assert np.abs(decode(tmp_path / "a.mp4", WIDTH, HEIGHT) - float(code(0.2))).max() <= 2


def test_it_is_said_and_only_of_a_video(exwarp, tmp_path):
    keys = flat(tmp_path / "keys", SHOWN, chromaticities=ACESCG)
    options = ("--progress", "plain", "-m", "hold", "--threads", 1)
    video = exwarp("upsample", keys, "-o", tmp_path / "a.mp4", *options)
    frames = exwarp("upsample", keys, "-o", tmp_path / "out", *options)
    assert video.code == frames.code == 0
    assert "the video is converted from ACEScg, as the header says, to Rec. 709" in video.err
    assert "converted" not in frames.err


@pytest.mark.parametrize(
    "chromaticities",
    [(0.64, 0.0, 0.3, 0.6, 0.15, 0.06, 0.3127, 0.329), (0.3,) * 8, (float("nan"),) * 8],
    ids=["y is 0", "one colour", "nan"],
)
def test_chromaticities_that_no_colours_have_do_not_matter(upsample, tmp_path, chromaticities):
    keys = flat(tmp_path / "keys", SHOWN, chromaticities=chromaticities)
    upsample(keys, tmp_path / "out", "-m", "hold", "--video", tmp_path / "a.mp4")
    expected = [code(value) for value in SHOWN]
    shown = decode(tmp_path / "a.mp4", WIDTH, HEIGHT)
    assert np.abs(shown - np.array(expected, float)).max() <= 3


@pytest.mark.parametrize(
    ("ratio", "aspect"), [(2.0, 2), (16 / 15, Fraction(16, 15)), (1.0, 1)], ids=str
)
def test_the_shape_of_pixels_goes_along(upsample, tmp_path, ratio, aspect):
    keys = flat(tmp_path / "keys", SHOWN, pixelAspectRatio=ratio)
    upsample(keys, tmp_path / "out", "-m", "hold", "--video", tmp_path / "a.mov")
    assert open_clip(tmp_path / "a.mov").look.pixel_aspect == aspect


def test_pictures_of_the_report_are_converted_too(upsample, tmp_path):
    keys = flat(tmp_path / "keys", np.array(REC709_TO_ACESCG) @ SHOWN, chromaticities=ACESCG)
    upsample(keys, tmp_path / "out", "-m", "hold", "--report", tmp_path / "report")
    assert_pictures_show(tmp_path / "report", [code(value) for value in SHOWN])


def assert_pictures_show(report: Path, codes: Any) -> None:
    """Expect one colour of all pictures of a page, but for those of errors."""
    page = (report / "report.html").read_text("utf-8")
    (text,) = re.findall(r'<script type="application/json"[^>]*>(.*?)</script>', page, re.DOTALL)
    album = json.loads(text)
    shown = {i for frame in album["frames"] for i in frame["pictures"].values()}
    assert shown
    for index in shown:
        text = album["images"][index]["url"].partition(",")[2]
        with Image.open(io.BytesIO(base64.b64decode(text))) as picture:
            shown = np.asarray(picture.convert("RGB"), float)
        assert np.abs(shown - codes).max() <= 4


class TestViewTransform:
    def codes(self, name: str, linear: Any) -> np.ndarray:
        """8-bit codes of a scene-linear Rec. 709 colour."""
        view = find_view_transform(name)
        assert view is not None
        light = view.apply(np.array(linear, np.float32).reshape(1, 1, 3))
        return np.array([code(value) for value in light.ravel()], float)

    @pytest.mark.parametrize("name", ["aces1", "aces2"])
    def test_video_and_page_show_it_and_say_so(self, upsample, tmp_path, name):
        acescg = np.array(REC709_TO_ACESCG) @ SHOWN
        keys = flat(tmp_path / "keys", acescg, chromaticities=ACESCG)
        video, report = tmp_path / "a.mp4", tmp_path / "report"
        options = ("--video", video, "--report", report, "--view-transform", name)
        upsample(keys, tmp_path / "out", "-m", "hold", *options)
        expected = self.codes(name, SHOWN)
        assert np.abs(expected - [code(value) for value in SHOWN]).max() > 15
        assert np.abs(decode(video, WIDTH, HEIGHT) - expected).max() <= 3
        assert_pictures_show(report, expected)
        page = (report / "report.html").read_text("utf-8")
        assert re.search(rf"<bdi>pictures shown by</bdi></th>\s*<td><bdi>{name}<", page)
        assert json.loads((report / "report.json").read_text())["view_transform"] == name
        assert read_video_note(video) == f"ExWarp, view transform {name}"

    def test_frames_do_not_change(self, upsample, tmp_path):
        keys = flat(tmp_path / "keys", SHOWN)
        for name in ("srgb", "aces1"):
            upsample(keys, tmp_path / name, "-m", "hold", "--view-transform", name)
        assert shots.contents(tmp_path / "srgb") == shots.contents(tmp_path / "aces1")

    def test_exposure_comes_before_it(self, upsample, tmp_path):
        keys, video = flat(tmp_path / "keys", SHOWN), tmp_path / "a.mp4"
        options = ("--video", video, "--view-transform", "aces1", "--exposure", 2)
        upsample(keys, tmp_path / "out", "-m", "hold", *options)
        expected = self.codes("aces1", [4 * value for value in SHOWN])
        assert np.abs(decode(video, WIDTH, HEIGHT) - expected).max() <= 3

    def test_a_video_alone_is_made_again_for_another_view_or_codec(self, upsample, tmp_path):
        keys, video = flat(tmp_path / "keys", SHOWN), tmp_path / "a.mov"
        chosen: list[tuple[str, ...]] = [
            *((), ("--view-transform", "aces1"), ("--view-transform", "aces2")),
            ("--video-codec", "prores"),
        ]
        for options in chosen:
            again = ("-m", "hold", "--skip-existing", *options)
            upsample(keys, video, *again)
            written = video.stat().st_mtime_ns, video.read_bytes()
            said = upsample(keys, video, *again).out
            assert "is there already, as this run would write it" in said
            assert (video.stat().st_mtime_ns, video.read_bytes()) == written
        assert b"apch" in written[1]

    @pytest.mark.parametrize("name", ["srgb", "aces1"])
    def test_a_comparison_shows_all_its_pictures_so_and_scores_as_without(
        self, exwarp, tmp_path, name
    ):
        acescg = np.array(REC709_TO_ACESCG) @ SHOWN
        a, b = (flat(tmp_path / n, acescg, chromaticities=ACESCG) for n in ("a", "b"))
        truth = flat(tmp_path / "truth", SHOWN)
        run = ("compare", a, b, "--ground-truth", truth, "--metrics", "psnr", "--json")
        report = tmp_path / "report"
        result = exwarp(*run, "--report", report, "--view-transform", name)
        assert result.code == 0, result.err
        codes = [code(value) for value in SHOWN] if name == "srgb" else self.codes(name, SHOWN)
        assert_pictures_show(report, codes)
        document = json.loads(result.out)
        assert document["view_transform"] == name
        assert document["quality"] == json.loads(exwarp(*run).out)["quality"]
        shown = "pictures shown by" in (report / "report.html").read_text("utf-8")
        assert shown == (name != "srgb")

    def test_footage_is_shown_as_it_is(self, exwarp, tmp_path):
        keys = pictures.stills(tmp_path / "keys", [pictures.frame(i) for i in range(3)])
        for command in (("upsample", keys, "-o", tmp_path / "out"), ("compare", keys, keys)):
            result = exwarp(*command, "--view-transform", "aces1")
            result.refused(2, "--view-transform is for EXR", "leave it out")


@pytest.mark.parametrize(
    ("name", "stream"), [("hevc", r"hevc \(Main 10\) \(hvc1"), ("prores", r"prores \(HQ\)")]
)
def test_codecs_of_ten_bits(upsample, tmp_path, name, stream):
    keys, video = flat(tmp_path / "keys", SHOWN, pixelAspectRatio=2.0), tmp_path / "a.mov"
    options = ("-m", "hold", "--fps", 24, "--video", video, "--video-codec", name, "--verify")
    upsample(keys, tmp_path / "out", *options)
    output = ffmpeg("-i", str(video)).stderr.decode()
    assert re.search(stream, output) and "96 fps" in output and "SAR 2:1" in output
    clip = open_clip(video)
    assert clip.deep and clip.rate == 96 and clip.count == 12
    linear = next(clip.frames())
    assert np.abs(linear - SHOWN).max() < 0.01


def test_a_ramp_keeps_ten_bits_through_a_view_transform(upsample, tmp_path):
    width = 2048
    ramp = np.linspace(0, 4, width).repeat(4).reshape(width, 4).transpose(1, 0)
    image = np.ones((4, width, 4))
    image[..., :3] = ramp[:, :, None]
    for number in (1, 2):
        path = tmp_path / "keys" / f"s.{number:04d}.exr"
        shots.write(path, {"": layer("", "RGBA", image, HALF)}, shots.HEADER)
    video = tmp_path / "a.mov"
    options = ("--video", video, "--video-codec", "prores", "--view-transform", "aces1")
    upsample(tmp_path / "keys", tmp_path / "out", "-m", "hold", *options)
    grey = ffmpeg("-i", str(video), "-f", "rawvideo", "-pix_fmt", "gray16le", "-").stdout
    assert len(np.unique(np.frombuffer(grey, np.uint16)[:width])) > 512
