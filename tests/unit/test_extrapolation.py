"""What an extrapolation network is given, and what becomes of its answer."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from exwarp_cli.domain.frame import Float32, GBuffer, KeyFrame, Window
from exwarp_cli.domain.network_api import EXTRAPOLATOR_INTERFACE, NetworkPictures
from exwarp_cli.errors import LayoutError
from exwarp_cli.runtime.frame_pool import ScratchFrames
from exwarp_cli.synthesis.extrapolation import DARKEST, decode, encode, modulation_of
from exwarp_cli.synthesis.interval import Interval
from tests.unit.analytic_scene import STEP
from tests.unit.filled import Filled, without
from tests.unit.scenes import SKY, town

K = 3
SETTINGS = ("key", "slot")


class Bright(Filled):
    """A network that makes everything brighter, what is black too."""

    def __call__(self, inputs: NetworkPictures) -> Float32:
        return np.abs(inputs.pictures["warped"][3:]) + 1


@pytest.fixture(scope="module", params=SETTINGS)
def interval(request, footage) -> Interval:
    return replace(footage.causal(K, request.param), extrapolator=Filled())


@pytest.mark.parametrize("slot", [2, 3])
def test_where_arrays_lie_changes_nothing(interval, slot):
    """Those of large frames leave memory between steps; here these small ones do."""
    scratch = ScratchFrames(0)
    stored = scratch.store(replace(interval, scratch=scratch))
    assert not np.shares_memory(stored.key.image.pixels, interval.key.image.pixels)
    np.testing.assert_array_equal(stored.extrapolated(slot), interval.extrapolated(slot))


@given(
    arrays.arrays(np.float32, (7,), elements=st.floats(-60000, 60000, width=32)),
)
def test_colour_survives_being_coded(linear):
    np.testing.assert_allclose(decode(encode(linear)), linear, rtol=2e-5, atol=1e-6)


def test_surface_colour_is_diffuse_and_glossy_together():
    window = Window(0, 0, 4, 1)
    albedo = np.array([[[0.5] * 3, [0] * 3, [0] * 3, [9] * 3]], np.float32)
    metal = np.array([[[0.1] * 3, [0.9] * 3, [0] * 3, [0.5] * 3]], np.float32)
    found = modulation_of(GBuffer(window, albedo=albedo, specular=metal))
    np.testing.assert_allclose(found[0, :, 0], [0.6, 0.9, DARKEST, 2.0], rtol=1e-6)
    assert modulation_of(GBuffer(window, albedo=albedo)) is None
    assert modulation_of(GBuffer(window, specular=metal)) is None


@pytest.mark.parametrize("slot", [1, 2, 3])
def test_inputs_have_their_shapes_and_ranges(interval, slot):
    inputs = interval.prepared(slot).inputs
    height, width = interval.key.image.data_window.shape
    for name, plane in inputs.pictures.items():
        assert plane.shape == (EXTRAPOLATOR_INTERFACE.inputs[name], height, width), name
        assert plane.dtype == np.float32, name
        assert np.isfinite(plane).all(), name
    assert inputs.time == slot / 4
    hole = interval.back(slot).hole
    assert (inputs.pictures["mask"][0][hole] == 0).all()
    assert (inputs.pictures["warped"][:3, hole] == 0).all()
    visible = inputs.pictures["mask"][0] == 1
    np.testing.assert_array_equal(
        inputs.pictures["history"][:3, visible], inputs.pictures["warped"][:3, visible]
    )
    assert 0 <= inputs.pictures["features"][3:].min() <= inputs.pictures["features"][3:].max() <= 1


@pytest.mark.parametrize("slot", [2, 3])
def test_every_frame_of_the_history_shows_the_slot(interval, slot):
    """Where three frames show a point that nothing lights differently, they agree."""
    prepared = interval.prepared(slot)
    truth = town().view(STEP * (4 * K + slot))
    frames = prepared.inputs.pictures["history"].reshape(3, 4, *truth.surface.shape)
    for frame in frames:
        seen = (frame[3] > 0) & (truth.surface != SKY) & truth.inside(3)
        assert seen.mean() > 0.3
        colour = prepared.finish(frame[:3])[..., :3]
        assert np.median(np.abs(colour - truth.colour[..., :3])[seen]) < 0.02


def test_a_network_that_answers_with_the_warp_makes_the_warp(interval):
    plain = without(interval, "albedo", "specular")
    made = plain.extrapolated(3)
    expected = plain.warp(3).make(plain.key.image.pixels)
    np.testing.assert_allclose(made, expected, rtol=1e-5, atol=1e-6)
    assert plain.extrapolated(3) is made


def test_surface_colour_is_put_back(interval):
    """Shading is warped; the slot's own surface colour is put on it."""
    made, plain = interval.extrapolated(2), without(interval, "albedo", "specular").extrapolated(2)
    truth = town().view(STEP * (4 * K + 2))
    mask = interval.prepared(2).inputs.pictures["mask"]
    seen = (mask[0] > 0) & (truth.surface != SKY) & truth.inside(3)
    assert np.median(np.abs(made - plain)[seen]) < 0.02


