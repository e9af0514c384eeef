"""The G-buffer of a slot from those of other frames."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, replace

import numpy as np

from exwarp_cli.domain.frame import Bool, Float32, GBuffer
from exwarp_cli.kernels import gather
from exwarp_cli.synthesis.geometry import depth_of

SMOOTH = ("albedo", "specular")
"""Sampled bilinearly, as colour is, so that they cancel where colour is divided by them."""

LEFT_OUT = ("window", "to_previous", "to_next")


def reprojected(sources: Sequence[tuple[GBuffer, Float32]]) -> tuple[GBuffer, Bool]:
    """Return a slot's G-buffer, taken from other frames'.

    Parameters
    ----------
    sources
        G-buffers on one window, each with the motion field float32 [H, W, 2] from the slot to it,
        NaN where it shows nothing of the slot. Each pixel comes from the first that shows it.

    Returns
    -------
    GBuffer
        The parts that the first source has, without motion, and a depth in any case: NaN where
        nothing shows what is there, as all else is 0.
    bool [H, W]
        Where that is so.
    """
    first = sources[0][0]
    out = {}
    unknown = np.ones(first.window.shape, np.bool_)
    sources = [(replace(gbuffer, depth=depth_of(gbuffer)), field) for gbuffer, field in sources]
    for part in fields(GBuffer):
        array = getattr(sources[0][0], part.name)
        if part.name in LEFT_OUT or array is None:
            continue
        made = np.full(array.shape, np.nan if part.name == "depth" else 0, array.dtype)
        missing = np.ones(array.shape[:2], np.bool_)
        for gbuffer, field in sources:
            other = getattr(gbuffer, part.name)
            if other is not None and missing.any():
                take = _sample if part.name in SMOOTH else _nearest
                missing &= ~take(other, field, missing, made)
        out[part.name] = made
        if part.name == "depth":
            unknown = missing
    return GBuffer(first.window, **out), unknown


def lookup(array: np.ndarray, field: Float32, default: object) -> np.ndarray:
    """Return what lies at the end of a motion field, from the nearest pixel.

    Parameters
    ----------
    array
        [H, W, ...].
    field
        float32 [H, W, 2], NaN where unknown.
    default
        For pixels without an end inside the frame.
    """
    out = np.full_like(array, default)
    _nearest(array, field, np.ones(array.shape[:2], np.bool_), out)
    return out


def _nearest(array: np.ndarray, field: Float32, wanted: Bool, out: np.ndarray) -> Bool:
    """Copy the nearest pixel at the end of a field to wanted pixels; return where there is one."""
    height, width = wanted.shape
    with np.errstate(invalid="ignore"):
        x = np.arange(width, dtype=np.float32) + field[..., 0]
        y = np.arange(height, dtype=np.float32)[:, None] + field[..., 1]
        inside = (x >= -0.5) & (y >= -0.5) & (x <= width - 0.5) & (y <= height - 0.5)
    took: Bool = inside & wanted
    column = np.clip(np.floor(x[took] + 0.5).astype(np.intp), 0, width - 1)
    row = np.clip(np.floor(y[took] + 0.5).astype(np.intp), 0, height - 1)
    out[took] = array[row, column]
    return took


def _sample(array: np.ndarray, field: Float32, wanted: Bool, out: np.ndarray) -> Bool:
    """Do the same bilinearly."""
    sampled, unseen = np.empty_like(out), np.empty(wanted.shape, np.bool_)
    gather.gather_bilinear(array, field, sampled, unseen)
    took: Bool = wanted & ~unseen
    out[took] = sampled[took]
    return took
