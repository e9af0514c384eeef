"""How many renders of a training shot's frames must be averaged until little noise is left.

Two renders of 16 samples differ by 25 to 36 dB from shot to shot, so that one setting for all would
be too noisy for some or waste time on others. Two renders of its middle tell. They have the shot's
own size: at half of it the two differed by 1.4 to 6 dB more.
"""

from __future__ import annotations

import json
import math
import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from stage import files, manifest, motion, render
from stage.blender import bpy
from stage.quality import TRAINING, Quality

AIM = 33.2
"""Decibels between two renders of a training frame, on the display; the goal is 33."""

GAIN = 9.6
"""Decibels that ten times the renders are worth, as measured on the judged scenes."""

MOST = 5
MIDDLE = 6
OTHER_NOISE = 777


Build = Callable[[int, int], object]


def quality_of(
    folder: Path, seed: int, build: Build, last: int, size: tuple[int, int], on_gpu: bool = False
) -> Quality:
    """Return the quality with which a shot is rendered: as it was begun, or as a probe tells.

    Parameters
    ----------
    folder : Path
        The shot's; where it has a manifest, that counts.
    seed : int
        The shot's.
    build : callable
        Builds the shot in an empty file; takes (seed, last).
    last : int
        The last instant.
    size : tuple of int
        Width and height.
    on_gpu : bool
        Whether the probe is rendered on NVIDIA cards.
    """
    path = folder / manifest.NAME
    if path.is_file():
        content = json.loads(path.read_text(encoding="utf-8"))
        return replace(TRAINING, seeds=int(content.get("seeds", 1)))
    bpy.ops.wm.read_factory_settings(use_empty=True)
    build(seed, last)
    return replace(TRAINING, seeds=renders_needed(_floor(seed, size, on_gpu)))


def renders_needed(floor: float) -> int:
    """Return how many renders averaged reach `AIM`, where two single ones differ by `floor` dB."""
    needed = math.ceil(10 ** ((AIM - floor) / GAIN) - 0.05)
    return min(MOST, max(1, needed))


def _floor(seed: int, size: tuple[int, int], on_gpu: bool) -> float:
    """Render the middle of the shot twice, and return the PSNR between the two."""
    render.settle(size, TRAINING, on_gpu)
    product = render.products(TRAINING.samples, manifest.INSTANTS_PER_KEY)["instants"]
    render.configure(product, motion.FPS)
    pictures = []
    with tempfile.TemporaryDirectory() as folder:
        for noise in (seed, seed + OTHER_NOISE):
            target = Path(folder, f"{noise}.exr")
            render.render(MIDDLE, product, target, noise)
            pictures.append(_display(target))
    error = float(np.mean((pictures[0] - pictures[1]) ** 2))
    return -10 * math.log10(max(error, 1e-9))


def _display(path: Path) -> np.ndarray:
    """Read a frame's colour as an sRGB display shows it, 0..1."""
    linear = np.clip(files.read_colour(path), 0, 1)
    return np.where(linear < 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
