"""What stands in the files that are written: pixels, channels, types, windows, attributes."""

from __future__ import annotations

import csv
from fractions import Fraction
from pathlib import Path

import numpy as np
import OpenEXR
import pytest

import exwarp_cli
from tests.cli import shots
from tests.cli.street import Street

FORWARD = ("--motion", "next=u,-v")


@pytest.fixture(scope="module")
def artist_shot(tmp_path_factory) -> Path:
    """Two frames with an artist's layer name, all passes in one part."""
    return shots.sequence(tmp_path_factory.mktemp("artist") / "keys", shots.blender4, (1, 2))


class TestKeyFrames:
    @pytest.mark.parametrize("options", [(), ("--compression", "piz")])
    def test_they_pass_through_but_for_the_rate(self, artist_shot, upsample, tmp_path, options):
        upsample(artist_shot, tmp_path, "-m", "s6", *options)
        for key, slot in ((1, 1), (2, 5)):
            got = (tmp_path / f"shot.{slot:04d}.exr").read_bytes()
            assert got == shots.passed_through(artist_shot / f"shot.{key:04d}.exr", 120)


class TestGeneratedFrames:
    def test_they_look_like_the_input_s_colour(self, artist_shot, upsample, tmp_path):
        upsample(artist_shot, tmp_path, "-m", "s6")
        source, _ = shots.read(artist_shot / "shot.0001.exr")
        for number in (2, 3, 4):
            header, planes = shots.read(tmp_path / f"shot.{number:04d}.exr")
            assert set(planes) == {f"Hero shot.v2.Combined.{c}" for c in "RGBA"}
            assert {plane.dtype for plane in planes.values()} == {np.dtype(np.float16)}
            assert header["compression"] == OpenEXR.ZIP_COMPRESSION
            for name in ("dataWindow", "displayWindow"):
                assert np.array_equal(header[name], source[name])
            assert (header["owner"], header["shot:take"]) == ("Ada", 3)
            assert np.array_equal(header["chromaticities"], source["chromaticities"])
            assert header["framesPerSecond"] == Fraction(120)

    def test_they_tell_where_they_come_from(self, artist_shot, upsample, tmp_path):
        upsample(artist_shot, tmp_path, "-m", "softsplat")
        expected = {3: ("softsplat", "1,2", 1, 2), 6: ("s6", "2", 2, 1)}
        for number, (method, sources, key, slot) in expected.items():
            header, _ = shots.read(tmp_path / f"shot.{number:04d}.exr")
            assert header["exwarp:method"] == method and header["exwarp:sources"] == sources
            assert (header["exwarp:key"], header["exwarp:slot"]) == (key, slot)
            assert header["exwarp:version"] == exwarp_cli.__version__
            assert header["exwarp:setting"] == "key"
            assert 0 <= header["exwarp:holeFraction"] < 0.3

    def test_openexr_s_own_encoder_on_demand(self, artist_shot, upsample, tmp_path):
        """Other bytes, the same pixels; the header names no level, as OpenEXR knows none there."""
        found = []
        for name in ("zip", "zip:4"):
            upsample(artist_shot, tmp_path / name, "-m", "s6", "--compression", name)
            header, planes = shots.read(tmp_path / name / "shot.0002.exr")
            assert header["compression"] == OpenEXR.ZIP_COMPRESSION
            found.append({channel: plane.tobytes() for channel, plane in planes.items()})
        assert found[0] == found[1]
        files = [(tmp_path / name / "shot.0002.exr").read_bytes() for name in ("zip", "zip:4")]
        assert files[0] != files[1]

    @pytest.mark.parametrize("name", ["none", "piz", "zips", "dwaa"])
    def test_compression_on_demand(self, artist_shot, upsample, tmp_path, name):
        upsample(artist_shot, tmp_path, "-m", "hold", "--compression", name, "--frames", "1")
        header, _ = shots.read(tmp_path / "shot.0002.exr")
        wanted = {"none": "NO", "piz": "PIZ", "zips": "ZIPS", "dwaa": "DWAA"}[name]
        assert header["compression"] == getattr(OpenEXR, f"{wanted}_COMPRESSION")

    def test_float_colour_stays_float_and_rgb_stays_rgb(self, upsample, tmp_path):
        def frame(path: Path, street: Street, time: float) -> None:
            colour = street.colour(time)[..., :3]
            shots.write(path, {"": shots.layer("", "RGB", colour)})

        shots.sequence(tmp_path / "keys", frame, (1, 2), Street(16, 9))
        upsample(tmp_path / "keys", tmp_path / "out", "-m", "blend")
        _, planes = shots.read(tmp_path / "out" / "shot.0003.exr")
        assert set(planes) == set("RGB")
        assert {plane.dtype for plane in planes.values()} == {np.dtype(np.float32)}
        a, b = (shots.colour_of(tmp_path / "keys" / f"shot.000{i}.exr") for i in (1, 2))
        got = shots.colour_of(tmp_path / "out" / "shot.0003.exr")
        assert np.allclose(got, (a + b) / 2, atol=1e-6)

    def test_every_written_frame_is_an_image(self, artist_shot, upsample, tmp_path):
        upsample(artist_shot, tmp_path, "-m", "softsplat")
        for name in shots.names(tmp_path):
            assert np.isfinite(shots.colour_of(tmp_path / name)).all()


