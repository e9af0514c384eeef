"""Taking surface colour out of shading, and colour into the range that networks work in."""

from __future__ import annotations

import numpy as np

from exwarp_cli.domain.frame import Float32, GBuffer

DARKEST = 0.2
"""Surface colour that is divided by at the least: what is darker shows emission, refraction or the
sky, of which surface colour says nothing, and a silhouette mixes it with the surface beside it.

On four scenes with slot G-buffers, division with this floor gained W -0.8 to 1.1 dB at 0.1, 0.0 to
1.0 at 0.2, 0.2 to 0.8 at 0.3, 0.1 to 0.2 at 0.5; giving the background a colour of 1 or 0.5, or
adding the floor instead, was worse on the scene with foliage before the sky."""


def modulation_of(gbuffer: GBuffer) -> Float32 | None:
    """Return what lighting is multiplied with at a surface, float32 [H, W, 3], DARKEST to 2.

    Diffuse and glossy colour together: metals have a black diffuse colour, so that without the
    glossy one nothing is known, and None is returned.
    """
    if gbuffer.albedo is None or gbuffer.specular is None:
        return None
    total = gbuffer.albedo + gbuffer.specular
    return np.asarray(np.clip(total, np.float32(DARKEST), np.float32(2)))


def encode(linear: Float32) -> Float32:
    """Return sign(x) log(1 + |x|): high dynamic range in a few units, negative values kept."""
    return np.copysign(np.log1p(np.abs(linear)), linear)


def decode(coded: Float32) -> Float32:
    """Return the linear values that :func:`encode` was given."""
    return np.copysign(np.expm1(np.abs(coded)), coded)