def test_what_is_missing_has_stated_defaults(interval):
    bare = without(interval, "albedo", "specular", "roughness", "metallic", "normal")
    prepared = bare.prepared(2)
    assert prepared.modulation is None
    features = prepared.inputs.pictures["features"]
    assert (features[:3] == 0).all()
    assert (features[4] == 0.5).all()
    assert (features[5] == 0).all()


def test_diffuse_colour_alone_is_not_divided_by(interval):
    assert without(interval, "specular").prepared(2).modulation is None


def test_high_dynamic_range_and_alpha_come_through(interval):
    pixels = interval.key.image.pixels
    alpha = np.linspace(0, 1, pixels.shape[1], dtype=np.float32)
    bright = np.concatenate(
        [1000 * pixels[..., :3] - 5, np.broadcast_to(alpha[:, None], (*pixels.shape[:2], 1))], -1
    ).astype(np.float32)
    image = replace(interval.key.image, pixels=bright)
    given_alpha = replace(interval, key=replace(interval.key, image=image))
    expected = given_alpha.warp(2).make(bright)
    plain = without(given_alpha, "albedo", "specular")
    apart = np.abs(plain.extrapolated(2) - expected) > 1e-4 * np.abs(expected) + 1e-3
    assert apart.mean() < 5e-4  # in holes, which are filled as shown and bounded in linear light
    assert given_alpha.extrapolated(2).shape == bright.shape
    # Not the network's planes: every kernel would copy those.
    assert (
        given_alpha.extrapolated(2).flags.c_contiguous and plain.extrapolated(2).flags.c_contiguous
    )


def seen_as(interval: Interval, pixels: Float32) -> Interval:
    """The interval with other colour in its key frame, and as many channels in the past."""

    def with_pixels(frame: KeyFrame, pixels: Float32) -> KeyFrame:
        return replace(frame, image=replace(frame.image, pixels=pixels))

    past = tuple(
        replace(p, frame=with_pixels(p.frame, p.frame.image.pixels[..., : pixels.shape[-1]]))
        for p in interval.past
    )
    return replace(interval, key=with_pixels(interval.key, pixels), past=past)


@pytest.mark.parametrize("slot", [2, 3])
def test_an_element_stays_empty_around_its_object(interval, slot):
    """A network that lights all of it up makes no colour where the warp has none."""
    pixels = interval.key.image.pixels.copy()
    pixels[interval.key.gbuffer.stencil != 3] = 0
    bright = replace(interval, extrapolator=Bright())
    element = seen_as(bright, pixels)
    made, filled = element.extrapolated(slot), element.warp(slot).make(pixels)
    empty = (filled == 0).all(axis=-1)
    assert 0.3 < empty.mean() < 0.99
    assert (made[empty] == 0).all()
    assert (made[~empty, :3] > 0).all()
    np.testing.assert_array_equal(made[..., 3], filled[..., 3])
    without_alpha = seen_as(bright, pixels[..., :3]).extrapolated(slot)
    lit = (without_alpha > 0).all(axis=-1)
    assert lit[~empty].all() and not lit[empty].all()
    assert lit[empty].any(), "beside the object black is a colour where there is no alpha"


