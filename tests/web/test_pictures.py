"""Pictures of a page: what they keep of a frame, and how large they get."""

from __future__ import annotations

import io
import math

import numpy as np
import pytest
from PIL import Image

from exwarp_cli.report.gallery import MAX_FRAMES, Album, choose_groups
from exwarp_cli.report.pictures import (
    HIGHEST,
    SLOPE,
    encode_colour,
    encode_error,
    encode_mask,
    find_peak,
    shrink,
    tone_curve,
)


def decoded(picture) -> np.ndarray:
    return np.asarray(Image.open(io.BytesIO(picture.data)).convert("RGB")).astype(np.float64)


def inverse(codes: np.ndarray, peak: int) -> np.ndarray:
    """Scene-linear values of codes 0 to 1, as the page's script has them."""
    v = codes * (1 + SLOPE * math.log(peak))
    toe, body = v / 12.92, ((v + 0.055) / 1.055).clip(0) ** 2.4
    return np.where(v > 1, np.exp((v - 1) / SLOPE), np.where(v <= 0.04045, toe, body))


@pytest.mark.parametrize("peak", [1, 2, 16])
def test_the_curve_comes_back_and_has_no_step(peak: int) -> None:
    linear = np.linspace(0, peak, 4001, dtype=np.float32)
    codes = tone_curve(linear, peak)
    assert codes[0] == 0 and codes[-1] == pytest.approx(1)
    assert (np.diff(codes) > 0).all()
    np.testing.assert_allclose(inverse(codes.astype(np.float64), peak), linear, atol=1e-4 * peak)


def test_with_a_peak_of_one_it_is_the_srgb_curve() -> None:
    assert tone_curve(np.float32([0.5]), 1)[0] == pytest.approx(0.735357, abs=1e-5)


@pytest.mark.parametrize(
    ("value", "expected"), [(0.3, 1), (1.0, 1), (1.1, 2), (7.0, 8), (500.0, HIGHEST)]
)
def test_the_peak_is_a_power_of_two(value: float, expected: int) -> None:
    dim, bright = np.zeros((20, 20, 3), np.float32), np.full((20, 20, 3), value, np.float32)
    assert find_peak(dim, shrink(bright)) == expected


def test_single_bright_pixels_do_not_set_the_peak() -> None:
    image = np.full((100, 100, 3), 0.5, np.float32)
    image[3, 3] = 1000
    assert find_peak(shrink(image)) == 1


def test_large_frames_are_averaged_and_broken_pixels_are_no_matter() -> None:
    image = np.zeros((300, 1280, 4), np.float32)
    image[::2] = 1
    image[0, 0] = np.nan, np.inf, -np.inf, 1
    small = shrink(image)
    assert small.shape == (150, 640, 3) and np.isfinite(small).all()
    np.testing.assert_allclose(small[1:], 0.5, atol=1e-6)
    assert small[0, 0, 1] == pytest.approx((HIGHEST + 1) / 4)


def test_a_picture_stays_within_its_room() -> None:
    noise = np.random.default_rng(3).random((360, 640, 3), dtype=np.float32)
    large = encode_colour(noise, 1, 10_000_000)
    assert (large.width, large.height) == (640, 360) and len(large.data) > 60_000
    assert len(encode_colour(noise, 1, 60_000).data) <= 60_000
    tiny = encode_colour(noise, 1, 3_000)
    assert len(tiny.data) <= 3_000 and tiny.width < 640


def test_colours_survive() -> None:
    flat = np.full((32, 48, 3), [0.2, 0.5, 3.0], np.float32)
    back = inverse(decoded(encode_colour(flat, 4, 100_000)) / 255, 4)
    np.testing.assert_allclose(back, flat, rtol=0.08)


def test_errors_are_those_on_a_display() -> None:
    black, white = np.zeros((16, 16, 3), np.float32), np.full((16, 16, 3), 7.0, np.float32)
    assert decoded(encode_error(black, white, 100_000)).min() > 250
    assert decoded(encode_error(white, 2 * white, 100_000)).max() == 0, "both are white"
    grey = np.full((16, 16, 3), 0.0130, np.float32)  # sRGB 0.118
    shown = decoded(encode_error(black, grey, 100_000)).mean() / 255
    assert shown == pytest.approx(math.sqrt(0.118), abs=0.01)


def test_masks_are_one_bit_and_keep_thin_holes() -> None:
    mask = np.zeros((200, 1280), np.bool_)
    mask[:, 100] = True
    mask[10, 400] = True
    picture = encode_mask(mask)
    holes = Image.open(io.BytesIO(picture.data))
    assert holes.mode == "1" and holes.size == (640, 100)
    columns = np.asarray(holes).any(axis=0)
    assert np.flatnonzero(columns).tolist() == [50]


def test_equal_pictures_appear_once_and_in_order_of_frames() -> None:
    album = Album(("a", "b"), "a", "b")
    pixels = np.full((8, 8, 3), 0.5, np.float32)
    second = album.add(2, "warp", {"a": pixels, "b": pixels}, "b")
    first = album.add(1, "key", {"a": pixels})
    first.pictures["b"] = second.pictures["b"]
    album.set_facts(2, "blend", {"x": "1"})
    album.set_facts(3, "none", {})
    plain = album.to_plain()
    assert [frame["number"] for frame in plain["frames"]] == [1, 2]
    assert plain["frames"][0]["pictures"]["b"] == plain["frames"][1]["pictures"]["b"]
    assert plain["frames"][1]["kind"] == "blend" and set(plain["frames"][1]["errors"]) == {"a"}
    assert len(plain["images"]) == 4


@pytest.mark.parametrize(
    ("count", "limit", "chosen"),
    [(0, 5, 0), (3, 5, 3), (100, 7, 6), (10_000, 24, 24), (9, 1, 1)],
)
def test_spread(count: int, limit: int, chosen: int) -> None:
    found = choose_groups([range(MAX_FRAMES // limit)] * count)
    assert sorted(set(found)) == found and len(found) == chosen
    if count and limit > 1:
        assert found[0] == 0 and found[-1] == count - 1
