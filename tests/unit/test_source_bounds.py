"""New frames hold no colour that the key frames do not hold around the same places."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from exwarp_cli.domain.frame import Float32, KeyFrame
from exwarp_cli.domain.network_api import LazyInputs
from exwarp_cli.synthesis.interval import Interval
from exwarp_cli.synthesis.methods import METHODS
from exwarp_cli.synthesis.motion_fields import SlotField
from exwarp_cli.synthesis.source_bounds import hold_between
from exwarp_cli.synthesis.warp import Mover, fill_holes, mix_by_depth
from tests.matrix import combinations, spread
from tests.reference import extremes as naive
from tests.unit.filled import without

K = 3
SETTINGS = ("key", "slot")
ROUNDING = 1e-5
"""Of mixtures of values up to 1."""

Change = Callable[[Float32, int], Float32]


class Wild:
    """A network that answers anything from -19 to 19 anywhere."""

    checksum = "1" * 64

    def __call__(self, inputs: LazyInputs) -> Float32:
        shape = (3, *inputs.shape)
        return np.random.default_rng(7).uniform(-3, 3, shape).astype(np.float32)  # log(1 + 19)


class Bright(Wild):
    """A network that makes everything as bright as it may be."""

    def __call__(self, inputs: LazyInputs) -> Float32:
        return np.full((3, *inputs.shape), 5, np.float32)


class WildBetween:
    """A network that interpolates, and answers anything from -20 to 20 anywhere."""

    name, checksum = "wild", "2" * 64

    def __call__(self, before: Float32, after: Float32, time: float) -> Float32:
        return np.random.default_rng(8).uniform(-20, 20, before.shape).astype(np.float32)


@pytest.fixture(scope="module", params=SETTINGS)
def causal(request, footage) -> Interval:
    return replace(footage.causal(K, request.param), extrapolator=Wild())


def with_pixels(frame: KeyFrame, pixels: Float32) -> KeyFrame:
    return replace(frame, image=replace(frame.image, pixels=pixels.astype(np.float32)))


def changed(interval: Interval, change: Change) -> Interval:
    """The interval with other pixels in its key frames; `change` gets 0 for F_k, 1 for F_k-1 …"""

    def of(frame: KeyFrame, age: int) -> KeyFrame:
        return with_pixels(frame, change(frame.image.pixels.copy(), age))

    past = tuple(replace(p, frame=of(p.frame, age)) for age, p in enumerate(interval.past, start=1))
    return replace(interval, key=of(interval.key, 0), past=past)


def key_bounds(interval: Interval, slot: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Where the key frame shows a slot, and the least and greatest there.

    Of its pixels around, by loops, and of what W makes of them.
    """
    back, pixels = interval.back(slot), interval.key.image.pixels
    seen = ~Mover(back).move(pixels)[1]
    least, greatest = naive.bounds(pixels, back.field, seen)
    warped = interval.warp(slot).make(pixels)
    return seen, np.minimum(least, warped), np.maximum(greatest, warped)


def matte(pixels: Float32, age: int) -> Float32:
    """Colour, not negative, and alpha within a disc alone."""
    rows, columns = np.mgrid[: pixels.shape[0], : pixels.shape[1]]
    inside = (rows - 40) ** 2 + (columns - 64) ** 2 < 30**2
    colour = np.concatenate([np.abs(pixels[..., :3]), np.ones((*inside.shape, 1))], axis=-1)
    return np.where(inside[..., None], colour, 0).astype(np.float32)


def with_alpha(alpha: float) -> Change:
    """As `matte`, but with one alpha everywhere."""

    def change(pixels: Float32, age: int) -> Float32:
        out = matte(pixels, age)
        out[..., 3] = alpha
        return out

    return change


def glow(pixels: Float32, age: int) -> Float32:
    """As `matte`, and light of 5 in a corner where alpha is 0."""
    out = matte(pixels, age)
    out[:20, :30, :3] = 5
    return out


def lit(light: float, older: bool) -> Change:
    """Other light on the key frame, or on those before it."""

    def change(pixels: Float32, age: int) -> Float32:
        pixels[..., :3] = np.abs(pixels[..., :3])
        if (age > 0) is older:
            pixels[..., :3] *= np.float32(light)
        return pixels

    return change


