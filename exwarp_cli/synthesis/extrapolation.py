"""E: a slot's frame from the last three rendered ones by a network (paper, section II-C)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from exwarp_cli.domain import network_api
from exwarp_cli.domain.frame import Bool, Float32, GBuffer, KeyFrame
from exwarp_cli.domain.timeline import FACTOR
from exwarp_cli.kernels import _row_bands
from exwarp_cli.runtime.frame_pool import IN_MEMORY, ScratchFrames, pool
from exwarp_cli.synthesis.history import SMOOTH, HistorySamples, OlderKeyFrame, is_lit_alike
from exwarp_cli.synthesis.motion_fields import SlotField
from exwarp_cli.synthesis.source_bounds import ColourSource, SlotSources, hold_within
from exwarp_cli.synthesis.warp import Mover, fill_holes

# What the network receives for a slot whose G-buffer lacks depth, roughness or metallic; an unknown
# normal is 0, as that of the background.
UNKNOWN_DEPTH, UNKNOWN_ROUGHNESS, UNKNOWN_METALLIC = 0.5, 0.5, 0.0

# Least median of depths, which are divided by it.
MIN_MEDIAN = np.finfo(np.float32).tiny

# Surface colour is divided by at least this: what is darker shows emission, refraction or the sky,
# of which surface colour says nothing, and a silhouette mixes it with the surface beside it. On
# four scenes with slot G-buffers, division with this floor gained W -0.8 to 1.1 dB at 0.1, 0.0 to
# 1.0 at 0.2, 0.2 to 0.8 at 0.3, 0.1 to 0.2 at 0.5; giving the background a colour of 1 or 0.5, or
# adding the floor instead, was worse on the scene with foliage before the sky.
DARKEST = 0.2

# At most: white of both kinds.
BRIGHTEST = 2.0


@dataclass(frozen=True)
class MovedFrame:
    """A rendered frame moved to the slot."""

    pixels: Float32  # [H, W, C], divided by surface colour where that is known
    visible: Bool  # [H, W]: the frame shows the slot's surface


@dataclass(frozen=True)
class SlotInputs:
    """The inputs of a network for a slot, coded part by part as requested.

    All 25 planes at once are 830 MB for a frame of 3840x2160.
    """

    frames: tuple[MovedFrame, ...]  # F_k, F_k-1, F_k-2; the oldest repeated if there are fewer
    filled: Float32  # [H, W, C]: W's frame, divided by surface colour where that is known
    surface: GBuffer  # of the slot
    median: float  # of its finite depths, which become relative: d / (d + median)
    time: float  # of the slot in its key interval
    scratch: ScratchFrames = IN_MEMORY  # where large arrays are kept

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width."""
        return self.surface.window.shape

    def part(
        self, rows: slice, columns: slice, room: Float32 | None = None
    ) -> network_api.NetworkPictures:
        """Return the inputs of some rows and columns; beyond the frame its edge is repeated."""
        (top, bottom), (left, right) = (
            (span.start or 0, size if span.stop is None else span.stop)
            for span, size in zip((rows, columns), self.shape, strict=True)
        )
        shape = network_api.EXTRAPOLATOR_INTERFACE.channels, bottom - top, right - left
        out = np.empty(shape, np.float32) if room is None else room
        _row_bands.run_bands(self._write_rows, (out, (top, left)), _row_bands.threads())
        self.scratch.page_out()  # before the network takes its memory
        return network_api.NetworkPictures(network_api.EXTRAPOLATOR_INTERFACE.split(out), self.time)

    def _write_rows(self, planes: Float32, corner: tuple[int, int], band: _row_bands.Band) -> None:
        """Write a band of rows of a part [25, h, w], which begins at a row and column."""
        (height, width), (top, left), surface = self.shape, corner, self.surface
        lines = _row_bands.band_range(planes.shape[1], band)
        part = planes[:, lines.start : lines.stop]
        begin, end = max(-left, 0), min(width - left, part.shape[2])
        rows = np.clip(np.arange(top + lines.start, top + lines.stop), 0, height - 1)
        place = np.s_[rows, left + begin : left + end]
        inside = network_api.EXTRAPOLATOR_INTERFACE.split(part[..., begin:end])
        warped, features, history = inside["warped"], inside["features"], inside["history"]
        colours = [(self.filled, warped[3:])]
        for k, frame in enumerate(self.frames):
            colours.append((frame.pixels, history[4 * k : 4 * k + 3]))
            history[4 * k + 3] = frame.visible[place]
        for pixels, colour in colours:
            colour[:] = np.moveaxis(pixels[place][..., :3], -1, 0)
            encode(colour, out=colour)
        inside["mask"][0] = history[3]
        np.multiply(history[:3], history[3], out=warped[:3])
        features[:3] = 0
        if surface.normal is not None:
            normal = surface.normal[place]
            normal = np.where(np.isfinite(normal), normal.clip(-1, 1), np.float32(0))
            features[:3] = np.moveaxis(normal, -1, 0)
        depth, roughness, metallic = (
            None if values is None else values[place]
            for values in (surface.depth, surface.roughness, surface.metallic)
        )
        if depth is not None:
            median = np.float32(self.median)
            with np.errstate(over="ignore"):  # of the largest floats
                distance = np.maximum(depth, 0) + max(median, MIN_MEDIAN)
            depth = np.float32(1) - median / distance
        known = (depth, UNKNOWN_DEPTH), (roughness, UNKNOWN_ROUGHNESS), (metallic, UNKNOWN_METALLIC)
        for plane, (values, unknown) in zip(features[3:], known, strict=True):
            plane[:] = unknown
            if values is not None:
                np.copyto(plane, values.clip(0, 1), where=~np.isnan(values))
        part[..., :begin] = part[..., begin : begin + 1]
        part[..., end:] = part[..., end - 1 : end]

    @property
    def pictures(self) -> Mapping[str, Float32]:
        """The picture inputs of the whole frame by name."""
        return self.part(slice(None), slice(None)).pictures


