"""E: a slot's frame from the last three rendered ones by a network (paper, section II-C)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from exwarp_cli.domain.extrapolator import HISTORY, Inputs, NetworkInputs
from exwarp_cli.domain.frame import Bool, Float32, GBuffer, KeyFrame
from exwarp_cli.domain.timeline import FACTOR
from exwarp_cli.synthesis.geometry import SlotField
from exwarp_cli.synthesis.history import LookBack, Past
from exwarp_cli.synthesis.modulation import decode, encode, modulation_of
from exwarp_cli.synthesis.warp import fill_holes, sampled, warp

UNKNOWN_DEPTH = 0.5
UNKNOWN_ROUGHNESS = 0.5
UNKNOWN_METALLIC = 0.0
"""What the network is told of a slot whose G-buffer lacks depth, roughness or metallic; an unknown
normal is 0, as that of the background."""

ALL = (slice(None), slice(None))
"""Every row and column."""


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

    def part(self, rows: slice, columns: slice) -> Float32:
        """Return coded colour and mask of some rows and columns, float32 [4, H, W]."""
        visible = self.visible[None, rows, columns].astype(np.float32)
        return np.concatenate([_coded(self.pixels[rows, columns]), visible])


@dataclass(frozen=True)
class SlotInputs:
    """What a network is given for a slot, coded part by part as it is asked for.

    All 25 planes at once are 830 MB for a frame of 3840x2160, and what they are made of is here.

    Attributes
    ----------
    frames
        F_k, F_k-1 and F_k-2, the oldest repeated where there are fewer.
    filled
        float32 [H, W, C]: the first of them with its holes filled.
    surface
        The slot's G-buffer.
    depth
        float32 [H, W], relative.
    time
        Of the slot in its key interval.
    """

    frames: tuple[Moved, ...]
    filled: Float32
    surface: GBuffer
    depth: Float32
    time: float

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width."""
        return self.surface.window.shape

    def part(self, rows: slice, columns: slice) -> NetworkInputs:
        """Return the inputs of some rows and columns."""
        where = (rows, columns)
        return NetworkInputs(
            self._warped(*where), self._mask(*where), self._features(*where),
            self._history(*where), self.time,
        )  # fmt: skip

    @property
    def warped(self) -> Float32:
        """As `NetworkInputs` has it, of the whole frame; so are the other planes."""
        return self._warped(*ALL)

    @property
    def mask(self) -> Float32:
        """float32 [1, H, W]."""
        return self._mask(*ALL)

    @property
    def features(self) -> Float32:
        """float32 [6, H, W]."""
        return self._features(*ALL)

    @property
    def history(self) -> Float32:
        """float32 [12, H, W]."""
        return self._history(*ALL)

    @property
    def pictures(self) -> dict[str, Float32]:
        """The picture inputs by name."""
        return self.part(*ALL).pictures

    def _warped(self, rows: slice, columns: slice) -> Float32:
        last = self.frames[0]
        shown = last.pixels[rows, columns] * last.visible[rows, columns, None]
        return np.concatenate([_coded(shown), _coded(self.filled[rows, columns])])

    def _mask(self, rows: slice, columns: slice) -> Float32:
        return self.frames[0].visible[None, rows, columns].astype(np.float32)

    def _history(self, rows: slice, columns: slice) -> Float32:
        return np.concatenate([frame.part(rows, columns) for frame in self.frames])

    def _features(self, rows: slice, columns: slice) -> Float32:
        """Return the six feature planes, with defaults for what is not known."""
        depth = self.depth[rows, columns]
        normal, roughness, metallic = (
            None if array is None else array[rows, columns]
            for array in (self.surface.normal, self.surface.roughness, self.surface.metallic)
        )
        if normal is None:
            normal = np.zeros((*depth.shape, 3), np.float32)
        planes = [
            *np.clip(np.nan_to_num(normal, posinf=0, neginf=0), -1, 1).transpose(2, 0, 1),
            depth,
            _plane(roughness, depth.shape, UNKNOWN_ROUGHNESS),
            _plane(metallic, depth.shape, UNKNOWN_METALLIC),
        ]
        return np.stack(planes).astype(np.float32)