PARTS = ("depth", "position", "stencil", "normal", "to_next", "to_previous")
PAIRS = [("depth", "position"), ("stencil", "normal"), ("depth", "to_next"),
         ("position", "stencil"), ("stencil", "to_next"), ("normal", "depth")]  # fmt: skip


@pytest.mark.parametrize("parts", [*((part,) for part in PARTS), *PAIRS], ids="+".join)
def test_whatever_is_not_rendered_is_done_without(interval, parts):
    bare = without(interval, *parts)
    if bare.slots and "to_previous" in parts:
        with pytest.raises(LayoutError, match="no vectors to the previous slot; render them"):
            bare.prepared(2)
        return
    prepared = bare.prepared(2)
    height, width = interval.key.image.data_window.shape
    for name, plane in prepared.inputs.pictures.items():
        assert plane.shape == (EXTRAPOLATOR_INTERFACE.inputs[name], height, width), name
        assert np.isfinite(plane).all(), name
    features = prepared.inputs.pictures["features"]
    assert 0 <= features[3:].min() <= features[3:].max() <= 1
    frame = bare.extrapolated(2)
    assert np.isfinite(frame).all()
    truth = town().view(STEP * (4 * K + 2))
    seen = (prepared.inputs.pictures["mask"][0] > 0) & (truth.surface != SKY) & truth.inside(3)
    assert seen.mean() > 0.3
    assert np.median(np.abs(frame - truth.colour)[seen]) < 0.03


def test_without_any_motion_it_is_said(interval):
    with pytest.raises(LayoutError, match=r"no (motion )?vectors"):
        without(interval, "to_previous", "to_next").prepared(2)


def test_broken_pixels_do_not_reach_the_network(interval):
    pixels = interval.key.image.pixels.copy()
    pixels[20:24, 30:60] = np.nan
    pixels[40, 40] = np.inf
    image = replace(interval.key.image, pixels=pixels)
    damaged = replace(interval, key=replace(interval.key, image=image))
    for plane in damaged.prepared(2).inputs.pictures.values():
        assert np.isfinite(plane).all()
    assert np.isfinite(damaged.extrapolated(2)).all()


@pytest.mark.parametrize(("k", "older"), [(0, 0), (1, 1), (2, 2)])
@pytest.mark.parametrize("setting", SETTINGS)
def test_the_oldest_frame_is_repeated(footage, setting, k, older):
    inputs = footage.causal(k, setting).prepared(1).inputs
    frames = inputs.pictures["history"].reshape(3, 4, *inputs.pictures["mask"].shape[1:])
    for index in range(older + 1, 3):
        np.testing.assert_array_equal(frames[index], frames[older])
    for index in range(1, older + 1):
        assert (frames[index] != frames[index - 1]).any()


@pytest.mark.parametrize("slot", [2, 3])
def test_a_part_of_a_frame_is_as_if_no_more_had_been_rendered(interval, slot):
    whole = interval.key.image.data_window
    part = Window(whole.x + 20, whole.y + 8, whole.width - 48, whole.height - 20)
    rows, columns = slice(8, 8 + part.height), slice(20, 20 + part.width)
    found, full = (i.prepared(slot).inputs for i in (interval.on(part), interval))
    before, after = full.pictures["mask"][0, rows, columns] > 0, found.pictures["mask"][0] > 0
    assert after.shape == part.shape
    lost = before & ~after
    assert not (after & ~before).any() and lost.any()
    # What is lost lies beyond the part of the key frame.
    back = interval.back(slot).field[rows, columns]
    y, x = np.mgrid[: part.height, : part.width]
    inside = (x + back[..., 0] >= 3) & (x + back[..., 0] <= part.width - 4)
    inside &= (y + back[..., 1] >= 3) & (y + back[..., 1] <= part.height - 4)
    assert (lost & inside).mean() < 0.002
    was, now = full.pictures["history"][:3, rows, columns], found.pictures["history"][:3]
    same = np.abs(now - was).max(axis=0)
    assert np.percentile(same[after & inside], 99) < 1e-3