@dataclass(frozen=True)
class Prepared:
    """What the network needs for a slot, and what turns its answer into a frame."""

    inputs: network_api.LazyInputs
    modulation: Float32 | None  # [H, W, 3], factor of the answer; None if the answer is colour
    warped: Float32  # [H, W, C]: W's frame, whose alpha is taken over
    sources: SlotSources  # the key frames, in whose range the frame is held

    def finish(self, answer: Float32) -> Float32:
        """Turn the network's answer, float32 [3, H, W], into scene-linear colour [H, W, C]."""
        out: Float32 = pool.empty(self.warped.shape, np.float32)
        out[..., :3] = np.moveaxis(decode(answer), 0, -1)
        if self.modulation is not None:
            with np.errstate(over="ignore"):  # of the largest floats
                out[..., :3] *= self.modulation
        out[..., 3:] = self.warped[..., 3:]
        hold_within(out, self.sources)
        return out


def prepare(
    slot: int,  # 1 to 3
    warped: Float32,  # [H, W, C], scene-linear: W's frame of the slot
    # The slot's motion field to the key frame, and its surfaces.
    back: SlotField,
    samples: HistorySamples,
    # F_k, and F_k-1 and F_k-2 as far as they exist. Those in other light are left out.
    key: KeyFrame,
    past: Sequence[OlderKeyFrame],
    scratch: ScratchFrames = IN_MEMORY,  # where large arrays wait for the network
) -> Prepared:
    """Gather what the network needs for a slot."""
    modulation = modulation_of(samples.surface)
    if modulation is not None and samples.unknown.any():
        assert samples.surface.depth is not None
        modulation = fill_holes(modulation, samples.surface.depth, samples.unknown)
    modulation = scratch.store(modulation)
    surface = samples.surface.without(*SMOOTH)  # whose colours are in the modulation

    def move(frame: KeyFrame, source: SlotField) -> MovedFrame:
        mover, pixels, own = Mover(source), frame.image.pixels, None
        if modulation is not None and frame.gbuffer is not None:
            own = modulation_of(frame.gbuffer)
        pixels, unseen = mover.move(
            mover.codes(pixels if own is None else demodulated(pixels, own))
        )
        return scratch.store(MovedFrame(mover.light(pixels), ~unseen))

    newest = move(key, back)
    warped = scratch.store(warped)
    filled = warped if modulation is None else scratch.store(demodulated(warped, modulation))
    history, older = [newest], []
    for step, field, hidden in zip(past, samples.fields, samples.hidden, strict=False):
        moved = move(step.frame, SlotField(field, back.depth, hidden))
        if is_lit_alike(newest.pixels, moved.pixels, newest.visible & moved.visible):
            history.append(moved)
            older.append(ColourSource(step.frame.image.pixels, field, moved.visible))
        del moved
        scratch.page_out()
    history += [history[-1]] * (network_api.HISTORY_FRAMES - len(history))
    depth = np.ones(1) if surface.depth is None else np.maximum(surface.depth, 0)
    depth = depth[np.isfinite(depth)]
    median = float(np.median(depth)) if depth.size else 1.0
    inputs = SlotInputs(tuple(history), filled, surface, median, slot / FACTOR, scratch)
    side = ColourSource(key.image.pixels, back.field, newest.visible)
    sources = scratch.store(SlotSources((side,), tuple(older), back.depth, warped))
    return Prepared(inputs, modulation, warped, sources)


def modulation_of(gbuffer: GBuffer) -> Float32 | None:
    """Return the factor of lighting at a surface, float32 [H, W, 3], from DARKEST to BRIGHTEST.

    Diffuse and glossy colour together. None without both: metals have a black diffuse colour.
    """
    if gbuffer.albedo is None or gbuffer.specular is None:
        return None
    total: Float32 = pool.empty(gbuffer.albedo.shape, np.float32)
    np.add(gbuffer.albedo, gbuffer.specular, out=total)
    return np.clip(total, np.float32(DARKEST), np.float32(BRIGHTEST), out=total)


def demodulated(pixels: Float32, modulation: Float32) -> Float32:
    """Return pixels, float32 [H, W, C], divided by a :func:`modulation_of`."""
    out = np.array(pixels, order="C")
    with np.errstate(over="ignore"):  # of the largest floats
        out[..., :3] /= modulation
    return out


def encode(linear: Float32, out: Float32 | None = None) -> Float32:
    """Return sign(x) log(1 + |x|): high dynamic range in a few units, negative values kept.

    `out` may be `linear` itself.
    """
    size = np.abs(linear)
    coded: Float32 = np.copysign(np.log1p(size, out=size), linear, out=out)
    return coded


def decode(coded: Float32) -> Float32:
    """Invert :func:`encode`."""
    size = np.abs(coded)
    linear: Float32 = np.copysign(np.expm1(size, out=size), coded, out=size)
    return linear
