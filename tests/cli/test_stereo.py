"""Views of a stereo shot are made and written as its files have them: one view, or all."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
import pytest

from exwarp_cli.io.frames import read_image
from exwarp_cli.pipeline import fingerprint
from tests.cli import shots
from tests.cli.conftest import run_quietly
from tests.matrix import combinations
from tests.stereo_layouts import LAYOUTS
from tests.stereo_shots import EYES, arguments, eyes_at, write_stereo

EDGE = 4
"""Pixels at the rim that the moving data windows may leave out."""

TOGETHER = ("single", "single_named", "nuke", "parts")
"""Layouts with all views and layers in one file."""

Found = dict[tuple[str, str], tuple[np.ndarray, tuple[int, int]]]


def planes_of(path: Path) -> Found:
    """Every channel by part and name: its pixels, and where its data window begins."""
    found: Found = {}
    with OpenEXR.File(str(path), separate_channels=True) as file:
        for part in file.parts:
            start = tuple(int(v) for v in part.header["dataWindow"][0])
            for name, channel in part.channels.items():
                found[part.header.get("name", ""), name] = channel.pixels.copy(), start
    return found


def headers(path: Path) -> list[dict[str, Any]]:
    with OpenEXR.File(str(path), header_only=True) as file:
        return [dict(part.header) for part in file.parts]


def scores(folder: Path, view: str) -> float:
    """Mean PSNR of the slots between key frames against the truth of a view."""
    found = []
    files = sorted(folder.iterdir())
    assert len(files) == 9
    for order, path in enumerate(files):
        if order % 4:
            image = read_image(path, view)
            ours = image.on(image.display_window).pixels[EDGE:-EDGE, EDGE:-EDGE]
            truth = EYES[view].colour(order / 4)[EDGE:-EDGE, EDGE:-EDGE]
            found.append(shots.psnr(truth, ours))
    return float(np.mean(found))


@pytest.fixture(scope="module", params=TOGETHER)
def stereo(request, tmp_path_factory) -> Path:
    """Three key frames of a layout; read only."""
    return write_stereo(tmp_path_factory.mktemp("stereo") / request.param, request.param)


@pytest.fixture(scope="module")
def single(tmp_path_factory) -> Path:
    return write_stereo(tmp_path_factory.mktemp("single") / "keys", "single")


@pytest.fixture(scope="module")
def parts(tmp_path_factory) -> Path:
    return write_stereo(tmp_path_factory.mktemp("parts") / "keys", "parts")


@pytest.fixture(scope="module")
def truth(tmp_path_factory) -> Path:
    """Colour of both views at every slot of three key frames."""
    folder = tmp_path_factory.mktemp("truth") / "truth"
    folder.mkdir()
    for order in range(9):
        eyes = {
            view: {n: p for n, p in planes.items() if n.startswith("Combined")}
            for view, planes in eyes_at(order / 4).items()
        }
        LAYOUTS["single"](folder / f"shot.{order + 1:04d}.exr", eyes, order + 1)
    return folder


LAYERED = ("-m", "softsplat", "--layers", "all", "--no-tail")


@pytest.fixture(scope="module")
def every(stereo, tmp_path_factory) -> Path:
    """All views and layers of the layout, upsampled; read only."""
    out = tmp_path_factory.mktemp("every") / "out"
    run_quietly("upsample", stereo, "-o", out, "--view", "all", *LAYERED)
    return out


class TestStructure:
    def test_all_views_are_laid_out_as_in_the_source(self, stereo, every):
        source = stereo / "shot.0001.exr"
        types = {key: pixels.dtype for key, (pixels, _) in planes_of(source).items()}
        for number in (2, 7):
            path = every / f"shot.{number:04d}.exr"
            assert {key: pixels.dtype for key, (pixels, _) in planes_of(path).items()} == types
            for made, wanted in zip(headers(path), headers(source), strict=True):
                for name in ("name", "view", "multiView"):
                    assert made.get(name) == wanted.get(name)
        # Measured: 33 dB; the other eye's truth is 20 dB away.
        assert min(scores(every, view) for view in EYES) > 31

    def test_all_views_digest_their_files_once(self, single, upsample, monkeypatch, tmp_path):
        seen: list[Path] = []
        true = fingerprint.digests

        def digests(path: Path, *options: object) -> tuple[str, str | None]:
            seen.append(path)
            return true(path, *options)

        monkeypatch.setattr(fingerprint, "digests", digests)
        upsample(single, tmp_path / "out", "-m", "softsplat", "--view", "all")
        assert sorted(seen) == sorted(single.iterdir())

    @pytest.mark.parametrize(
        ("stereo", "view"), combinations(TOGETHER, list(EYES)), indirect=["stereo"], scope="module"
    )
    def test_one_view_is_that_part_of_all(self, stereo, every, view, upsample, tmp_path):
        out = tmp_path / view
        upsample(stereo, out, "--view", view, *LAYERED)
        assert scores(out, view) > 31
        for number in (3, 8):
            name = f"shot.{number:04d}.exr"
            both, one = planes_of(every / name), planes_of(out / name)
            assert set(one) < set(both)
            assert 2 * len(one) == len(both)
            for key, (pixels, start) in one.items():
                np.testing.assert_array_equal(both[key][0], pixels)
                assert both[key][1] == start
            every_part = headers(out / name)
            assert {h["view"] for h in every_part if "view" in h} <= {view}
            assert all(h.get("multiView", [view]) == [view] for h in every_part)

    def test_key_frames_hold_all_views(self, single, upsample, tmp_path):
        upsample(single, tmp_path / "o", "-m", "hold", "--view", "right", "--no-tail")
        ours = (tmp_path / "o" / "shot.0005.exr").read_bytes()
        assert ours == (single / "shot.0002.exr").read_bytes()


class TestDecisions:
    def test_the_hero_decides_for_all(self, single, upsample, network, tmp_path):
        """Decided by truth, which the hero alone has, and which is what path S1 makes of it.

        S1 repeats what was shown before at slots 1 and 3, which layers have to follow.
        """
        more = ("--extrapolator", network, "--no-tail", "--layers", "all")
        for view in EYES:
            upsample(single, tmp_path / view, "-m", "s1", "--view", view, *more)
        judged = ("-m", "oracle", "--ground-truth", tmp_path / "left")
        upsample(single, tmp_path / "all", "--view", "all", *judged, *more)
        for number in (2, 3, 4, 6, 7, 8):
            name = f"shot.{number:04d}.exr"
            assert headers(tmp_path / "all" / name)[0]["exwarp:path"] == "S1"
            every = planes_of(tmp_path / "all" / name)
            for view in EYES:
                for key, (pixels, _) in planes_of(tmp_path / view / name).items():
                    np.testing.assert_array_equal(every[key][0], pixels)

    def test_scores_are_of_the_view_that_is_made(self, single, truth, upsample, tmp_path):
        found = {}
        for view in ("left", "right", "all"):
            more = ("--view", view, "--ground-truth", truth, "--json")
            run = upsample(single, tmp_path / view, "-m", "softsplat", "--no-tail", *more)
            found[view] = json.loads(run.out)
        psnr = {view: document["quality"]["all"]["psnr_db"] for view, document in found.items()}
        assert psnr["all"] == psnr["left"] != psnr["right"]
        assert min(psnr.values()) > 30
        assert found["all"]["views"] == ["left", "right"]
        assert found["right"]["views"] == ["right"]

    def test_either_view_is_compared(self, single, truth, upsample, exwarp, tmp_path):
        out = tmp_path / "out"
        upsample(single, out, "-m", "softsplat", "--no-tail", "--view", "right")
        found = exwarp("compare", truth, out, "--view", "right", "--metrics", "psnr", "--json")
        assert found.code == 0, found.err
        score = json.loads(found.out)["quality"]
        # Key frames, which hold both views, are equal.
        assert score["all"]["psnr_db"] > 45 and score["generated"]["psnr_db"] > 30
        exwarp("compare", truth, out, "--view", "left", "--metrics", "psnr").refused(
            3, "shot.0002.exr has the views right, not 'left'"
        )

    def test_a_cut_is_a_cut_in_every_view(self, upsample, tmp_path):
        """The hero jumps to another place, and the other view does not: both stop there."""
        keys = tmp_path / "keys"
        keys.mkdir()
        for number, time in enumerate((-20.0, -19.0, 6.0, 7.0), start=1):
            eyes = {"left": eyes_at(time)["left"], "right": eyes_at(number - 1.0)["right"]}
            LAYOUTS["single"](keys / f"shot.{number:04d}.exr", eyes, number)
        given = ("--motion", "previous=X,-Y next=-Z,W")
        for method, view in (("softsplat", "all"), ("softsplat", "right"), ("s6", "right")):
            upsample(keys, tmp_path / f"{method}-{view}", "-m", method, "--view", view, *given)
        for number, same in ((4, "softsplat"), (6, "s6"), (8, "s6"), (10, "softsplat")):
            name = f"shot.{number:04d}.exr"
            ours = read_image(tmp_path / "softsplat-all" / name, "right").pixels
            alone = read_image(tmp_path / f"{same}-right" / name, "right").pixels
            np.testing.assert_array_equal(ours, alone)


class TestRuns:
    def test_any_split_gives_the_whole(self, parts, upsample, tmp_path):
        more = ("-m", "softsplat", "--view", "all", "--layers", "all")
        upsample(parts, tmp_path / "whole", *more)
        for part in ("1", "2-3"):
            upsample(parts, tmp_path / "split", *more, "--frames", part)
        assert shots.contents(tmp_path / "whole") == shots.contents(tmp_path / "split")

    def test_an_interrupted_run_goes_on(self, single, truth, upsample, tmp_path):
        out = tmp_path / "out"

        def run(*options: object) -> set[int]:
            def go() -> None:
                upsample(single, out, "-m", "s6", "--no-tail", "--skip-existing", *options)

            return shots.changed_by(go, out)

        every = shots.generated(1, 2)
        assert run("--view", "all") >= every
        before = shots.contents(out)
        (out / "shot.0003.exr").unlink()
        assert run("--view", "all", "--ground-truth", truth) == {3}
        assert shots.contents(out) == before
        assert run("--view", "left") == every
        assert run("--view", "right") == every
        assert (
            run("--view", "right", "--ground-truth", truth, "--video", tmp_path / "v.mp4") == set()
        )
        assert run("--view", "left") == every


class TestRefusals:
    def test_views_with_files_of_their_own(self, exwarp, tmp_path):
        folder = write_stereo(tmp_path / "folders", "folders")
        sequence, _ = arguments(folder, "folders")
        result = exwarp("upsample", sequence, "-o", tmp_path / "o", "-m", "s6", "--view", "all")
        result.refused(2, "run once for each: --view left, --view right")

    def test_a_shot_without_views(self, exwarp, plain_shot, tmp_path):
        given = ("upsample", plain_shot, "-o", tmp_path / "o", "-m", "s6", "--view")
        exwarp(*given, "all").refused(3, "has no views; leave --view all out")
        exwarp(*given, "right").refused(3, "has no views, so none is called 'right'")

    def test_a_view_that_is_not_there(self, exwarp, single, tmp_path):
        result = exwarp("upsample", single, "-o", tmp_path / "o", "-m", "s6", "--view", "middle")
        result.refused(3, "has the views left and right, not 'middle'")
