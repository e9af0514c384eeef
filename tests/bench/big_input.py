"""The rendered example, enlarged: a multi-part input at production size without a renderer.

``python -m tests.bench.big_input FOLDER [--count N] [--height H] [--compression NAME]``. Colour is
interpolated and gets seeded grain, so that it compresses about as badly as a render; geometry is
interpolated inside surfaces and repeated at silhouettes and for ids; vectors grow with the frame.

More frames than the example has go on with its motion played backward, then forward again: no cut,
and the vectors to the previous and the next frame change places where time runs backward. Frames
that are shown again are links to their file.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import cv2
import numpy as np
import OpenEXR

HEIGHT = 1080
GRAIN = 0.04
"""Standard deviation, relative to the colour."""

SAME_DEPTH = 0.05
FAR = 1e9
CARRIED = ("compression", "type", "name")

SWAPPED = {"X": "Z", "Y": "W", "Z": "X", "W": "Y"}
"""Blender's vectors, X and Y to the previous frame, Z and W to the next, in a time turned round."""

COMPRESSIONS = {
    "none": OpenEXR.NO_COMPRESSION,
    "zip": OpenEXR.ZIP_COMPRESSION,
    "piz": OpenEXR.PIZ_COMPRESSION,
    "dwaa": OpenEXR.DWAA_COMPRESSION,
}

Shown = tuple[int, int, int]
"""Which frame of the example is shown, and which come before and after it; by index."""


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser("python -m tests.bench.big_input", description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--keys", type=Path, default=next(iter(Path("examples").glob("*/keys"))))
    parser.add_argument("--count", type=int, help="frames; default: as many as there are")
    parser.add_argument("--height", type=int, default=HEIGHT)
    parser.add_argument("--compression", choices=COMPRESSIONS, help="default: the example's")
    options = parser.parse_args(arguments)
    options.folder.mkdir(parents=True, exist_ok=True)
    sources = sorted(options.keys.glob("*.exr"))
    shown = played(len(sources), options.count or len(sources))
    stem, digits = sources[0].stem.rsplit(".", 1)
    targets = [
        options.folder / f"{stem}.{int(digits) + k:0{len(digits)}d}.exr" for k in range(len(shown))
    ]
    made = {which: target for which, target in zip(reversed(shown), reversed(targets), strict=True)}
    with ThreadPoolExecutor() as pool:
        waiting = [
            pool.submit(enlarge, sources, which, made[which], options.height, options.compression)
            for which in made
        ]
        for enlarged in waiting:
            enlarged.result()
    for which, target in zip(shown, targets, strict=True):
        if target != made[which]:
            target.unlink(missing_ok=True)
            os.link(made[which], target)
    return 0


def played(length: int, count: int) -> list[Shown]:
    """Return what `count` frames show of `length`: forward, backward, forward …"""
    period = max(2 * (length - 1), 1)
    order = [length - 1 - abs(length - 1 - k % period) for k in range(-1, count + 1)]
    if count <= length:  # nothing is played backward: the last frame keeps its own vectors
        order[0], order[-1] = -1, length
    triples = zip(order, order[1:], order[2:], strict=False)
    return [(now, before, after) for before, now, after in triples]


def enlarge(
    sources: Sequence[Path], shown: Shown, target: Path, height: int, compression: str | None
) -> None:
    """Write one frame at another height."""
    source = sources[shown[0]]
    with OpenEXR.File(str(source), separate_channels=True) as file:
        parts = [(dict(part.header), dict(part.channels)) for part in file.parts]
    depth = next(
        channel.pixels
        for _, channels in parts
        for name, channel in channels.items()
        if name.endswith(("Depth.Z", "Depth.V"))
    )
    size = (_even(depth.shape[1] * height / depth.shape[0]), height)
    smooth = _enlarged(_inside(depth), size, cv2.INTER_NEAREST) > 0
    seeded = np.random.default_rng(shown[0] + 1)
    grain = 1 + GRAIN * seeded.standard_normal(smooth.shape, dtype=np.float32)
    out = []
    for header, channels in parts:
        kept = {k: v for k, v in header.items() if k in CARRIED}
        if compression is not None:
            kept["compression"] = COMPRESSIONS[compression]
        planes = {name: channel.pixels for name, channel in channels.items()}
        turned = _turned(planes, shown)
        made = {name: _plane(name, turned[name], smooth, grain) for name in turned}
        out.append(OpenEXR.Part(kept, made))
    OpenEXR.File(out).write(str(target))


def _even(value: float) -> int:
    return 2 * round(value / 2)


def _inside(depth: np.ndarray) -> np.ndarray:
    """uint8 [H, W]: 1 where a pixel and its neighbours show one surface."""
    window = np.ones((3, 3), np.uint8)
    near, far = cv2.erode(depth, window), cv2.dilate(depth, window)
    return ((far < FAR) & (far - near <= SAME_DEPTH * far)).astype(np.uint8)


def _enlarged(plane: np.ndarray, size: tuple[int, int], way: int) -> np.ndarray:
    return cv2.resize(plane, size, interpolation=way)


def _is_vector(name: str) -> bool:
    return ".Vector." in name


def _turned(planes: dict[str, np.ndarray], shown: Shown) -> dict[str, np.ndarray]:
    """Have vectors lead to the frames that are shown before and after; others stay."""
    now, before, after = shown
    # The signs of Z and W are the reverse of those of X and Y.
    other = {
        name: -planes[f"{name[:-1]}{SWAPPED[name[-1]]}"] if _is_vector(name) else plane
        for name, plane in planes.items()
    }
    to_previous = planes if before < now else other
    to_next = planes if after > now else other
    return {name: (to_previous if name[-1] in "XY" else to_next)[name] for name in planes}


def _plane(name: str, plane: np.ndarray, smooth: np.ndarray, grain: np.ndarray) -> np.ndarray:
    """Enlarge one channel in its own pixel type."""
    values = plane.astype(np.float32)
    size = (smooth.shape[1], smooth.shape[0])
    repeated = _enlarged(values, size, cv2.INTER_NEAREST)
    if "Index" in name:
        return repeated.astype(plane.dtype)
    between = _enlarged(values, size, cv2.INTER_LINEAR)
    if plane.dtype == np.float16:
        return (between if name.endswith(".A") else between * grain).astype(plane.dtype)
    grown = np.where(smooth, between, repeated)
    if _is_vector(name):
        grown *= smooth.shape[0] / plane.shape[0]
    return grown.astype(plane.dtype)


if __name__ == "__main__":
    sys.exit(main())
