"""Opening an input: conventions by hand, matching by number or order, the frame rate."""

from __future__ import annotations

import struct
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from exwarp_cli.domain.motion import PRESETS, AxisMap, MotionConvention
from exwarp_cli.domain.settings import DEFAULT_FPS, SourceSettings
from exwarp_cli.domain.timeline import Slot, Timeline
from exwarp_cli.errors import InputError, LayoutError, MissingFrameError, MotionError
from exwarp_cli.io.sequences import Sequence
from exwarp_cli.io.shot import open_shot
from exwarp_cli.pipeline.motion_convention import find_motion, motion_names
from exwarp_cli.pipeline.source import align, open_source, rate_of
from tests.unit.exr_files import plane, rgba, write_single
from tests.unit.scenes import town

UV = ("forward.u", "forward.v", "backward.u", "backward.v")


def sequence(numbers: range | list[int]) -> Sequence:
    files = {n: Path(f"/in/g.{n:04d}.exr") for n in numbers}
    return Sequence("g.", 4, ".exr", Path("/in"), files)


class TestAlign:
    TIMELINE = Timeline.of([1001, 1002, 1003])  # slots 1001 to 1012

    def test_by_number(self):
        frame_of = align(self.TIMELINE, sequence(range(1001, 1013)), "--gbuffers")
        assert frame_of(Slot(0, 0)) == 1001 and frame_of(Slot(1, 2)) == 1007
        assert frame_of(Slot(2, 3)) == 1012

    def test_by_number_among_others(self):
        frame_of = align(self.TIMELINE, sequence(range(990, 1010)), "--gbuffers")
        assert frame_of(Slot(0, 0)) == 1001 and frame_of(Slot(2, 0)) == 1009
        assert frame_of(Slot(2, 1)) is None  # past the last one

    def test_by_order(self):
        frame_of = align(self.TIMELINE, sequence(range(9)), "--gbuffers")
        assert frame_of(Slot(0, 0)) == 0 and frame_of(Slot(1, 1)) == 5
        assert frame_of(Slot(2, 0)) == 8 and frame_of(Slot(2, 1)) is None

    def test_by_order_where_numbers_begin_elsewhere(self):
        frame_of = align(self.TIMELINE, sequence(range(1002, 1014)), "--gbuffers")
        assert frame_of(Slot(0, 0)) == 1002 and frame_of(Slot(2, 0)) == 1010

    def test_one_that_has_the_key_frames_rate(self):
        with pytest.raises(InputError, match=r"--gbuffers has 3 frames like the key frames"):
            align(self.TIMELINE, sequence(range(1001, 1004)), "--gbuffers")

    def test_one_with_a_gap(self):
        with pytest.raises(MissingFrameError, match="frame 5 is missing"):
            align(self.TIMELINE, sequence([1, 2, 3, 4, 6, 7, 8, 9]), "--gbuffers")

    def test_the_key_frames_instants_belong_to_it(self):
        """VMAF would have no video without them, and order would be another one."""
        with pytest.raises(MissingFrameError, match=r"--ground-truth needs.* key .*frame 5,9 is"):
            align(self.TIMELINE, sequence([2, 3, 4, 6, 7, 8, 10, 11, 12]), "--ground-truth")

    def test_one_slot_of_every_interval_is_not_taken_for_every_slot(self):
        with pytest.raises(InputError, match="has only the frames 1003,1007 of 1001-1009, and"):
            align(self.TIMELINE, sequence([1003, 1007]), "--ground-truth")


