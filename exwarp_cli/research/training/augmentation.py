"""Augmentation of rendered scenes: other key frames, backwards, and as users deliver it.

A variant chooses how a render is played. A look is what renderers, game engines and artists in a
hurry make of it: it is put on a clean render as it is loaded, so that a network learns from frames
like those that users have. Ground truth gets the tones of the look, but neither its noise nor its
rounding. No look has motion blur: what ExWarp makes frames of is rendered without.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from exwarp_cli.domain.colour import SRGB
from exwarp_cli.domain.frame import SURFACE_PARTS, Float32, GBuffer, Image, KeyFrame, Window

# What game engines do not deliver: they have colour, vectors, depth and a mask.
GAME = ("normal", "position", *SURFACE_PARTS)

# What is left are colour, vectors and depth.
BARE = (*GAME, "stencil")

# What any renderer may leave out, and how likely each pass is missing where some are.
OPTIONAL = ("depth", "normal", "position", "stencil", *SURFACE_PARTS)
LEFT_OUT = 0.4

# How often each kind is drawn.
PASSES = {"all": 0.4, "no surface": 0.2, "game": 0.2, "bare": 0.1, "some": 0.1}
TONES = {"linear": 0.7, "8-bit": 0.18, "tone-mapped": 0.12}
DEPTHS = {"full": 0.7, "coarse": 0.12, "inverse": 0.12, "absent": 0.06}
VECTORS = {"full": 0.7, "half": 0.15, "rounded": 0.15}

# How often each is drawn, apart from the kinds above.
SHARPENED = 0.12
NOISY = 0.15
ALIASED = 0.12

# Standard deviation of noise that is left, as a share of the light of a pixel of 1.
NOISE = (0.02, 0.12)

# How much of what a blurred copy lacks is added.
SHARPNESS = (0.3, 1.0)

# Scene-linear value that tone mapping shows as white.
WHITE = 4.0

# Of a depth that is stored as a share of the farthest one, and of rounded vectors.
COARSE_BITS = 10
STEPS_A_PIXEL = 4

# Scene units to a camera's near plane, by which inverse depth is stored.
_NEAREST = np.float32(0.05)


@dataclass(frozen=True)
class Variant:
    """One way of playing a render."""

    # Which instant, in playing order and counted from 0, is the first key frame: 0 <= phase < 4
    # speed.
    phase: int = 0
    backwards: bool = False  # Whether time runs backwards
    speed: int = 1  # 1, or 2 to take every second instant

    def order(self, count: int) -> range:
        """Return which of `count` instants are shown, in order; every fourth is a key frame."""
        played = range(count)[::-1] if self.backwards else range(count)
        return played[self.phase :: self.speed]


def reverse_time(gbuffer: GBuffer) -> GBuffer:
    """Let time run backwards: what was the motion to the next frame is that to the previous one."""
    # Displacements keep their sign, as they lead from this frame to the other in either case. In a
    # renderer's files, where both vectors run along time, they are exchanged and negated.
    bend = None if gbuffer.bend is None else gbuffer.bend[::-1]
    return replace(gbuffer, to_previous=gbuffer.to_next, to_next=gbuffer.to_previous, bend=bend)


@dataclass(frozen=True)
class Look:
    """One way of delivering a shot."""

    tones: str = "linear"  # "linear", "8-bit" (sRGB, clipped at 1) or "tone-mapped" (to 0..1).
    # "full"; "coarse", of few bits; "inverse", near by far as half floats; "absent".
    depth: str = "full"
    vectors: str = "full"  # "full"; "half" floats; "rounded" to a quarter of a pixel.
    missing: tuple[str, ...] = ()  # Passes that are left out
    # How strongly; 0 for not at all
    sharpened: float = 0.0
    noisy: float = 0.0
    # Whether only every second pixel is shown, which halves the size of the frame.
    aliased: bool = False


PLAIN = Look()


def draw_look(rng: np.random.Generator, can_halve: bool) -> Look:
    """Draw a look; `can_halve` if a frame of half the size is still large enough."""
    passes = _draw(PASSES, rng)
    subset = tuple(name for name in OPTIONAL if rng.random() < LEFT_OUT)
    sets = {"all": (), "no surface": SURFACE_PARTS, "game": GAME, "bare": BARE, "some": subset}
    tones, depth, vectors = _draw(TONES, rng), _draw(DEPTHS, rng), _draw(VECTORS, rng)
    sharpened = rng.uniform(*SHARPNESS) if rng.random() < SHARPENED else 0.0
    noisy = rng.uniform(*NOISE) if rng.random() < NOISY else 0.0
    is_aliased = bool(rng.random() < ALIASED) and can_halve
    return Look(tones, depth, vectors, sets[passes], sharpened, noisy, is_aliased)


def deliver(frame: KeyFrame, look: Look, rng: np.random.Generator) -> KeyFrame:
    """Return a frame as the look delivers it; `rng` draws its noise."""
    image = with_tones(frame.image, look)
    pixels = image.pixels
    if look.noisy:
        colour = pixels[..., :3]
        # Noise of light paths grows with the square root of light.
        spread = np.float32(look.noisy) * np.sqrt(np.maximum(colour, 0))
        colour = colour + spread * rng.standard_normal(colour.shape, np.float32)
        pixels = _with_colour(pixels, np.maximum(colour, 0))
    if look.tones == "8-bit":
        code = np.round(SRGB.to_code(pixels[..., :3].clip(0, 1)) * 255) / np.float32(255)
        pixels = _with_colour(pixels, SRGB.to_linear(code.astype(np.float32)))
    gbuffer = None if frame.gbuffer is None else _deliver_geometry(frame.gbuffer, look)
    return replace(frame, image=replace(image, pixels=pixels), gbuffer=gbuffer)


def with_tones(image: Image, look: Look) -> Image:
    """Return the ground truth of a look: its size and tones, without noise and rounding."""
    if look.aliased:
        image = Image(
            image.pixels[::2, ::2], _halved(image.data_window), _halved(image.display_window)
        )
    if look.tones == "linear" and not look.sharpened:
        return image
    colour = image.pixels[..., :3]
    if look.tones == "tone-mapped":
        light = np.maximum(colour, 0)
        with np.errstate(invalid="ignore"):  # infinity becomes NaN, which is no target either
            colour = (light * (1 + light / np.float32(WHITE**2)) / (1 + light)).clip(0, 1)
    elif look.tones == "8-bit":
        colour = colour.clip(0, 1)
    if look.sharpened:
        # Against the mean of each pixel and its neighbours, (1, 2, 1) / 4 along both axes.
        padded = np.pad(colour, ((1, 1), (1, 1), (0, 0)), "edge")
        rows = (padded[:-2] + 2 * padded[1:-1] + padded[2:]) / np.float32(4)
        blurred = (rows[:, :-2] + 2 * rows[:, 1:-1] + rows[:, 2:]) / np.float32(4)
        colour = np.maximum(colour + np.float32(look.sharpened) * (colour - blurred), 0)
    return replace(image, pixels=_with_colour(image.pixels, colour))


def _deliver_geometry(gbuffer: GBuffer, look: Look) -> GBuffer:
    if look.aliased:
        parts = ((part.name, getattr(gbuffer, part.name)) for part in fields(gbuffer))
        arrays = {name: part[::2, ::2] for name, part in parts if isinstance(part, np.ndarray)}
        if gbuffer.bend is not None:
            arrays["bend"] = gbuffer.bend[:, ::2, ::2]
        for name in ("to_previous", "to_next", "bend"):
            if name in arrays:
                arrays[name] = arrays[name] / np.float32(2)
        gbuffer = replace(gbuffer, window=_halved(gbuffer.window), **arrays)
    missing = (*look.missing, "depth") if look.depth == "absent" else look.missing
    gbuffer = gbuffer.without(*missing)
    changed: dict[str, Any] = {}
    for name in ("to_previous", "to_next"):
        vectors = getattr(gbuffer, name)
        if vectors is not None and look.vectors == "half":
            changed[name] = vectors.astype(np.float16).astype(np.float32)
        elif vectors is not None and look.vectors == "rounded":
            changed[name] = np.round(vectors * STEPS_A_PIXEL) / np.float32(STEPS_A_PIXEL)
    depth = gbuffer.depth
    if depth is None or not (finite := np.isfinite(depth)).any():
        return replace(gbuffer, **changed)
    # Background stays infinite.
    if look.depth == "inverse":
        stored = (_NEAREST / np.maximum(depth, _NEAREST)).astype(np.float16).astype(np.float32)
        with np.errstate(divide="ignore"):
            changed["depth"] = np.where(finite, _NEAREST / stored, depth)
    elif look.depth == "coarse":
        step = depth[finite].max() / np.float32(2**COARSE_BITS - 1)
        coarse = np.maximum(np.round(depth / step), 1) * step
        changed["depth"] = np.where(finite, coarse, depth)
    return replace(gbuffer, **changed)


def _halved(window: Window) -> Window:
    return Window(window.x // 2, window.y // 2, (window.width + 1) // 2, (window.height + 1) // 2)


def _with_colour(pixels: Float32, colour: Float32) -> Float32:
    return np.concatenate([colour.astype(np.float32), pixels[..., 3:]], axis=-1)


def _draw(shares: dict[str, float], rng: np.random.Generator) -> str:
    return str(rng.choice(list(shares), p=list(shares.values())))
