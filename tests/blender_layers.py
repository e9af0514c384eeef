"""The layers of a frame as Blender names and writes them."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

Planes = dict[str, np.ndarray]
HALF, FLOAT = np.float16, np.float32


def layer(name: str, letters: str, image: np.ndarray, kind: type = FLOAT) -> Planes:
    """Name the channels of an image [H, W, C] or [H, W]."""
    dot = f"{name}." if name else ""
    planes = image[..., None] if image.ndim == 2 else image
    return {
        f"{dot}{letter}": np.ascontiguousarray(planes[..., i].astype(kind))
        for i, letter in enumerate(letters)
    }


def multipart(layers: Iterable[Planes]) -> dict[str, Planes]:
    """Parts of a multi-part file, a part a layer, all of the view layer "ViewLayer"."""
    parts = {}
    for planes in layers:
        named = {f"ViewLayer.{name}": plane for name, plane in planes.items()}
        parts[next(iter(named)).rsplit(".", 1)[0]] = named
    return parts


def blender_vector(to_previous: np.ndarray, to_next: np.ndarray) -> np.ndarray:
    """X, Y: previous minus current; Z, W: current minus next; y up."""
    p, n = to_previous, to_next
    return np.stack([p[..., 0], -p[..., 1], -n[..., 0], n[..., 1]], axis=-1)


def blender_depth(depth: np.ndarray) -> np.ndarray:
    return np.where(np.isinf(depth), 1e10, depth)
