"""Stills, and EXR without vectors: upsampled by estimated motion, their format kept."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from exwarp_cli.io.stills import still_facts
from tests.cli import pictures, shots
from tests.cli.pictures import codes_of, frame, psnr, stills, write_still
from tests.cli.shots import changed_by, colour_of, contents, names, read

KEYS = 4


@pytest.fixture(scope="module")
def keys(tmp_path_factory) -> Path:
    """Four PNG, 1 to 4; read only."""
    return stills(tmp_path_factory.mktemp("stills") / "keys", map(frame, range(KEYS)))


class TestPng:
    def test_frames_between_come_where_the_motion_leads(self, upsample, keys, tmp_path):
        report = tmp_path / "report"
        truth = stills(tmp_path / "truth", (frame(i / 4) for i in range(4 * KEYS - 3)))
        out = tmp_path / "out"
        upsample(keys, out, "--no-tail", "--ground-truth", truth, "--report", report)
        assert names(out) == [f"pan.{n:04d}.png" for n in range(1, 4 * KEYS - 2)]
        found = [codes_of(path) for path in sorted(out.iterdir())]
        assert min(psnr(frame(i / 4), found[i]) for i in range(4, 8)) > 38
        document = json.loads((report / "report.json").read_text())
        quality = document["quality"]["all"]
        assert quality["frames"] == 9 and quality["psnr_db"] > 30
        assert document["input"]["producer"] == "PNG images"
        assert document["fps"]["source"] == "assumed"
        assert document["input"]["motion"]["source"] == "estimated"

    def test_given_ones_pass_through_and_new_ones_say_what_they_are(self, upsample, keys, tmp_path):
        upsample(keys / "pan.####.png", tmp_path / "out", "--factor", 2)
        for i in range(KEYS):
            given = (keys / f"pan.{i + 1:04d}.png").read_bytes()
            assert (tmp_path / "out" / f"pan.{2 * i + 1:04d}.png").read_bytes() == given
        facts = still_facts(tmp_path / "out" / "pan.0002.png")
        assert facts is not None
        assert (facts["kind"], facts["method"], facts["sources"]) == (
            "generated", "exwarp", "1,2",
        )  # fmt: skip

    def test_parts_and_resuming_give_the_same(self, upsample, keys, tmp_path):
        whole, parts = tmp_path / "whole", tmp_path / "parts"
        upsample(keys, whole)
        upsample(keys, parts, "--frames", "3-4")
        upsample(keys, parts, "--frames", "1-2")
        assert contents(whole) == contents(parts)
        damaged = parts / "pan.0002.png"
        damaged.write_bytes(damaged.read_bytes()[:-40])
        (parts / "pan.0005.png").write_bytes((keys / "pan.0001.png").read_bytes())
        made = changed_by(lambda: upsample(keys, parts, "--skip-existing"), parts)
        assert made == {2, 5} and contents(whole) == contents(parts)

    def test_another_neighbour_makes_other_frames(self, upsample, keys, tmp_path):
        """Motion depends also on the key frames around an interval's, which are in its recipe."""
        copy = stills(tmp_path / "keys", map(frame, range(KEYS)))
        out = tmp_path / "out"
        upsample(copy, out)
        write_still(copy / "pan.0004.png", frame(1))
        made = changed_by(lambda: upsample(copy, out, "--skip-existing"), out)
        assert made == set(range(6, 9)) | set(range(10, 17))

    def test_a_cross_fade_needs_no_motion(self, upsample, keys, tmp_path):
        upsample(keys, tmp_path / "out", "-m", "blend")
        faded = frame(1) / 2 + frame(2) / 2
        assert psnr(faded, codes_of(tmp_path / "out" / "pan.0007.png")) > 30


