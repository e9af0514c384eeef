"""Frames as typed arrays: windows, background, ids, and frames that cannot be used."""

from __future__ import annotations

import numpy as np
import pytest

from exwarp_cli.domain.frame import Window
from exwarp_cli.domain.motion import AxisMap, MotionConvention
from exwarp_cli.errors import DamagedFileError, LayoutError, MissingFrameError
from exwarp_cli.io.channel_map import ChannelMap
from exwarp_cli.io.channels import Role
from exwarp_cli.io.frames import MAX_BROKEN, clean_depth, clean_stencil, join_planes, read_raw
from exwarp_cli.io.shot import open_shot
from tests.unit.exr_files import box, plane, rgba, write_parts, write_single

INF = np.inf


class TestCleanDepth:
    @pytest.mark.parametrize("background", [0, -1, 1e10, 1e9, np.inf, -np.inf, np.nan, 65504e5])
    def test_every_way_of_writing_background(self, background):
        depth = np.array([[2.5, background], [1e-6, 9.9e8]], np.float32)
        found = clean_depth(depth, None)
        np.testing.assert_array_equal(found, np.array([[2.5, INF], [1e-6, 9.9e8]], np.float32))
        assert found.dtype == np.float32

    def test_unreal_marks_it_by_the_normal(self):
        normal = np.zeros((1, 3, 3), np.float32)
        normal[0, 1] = -1
        normal[0, 2] = (-1, 0, 0)
        found = clean_depth(np.full((1, 3), 4, np.float32), normal)
        assert found.tolist() == [[4, INF, 4]]


class TestCleanStencil:
    def test_whole_numbers_stay_and_mixtures_are_marked(self):
        ids = np.array([[0, 1, 7, 254.999, 0.5, 3.4, np.nan, INF, -3]], np.float32)
        assert clean_stencil(ids).tolist() == [[0, 1, 7, 255, -1, -1, -1, -1, -1]]
        assert clean_stencil(ids).dtype == np.int32

    def test_unsigned_ids_keep_apart_and_are_never_negative(self):
        ids = np.array([[0, 5, 2**24 + 1, 2**31 - 1, 2**32 - 1]], np.uint32)
        found = clean_stencil(ids)
        assert found.tolist()[0][:4] == [0, 5, 2**24 + 1, 2**31 - 1]
        assert (found >= 0).all() and found.dtype == np.int32

    def test_huge_floats_do_not_overflow(self):
        assert (clean_stencil(np.array([[1e20, 3e9]], np.float32)) != 0).all()


def motion(height: int, width: int) -> dict[str, np.ndarray]:
    values = zip("XYZW", (1.5, -2, 3, 4), strict=True)
    return {f"Vector.{letter}": plane(height, width, value) for letter, value in values}


class TestJoined:
    BLOCK = np.arange(5 * 7 * 4, dtype=np.float32).reshape(5, 7, 4)

    def test_neighbours_are_not_copied(self):
        found = join_planes([self.BLOCK[..., i] for i in range(4)])
        np.testing.assert_array_equal(found, self.BLOCK)
        assert np.shares_memory(found, self.BLOCK) and found.flags.c_contiguous

    @pytest.mark.parametrize("order", [(0, 1, 2), (1, 2, 3), (3, 2, 1, 0), (0, 0, 1, 1), (2,)])
    def test_anything_else_is(self, order):
        found = join_planes([self.BLOCK[..., i] for i in order])
        np.testing.assert_array_equal(found, self.BLOCK[..., list(order)])
        assert found.flags.c_contiguous and not np.shares_memory(found, self.BLOCK)

    def test_planes_of_different_arrays(self):
        planes = [np.full((3, 4), i, np.float32) for i in range(3)]
        np.testing.assert_array_equal(join_planes(planes), np.stack(planes, -1))