class TestRate:
    def shot(self, tmp_path, **attributes):
        write_single(tmp_path / "a.0001.exr", rgba(2, 2), **attributes)
        return open_shot(str(tmp_path))

    def test_what_is_given_counts_first(self, tmp_path):
        shot = self.shot(tmp_path, framesPerSecond=Fraction(25))
        assert rate_of(shot, Fraction(12)) == (12, "option")

    def test_then_the_header(self, tmp_path):
        shot = self.shot(tmp_path, framesPerSecond=Fraction(24000, 1001))
        assert rate_of(shot, None) == (Fraction(24000, 1001), "header")

    @pytest.mark.parametrize(
        ("value", "rate"),
        [
            (24, 24),
            (24.0, 24),
            (23.976, Fraction(24000, 1001)),
            ("24", 24),
            ("24000/1001", Fraction(24000, 1001)),
            ("29.97", Fraction(30000, 1001)),
            (Fraction(2147483647, 89478485), 24),
            (Fraction(23976024, 1000000), Fraction(24000, 1001)),
            (Fraction(1998, 83), Fraction(1998, 83)),
        ],
    )
    def test_the_header_s_may_be_of_any_type(self, tmp_path, value, rate):
        assert rate_of(self.shot(tmp_path, framesPerSecond=value), None) == (rate, "header")

    def test_the_header_s_may_be_a_double(self, tmp_path):
        shot = self.shot(tmp_path, framesPerSecond=Fraction(24))
        path = tmp_path / "a.0001.exr"
        rational = b"framesPerSecond\0rational\0" + struct.pack("<Iii", 8, 24, 1)
        double = b"framesPerSecond\0double\0" + struct.pack("<Id", 8, 23.976)
        before, after = path.read_bytes().split(rational)
        path.write_bytes(before + double + after)
        assert rate_of(shot, None) == (Fraction(24000, 1001), "header")

    @pytest.mark.parametrize("value", ["fast", "", 0, -24, "1/0", float("nan")])
    def test_what_is_no_rate_is_left_out(self, tmp_path, value):
        shot = self.shot(tmp_path, framesPerSecond=value)
        assert rate_of(shot, None) == (DEFAULT_FPS, "assumed")

    def test_else_it_is_assumed(self, tmp_path):
        assert rate_of(self.shot(tmp_path), None) == (DEFAULT_FPS, "assumed")


def write_town(folder: Path, channels: bool = True, count: int = 2, still: bool = False) -> Path:
    """The ray-traced scene as plain EXR files, forward.u and forward.v in pixels, y up."""
    folder.mkdir(exist_ok=True)
    scene = town((96, 60)).still() if still else town((96, 60))
    for number in range(count):
        view = scene.view(float(number))
        colour = view.colour
        planes = {c: np.ascontiguousarray(colour[..., i]) for i, c in enumerate("RGBA")}
        if channels:
            vectors = view.motion_to(number + 1.0, sky=False)
            planes["forward.u"] = np.ascontiguousarray(vectors[..., 0])
            planes["forward.v"] = np.ascontiguousarray(-vectors[..., 1])
            planes["Z"] = np.where(np.isinf(view.depth), 1e10, view.depth).astype(np.float32)
        write_single(folder / f"a.{number + 1:04d}.exr", planes)
    return folder


class TestOpen:
    def test_a_shot_with_motion(self, tmp_path):
        source = open_source(SourceSettings(str(write_town(tmp_path))))
        assert source.setting == "key" and source.timeline.numbers == (1, 2)
        assert source.finding is not None
        assert source.finding.convention == PRESETS["forward"]
        assert source.finding.source == "calibrated"
        assert source.slot_number(Slot(0, 1)) is None

    def test_a_convention_by_hand_is_not_questioned(self, tmp_path):
        settings = SourceSettings(str(write_town(tmp_path)), motion="previous=u,v")
        finding = open_source(settings).finding
        assert finding is not None and finding.source == "given"
        assert finding.convention == MotionConvention(AxisMap(0, 1, 1, 1))
        assert "previous=u,v given by --motion" in finding.evidence

    def test_one_frame_alone_keeps_the_names(self, tmp_path):
        shot = open_shot(str(write_town(tmp_path, count=1)))
        finding = find_motion(shot, None)
        assert finding is not None and finding.source == "untested"

    def test_without_motion(self, tmp_path):
        folder = str(write_town(tmp_path, channels=False))
        with pytest.raises(LayoutError, match=r"has no motion vectors .* --method hold or blend"):
            open_source(SourceSettings(folder))
        assert open_source(SourceSettings(folder), motion_needed=False).finding is None

    def test_a_convention_that_cannot_be_settled_matters_only_where_it_is_needed(self, tmp_path):
        for number in (1, 2):
            planes = rgba(20, 20, seed=number)
            planes |= {f"velocity.{c}": plane(20, 20, 3) for c in "XY"}
            write_single(tmp_path / f"a.{number:04d}.exr", planes)
        with pytest.raises(MotionError):
            open_source(SourceSettings(str(tmp_path)))
        assert open_source(SourceSettings(str(tmp_path)), motion_needed=False).finding is None

    def test_without_colour(self, tmp_path):
        write_single(tmp_path / "a.0001.exr", {"Z": plane(4, 4, 1)})
        with pytest.raises(LayoutError, match="no colour channels"):
            open_source(SourceSettings(str(tmp_path)))

    def test_names_get_their_layer_where_they_are_not_unique(self, tmp_path):
        planes = rgba(4, 4)
        for layer in ("a.forward", "a.backward"):
            planes |= {f"{layer}.{c}": plane(4, 4, 0) for c in "uv"}
        write_single(tmp_path / "a.0001.exr", planes)
        assert motion_names(open_shot(str(tmp_path))) == UV