class TestRange:
    """Scene-linear values of any size live on in a still."""

    @pytest.fixture(scope="class")
    @staticmethod
    def still(tmp_path_factory) -> Path:
        def frame(path: Path, street: Street, time: float) -> None:
            planes = shots.plain_planes(street, time)
            planes["R"][10:20, 10:20] = 60.0
            planes["B"][10:20, 10:20] = -0.5
            planes["A"][5:25, 40:] = 0.25
            shots.write(path, {"": planes})

        folder = tmp_path_factory.mktemp("still") / "keys"
        return shots.sequence(folder, frame, (1, 2), Street(speed=0))

    @pytest.mark.parametrize("method", ["s6", "softsplat", "blend", "hold"])
    def test_nothing_is_clipped(self, still, upsample, tmp_path, method):
        result = upsample(still, tmp_path, "-m", method)
        if method != "hold":
            assert "motion untested: " in result.err
        key = shots.colour_of(still / "shot.0001.exr")
        assert key.max() == 60 and key.min() == -0.5 and key[10, 50, 3] == 0.25
        for number in (2, 3, 4):
            got = shots.colour_of(tmp_path / f"shot.{number:04d}.exr")
            assert np.allclose(got, key, rtol=1e-3, atol=1e-3)


class TestBrokenPixels:
    """Fireflies of NaN and infinity are treated as holes, and counted."""

    PLACES = ((3, 4), (20, 30), (21, 30), (35, 63))

    @pytest.fixture(scope="class")
    @staticmethod
    def sparks(tmp_path_factory) -> Path:
        def frame(path: Path, street: Street, time: float) -> None:
            planes = shots.plain_planes(street, time)
            for i, (y, x) in enumerate(TestBrokenPixels.PLACES):
                planes["RGBA"[i]][y, x] = (np.nan, np.inf, -np.inf, np.nan)[i]
            shots.write(path, {"": planes})

        return shots.sequence(tmp_path_factory.mktemp("sparks") / "keys", frame, (1, 2))

    @pytest.mark.parametrize("method", ["s6", "softsplat", "blend", "hold"])
    def test_generated_frames_are_finite(self, sparks, upsample, tmp_path, method):
        report = tmp_path / "report"
        upsample(sparks, tmp_path / "out", "-m", method, "--report", report, *FORWARD)
        for number in (2, 3, 4, 6, 7, 8):
            got = shots.colour_of(tmp_path / "out" / f"shot.{number:04d}.exr")
            assert np.isfinite(got).all() and got.max() < 2 and got.min() >= 0
        for key, slot in ((1, 1), (2, 5)):
            got = (tmp_path / "out" / f"shot.{slot:04d}.exr").read_bytes()
            assert got == shots.passed_through(sparks / f"shot.{key:04d}.exr", 120)
        rows = list(csv.DictReader((report / "frames.csv").read_text().splitlines()))
        both = 8 if method in ("softsplat", "blend") else 4
        assert [int(row["nonfinite_pixels"]) for row in rows if row["slot"] != "0"] == (
            [both] * 3 + [4] * 3
        )

    def test_a_frame_of_little_else_is_refused(self, exwarp, tmp_path):
        def frame(path: Path, street: Street, time: float) -> None:
            planes = shots.plain_planes(street, time)
            if time == 2:
                planes["G"][:20] = np.nan
            shots.write(path, {"": planes})

        shots.sequence(tmp_path / "keys", frame)
        result = exwarp("upsample", tmp_path / "keys", "-o", tmp_path / "out", "-m", "blend")
        result.refused(3, "shot.0003.exr", "NaN", "56%")


