"""Either view of a stereo shot is read, measured and warped, whatever the layout of its files."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import OpenEXR
import pytest

from exwarp_cli.domain.results import RunSummary
from exwarp_cli.domain.settings import SourceSettings, UpsampleSettings
from exwarp_cli.errors import ExwarpError
from exwarp_cli.pipeline.run import upsample
from exwarp_cli.pipeline.source import each_view, open_source
from exwarp_cli.report.schema import run_document
from tests.cli import shots
from tests.stereo_layouts import LAYOUTS
from tests.stereo_shots import EYES, arguments, write_stereo

EDGE = 4
"""Pixels at the rim that the moving data windows may leave out."""


@pytest.fixture(scope="module", params=LAYOUTS)
def stereo(request, tmp_path_factory) -> tuple[str, SourceSettings]:
    layout = request.param
    folder = write_stereo(tmp_path_factory.mktemp("stereo") / layout, layout)
    sequence, aovs = arguments(folder, layout)
    return layout, SourceSettings(sequence, aovs=aovs, tail=False)


def pixels_of(path: Path) -> np.ndarray:
    """R, G, B of the only part of a file, within the display window less its rim."""
    with OpenEXR.File(str(path), separate_channels=True) as file:
        part = file.parts[0]
        left, top = -part.header["dataWindow"][0]
        width, height = part.header["displayWindow"][1] + 1
        planes = {name.rsplit(".", 1)[-1]: c.pixels for name, c in part.channels.items()}
    rows = slice(top + EDGE, top + height - EDGE)
    columns = slice(left + EDGE, left + width - EDGE)
    return np.stack([planes[c][rows, columns] for c in "RGB"], -1).astype(float)


def scores(folder: Path, view: str) -> float:
    """Mean PSNR of the slots between key frames against the truth of a view."""
    files = sorted(folder.iterdir())
    found = []
    for order, path in enumerate(files):
        if order % 4:
            truth = EYES[view].colour(order / 4)[EDGE:-EDGE, EDGE:-EDGE]
            found.append(shots.psnr(truth, pixels_of(path)))
    assert len(files) == 9 and len(found) == 6
    return float(np.mean(found))


def run(settings: SourceSettings, folder: Path, method: str) -> RunSummary:
    return upsample(UpsampleSettings(settings, str(folder), method=method, threads=1))


class TestEveryLayout:
    def test_the_right_view_is_warped_by_its_own_vectors(self, stereo, tmp_path):
        layout, settings = stereo
        found = run(replace(settings, view="right"), tmp_path / "out", "softsplat")
        # Measured: 33 dB; the other eye's truth is 20 dB away.
        assert scores(tmp_path / "out", "right") > 31
        assert scores(tmp_path / "out", "left") < 25
        motion = run_document(found)["input"]["motion"]
        wanted = "previous=backward.u,-backward.v next=forward.u,-forward.v"
        assert motion["source"] == "calibrated"
        assert (wanted if layout == "nuke" else "previous=X,-Y next=-Z,W") in motion["evidence"]

    def test_all_views_are_the_hero_and_the_others(self, stereo):
        _, settings = stereo
        each = each_view(replace(settings, view="all"))
        assert each == tuple(replace(settings, view=view) for view in ("left", "right"))
        assert each_view(settings) == (settings,)


def test_without_a_word_the_hero_is_warped(tmp_path):
    folder = write_stereo(tmp_path / "single", "single")
    for view in (None, "left"):
        settings = SourceSettings(str(folder), view=view, tail=False)
        run(settings, tmp_path / f"out-{view}", "s6")
    # Measured: 29 dB.
    assert scores(tmp_path / "out-None", "left") > 27 > scores(tmp_path / "out-None", "right") + 5
    assert shots.contents(tmp_path / "out-None") == shots.contents(tmp_path / "out-left")


class TestSlots:
    def test_slot_gbuffers_are_of_the_same_view(self, tmp_path):
        for view in ("left", "right"):
            folder = tmp_path / "slots" / view
            folder.mkdir(parents=True)
            for order in range(9):
                shots.slot_gbuffer(folder / f"g.{order + 1:04d}.exr", EYES[view], order / 4)
        keys = write_stereo(tmp_path / "single", "single")
        slots = str(tmp_path / "slots" / "%V" / "g.####.exr")
        settings = SourceSettings(str(keys), slots, view="right", tail=False)
        run(settings, tmp_path / "out", "softsplat")
        assert scores(tmp_path / "out", "right") > 31

    def test_the_hero_of_the_keys_is_sought_in_the_slots(self, tmp_path):
        for view in ("left", "right"):
            folder = tmp_path / "keys" / view
            folder.mkdir(parents=True)
            for number in (1, 2):
                shots.plain(folder / f"k.{number:04d}.exr", EYES[view], number - 1)
        slots = tmp_path / "slots"
        slots.mkdir()
        for order in range(5):
            planes = shots.slot_planes(EYES["left"], order / 4)
            named = {f"{name[:-1]}left.{name[-1]}": plane for name, plane in planes.items()}
            header = shots.header(multiView=["right", "left"])
            shots.write(slots / f"g.{order + 1:04d}.exr", {"": planes | named}, header)
        keys = str(tmp_path / "keys" / "%V" / "k.####.exr")
        source = open_source(SourceSettings(keys, str(slots)))
        assert (source.keys.view, source.slots.view) == ("left", "left")

    def test_slots_without_views_do_for_the_hero_alone(self, tmp_path):
        keys = write_stereo(tmp_path / "single", "single", (1, 2))
        slots = shots.sequence(tmp_path / "slots", shots.slot_gbuffer, range(1, 6), step=0.25)
        assert open_source(SourceSettings(str(keys), str(slots))).slots.view == ""
        with pytest.raises(ExwarpError, match=r"slots/shot\.####\.exr has no views, so none"):
            open_source(SourceSettings(str(keys), str(slots), view="right"))
