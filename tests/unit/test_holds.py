"""When two key frames show the same picture, and which vectors count around a hold."""

from __future__ import annotations

import numpy as np
import pytest

from exwarp_cli.domain.colour import SRGB
from exwarp_cli.domain.frame import GBuffer, Image, KeyFrame, Window
from exwarp_cli.synthesis.holds import NOISE, adapt_motion_to_holds, change_between, is_same_picture

WINDOW = Window(0, 0, 40, 30)


def image(pixels: np.ndarray) -> Image:
    return Image(pixels.astype(np.float32), WINDOW, WINDOW)


@pytest.fixture
def pixels() -> np.ndarray:
    return np.random.default_rng(3).uniform(0.05, 4.0, (30, 40, 4)).astype(np.float32)


class TestFiles:
    def test_a_copy_and_its_half_floats_are_the_same(self, pixels):
        assert is_same_picture(image(pixels), image(pixels.copy()))
        assert is_same_picture(image(pixels), image(pixels.astype(np.float16)))

    def test_so_is_what_is_not_finite_in_both(self, pixels):
        pixels[3, 4] = np.nan
        pixels[5, 6] = np.inf
        assert is_same_picture(image(pixels), image(pixels.copy()))
        assert not is_same_picture(image(pixels), image(np.nan_to_num(pixels, posinf=1.0)))

    @pytest.mark.parametrize(("y", "x"), [(0, 0), (13, 22), (29, 39)])
    def test_one_pixel_that_changes_is_no_hold(self, pixels, y, x):
        other = pixels.copy()
        other[y, x, 1] *= 1.01
        assert not is_same_picture(image(pixels), image(other))

    def test_other_windows_are_other_pictures(self, pixels):
        moved = Image(pixels, Window(1, 0, 40, 30), WINDOW)
        assert not is_same_picture(image(pixels), moved)


def codes(values: np.ndarray) -> Image:
    return image(SRGB.to_linear((np.clip(values, 0, 255) / 255).astype(np.float32)))


class TestVideos:
    @pytest.fixture
    def drawn(self) -> np.ndarray:
        return np.random.default_rng(4).uniform(20, 230, (30, 40, 3)).round()

    def test_what_a_codec_adds_to_every_pixel_is_noise(self, drawn):
        noise = np.random.default_rng(5).integers(-1, 2, drawn.shape)
        assert change_between(codes(drawn), codes(drawn + noise)).local <= NOISE

    def test_a_small_object_that_moves_is_none(self, drawn):
        other = drawn.copy()
        other[14:16, 20:22] = drawn[14:16, 20:22] + 9
        change = change_between(codes(drawn), codes(other))
        assert change.mean < 0.1 and change.local == pytest.approx(4.0, abs=0.1)
        assert change.local > NOISE

    def test_more_noise_is_borne_only_after_motion(self, drawn):
        other = drawn.copy()
        other[14:16, 20:22] = drawn[14:16, 20:22] + 9
        calm = change_between(codes(drawn), codes(other))
        moved = change_between(codes(drawn), codes(np.roll(drawn, 5, axis=1)))
        assert calm.is_calm_after(moved) and not calm.is_calm_after(calm)
        assert not moved.is_calm_after(moved)


def frame(number: int, previous: float | None, following: float | None) -> KeyFrame:
    """A key frame that moves to the right by so many pixels from the one before, to the next."""

    def field(x: float | None) -> np.ndarray | None:
        return None if x is None else np.full((30, 40, 2), (x, 0), np.float32)

    back = None if previous is None else -previous
    gbuffer = GBuffer(WINDOW, to_previous=field(back), to_next=field(following))
    return KeyFrame(number, image(np.zeros((30, 40, 3))), gbuffer)


def sides(key: KeyFrame | None) -> str:
    assert key is not None and key.gbuffer is not None
    ways = {"previous": key.gbuffer.to_previous, "next": key.gbuffer.to_next}
    return " ".join(name for name, vectors in ways.items() if vectors is not None)


class TestVectorsAroundHolds:
    @pytest.mark.parametrize(
        ("before", "across", "after", "left"),
        [
            (0.0, 6.0, 0.0, ("next", "previous")),  # on twos: a straight line
            (6.0, 0.0, 6.0, ("next", "previous")),  # it stands in the interval
            (0.0, 6.0, 6.0, ("previous next", "previous next")),  # it may start smoothly
            (6.0, 6.0, 0.0, ("previous next", "previous next")),  # or end so
            (5.0, 6.0, 7.0, ("previous next", "previous next")),
            (0.0, 0.0, 0.0, ("previous next", "previous next")),
        ],
    )
    def test_those_that_lead_across_the_interval_are_left(self, before, across, after, left):
        found = adapt_motion_to_holds(frame(1, before, across), frame(2, across, after))
        assert (sides(found[0]), sides(found[1])) == left

    @pytest.mark.parametrize(("after_hold", "left"), [(True, "next"), (False, "previous next")])
    def test_a_causal_method_goes_by_the_repeated_picture(self, after_hold, left):
        found, _ = adapt_motion_to_holds(frame(1, 0.0, 6.0), None, after_hold)
        assert sides(found) == left

    def test_vectors_one_way_alone_lead_the_key_frame_that_stood(self):
        key, following = adapt_motion_to_holds(frame(1, 0.0, None), frame(2, 6.0, None))
        assert (sides(key), sides(following)) == ("next", "previous")
        assert key.gbuffer is not None and key.gbuffer.to_next is not None
        assert (key.gbuffer.to_next[:, :30] == (6, 0)).all()

    def test_or_the_one_that_will_stand(self):
        key, following = adapt_motion_to_holds(frame(1, None, 6.0), frame(2, None, 0.0))
        assert (sides(key), sides(following)) == ("next", "previous")
        assert following is not None and following.gbuffer is not None
        assert following.gbuffer.to_previous is not None
        assert (following.gbuffer.to_previous[:, 10:] == (-6, 0)).all()
