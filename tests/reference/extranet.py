"""Naive twin of ExtraNet: arrays [C, H, W] and a state dict of arrays."""

from __future__ import annotations

import numpy as np

State = dict[str, np.ndarray]
BLOCK = (("0", "1"), ("3", "4"), ("6", "7"))


def convolve(x: np.ndarray, weight: np.ndarray, bias: np.ndarray, step: int = 1) -> np.ndarray:
    """Correlate with zeros around, and keep every `step`-th row and column."""
    outputs, _, size, _ = weight.shape
    reach, (_, height, width) = size // 2, x.shape
    padded = np.pad(x, ((0, 0), (reach, reach), (reach, reach)))
    out = np.zeros((outputs, height, width))
    for i in range(size):
        for j in range(size):
            shifted = padded[:, i : i + height, j : j + width]
            out += np.tensordot(weight[:, :, i, j], shifted, axes=1)
    return (out + bias[:, None, None])[:, ::step, ::step]


def normalise(x: np.ndarray, state: State, name: str) -> np.ndarray:
    """Batch normalisation as after training, then ReLU."""
    mean, variance = state[f"{name}.running_mean"], state[f"{name}.running_var"]
    scale = state[f"{name}.weight"] / np.sqrt(variance + 1e-5)
    shift = state[f"{name}.bias"] - mean * scale
    return np.maximum(x * scale[:, None, None] + shift[:, None, None], 0)


def plain(x: np.ndarray, state: State, name: str, step: int = 1) -> np.ndarray:
    return convolve(x, state[f"{name}.weight"], state[f"{name}.bias"], step)


def gated(x: np.ndarray, state: State, name: str, step: int = 1) -> np.ndarray:
    gate = plain(x, state, f"{name}.conv_mask.0", step)
    return plain(x, state, f"{name}.conv_feature", step) / (1 + np.exp(-gate))


def twice(x: np.ndarray) -> np.ndarray:
    """Double the size; corners keep their values, all between is linear."""
    for axis in (1, 2):
        count = x.shape[axis]
        at = np.linspace(0, count - 1, 2 * count)
        low = np.minimum(at.astype(int), count - 2)
        part = (at - low).reshape((-1, 1) if axis == 1 else (1, -1))
        x = np.take(x, low, axis) * (1 - part) + np.take(x, low + 1, axis) * part
    return x


def down(x: np.ndarray, state: State, name: str) -> np.ndarray:
    x = gated(x, state, f"{name}.downsample", step=2)
    for i in "12":
        x = normalise(gated(x, state, f"{name}.conv{i}"), state, f"{name}.bn{i}")
    return x


def up(x: np.ndarray, skip: np.ndarray, state: State, name: str) -> np.ndarray:
    x = np.concatenate([skip, twice(x)])
    for convolution, norm in BLOCK[:2]:
        inside = f"{name}.conv.double_conv"
        x = normalise(plain(x, state, f"{inside}.{convolution}"), state, f"{inside}.{norm}")
    return x


def look(frame: np.ndarray, state: State) -> np.ndarray:
    """What is seen of one frame of the history, at an eighth of the size."""
    for block in ("convHis1", "convHis2", "convHis3"):
        for convolution, norm in BLOCK:
            step = 2 if convolution == "0" else 1
            frame = plain(frame, state, f"{block}.{convolution}", step)
            frame = normalise(frame, state, f"{block}.{norm}")
    return frame


def extranet(
    pictures: np.ndarray,
    mask: np.ndarray,
    features: np.ndarray,
    history: list[np.ndarray],
    state: State,
) -> np.ndarray:
    """The network's answer, [3, H, W]; the history is oldest first."""
    x = np.concatenate([pictures, pictures * mask, features])
    for i in "12":
        x = normalise(gated(x, state, f"conv{i}"), state, f"bn{i}")
    half = down(x, state, "down1")
    quarter = down(half, state, "down2")
    seen = np.concatenate([look(frame, state) for frame in history])
    bottom = np.concatenate([down(quarter, state, "down3"), gated(seen, state, "lowlevelGated")])
    risen = up(up(up(bottom, quarter, state, "up1"), half, state, "up2"), x, state, "up3")
    return plain(risen, state, "outc") + pictures[:3]
