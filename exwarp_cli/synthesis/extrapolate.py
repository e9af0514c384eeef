"""E: a slot's frame from the last three rendered ones by a network (paper, section II-C)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from exwarp_cli.domain.frame import Bool, Float32, GBuffer, KeyFrame
from exwarp_cli.domain.network_api import (
    EXTRAPOLATOR_INPUTS,
    HISTORY_FRAMES,
    ExtrapolatorInputs,
    NetworkInputs,
)
from exwarp_cli.domain.timeline import FACTOR
from exwarp_cli.kernels import _row_bands, network_planes
from exwarp_cli.kernels._row_bands import Band, band_slice
from exwarp_cli.runtime.frame_pool import IN_MEMORY, ScratchFrames, pool
from exwarp_cli.synthesis.geometry import SlotField
from exwarp_cli.synthesis.history import SMOOTH, LookBack, Past, lit_alike
from exwarp_cli.synthesis.source_bounds import Side, Sources, hold_within
from exwarp_cli.synthesis.warp import Mover, fill_holes

UNKNOWN_DEPTH = 0.5
UNKNOWN_ROUGHNESS = 0.5
UNKNOWN_METALLIC = 0.0
"""What the network receives for a slot whose G-buffer lacks depth, roughness or metallic; an
unknown normal is 0, as that of the background."""

COLOUR_PLANES = ((3, 3), (13, 3), (17, 3), (21, 3))
"""Which of a network's planes, in the order of INPUTS, hold colour: the first, and how many. The
first three of all are those from 13 on, times the mask."""

NO_PLANE, NO_VECTORS = np.zeros((0, 0), np.float32), np.zeros((0, 0, 3), np.float32)
"""What kernels are given for what is not known."""

ALL = slice(None)
"""Every row or column."""


@dataclass(frozen=True)
class Moved:
    """A rendered frame moved to the slot.

    Attributes
    ----------
    pixels
        float32 [H, W, C], divided by surface colour where that is known.
    visible
        bool [H, W]: the frame shows the slot's surface.
    """

    pixels: Float32
    visible: Bool


@dataclass(frozen=True)
class SlotInputs:
    """What a network is given for a slot, coded part by part as it is asked for.

    All 25 planes at once are 830 MB for a frame of 3840x2160, and what they are made of is here.

    Attributes
    ----------
    frames
        F_k, F_k-1 and F_k-2, the oldest repeated where there are fewer.
    filled
        float32 [H, W, C]: W's frame, divided by surface colour where that is known.
    surface
        The slot's G-buffer.
    median
        Of its depth, where it is finite.
    time
        Of the slot in its key interval.
    scratch
        Where large arrays lie.
    """

    frames: tuple[Moved, Moved, Moved]
    filled: Float32
    surface: GBuffer
    median: float
    time: float
    scratch: ScratchFrames = IN_MEMORY

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width."""
        return self.surface.window.shape

    def part(self, rows: slice, columns: slice, room: Float32 | None = None) -> NetworkInputs:
        """Return the inputs of some rows and columns; beyond the frame its edge is repeated."""
        (top, bottom), (left, right) = (
            (given.start or 0, size if given.stop is None else given.stop)
            for given, size in zip((rows, columns), self.shape, strict=True)
        )
        shape = sum(EXTRAPOLATOR_INPUTS.values()), bottom - top, right - left
        made = np.empty(shape, np.float32) if room is None else room
        known = self.surface
        surface = _plane(known.depth), _plane(known.normal, NO_VECTORS)
        materials = _plane(known.roughness), _plane(known.metallic)
        frames = tuple((frame.pixels, frame.visible) for frame in self.frames)
        defaults = UNKNOWN_DEPTH, UNKNOWN_ROUGHNESS, UNKNOWN_METALLIC
        network_planes.write_input_planes(
            frames, self.filled, (*surface, *materials), defaults, np.float32(self.median),
            (top, left), made,
        )  # fmt: skip
        self.scratch.page_out()  # before the network takes its memory
        _row_bands.run_bands(_encode, (made.reshape(len(made), -1),), _row_bands.threads())
        ends = np.cumsum(list(EXTRAPOLATOR_INPUTS.values()))[:-1]
        warped, mask, features, history = np.split(made, ends)
        return NetworkInputs(warped, mask, features, history, self.time)

    @property
    def warped(self) -> Float32:
        """As `NetworkInputs` has it, of the whole frame, as the other planes are.

        Callers that need several of them take one `part`: each is made with all the others.
        """
        return self.part(ALL, ALL).warped

    @property
    def mask(self) -> Float32:
        """float32 [1, H, W]."""
        return self.part(ALL, ALL).mask

    @property
    def features(self) -> Float32:
        """float32 [6, H, W]."""
        return self.part(ALL, ALL).features

    @property
    def history(self) -> Float32:
        """float32 [12, H, W]."""
        return self.part(ALL, ALL).history

    @property
    def pictures(self) -> dict[str, Float32]:
        """The picture inputs by name."""
        return self.part(ALL, ALL).pictures