@dataclass(frozen=True)
class Prepared:
    """What the network needs for a slot, and what its answer has to go through.

    Attributes
    ----------
    inputs
        For the network.
    modulation
        float32 [H, W, 3] that its answer is multiplied with; None for an answer that is colour.
    alpha
        float32 [H, W, 1], warped and filled; [H, W, 0] without.
    empty
        bool [H, W]: the filled warp is 0 in colour and alpha; so is the frame, where it has alpha.
    """

    inputs: Inputs
    modulation: Float32 | None
    alpha: Float32
    empty: Bool

    def finish(self, answer: Float32) -> Float32:
        """Turn the network's answer, float32 [3, H, W], into scene-linear colour [H, W, C]."""
        colour = decode(answer.transpose(1, 2, 0))
        if self.modulation is not None:
            colour = colour * self.modulation
        if self.alpha.size:
            colour = np.where(self.empty[..., None], np.float32(0), colour)
        return np.concatenate([colour, self.alpha], axis=-1).astype(np.float32, order="C")


def prepare(
    slot: int, back: SlotField, seen: LookBack, key: KeyFrame, past: Sequence[Past]
) -> Prepared:
    """Gather what the network needs for a slot.

    Parameters
    ----------
    slot
        1 to 3.
    back, seen
        The slot's motion field to the key frame, and what is known of its surfaces.
    key, past
        F_k, and F_k-1 and F_k-2 as far as they are there.
    """
    modulation = _modulation(seen)
    demodulated = modulation is not None
    last = warp(_shading(key, demodulated), back)
    filled, visible = fill_holes(last.pixels.copy(), last.depth, last.hole), ~last.hole
    history = [Moved(last.pixels, visible)]
    for step, field, hidden in zip(past, seen.fields, seen.hidden, strict=False):
        pixels, unseen = sampled(_shading(step.frame, demodulated), field)
        history.append(Moved(pixels, ~(unseen | hidden)))
    history += [history[-1]] * (HISTORY - len(history))
    depth = _relative_depth(seen.surface)
    inputs = SlotInputs(tuple(history), filled, seen.surface, depth, slot / FACTOR)
    empty = (filled == 0).all(axis=-1)
    return Prepared(inputs, modulation, filled[..., 3:], empty)


def _shading(frame: KeyFrame, demodulated: bool) -> Float32:
    """Return a frame's pixels, float32 [H, W, C], divided by its surface colour."""
    pixels = frame.image.pixels
    modulation = None
    if demodulated and frame.gbuffer is not None:
        modulation = modulation_of(frame.gbuffer)
    if modulation is None:
        return pixels
    return np.concatenate([pixels[..., :3] / modulation, pixels[..., 3:]], axis=-1)


def _coded(pixels: Float32) -> Float32:
    """Return colour as the network sees it, float32 [3, H, W]."""
    return np.ascontiguousarray(encode(pixels[..., :3]).transpose(2, 0, 1))


def _plane(values: Float32 | None, shape: tuple[int, int], unknown: float) -> Float32:
    if values is None:
        return np.full(shape, unknown, np.float32)
    return np.asarray(np.clip(np.nan_to_num(values, nan=unknown), 0, 1))


def _relative_depth(surface: GBuffer) -> Float32:
    """Return d / (d + median): 0 to 1 whatever the unit, 1 for the background."""
    if surface.depth is None:
        return np.full(surface.window.shape, UNKNOWN_DEPTH, np.float32)
    depth = np.maximum(surface.depth, 0)
    finite = depth[np.isfinite(depth)]
    median = float(np.median(finite)) if finite.size else 1.0
    relative = 1 - median / (depth + max(median, np.finfo(np.float32).tiny))
    return np.asarray(np.nan_to_num(relative, nan=UNKNOWN_DEPTH), np.float32)


def _modulation(seen: LookBack) -> Float32 | None:
    """Return the slot's surface colour, filled from the background where nothing shows it."""
    modulation = modulation_of(seen.surface)
    if modulation is None or not seen.unknown.any():
        return modulation
    assert seen.surface.depth is not None
    return fill_holes(modulation, seen.surface.depth, seen.unknown)