class TestExtrapolation:
    @pytest.mark.parametrize("name", ["s1", "s2", "s3", "s4", "s5"])
    @pytest.mark.parametrize("slot", [1, 2, 3])
    def test_no_path_makes_a_colour_that_no_key_frame_holds(self, causal, name, slot):
        frames = [f.image.pixels for f in (causal.key, *(past.frame for past in causal.past))]
        least, greatest = (
            end([end(pixels, axis=(0, 1)) for pixels in frames], axis=0) for end in (np.min, np.max)
        )
        made = METHODS[name].predict(replace(causal), slot).pixels
        assert (made >= least - ROUNDING).all() and (made <= greatest + ROUNDING).all()

    @pytest.mark.parametrize("slot", spread([3, 2], 1))
    def test_what_the_key_frame_shows_stays_in_its_5x5_pixels(self, causal, slot):
        made = replace(causal).extrapolated(slot)
        seen, least, greatest = key_bounds(causal, slot)
        assert 0.5 < seen.mean() < 1
        assert (made >= least)[seen].all() and (made <= greatest)[seen].all()
        ends = (made == least) | (made == greatest)
        assert ends[..., :3][seen].mean() > 0.9, "a wild network is held nearly everywhere"

    @pytest.mark.parametrize("slot", spread([2, 3], 1))
    def test_holes_stay_within_what_fills_them_and_the_older_frames(self, causal, slot):
        def levels(pixels: Float32, age: int) -> Float32:
            """1 to 1.5 in the key frame; 1.8 and 2 in the older ones."""
            ramp = np.linspace(1, 1.5, pixels.shape[1], dtype=np.float32)[None, :, None]
            pixels[:] = ramp if age == 0 else 1.6 + 0.2 * age
            return pixels

        levelled = replace(changed(causal, levels), extrapolator=Bright())
        made, seen = levelled.extrapolated(slot), key_bounds(levelled, slot)[0]
        assert not seen.all()
        assert made.min() >= 1 and made[seen].max() <= 1.5 and made[~seen].max() <= 2
        assert (made[..., 0][~seen] > 1.5).any(), "an older frame shows some of it"

    def test_what_fits_is_not_touched(self, causal):
        class Own(Wild):
            def __call__(self, inputs: LazyInputs) -> Float32:
                return inputs.part(slice(None), slice(None)).pictures["warped"][3:]

        plain = replace(without(causal, "albedo", "specular"), extrapolator=Own())
        filled = plain.prepared(2).warped
        np.testing.assert_allclose(plain.extrapolated(2), filled, rtol=1e-5, atol=1e-6)

    def test_negatives_stay_where_the_key_frames_have_them(self, causal):
        def corner(pixels: Float32, age: int) -> Float32:
            pixels[..., :3] = np.abs(pixels[..., :3])
            pixels[30:50, 40:60, :3] *= -1
            return pixels

        some = changed(causal, corner)
        seen, least, _ = key_bounds(some, 2)
        negative = (some.extrapolated(2)[..., :3] < 0).any(axis=-1)
        assert negative.any()
        assert not (negative & seen & (least[..., :3] >= 0).all(axis=-1)).any()
        assert changed(causal, lambda pixels, _: np.abs(pixels)).extrapolated(2).min() >= 0


class TestAlpha:
    def test_there_is_no_colour_where_alpha_is_0(self, causal):
        made = changed(causal, matte).extrapolated(2)
        clear = made[..., 3] == 0
        assert 0.3 < clear.mean() < 0.9
        assert (made[clear] == 0).all() and (made[~clear, :3] > 0).any()
        assert made[..., 3].min() >= 0 and made[..., 3].max() <= 1

    def test_light_without_matte_stays(self, causal):
        lights = replace(changed(causal, glow), extrapolator=Bright())
        made, (seen, _, greatest) = lights.extrapolated(2), key_bounds(lights, 2)
        clear = made[..., 3] == 0
        assert (clear & (made[..., :3] == 5).all(axis=-1)).sum() > 300
        dark = clear & seen & (greatest[..., :3] == 0).all(axis=-1)
        assert dark.any() and (made[dark] == 0).all()

    @pytest.mark.parametrize("alpha", spread([0.0, 0.5, 1.0], 2))
    def test_an_alpha_that_is_the_same_everywhere_is_no_matte(self, causal, alpha):
        """What is black beside the object may take its light."""
        flat = replace(changed(causal, with_alpha(alpha)), extrapolator=Bright())
        made, (seen, _, greatest) = flat.extrapolated(2), key_bounds(flat, 2)
        black = (flat.prepared(2).warped[..., :3] == 0).all(axis=-1)
        beside = black & seen & (greatest[..., :3] > 0).all(axis=-1)
        assert beside.sum() > 50 and (made[..., :3][beside] > 0).all()


class TestOtherLight:
    """Key frames of a fade to black, or beside a flash."""

    @pytest.mark.parametrize(("light", "slot"), combinations([0.0, 0.02], [2, 3]))
    def test_a_dark_key_frame_makes_dark_frames(self, causal, light, slot):
        dark = changed(causal, lit(light, older=False))
        assert dark.back(slot).hole.any()
        most = dark.key.image.pixels[..., :3].max(axis=(0, 1))
        made = dark.extrapolated(slot)[..., :3]
        assert made.min() >= 0 and (made <= most * (1 + ROUNDING)).all()

    @pytest.mark.parametrize("slot", [2, 3])
    def test_dark_key_frames_before_leave_no_trace(self, causal, slot):
        black, dark = (changed(causal, lit(light, older=True)) for light in (0.0, 0.01))
        np.testing.assert_array_equal(black.extrapolated(slot), dark.extrapolated(slot))
        assert not black.prepared(slot).sources.older

    def test_a_little_less_light_counts(self, causal):
        assert len(changed(causal, lit(0.8, older=True)).prepared(2).sources.older) == 2


