"""The kernels that look back from a slot, called with fresh outputs, and a case for each."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from exwarp_cli.kernels import gather, point_motion
from tests.unit import kernel_calls as calls
from tests.unit import kernel_cases as cases
from tests.unit.kernel_calls import Arrays, build

Frame = tuple[np.ndarray, np.ndarray]
NO_PLANE = np.zeros((0, 0), np.float32)


def shown_followed(
    step: np.ndarray,
    stencil: np.ndarray,
    gone: np.ndarray,
    moved: np.ndarray,
    lost: np.ndarray,
    serial: bool = False,
) -> Arrays:
    out, missed = np.full_like(moved, -9), np.zeros_like(lost)
    build(point_motion, "follow_visible", serial)(step, stencil, gone, moved, lost, out, missed)
    return out, missed


def taken_over(
    field: np.ndarray,
    parts: tuple[np.ndarray, ...],
    colours: tuple[np.ndarray, ...],
    unknown: np.ndarray,
    serial: bool = False,
    blanks: bool = False,
) -> Arrays:
    """Parts and colours as frames have them; empty ones are unknown."""
    made = tuple(np.full_like(part, -9) for part in parts)
    planes = [
        tuple(
            part.reshape(*part.shape[:2], -1) if part.size else np.zeros((0, 0, 0), np.float32)
            for part in group
        )
        for group in (parts, made)
    ]
    mixed = tuple(np.full_like(colour, -9) for colour in colours)
    rest = unknown.copy()
    flat = [tuple(colour.reshape(-1) for colour in group) for group in (colours, mixed)]
    build(point_motion, "copy_surface", serial)(
        field, planes[0], flat[0], planes[1], flat[1], rest, blanks
    )
    return (*made, *mixed, rest)


def bounds_raised(
    pixels: np.ndarray,
    field: np.ndarray,
    wanted: np.ndarray,
    clear: bool,
    sign: float,
    serial: bool = False,
) -> Arrays:
    bound = np.full((*field.shape[:2], pixels.shape[2]), -np.inf, np.float32)
    call = build(gather, "raise_bounds", serial)
    call(pixels, field, wanted, clear, np.float32(sign), bound)
    return (bound,)


def held(
    bound: np.ndarray,
    wanted: np.ndarray,
    sign: float,
    channels: int,
    frame: np.ndarray,
    serial: bool = False,
) -> Arrays:
    out = frame.copy()
    build(gather, "clamp_to_bounds", serial)(bound, wanted, np.float32(sign), channels, out)
    return (out,)


def cameras(seed: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    return np.eye(3, 4) + rng.normal(0, 0.02, (3, 4)), np.eye(3) + rng.normal(0, 0.01, (3, 3))


def seen(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).random(cases.SHAPE) < 0.7


def frame(seed: int) -> Frame:
    return np.nan_to_num(cases.image(seed)), seen(seed)


def parts(seed: int) -> tuple[np.ndarray, ...]:
    """Depth, normal, roughness and metallic, not all of them usable."""
    normal, rough, metal = cases.vectors(seed, 0.5), cases.vectors(seed + 1, 1), cases.image(seed)
    normal[3, 4:6, 0] = np.nan, np.inf
    depth = cases.depth(seed)
    depth[5, 6:8] = np.nan, -1
    return depth, normal, rough[..., 0].copy(), metal[..., 0].copy()


def colours(seed: int) -> tuple[np.ndarray, np.ndarray]:
    return cases.image(seed)[..., :3].copy(), np.abs(cases.vectors(seed, 0.4, (1, 0, 0)))


def _follow_shown(serial: bool) -> Arrays:
    """With ids, and without."""
    moved, lost = cases.field(31), seen(34)
    known = shown_followed(cases.field(29), cases.ids(32), seen(33), moved, lost, serial)
    blind = shown_followed(cases.field(29), calls.NO_IDS, seen(33), moved, lost, serial)
    return known + blind


def _take_over(serial: bool) -> Arrays:
    """With everything, and with depth alone."""
    full = taken_over(cases.field(70), parts(71), colours(72), seen(73), serial)
    nothing = np.zeros((0, 0, 3), np.float32)
    bare = (cases.depth(71), nothing, NO_PLANE, NO_PLANE)
    return full + taken_over(cases.field(70), bare, (nothing, nothing), seen(73), serial)


def _raise_bounds(serial: bool) -> Arrays:
    """All pixels of a frame, and those whose alpha is 0 alone."""
    pixels = cases.image(87)
    pixels[::2, ::2, 3] = 0
    upper = bounds_raised(pixels, cases.field(88), seen(89), False, 1, serial)
    return upper + bounds_raised(pixels, cases.field(88), seen(89), True, -1, serial)


def _hold(serial: bool) -> Arrays:
    """All pixels, and some."""
    bound = frame(90)[0]
    bound[3, 4] = -np.inf
    upper = held(bound, calls.NO_MASK, 1, 4, frame(91)[0], serial)
    return upper + held(bound, seen(92), -1, 3, frame(91)[0], serial)


CASES: dict[str, Callable[[bool], Arrays]] = {
    "follow_visible": _follow_shown,
    "copy_surface": _take_over,
    "raise_bounds": _raise_bounds,
    "clamp_to_bounds": _hold,
}