class TestWindows:
    """Data windows that wander, reach outside the display window, or hold less than it."""

    CANVAS = Street(96, 54)
    DISPLAY = (16, 9, 64, 36)
    """Place and size of what is shown, on the canvas."""

    def shot(self, folder: Path, data, origin=(0, 0)) -> Path:
        """Write frames 1, 2 and 3, of which frame i holds `data(i)` = x, y, width, height.

        On the canvas; in the files the display window's corner is at `origin`.
        """
        left, top, width, height = self.DISPLAY

        def frame(path: Path, street: Street, time: float) -> None:
            x, y, w, h = data(int(time))
            planes = {
                name: np.ascontiguousarray(plane[y : y + h, x : x + w])
                for passes in shots.blender_passes(street, time)
                for name, plane in passes.items()
            }
            place = shots.window(x - left + origin[0], y - top + origin[1], w, h)
            display = shots.window(*origin, width, height)
            shots.write(path, {"": planes}, shots.header(dataWindow=place, displayWindow=display))

        return shots.sequence(folder, frame, street=self.CANVAS)

    @staticmethod
    def shown(path: Path) -> np.ndarray:
        """Return what a viewer shows of a file: its display window, black outside the data."""
        header, _ = shots.read(path)
        (x0, y0), _ = header["displayWindow"]
        (dx0, dy0), (dx1, dy1) = header["dataWindow"]
        canvas = np.zeros((400, 400, 4))
        canvas[dy0 - y0 + 100 : dy1 - y0 + 101, dx0 - x0 + 100 : dx1 - x0 + 101] = shots.colour_of(
            path
        )
        return canvas[100:136, 100:164]

    def true(self, time: float) -> np.ndarray:
        x, y, width, height = self.DISPLAY
        return self.CANVAS.colour(time)[y : y + height, x : x + width]

    def test_overscan_that_changes_from_frame_to_frame(self, upsample, tmp_path):
        keys = self.shot(tmp_path / "keys", lambda i: (9 + 2 * i, 1 + 3 * i, 78 - i, 47 - i))
        for method, least in (("s6", 33), ("softsplat", 35)):
            upsample(keys, tmp_path / method, "-m", method)
            found = []
            for order in (1, 2, 3, 5, 6, 7):
                path = tmp_path / method / f"shot.{1 + order:04d}.exr"
                found.append(shots.psnr(self.true(order / 4), self.shown(path)))
                header, _ = shots.read(path)
                assert np.array_equal(header["displayWindow"], shots.window(0, 0, 64, 36))
            # no worse than frames that end at the display window, whose edges have nothing to show
            assert np.mean(found) > least

    def test_overscan_that_only_one_neighbour_has(self, upsample, tmp_path):
        """What a frame does not hold is unknown outside the display window, not black."""
        tight, wide = self.DISPLAY, (4, 2, 88, 50)
        for name, data in (("all", (tight, tight)), ("one", (tight, wide))):
            keys = self.shot(tmp_path / name, lambda i, data=data: data[i % 2])
            upsample(keys, tmp_path / f"out-{name}", "-m", "softsplat")
        scores = {
            name: [
                shots.psnr(
                    self.true(order / 4),
                    self.shown(tmp_path / f"out-{name}/shot.{1 + order:04d}.exr"),
                )
                for order in (1, 2, 3, 5, 6, 7)
            ]
            for name in ("all", "one")
        }
        # Of an edge that enters at the frame's end only one neighbour tells how far it is.
        losses = np.subtract(scores["all"], scores["one"])
        assert losses.mean() < 0.2 and losses.max() < 0.75
        assert min(scores["one"]) > 35

    def test_a_window_smaller_than_the_frame(self, upsample, tmp_path):
        keys = self.shot(tmp_path / "keys", lambda i: (26 + i, 14, 40, 26))
        upsample(keys, tmp_path / "out", "-m", "s6")
        for order in (1, 2, 3, 5, 6, 7):
            path = tmp_path / "out" / f"shot.{1 + order:04d}.exr"
            got, true = self.shown(path), self.true(order / 4)
            inner = (slice(9, 27), slice(16, 44))
            assert shots.psnr(true[inner], got[inner]) > 30
            assert not got[:2].any() and not got[:, :4].any()

    @pytest.mark.parametrize("origin", [(-100, -50), (1000, 7)])
    def test_where_the_display_window_lies_changes_no_pixel(self, upsample, tmp_path, origin):
        def data(i: int) -> tuple[int, int, int, int]:
            return 9 + 2 * i, 1 + 3 * i, 78, 46

        upsample(self.shot(tmp_path / "a", data), tmp_path / "out-a", "-m", "softsplat")
        upsample(self.shot(tmp_path / "b", data, origin), tmp_path / "out-b", "-m", "softsplat")
        for name in shots.names(tmp_path / "out-a"):
            a, b = tmp_path / "out-a" / name, tmp_path / "out-b" / name
            assert np.array_equal(shots.colour_of(a), shots.colour_of(b))
            shift = shots.read(b)[0]["dataWindow"][0] - shots.read(a)[0]["dataWindow"][0]
            assert np.array_equal(shift, origin)

    def test_scores_are_those_of_what_is_shown(self, exwarp, upsample, tmp_path):
        keys = self.shot(tmp_path / "keys", lambda i: (9 + 2 * i, 1 + 3 * i, 78, 46))

        def true(path: Path, street: Street, time: float) -> None:
            shots.write(path, {"": shots.layer("", "RGBA", self.true(time), np.float16)})

        truth = shots.sequence(tmp_path / "truth", true, range(1, 10), step=0.25)
        report, out = tmp_path / "report", tmp_path / "out"
        result = upsample(keys, out, "-m", "s6", "--ground-truth", truth, "--report", report)
        assert "against ground truth (6 frames)" in result.out
        assert exwarp("compare", truth, out, "--report", tmp_path / "compared").code == 0
        upsampled, compared = (
            {
                row["frame"]: row["psnr_db"]
                for row in csv.DictReader((folder / "frames.csv").read_text().splitlines())
            }
            for folder in (report, tmp_path / "compared")
        )
        for number in ("2", "3", "4", "6", "7", "8"):
            assert float(compared[number]) == pytest.approx(float(upsampled[number]), abs=1e-6)