class TestInterpolation:
    @pytest.fixture(params=SETTINGS)
    def between(self, footage, request) -> Interval:
        ahead = footage.interval(K, request.param)
        return replace(ahead, interpolator=WildBetween())

    @pytest.mark.parametrize("slot", spread([1, 2, 3], 1))
    def test_along_motion_it_stays_in_the_5x5_pixels_of_both_key_frames(self, between, slot):
        made = METHODS["onnx"].predict(between, slot).pixels
        ends, views = [], []
        for frame, field in (
            (between.key, between.back(slot)),
            (between.following, between.forward(slot)),
        ):
            pixels = frame.image.pixels
            seen = ~Mover(field).move(pixels)[1]
            views.append(seen)
            ends.append(naive.bounds(pixels, field.field, seen))
        least = np.fmin(ends[0][0], ends[1][0])
        greatest = np.fmax(ends[0][1], ends[1][1])
        seen = views[0] | views[1]
        assert (made >= least)[seen].all() and (made <= greatest)[seen].all()

    @pytest.mark.parametrize("slot", spread([3, 1, 2], 1))
    def test_without_motion_it_stays_in_the_range_of_both_key_frames(self, between, slot):
        bare = replace(
            between, slots=(),
            key=replace(between.key, gbuffer=None),
            following=replace(between.following, gbuffer=None),
        )  # fmt: skip
        pair = [f.image.pixels for f in (bare.key, bare.following)]
        made = METHODS["onnx"].predict(bare, slot).pixels
        assert (made >= np.min(pair, axis=(0, 1, 2))).all()
        assert (made <= np.max(pair, axis=(0, 1, 2))).all()
        matted = replace(
            bare,
            key=with_pixels(bare.key, matte(pair[0], 0)),
            following=with_pixels(bare.following, matte(pair[1], 0)),
            interpolator=Ghost(),
        )
        ghost = METHODS["onnx"].predict(matted, slot).pixels
        clear = ghost[..., 3] == 0
        assert clear.any() and (ghost[clear] == 0).all() and ghost.min() >= 0

    def test_key_frames_are_not_touched(self, between):
        class Same(WildBetween):
            def __call__(self, before: Float32, after: Float32, time: float) -> Float32:
                return before

        before = between.key.image.pixels.copy()
        METHODS["onnx"].predict(replace(between, interpolator=Same()), 2)
        np.testing.assert_array_equal(between.key.image.pixels, before)


class Ghost(WildBetween):
    """A network that leaves some light everywhere; alpha as in the frame before."""

    def __call__(self, before: Float32, after: Float32, time: float) -> Float32:
        return np.concatenate([np.full_like(before[..., :3], 0.3), before[..., 3:]], axis=-1)


SIZE = (9, 12)


def random_side(seed: int, spread: float) -> tuple[Float32, SlotField]:
    """A frame with alpha and negative colour, and a motion field with holes."""
    rng = np.random.default_rng(seed)
    pixels = (rng.lognormal(0, 2, (*SIZE, 4)) * rng.choice([-1, 1], (*SIZE, 4))).astype(np.float32)
    field = rng.normal(0, spread, (*SIZE, 2)).astype(np.float32)
    depth = rng.choice([1.0, 3.0, np.inf], SIZE).astype(np.float32)
    return pixels, SlotField(field, depth, rng.random(SIZE) < 0.2)


@settings(max_examples=40)
@given(st.integers(0, 2**32 - 1), st.floats(0, 4), st.sampled_from([0.25, 0.5, 0.75]))
def test_what_is_warped_and_blended_lies_within_the_bounds_by_itself(seed, spread, time):
    (first, back), (second, forward) = random_side(seed, spread), random_side(seed + 1, spread)
    movers = Mover(back), Mover(forward)
    warped = movers[0].warp_alone(first)
    sides = [
        mover.warp(mover.codes(pixels))
        for mover, pixels in zip(movers, (first, second), strict=True)
    ]
    blended = movers[0].light(fill_holes(*mix_by_depth(*sides, time)))
    seen = ~movers[0].move(first)[1]
    least, greatest = naive.bounds(first, back.field, seen)
    room = 1e-5 * np.abs(first).max()
    assert (warped >= least - room)[seen].all() and (warped <= greatest + room)[seen].all()
    held = blended.copy()
    hold_between(held, (first, second), (back, forward))
    room = 1e-5 * max(np.abs(first).max(), np.abs(second).max())
    np.testing.assert_allclose(held, blended, rtol=0, atol=room)
