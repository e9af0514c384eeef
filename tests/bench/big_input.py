"""The rendered example, enlarged: a multi-part input at production size without a renderer.

``python -m tests.bench.big_input FOLDER``. Colour is interpolated and gets seeded grain, so that it
compresses about as badly as a render; geometry is interpolated inside surfaces and repeated at
silhouettes and for ids; vectors grow with the frame.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import cv2
import numpy as np
import OpenEXR

SCALE = 6
GRAIN = 0.04
"""Standard deviation, relative to the colour."""

SAME_DEPTH = 0.05
FAR = 1e9
CARRIED = ("compression", "type", "name")


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser("python -m tests.bench.big_input", description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--keys", type=Path, default=next(iter(Path("examples").glob("*/keys"))))
    parser.add_argument("--scale", type=int, default=SCALE)
    options = parser.parse_args(arguments)
    options.folder.mkdir(parents=True, exist_ok=True)
    sources = sorted(options.keys.glob("*.exr"))
    with ThreadPoolExecutor() as pool:
        targets = [options.folder / source.name for source in sources]
        list(pool.map(enlarge, sources, targets, [options.scale] * len(sources)))
    return 0


def enlarge(source: Path, target: Path, scale: int) -> None:
    """Write one frame at `scale` times its size."""
    with OpenEXR.File(str(source)) as file:
        parts = [(dict(part.header), dict(part.channels)) for part in file.parts]
    depth = next(
        channel.pixels
        for _, channels in parts
        for name, channel in channels.items()
        if name.endswith(("Depth.Z", "Depth.V"))
    )
    smooth = _enlarged(_inside(depth), scale, cv2.INTER_NEAREST) > 0
    seeded = np.random.default_rng(int(source.stem.split(".")[-1]))
    out = []
    for header, channels in parts:
        kept = {k: v for k, v in header.items() if k in CARRIED}
        planes = {
            name: _plane(name, channel.pixels, smooth, scale, seeded)
            for name, channel in channels.items()
        }
        out.append(OpenEXR.Part(kept, planes))
    OpenEXR.File(out).write(str(target))


def _inside(depth: np.ndarray) -> np.ndarray:
    """uint8 [H, W]: 1 where a pixel and its neighbours show one surface."""
    window = np.ones((3, 3), np.uint8)
    near, far = cv2.erode(depth, window), cv2.dilate(depth, window)
    return ((far < FAR) & (far - near <= SAME_DEPTH * far)).astype(np.uint8)


def _enlarged(plane: np.ndarray, scale: int, way: int) -> np.ndarray:
    return cv2.resize(plane, None, fx=scale, fy=scale, interpolation=way)


def _plane(
    name: str, plane: np.ndarray, smooth: np.ndarray, scale: int, seeded: np.random.Generator
) -> np.ndarray:
    """Enlarge one channel, or an interleaved group of them, in its own pixel type."""
    values = plane.astype(np.float32)
    repeated = _enlarged(values, scale, cv2.INTER_NEAREST)
    if "Index" in name:
        return repeated.astype(plane.dtype)
    between = _enlarged(values, scale, cv2.INTER_LINEAR)
    if plane.dtype == np.float16:
        grain = 1 + GRAIN * seeded.standard_normal(between.shape[:2], dtype=np.float32)
        between[..., :3] *= grain[..., None]
        return between.astype(plane.dtype)
    where = smooth if values.ndim == 2 else smooth[..., None]
    grown = np.where(where, between, repeated)
    if ".Vector." in name or name.endswith("Vector"):
        grown *= scale
    return grown.astype(plane.dtype)


if __name__ == "__main__":
    sys.exit(main())