class TestReadRaw:
    def test_a_plain_frame(self, tmp_path):
        planes = rgba(4, 5) | {"Z": plane(4, 5, 3), "id": plane(4, 5, 2)} | motion(4, 5)
        planes |= {f"N.{c}": plane(4, 5, v) for c, v in zip("XYZ", (0, 0, 1), strict=True)}
        planes |= {f"P.{c}": plane(4, 5, v) for c, v in zip("XYZ", (1, 2, 3), strict=True)}
        write_single(tmp_path / "a.0007.exr", planes)
        raw = read_raw(open_shot(str(tmp_path)), 7)
        assert raw.number == 7 and raw.path == tmp_path / "a.0007.exr"
        assert raw.image is not None and raw.motion is not None
        np.testing.assert_array_equal(raw.image.pixels[..., 2], planes["B"])
        assert raw.motion.shape == (4, 5, 4) and raw.motion[0, 0].tolist() == [1.5, -2, 3, 4]
        buffer = raw.gbuffer
        assert buffer.window == raw.image.data_window == Window(0, 0, 5, 4)
        assert buffer.depth is not None and (buffer.depth == 3).all()
        assert buffer.normal is not None and (buffer.normal == (0, 0, 1)).all()
        assert buffer.position is not None and (buffer.position == (1, 2, 3)).all()
        assert buffer.stencil is not None and (buffer.stencil == 2).all()
        assert not buffer.has_motion
        arrays = (raw.image.pixels, raw.motion, buffer.depth, buffer.normal, buffer.position)
        assert all(a.dtype == np.float32 and a.flags.c_contiguous for a in arrays)

    def test_parts_of_different_windows_meet_on_the_colour_s(self, tmp_path):
        display = {"displayWindow": box(0, 0, 8, 8)}
        write_parts(
            tmp_path / "a.0001.exr",
            {
                "rgba": (rgba(6, 6), display | {"dataWindow": box(1, 1, 6, 6)}),
                "depth": ({"Z": plane(4, 3, 5)}, display | {"dataWindow": box(-1, 3, 3, 4)}),
                "id": ({"X": plane(2, 2, 9)}, display | {"dataWindow": box(3, 3, 2, 2)}),
                "Vector": (motion(1, 8), display | {"dataWindow": box(0, 2, 8, 1)}),
            },
        )
        raw = read_raw(open_shot(str(tmp_path)), 1)
        buffer = raw.gbuffer
        assert buffer.window == Window(1, 1, 6, 6)
        depth = np.full((6, 6), INF)
        depth[2:6, 0] = 5  # columns -1 to 1, rows 3 to 6, of which column 1 is seen
        np.testing.assert_array_equal(buffer.depth, depth)
        stencil = np.zeros((6, 6))
        stencil[2:4, 2:4] = 9
        np.testing.assert_array_equal(buffer.stencil, stencil)
        assert raw.motion is not None
        # Beyond its data window a pass is 0: here vectors of what stands still.
        assert (raw.motion[1] == (1.5, -2, 3, 4)).all()
        assert (np.delete(raw.motion, 1, 0) == 0).all()

    def test_vectors_that_end_before_the_overscan_are_unknown_there(self, tmp_path):
        display = {"displayWindow": box(0, 0, 4, 4)}
        write_parts(
            tmp_path / "a.0001.exr",
            {
                "rgba": (rgba(6, 6), display | {"dataWindow": box(-1, -1, 6, 6)}),
                "Vector": (motion(2, 4), display | {"dataWindow": box(0, 1, 4, 2)}),
            },
        )
        raw = read_raw(open_shot(str(tmp_path)), 1)
        assert raw.motion is not None
        known = np.zeros((6, 6))
        known[1:5, 1:5] = 1
        np.testing.assert_array_equal(np.isfinite(raw.motion[..., 0]), known)
        assert raw.motion[1:5, 1, 0].tolist() == [0, 1.5, 1.5, 0]

    def test_a_surface_beyond_the_end_of_the_positions_is_nowhere(self, tmp_path):
        """Not at the world's origin, to which it would be moved; background has no place anyway."""
        display = {"displayWindow": box(0, 0, 8, 8)}
        place = {f"P.{c}": plane(6, 5, v) for c, v in zip("XYZ", (1, 2, 3), strict=True)}
        write_parts(
            tmp_path / "a.0001.exr",
            {
                "rgba": (rgba(6, 6), display | {"dataWindow": box(1, 1, 6, 6)}),
                "depth": ({"Z": plane(6, 6, 5)}, display | {"dataWindow": box(1, 3, 6, 6)}),
                "P": (place, display | {"dataWindow": box(2, 1, 5, 6)}),
            },
        )
        buffer = read_raw(open_shot(str(tmp_path)), 1).gbuffer
        assert buffer.position is not None
        assert (buffer.position[:, 1:] == (1, 2, 3)).all()
        assert np.isnan(buffer.position[2:, 0]).all() and (buffer.position[:2, 0] == 0).all()

    def test_without_colour_the_display_window_counts(self, tmp_path):
        write_single(
            tmp_path / "a.0001.exr",
            {"Z": plane(2, 3, 5)},
            dataWindow=box(1, 1, 3, 2),
            displayWindow=box(0, 0, 5, 4),
        )
        raw = read_raw(open_shot(str(tmp_path)), 1)
        assert raw.image is None and raw.gbuffer.window == Window(0, 0, 5, 4)
        assert raw.gbuffer.depth is not None
        assert np.isfinite(raw.gbuffer.depth).sum() == 6
        with pytest.raises(LayoutError, match="no colour channels; render the beauty"):
            raw.key(None)

    def test_only_the_roles_asked_for_are_read(self, tmp_path):
        write_single(tmp_path / "a.0001.exr", rgba(3, 3) | {"Z": plane(3, 3, 1)} | motion(3, 3))
        raw = read_raw(open_shot(str(tmp_path)), 1, (Role.COLOUR,))
        assert raw.motion is None and raw.gbuffer.depth is None

    def test_motion_is_read_by_the_convention(self, tmp_path):
        write_single(tmp_path / "a.0001.exr", rgba(2, 2) | motion(2, 2))
        raw = read_raw(open_shot(str(tmp_path)), 1)
        frame = raw.key(MotionConvention(AxisMap(0, 1, 1, -1), AxisMap(2, 3, -2, 1)))
        assert frame.gbuffer is not None and frame.gbuffer.to_previous is not None
        assert frame.gbuffer.to_previous[0, 0].tolist() == [1.5, 2]
        assert frame.gbuffer.to_next is not None
        assert frame.gbuffer.to_next[0, 0].tolist() == [-6, 4]
        assert raw.settle(None) is raw.gbuffer

    def test_the_hero_view_is_the_first(self, tmp_path):
        left, right = rgba(2, 2, seed=1), rgba(2, 2, seed=2)
        write_parts(
            tmp_path / "a.0001.exr",
            {"l": (left, {"view": "left"}), "r": (right, {"view": "right"})},
        )
        raw = read_raw(open_shot(str(tmp_path)), 1)
        assert raw.image is not None
        np.testing.assert_array_equal(raw.image.pixels[..., 0], left["R"])


