"""Planes as networks take them: against the naive twin, and by their definitions."""

from __future__ import annotations

import numpy as np
import pytest

from exwarp_cli.domain.frame import GBuffer, Window
from exwarp_cli.synthesis.extrapolation import (
    BRIGHTEST,
    DARKEST,
    MovedFrame,
    SlotInputs,
    demodulated,
    modulation_of,
)
from tests.reference import slot_planes as naive
from tests.unit import slot_kernel_calls as calls
from tests.unit.kernel_cases import SHAPE

PARTS = [(slice(0, SHAPE[0]), slice(0, SHAPE[1])), (slice(-3, 9), slice(8, SHAPE[1] + 6))]


def spread(
    frames: tuple[calls.Frame, calls.Frame, calls.Frame],
    filled: np.ndarray,
    parts: tuple[np.ndarray | None, ...],
    median: float,
    rows: slice,
    columns: slice,
) -> np.ndarray:
    """Return the planes [25, h, w] of a part of a slot's inputs."""
    height, width, _ = filled.shape
    names = "depth", "normal", "roughness", "metallic"
    surface = GBuffer(Window(0, 0, width, height), **dict(zip(names, parts, strict=True)))
    moved = tuple(MovedFrame(*frame) for frame in frames)
    pictures = SlotInputs(moved, filled, surface, median, 0.5).part(rows, columns).pictures
    return np.concatenate(list(pictures.values()))


@pytest.mark.parametrize("part", PARTS)
@pytest.mark.parametrize("known", [True, False])
def test_planes_are_those_of_the_naive_twin(known, part):
    frames, filled = tuple(calls.frame(seed) for seed in (1, 2, 3)), calls.frame(4)[0]
    given = calls.parts(5)
    given = given if known else (None,) * 4
    found = spread(frames, filled, given, 2.5, *part)
    expected = naive.spread(frames, filled, given, 2.5, *part, (0.5, 0.5, 0.0))
    for first in (0, 3, 13, 17, 21):
        colour = expected[first : first + 3]
        expected[first : first + 3] = np.copysign(np.log1p(np.abs(colour)), colour)
    np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-6)


def test_what_is_not_shown_keeps_the_sign_of_its_nothing():
    """As a product with 0 has it: what reaches the network does not depend on how it is made."""
    frames, filled = tuple(calls.frame(seed) for seed in (1, 2, 3)), calls.frame(4)[0]
    found = spread(frames, filled, calls.parts(5), 2.5, *PARTS[0])
    pixels, seen = frames[0]
    hidden = np.signbit(pixels[..., :3])[~seen]
    assert (found[:3][:, ~seen] == 0).all()
    np.testing.assert_array_equal(np.signbit(found[:3][:, ~seen].T), hidden)


def test_shading_is_colour_without_the_surface_s():
    pixels = calls.frame(6)[0]
    albedo = np.full((*SHAPE, 3), 0.3, np.float32)
    specular = np.full((*SHAPE, 3), 0.3, np.float32)
    albedo[:5], specular[5:9], albedo[9:12] = 0, 5, 0.1
    specular[9:12] = 0
    window = Window(0, 0, SHAPE[1], SHAPE[0])
    gbuffer = GBuffer(window, albedo=albedo, specular=specular)
    modulation = modulation_of(gbuffer)
    assert modulation is not None
    found = demodulated(pixels, modulation)
    surface = np.clip(albedo + specular, np.float32(DARKEST), np.float32(BRIGHTEST))
    np.testing.assert_array_equal(found[..., :3], pixels[..., :3] / surface)
    np.testing.assert_array_equal(found[..., 3], pixels[..., 3])
