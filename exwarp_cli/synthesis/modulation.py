"""Taking surface colour out of shading, and colour into the range that networks work in."""

from __future__ import annotations

import numpy as np

from exwarp_cli.domain.frame import Float32, GBuffer, KeyFrame
from exwarp_cli.kernels import _row_bands, planes
from exwarp_cli.kernels._row_bands import Share, rows_of
from exwarp_cli.runtime.frame_pool import pool

DARKEST = 0.2
"""Surface colour that is divided by at the least: what is darker shows emission, refraction or the
sky, of which surface colour says nothing, and a silhouette mixes it with the surface beside it.

On four scenes with slot G-buffers, division with this floor gained W -0.8 to 1.1 dB at 0.1, 0.0 to
1.0 at 0.2, 0.2 to 0.8 at 0.3, 0.1 to 0.2 at 0.5; giving the background a colour of 1 or 0.5, or
adding the floor instead, was worse on the scene with foliage before the sky."""


BRIGHTEST = 2.0
"""At the most: white of both kinds."""

SIGN = np.uint32(0x80000000)
PART = 2**18
"""Values that are coded at a time. With fewer, threads that share them wait for each other more
often in between."""


def modulation_of(gbuffer: GBuffer) -> Float32 | None:
    """Return what lighting is multiplied with at a surface, float32 [H, W, 3].

    From DARKEST to BRIGHTEST. Diffuse and glossy colour together: metals have a black diffuse
    colour, so that without the glossy one nothing is known, and None is returned.
    """
    if gbuffer.albedo is None or gbuffer.specular is None:
        return None
    total: Float32 = pool.empty(gbuffer.albedo.shape, np.float32)
    _row_bands.run(_modulate, (gbuffer.albedo, gbuffer.specular, total), _row_bands.threads())
    return total


def _modulate(albedo: Float32, specular: Float32, out: Float32, share: Share) -> None:
    """Write the modulation of a share of the rows."""
    rows = rows_of(len(out), share)
    np.add(albedo[rows], specular[rows], out=out[rows])
    np.clip(out[rows], np.float32(DARKEST), np.float32(BRIGHTEST), out=out[rows])


def demodulated(frame: KeyFrame) -> Float32 | None:
    """Return a frame's pixels, float32 [H, W, C], divided by :func:`modulation_of` it.

    None where that is not known.
    """
    gbuffer, pixels = frame.gbuffer, np.ascontiguousarray(frame.image.pixels)
    if gbuffer is None or gbuffer.albedo is None or gbuffer.specular is None:
        return None
    out = np.empty_like(pixels)
    surface = np.ascontiguousarray(gbuffer.albedo), np.ascontiguousarray(gbuffer.specular)
    planes.demodulate(pixels, *surface, (DARKEST, BRIGHTEST), out)
    return out


def encode(linear: Float32) -> Float32:
    """Return sign(x) log(1 + |x|): high dynamic range in a few units, negative values kept."""
    return _signed(np.log1p, linear, np.empty(linear.shape, np.float32))


def encode_in_place(linear: Float32) -> None:
    """Write over linear values, contiguous, what :func:`encode` returns, in this thread alone."""
    _signed(np.log1p, linear, linear)


def decode(coded: Float32) -> Float32:
    """Return the linear values that :func:`encode` was given."""
    out: Float32 = pool.empty(coded.shape, np.float32)
    given = np.ascontiguousarray(coded).reshape(-1)
    _row_bands.run(_decode, (given, out.reshape(-1)), _row_bands.threads())
    return out


def _decode(coded: Float32, out: Float32, share: Share) -> None:
    """Write the linear values of a share of those that are given, both flat."""
    some = rows_of(coded.size, share)
    _signed(np.expm1, coded[some], out[some])


def _signed(curve: np.ufunc, values: Float32, out: Float32) -> Float32:
    """Write a curve of the magnitude with the value's sign, `out` being contiguous; return `out`.

    Numpy's curves compute 16 values at once, in a twentieth of the time of a loop of calls. A part
    at a time stays in the cache. A curve of magnitudes has no sign bit, so that setting it is the
    same as `copysign`, in a fifth of the time.
    """
    given, made = np.ascontiguousarray(values).reshape(-1), out.reshape(-1)
    room = np.empty(min(given.size, PART), np.float32)
    for first in range(0, given.size, PART):
        part, target = given[first : first + PART], made[first : first + PART]
        if part.view(np.int32).min() >= 0:  # none has a sign
            curve(part, out=target)
            continue
        size = room[: part.size]
        curve(np.abs(part, out=size), out=size)
        np.bitwise_and(part.view(np.uint32), SIGN, out=target.view(np.uint32))
        np.bitwise_or(target.view(np.uint32), size.view(np.uint32), out=target.view(np.uint32))
    return out