class TestBadFrames:
    def two(self, tmp_path, second, **attributes):
        write_single(tmp_path / "a.0001.exr", rgba(4, 4) | {"Z": plane(4, 4, 1)})
        write_single(tmp_path / "a.0002.exr", second, **attributes)
        return open_shot(str(tmp_path))

    def test_another_size(self, tmp_path):
        shot = self.two(tmp_path, rgba(4, 5) | {"Z": plane(4, 5, 1)})
        with pytest.raises(LayoutError, match=r"5x4\+0\+0 where .* 4x4\+0\+0; render all"):
            read_raw(shot, 2)

    def test_another_data_window_is_fine(self, tmp_path):
        windows = {"dataWindow": box(1, 1, 2, 2), "displayWindow": box(0, 0, 4, 4)}
        shot = self.two(tmp_path, rgba(2, 2) | {"Z": plane(2, 2, 1)}, **windows)
        image = read_raw(shot, 2).image
        assert image is not None and image.data_window == Window(1, 1, 2, 2)

    def test_a_missing_channel(self, tmp_path):
        shot = self.two(tmp_path, rgba(4, 4))
        with pytest.raises(LayoutError, match=r"a\.0002\.exr has no channel 'Z', which"):
            read_raw(shot, 2)

    def test_a_frame_that_vanished(self, tmp_path):
        shot = self.two(tmp_path, rgba(4, 4))
        (tmp_path / "a.0002.exr").unlink()
        with pytest.raises(MissingFrameError, match=r"a\.0002\.exr does not exist"):
            read_raw(shot, 2)

    def test_a_frame_that_was_never_there(self, tmp_path):
        shot = self.two(tmp_path, rgba(4, 4))
        with pytest.raises(MissingFrameError, match=r"a\.####\.exr lacks frame 3; finish"):
            read_raw(shot, 3)

    def test_broken_colour_of_channels_that_lie_apart(self, tmp_path):
        display = {"displayWindow": box(0, 0, 6, 6)}
        alpha = np.full((4, 4), np.nan, np.float32)
        colour = {name: one for name, one in rgba(6, 6).items() if name != "A"}
        write_parts(
            tmp_path / "a.0001.exr",
            {
                "rgb": (colour, display | {"dataWindow": box(0, 0, 6, 6)}),
                "a": ({"A": alpha}, display | {"dataWindow": box(1, 1, 4, 4)}),
            },
        )
        channel_map = ChannelMap(tmp_path / "m", {Role.COLOUR: ("R", "G", "B", "a.A")})
        raw = read_raw(open_shot(str(tmp_path), channel_map=channel_map), 1)
        assert raw.image is not None and np.isnan(raw.image.pixels).sum() == 16

    @pytest.mark.parametrize(("count", "refused"), [(8, False), (9, True), (16, True)])
    def test_mostly_broken_colour(self, tmp_path, count, refused):
        planes = rgba(4, 4)
        planes["G"].ravel()[:count] = np.nan
        write_single(tmp_path / "a.0001.exr", planes)
        shot = open_shot(str(tmp_path))
        assert (count / 16 > MAX_BROKEN) == refused
        if refused:
            with pytest.raises(DamagedFileError, match=r"NaN or infinite colour in (56|100)%"):
                read_raw(shot, 1)
        else:
            raw = read_raw(shot, 1)
            assert raw.image is not None and np.isnan(raw.image.pixels).sum() == count
            assert shot.nonfinite.counts[1] == {"colour": count}
