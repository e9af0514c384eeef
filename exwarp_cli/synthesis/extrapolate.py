"""E: a slot's frame from the last three rendered ones by a network (paper, section II-C)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from exwarp_cli.domain.extrapolator import HISTORY, NetworkInputs
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

    inputs: NetworkInputs
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
    history = [_picture(last.pixels, visible)]
    for step, field, hidden in zip(past, seen.fields, seen.hidden, strict=False):
        history.append(_moved(_shading(step.frame, demodulated), field, hidden))
    history += [history[-1]] * (HISTORY - len(history))
    inputs = NetworkInputs(
        warped=np.concatenate([_coded(last.pixels * visible[..., None]), _coded(filled)]),
        mask=visible[None].astype(np.float32),
        features=_features(seen.surface),
        history=np.concatenate(history),
        time=slot / FACTOR,
    )
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


def _moved(pixels: Float32, field: Float32, hidden: Bool) -> Float32:
    """Move an older frame to the slot; return colour and mask, float32 [4, H, W]."""
    out, unseen = sampled(pixels, field)
    return _picture(out, ~(unseen | hidden))


def _picture(pixels: Float32, visible: Bool) -> Float32:
    return np.concatenate([_coded(pixels), visible[None].astype(np.float32)])


def _coded(pixels: Float32) -> Float32:
    """Return colour as the network sees it, float32 [3, H, W]."""
    return np.ascontiguousarray(encode(pixels[..., :3]).transpose(2, 0, 1))


def _features(surface: GBuffer) -> Float32:
    """Return the six feature planes of a slot, with defaults for what is not known."""
    shape = surface.window.shape
    normal = surface.normal if surface.normal is not None else np.zeros((*shape, 3), np.float32)
    planes = [
        *np.clip(np.nan_to_num(normal, posinf=0, neginf=0), -1, 1).transpose(2, 0, 1),
        _relative_depth(surface),
        _plane(surface.roughness, shape, UNKNOWN_ROUGHNESS),
        _plane(surface.metallic, shape, UNKNOWN_METALLIC),
    ]
    return np.stack(planes).astype(np.float32)


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
