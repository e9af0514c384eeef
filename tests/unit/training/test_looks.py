"""Looks that training shots are delivered in."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from exwarp_cli.domain.colour import SRGB
from exwarp_cli.io.dataset import RenderedScene, open_scene
from exwarp_cli.research.training.augmentation import (
    ALIASED,
    BARE,
    DEPTHS,
    GAME,
    PASSES,
    PLAIN,
    SHARPENED,
    TONES,
    VECTORS,
    Look,
    Variant,
    draw_look,
)
from exwarp_cli.research.training.scene_clip import SceneClip
from tests.matrix import spread
from tests.unit.analytic_scene import write_scene

DRAWN = 3000


@pytest.fixture(scope="module")
def scene(tmp_path_factory) -> RenderedScene:
    return open_scene(write_scene(tmp_path_factory.mktemp("data") / "analytic"))


@pytest.fixture
def plain(scene) -> SceneClip:
    return SceneClip(scene)


def in_look(plain: SceneClip, **traits: object) -> SceneClip:
    return plain.seen_as(Variant(), replace(PLAIN, **traits))


def test_each_trait_has_its_share():
    rng = np.random.default_rng(1)
    looks = [draw_look(rng, can_halve=True) for _ in range(DRAWN)]
    for field, shares in (("tones", TONES), ("depth", DEPTHS), ("vectors", VECTORS)):
        counted = Counter(getattr(look, field) for look in looks)
        assert all(abs(counted[name] / DRAWN - p) < 0.03 for name, p in shares.items())
    missing = Counter(look.missing for look in looks)
    assert abs(missing[GAME] / DRAWN - PASSES["game"]) < 0.03
    assert abs(missing[BARE] / DRAWN - PASSES["bare"]) < 0.03
    assert abs(np.mean([look.aliased for look in looks]) - ALIASED) < 0.03
    assert abs(np.mean([look.sharpened > 0 for look in looks]) - SHARPENED) < 0.03
    assert PLAIN in looks


def test_small_frames_are_not_halved():
    rng = np.random.default_rng(1)
    assert not any(draw_look(rng, can_halve=False).aliased for _ in range(300))


def test_eight_bits_hold_256_codes_of_what_is_clipped_at_1(plain):
    footage = in_look(plain, tones="8-bit")
    code = SRGB.to_code(footage.key(1).image.pixels[..., :3]) * 255
    assert np.abs(code - np.round(code)).max() < 1e-3
    shown, truth = footage.slot(1, 2).image.pixels, footage.truth(1, 2).pixels
    assert 0 < np.abs(SRGB.to_code(shown) - SRGB.to_code(truth)).max() <= 0.5 / 255 + 1e-5
    assert truth.max() <= 1


def test_tone_mapping_shows_all_light_between_0_and_1(plain):
    frame = in_look(plain, tones="tone-mapped").key(0).image.pixels
    linear = plain.key(0).image.pixels
    assert frame.min() >= 0 and frame.max() <= 1
    brightest = np.unravel_index(linear[..., 0].argmax(), linear.shape[:2])
    assert frame[brightest][0] == frame[..., 0].max()


def test_noise_is_another_in_each_frame_and_not_in_the_truth(plain):
    footage = in_look(plain, noisy=0.1)
    clean = plain.key(1).image.pixels
    noise = [footage.key(k).image.pixels - plain.key(k).image.pixels for k in (1, 2)]
    assert all(0.01 < part.std() < 0.15 for part in noise)
    assert abs(np.corrcoef(noise[0].ravel(), noise[1].ravel())[0, 1]) < 0.1
    np.testing.assert_array_equal(footage.truth(1, 0).pixels, clean)


def test_sharpened_frames_have_steeper_edges_as_their_truth_has(plain):
    footage = in_look(plain, sharpened=1.0)

    def steepness(pixels: np.ndarray) -> float:
        return float(np.abs(np.diff(pixels, axis=1)).mean())

    assert steepness(footage.key(0).image.pixels) > 1.1 * steepness(plain.key(0).image.pixels)
    np.testing.assert_array_equal(footage.slot(1, 1).image.pixels, footage.truth(1, 1).pixels)


@pytest.mark.parametrize(("kind", "error"), [("coarse", 0.02), ("inverse", 0.005)])
def test_depth_is_stored_in_few_steps_and_the_sky_stays_far(plain, kind, error):
    depth, true = (f.key(1).gbuffer.depth for f in (in_look(plain, depth=kind), plain))
    surface = np.isfinite(true)
    np.testing.assert_array_equal(np.isfinite(depth), surface)
    wrong = np.abs(depth[surface] / true[surface] - 1)
    assert 0 < wrong.max() < error
    assert len(np.unique(depth[surface])) <= 1024


def test_missing_passes_are_missing(plain):
    gbuffer = in_look(plain, missing=GAME, depth="absent").key(1).gbuffer
    assert gbuffer.depth is None and gbuffer.normal is None and gbuffer.albedo is None
    assert gbuffer.stencil is not None and gbuffer.to_next is not None
    bare = in_look(plain, missing=BARE).key(1).gbuffer
    assert bare.stencil is None and bare.depth is not None and bare.to_next is not None


def test_rounded_vectors_are_quarters_of_pixels(plain):
    vectors = in_look(plain, vectors="rounded").key(1).gbuffer.to_next
    quarters = vectors[np.isfinite(vectors)] * 4
    np.testing.assert_array_equal(quarters, np.round(quarters))
    half = in_look(plain, vectors="half").key(1).gbuffer.to_next
    true = plain.key(1).gbuffer.to_next
    assert 0 < np.nanmax(np.abs(half - true)) < 0.02


def test_an_aliased_frame_is_half_as_large_and_warps_as_well(plain):
    footage = in_look(plain, aliased=True)
    frame, whole = footage.key(1), plain.key(1)
    assert frame.image.pixels.shape[0] == (whole.image.pixels.shape[0] + 1) // 2
    np.testing.assert_array_equal(frame.image.pixels, whole.image.pixels[::2, ::2])
    np.testing.assert_allclose(frame.gbuffer.to_next, whole.gbuffer.to_next[::2, ::2] / 2)
    assert footage.truth(1, 2).data_window == frame.image.data_window


@pytest.mark.parametrize("seed", spread(range(6), 3))
def test_any_look_can_be_learned_from(plain, seed):
    look = draw_look(np.random.default_rng(seed), can_halve=True)
    footage = plain.seen_as(Variant(), look)
    prepared = footage.causal(1, "key").prepared(2)
    made = prepared.finish(prepared.inputs.part(slice(None), slice(None)).pictures["warped"][3:])
    truth = footage.truth(1, 2).pixels[..., :3]
    assert made.shape[:2] == truth.shape[:2]
    assert np.mean((made[..., :3] - truth) ** 2) < np.mean((truth - truth.mean()) ** 2) / 4


def test_a_look_is_the_same_each_time(plain):
    look = Look("8-bit", "coarse", "half", GAME, 0.5, 0.1)
    again = plain.seen_as(Variant(), look).key(1).image.pixels
    np.testing.assert_array_equal(plain.seen_as(Variant(), look).key(1).image.pixels, again)