@dataclass(frozen=True)
class Prepared:
    """What the network needs for a slot, and what its answer has to go through.

    Attributes
    ----------
    inputs
        For the network.
    modulation
        float32 [H, W, 3] that its answer is multiplied with; None for an answer that is colour.
    warped
        float32 [H, W, C]: W's frame, whose alpha is taken over.
    sources
        The key frames, in whose range around the slot's places the frame is held.
    """

    inputs: ExtrapolatorInputs
    modulation: Float32 | None
    warped: Float32
    sources: Sources

    def finish(self, answer: Float32) -> Float32:
        """Turn the network's answer, float32 [3, H, W], into scene-linear colour [H, W, C]."""
        out: Float32 = pool.empty(self.warped.shape, np.float32)
        modulation = NO_VECTORS if self.modulation is None else self.modulation
        network_planes.write_network_frame(decode(answer), modulation, self.warped, out)
        hold_within(out, self.sources)
        return out


def prepare(
    slot: int,
    warped: Float32,
    back: SlotField,
    seen: LookBack,
    key: KeyFrame,
    past: Sequence[Past],
    scratch: ScratchFrames = IN_MEMORY,
) -> Prepared:
    """Gather what the network needs for a slot.

    Parameters
    ----------
    slot
        1 to 3.
    warped
        float32 [H, W, C], scene-linear: W's frame of the slot.
    back, seen
        The slot's motion field to the key frame, and what is known of its surfaces.
    key, past
        F_k, and F_k-1 and F_k-2 as far as they are there. Those in other light are left out.
    scratch
        Where what is large waits for the network.
    """
    modulation = scratch.store(_modulation(seen))
    divided = modulation is not None
    # Its colours are in the modulation.
    surface = seen.surface.without(*SMOOTH)
    mover = Mover(back)
    pixels, hole = mover.move(mover.codes(_shading(key, divided)))
    warped = scratch.store(warped)
    filled = warped
    if modulation is not None:
        filled = warped.copy()
        filled[..., :3] /= modulation
        filled = scratch.store(filled)
    history = [scratch.store(Moved(mover.light(pixels), ~hole))]
    sides = [Side(key.image.pixels, back.field, history[0].visible)]
    del pixels
    for step, field, hidden in zip(past, seen.fields, seen.hidden, strict=False):
        mover = Mover(SlotField(field, back.depth, hidden))
        pixels, unseen = mover.move(mover.codes(_shading(step.frame, divided)))
        older = scratch.store(Moved(mover.light(pixels), ~unseen))
        if lit_alike(history[0].pixels, older.pixels, history[0].visible & older.visible):
            history.append(older)
            sides.append(Side(step.frame.image.pixels, field, older.visible))
        del pixels, older
        scratch.page_out()
    history += [history[-1]] * (HISTORY_FRAMES - len(history))
    now, before, oldest = history
    median = _median(surface.depth)
    inputs = SlotInputs((now, before, oldest), filled, surface, median, slot / FACTOR, scratch)
    sources = scratch.store(Sources((sides[0],), tuple(sides[1:]), back.depth, warped))
    return Prepared(inputs, modulation, warped, sources)


def _encode(made: Float32, share: Band) -> None:
    """Encode the colour of a network's planes [C, N], of a share of their pixels."""
    part = made[:, band_slice(made.shape[1], share)]
    for first, count in COLOUR_PLANES:
        for line in part[first : first + count]:
            encode_in_place(line)
    np.multiply(part[13:16], part[16], out=part[:3])


def _shading(frame: KeyFrame, divided: bool) -> Float32:
    """Return a frame's pixels, float32 [H, W, C], divided by its surface colour where known."""
    shading = demodulated(frame) if divided else None
    return frame.image.pixels if shading is None else shading


def _plane(values: Float32 | None, nothing: Float32 = NO_PLANE) -> Float32:
    """Return what a kernel is given."""
    return nothing if values is None else np.ascontiguousarray(values)


def _median(depth: Float32 | None) -> float:
    """Return the median of the finite depths, by which they become relative: d / (d + median)."""
    if depth is None:
        return 1.0
    away = np.maximum(depth, 0)
    known = away[np.isfinite(away)]
    return float(np.median(known)) if known.size else 1.0


def _modulation(seen: LookBack) -> Float32 | None:
    """Return the slot's surface colour, filled from the background where nothing shows it."""
    modulation = modulation_of(seen.surface)
    if modulation is None or not seen.unknown.any():
        return modulation
    assert seen.surface.depth is not None
    return fill_holes(modulation, seen.surface.depth, seen.unknown)


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
    _row_bands.run_bands(_modulate, (gbuffer.albedo, gbuffer.specular, total), _row_bands.threads())
    return total


def _modulate(albedo: Float32, specular: Float32, out: Float32, share: Band) -> None:
    """Write the modulation of a share of the rows."""
    rows = band_slice(len(out), share)
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
    network_planes.divide_by_albedo(pixels, *surface, (DARKEST, BRIGHTEST), out)
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
    _row_bands.run_bands(_decode, (given, out.reshape(-1)), _row_bands.threads())
    return out


def _decode(coded: Float32, out: Float32, share: Band) -> None:
    """Write the linear values of a share of those that are given, both flat."""
    some = band_slice(coded.size, share)
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
