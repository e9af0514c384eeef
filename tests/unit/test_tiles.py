"""Frames that are made tile by tile: what is chosen, where the network is run, and no seams."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
import pytest

from exwarp_cli.domain.decision import EXTRAPOLATE, WARP
from exwarp_cli.domain.frame import Float32, Window
from exwarp_cli.domain.network_api import LazyInputs
from exwarp_cli.domain.tiles import MAKER_LETTERS, REWARP, TILE_PATHS, TileMakers, TilePlan
from exwarp_cli.synthesis.methods import predict_path, predict_tiles
from exwarp_cli.synthesis.mosaic import HALO, Mosaic, Tiles, lay_over, lay_tiles
from tests.unit.test_paths import SLOTS, Painter, interval, painted


@dataclass
class Careful(Painter):
    """Remembers how much of each frame it was shown."""

    shapes: list[tuple[int, int]] = field(default_factory=list)

    def __call__(self, inputs: LazyInputs) -> Float32:
        self.shapes.append(inputs.shape)
        return super().__call__(inputs)


def mosaic(width: int = 427, height: int = 240) -> Mosaic:
    window = Window(0, 0, width, height)
    return Mosaic.of(Tiles(window, window))


def marks(shown: Mosaic, *tiles: tuple[int, int]) -> np.ndarray:
    chosen = np.zeros((len(shown.down), len(shown.across)), np.bool_)
    for tile in tiles:
        chosen[tile] = True
    return chosen


class TestChoices:
    @pytest.mark.parametrize("path", TILE_PATHS)
    def test_a_path_is_known_by_what_made_its_slots(self, path):
        plan = TilePlan.fixed(3, 2, path)
        for first, *others in zip(*(plan.makers(slot).letters for slot in (1, 2, 3)), strict=True):
            assert first == MAKER_LETTERS[WARP]
            assert [name for name in TILE_PATHS if list(TILE_PATHS[name][1:]) == others] == [path]

    def test_what_is_written_is_read(self):
        plan = TilePlan(2, 2, ("S3", "S4", "S5", "S6"))
        assert plan.makers(3).text == "2x2:erew"
        assert TileMakers.parsed("2x2:erew") == plan.makers(3)
        assert plan.makers(3).made_by(REWARP).tolist() == [[False, True], [False, False]]
        assert plan.makers(2).share(EXTRAPOLATE) == 0.5

    @pytest.mark.parametrize("text", ["", "2x2:ere", "2x2:erex", "0x2:", "2x2", "x2:ee"])
    def test_what_says_nothing_of_tiles_is_refused(self, text):
        with pytest.raises(ValueError, match="says nothing of tiles"):
            TileMakers.parsed(text)


class TestMosaic:
    @pytest.mark.parametrize("size", [(427, 240), (1920, 1080), (64, 48), (33, 7)])
    def test_tiles_cover_the_frame_once(self, size):
        shown = mosaic(*size)
        width, height = size
        assert [row for a, b in shown.down for row in range(a, b)] == list(range(height))
        assert [column for a, b in shown.across for column in range(a, b)] == list(range(width))

    def test_outer_tiles_reach_to_what_lies_around_the_display(self):
        shown = Mosaic.of(Tiles(Window(-8, -4, 80, 56), Window(0, 0, 64, 48)))
        assert shown.shape == (56, 80)
        assert shown.down[0] == (0, 4 + 6) and shown.down[-1][1] == 56

    def test_a_chosen_tile_counts_in_full_and_fades_beyond(self):
        shown = mosaic()
        weight = shown.weight(marks(shown, (3, 5)))
        (top, bottom), (left, right) = shown.down[3], shown.across[5]
        assert (weight[top:bottom, left:right] == 1).all()
        row = weight[(top + bottom) // 2]
        beyond = row[right : right + shown.ramp + 1]
        assert (np.diff(beyond) < 0).all() and beyond[-1] == 0 and beyond[0] < 1
        assert not weight[:, : left - shown.ramp].any()
        assert shown.ramp < HALO

    def test_neighbours_are_computed_together(self):
        shown = mosaic()
        chosen = marks(shown, *((r, c) for r in (2, 3) for c in (4, 5, 6)), (7, 13))
        boxes = [box for box, _, _ in shown.parts(chosen)]
        assert sorted(boxes) == [
            ((2, 4), (4, 7)), ((7, 8), (13, 14)),
        ]  # fmt: skip

    def test_scattered_tiles_take_the_whole_frame_where_that_is_less(self):
        shown = mosaic(854, 480)
        chosen = np.indices((8, 14)).sum(axis=0) % 2 == 0
        ((box, rows, columns),) = shown.parts(chosen)
        assert box == ((0, 8), (0, 14))
        assert (rows, columns) == (slice(0, 480), slice(0, 854))

    def test_each_tile_has_what_was_made_for_it(self):
        """A box may be looked at by its neighbour, whose own pixels are the better ones there."""
        shown = mosaic()
        below = ((row, 13) for row in range(1, 5))  # beside the row, and computed after it
        chosen = marks(shown, *((0, column) for column in range(14)), *below)
        boxes, parts = shown.parts(chosen), []
        for number, (box, rows, columns) in enumerate(boxes, start=1):
            size = 3, rows.stop - rows.start, columns.stop - columns.start
            parts.append((box, rows, columns, np.full(size, number, np.float32)))
        made = np.zeros((3, *shown.shape), np.float32)
        lay_tiles(shown, parts, made)
        assert len(boxes) > 1
        for number, (box, _, _) in enumerate(boxes, start=1):
            assert (made[(slice(None), *shown.inside(box))] == number).all()
        assert not made[:, shown.down[7][0] :, :].any()

    def test_a_weight_of_one_or_none_is_exactly_one_of_the_frames(self):
        below, above = (np.full((2, 2, 3), value, np.float32) for value in (1e9, 0.1))
        weight = np.array([[0, 1], [0.5, 1]], np.float32)
        made = lay_over(below, above, weight)
        assert (made[0, 0] == below[0, 0]).all() and (made[:, 1] == above[:, 1]).all()
        assert (made[1, 0] == np.float32(0.5e9)).all()


class TestFrames:
    @pytest.mark.parametrize("path", TILE_PATHS)
    @pytest.mark.parametrize("slot", SLOTS)
    def test_of_one_path_they_are_those_of_that_path(self, path, slot):
        given = interval()
        plan = TilePlan.fixed(given.tiles.columns, 8, path)
        made, expected = predict_tiles(plan, given, slot), predict_path(path, interval(), slot)
        np.testing.assert_array_equal(made.pixels, expected.pixels)
        assert (made.made_by, made.sources) == (expected.made_by, expected.sources)

    @pytest.mark.parametrize("slot", [2, 3])
    def test_the_network_paints_the_chosen_tiles_alone(self, slot):
        given = replace(interval(), extrapolator=Careful())
        plan, tile = self.plan(given, "S3", (4, 2))
        made = predict_tiles(plan, given, slot).pixels
        warped = predict_path("S6", interval(), slot).pixels
        rows, columns = self.pixels(given, tile)
        np.testing.assert_allclose(made[rows, columns, :3], painted(slot), rtol=1e-5)
        weight = given.mosaic.weight(plan.makers(slot).made_by(EXTRAPOLATE))
        np.testing.assert_array_equal(made[weight == 0], warped[weight == 0])
        assert isinstance(given.extrapolator, Careful)
        (shape,) = given.extrapolator.shapes
        assert np.prod(shape) < warped[..., 0].size

    def test_what_the_network_made_is_warped_on(self):
        given = interval()
        plan, tile = self.plan(given, "S4", (4, 2))
        made = predict_tiles(plan, given, 3)
        rows, columns = self.pixels(given, tile)
        warped = predict_path("S6", interval(), 3).pixels
        assert not np.array_equal(made.pixels[rows, columns], warped[rows, columns])
        assert made.made_by == WARP and len(made.sources) == 3
        assert isinstance(given.extrapolator, Painter)
        assert given.extrapolator.asked == [0.5]

    def test_no_network_runs_where_no_tile_wants_it(self):
        given = interval()
        plan = TilePlan.fixed(given.tiles.columns, 8, "S6")
        for slot in SLOTS:
            predict_tiles(plan, given, slot)
        assert isinstance(given.extrapolator, Painter) and not given.extrapolator.asked

    @staticmethod
    def plan(given, path, tile):
        columns = given.tiles.columns
        paths = ["S6"] * (8 * columns)
        paths[tile[0] * columns + tile[1]] = path
        return TilePlan(columns, 8, tuple(paths)), tile

    @staticmethod
    def pixels(given, tile):
        shown = given.mosaic
        return slice(*shown.down[tile[0]]), slice(*shown.across[tile[1]])