class TestOtherFormats:
    def test_sixteen_bits_with_alpha(self, upsample, tmp_path):
        def codes(time: float) -> np.ndarray:
            colour = frame(time).astype(np.uint16) * 257
            alpha = np.full((*colour.shape[:2], 1), 40000, np.uint16)
            return np.concatenate([colour, alpha], axis=-1)

        stills(tmp_path / "keys", map(codes, range(3)), ".tif")
        upsample(tmp_path / "keys", tmp_path / "out")
        made = codes_of(tmp_path / "out" / "pan.0006.tif")
        assert made.dtype == np.uint16 and made.shape[-1] == 4
        assert np.abs(made[8:-8, 8:-8, 3].astype(int) - 40000).max() <= 1
        assert psnr(frame(1.25), made / 257) > 38

    def test_jpeg_to_png(self, upsample, tmp_path):
        stills(tmp_path / "keys", map(frame, range(3)), ".jpg")
        out = tmp_path / "out"
        upsample(tmp_path / "keys", out / "a.##.png")
        passed = codes_of(out / "a.05.png")
        assert np.array_equal(passed, codes_of(tmp_path / "keys" / "pan.0002.jpg"))
        made = changed_by(lambda: upsample(tmp_path / "keys", out / "a.##.png", "--skip-existing"),
                          out)  # fmt: skip
        assert made == set()

    def test_jpeg_to_exr(self, upsample, tmp_path):
        stills(tmp_path / "keys", map(frame, range(2)), ".jpg")
        upsample(tmp_path / "keys", tmp_path / "a.##.exr", "--fps", 25)
        header, planes = read(tmp_path / "a.02.exr")
        assert planes["G"].dtype == np.float16 and header["framesPerSecond"] == 100

    def test_rendered_frames_beside_their_previews_come_first(self, upsample, tmp_path):
        folder = shots.sequence(tmp_path / "keys", shots.plain)
        stills(folder, map(frame, range(3)))
        upsample(folder, tmp_path / "out", "-m", "hold")
        assert names(tmp_path / "out")[0] == "shot.0001.exr"

    def test_a_video_of_them(self, upsample, keys, tmp_path):
        upsample(keys, tmp_path / "out.mp4", "--fps", 24)
        assert len(pictures.shown(tmp_path / "out.mp4")) == 4 * KEYS


class TestRefusals:
    def test_frames_that_differ(self, exwarp, tmp_path):
        folder = stills(tmp_path / "keys", map(frame, range(2)))
        write_still(folder / "pan.0003.png", frame(2)[:, :-2])
        quiet = ("--progress", "none")
        result = exwarp("upsample", folder, "-o", tmp_path / "out", *quiet)
        result.refused(3, "pan.0003.png is 62x48", "write all frames at one resolution")
        write_still(folder / "pan.0003.png", np.dstack([frame(2), frame(2)[..., :1]]))
        exwarp("upsample", folder, "-o", tmp_path / "out", "--overwrite", *quiet).refused(
            3, "with 4 channels"
        )

    def test_a_damaged_frame(self, exwarp, tmp_path):
        folder = stills(tmp_path / "keys", map(frame, range(3)))
        data = (folder / "pan.0002.png").read_bytes()
        (folder / "pan.0002.png").write_bytes(data[: len(data) // 2])
        quiet = ("--progress", "none")
        exwarp("upsample", folder, "-o", tmp_path / "out", *quiet).refused(3, "pan.0002.png")

    def test_a_gap(self, exwarp, tmp_path):
        folder = stills(tmp_path / "keys", map(frame, range(4)))
        (folder / "pan.0002.png").unlink()
        exwarp("upsample", folder, "-o", tmp_path / "out").refused(3, "frame 2 is missing")
        left_out = exwarp("upsample", folder, "-o", tmp_path / "out", "--keep-going", "-m", "hold")
        place = folder / "pan.0002.png"
        assert f"frames 5-8: cannot read {place}: No such file or directory;" in left_out.err

    def test_truth_of_another_size(self, exwarp, keys, tmp_path):
        truth = stills(tmp_path / "truth", (frame(0)[:-2] for _ in range(13)))
        options = ("--ground-truth", truth)
        exwarp("upsample", keys, "-o", tmp_path / "out", *options).refused(3, "64x46", "64x48")

    def test_a_map_of_channels(self, exwarp, keys, tmp_path):
        out = tmp_path / "map.toml"
        exwarp("inspect", keys, "--write-channel-map", out).refused(2, "has colour alone")


class TestBeautyAlone:
    """EXR without vectors."""

    def panned(self, folder: Path, count: int = 3, gain: float = 4.0) -> Path:
        for i in range(count):
            light = (gain * frame(i) / 255).astype(np.float16)
            alpha = np.full(light.shape[:2], 0.5, np.float16)
            planes = {c: np.ascontiguousarray(light[..., k]) for k, c in enumerate("RGB")}
            planes["A"] = alpha
            shots.write(folder / f"pan.{i + 1:04d}.exr", {"": planes})
        return folder

    def test_light_and_alpha_stay(self, upsample, tmp_path):
        keys = self.panned(tmp_path / "keys")
        upsample(keys, tmp_path / "out")
        header, planes = read(tmp_path / "out" / "pan.0006.exr")
        assert set(planes) == set("RGBA") and planes["R"].dtype == np.float16
        assert header["owner"] == "Ada" and header["exwarp:method"] == "exwarp"
        made, truth = colour_of(tmp_path / "out" / "pan.0006.exr"), 4 * (frame(1.25) / 255)
        inside = (slice(8, -8), slice(8, -8))
        assert made[inside][..., :3].max() > 1.5
        assert np.abs(made[inside][..., :3] - truth[inside]).mean() < 0.05
        assert np.abs(made[inside][..., 3] - 0.5).max() < 1e-3
        passed = (tmp_path / "out" / "pan.0005.exr").read_bytes()
        assert passed == shots.passed_through(keys / "pan.0002.exr", 120)

    def test_it_is_said(self, exwarp, tmp_path):
        keys, report = self.panned(tmp_path / "keys"), tmp_path / "report"
        said = exwarp("upsample", keys, "-o", tmp_path / "out", "--report", report)
        assert said.code == 0 and "no motion vectors" in said.err
        document = json.loads((report / "report.json").read_text())
        assert document["input"]["motion"]["source"] == "estimated"
        assert "estimates motion from colour" in exwarp("inspect", keys).out

    def test_data_windows_may_differ(self, upsample, tmp_path):
        """Each frame holds the box of what moves; the flow between two covers both."""
        for i in range(3):
            box = (frame(0)[:, 8:40] / 255).astype(np.float16)
            planes = {c: np.ascontiguousarray(box[..., k]) for k, c in enumerate("RGB")}
            planes["A"] = np.ones(box.shape[:2], np.float16)
            windows = {
                "dataWindow": shots.window(4 + 4 * i, 0, 32, 48),
                "displayWindow": shots.window(0, 0, 64, 48),
            }
            path = tmp_path / "keys" / f"pan.{i + 1:04d}.exr"
            shots.write(path, {"": planes}, shots.header(**windows))
        upsample(tmp_path / "keys", tmp_path / "out", "--factor", 2)
        header, planes = read(tmp_path / "out" / "pan.0002.exr")
        left, right = (corner[0] for corner in header["dataWindow"])
        assert 4 <= left <= 8 and 35 <= right <= 42
        middle = planes["R"][12:36, 16 - left : 28 - left].astype(float)
        assert np.abs(middle - frame(0)[12:36, 18:30, 0] / 255).mean() < 0.04

    @pytest.mark.parametrize("method", ["causal", "s3"])
    def test_what_needs_surfaces_is_refused(self, exwarp, tmp_path, method):
        keys = self.panned(tmp_path / "keys")
        result = exwarp("upsample", keys, "-o", tmp_path / "out", "-m", method)
        result.refused(3, "no motion vectors", "--method softsplat, for which it is estimated")

    def test_half_of_a_vector_is_no_leave_to_estimate(self, exwarp, tmp_path):
        def frame_with_half(path: Path, street: shots.Street, time: float) -> None:
            planes = shots.plain_planes(street, time)
            del planes["forward.v"]
            shots.write(path, {"": planes})

        keys = shots.sequence(tmp_path / "keys", frame_with_half, street=shots.SMALL)
        result = exwarp("upsample", keys, "-o", tmp_path / "out", "-m", "softsplat")
        result.refused(3, "'forward' has only u")
