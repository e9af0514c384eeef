"""Frames and their templates, for tests of what is written."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import numpy as np

from exwarp_cli.domain.frame import Image, Window
from exwarp_cli.io.channels import ChannelRef
from exwarp_cli.io.exr.writer import (
    Template,
    ViewLayers,
    read_template,
)
from tests.unit.exr_files import rgba, write_single

RGBA = tuple(ChannelRef("", name) for name in "RGBA")
WINDOW = Window(0, 0, 12, 9)

CARRIED = {
    "owner": "Ada Lovelace",
    "shot:take": 3,
    "exposure": 0.25,
    "pixelAspectRatio": 1.5,
    "screenWindowWidth": 2.0,
    "gate": np.array([36, 24], np.int32),
    "chromaticities": (0.64, 0.33, 0.3, 0.6, 0.15, 0.06, 0.3127, 0.329),
    "worldToCamera": np.arange(16, dtype=np.float32).reshape(4, 4),
    "cut": Fraction(24000, 1001),
}


def pixels(seed: int = 0, window: Window = WINDOW) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return (rng.random((*window.shape, 4)) * 3 - 0.5).astype(np.float32)


def image(seed: int = 0) -> Image:
    return Image(pixels(seed), WINDOW, Window(0, 0, 16, 10))


def beauty(*refs: ChannelRef) -> tuple[ViewLayers, ...]:
    """What is written of a file without views, of which only the beauty is."""
    return (ViewLayers("", "", refs or RGBA),)


def template(path: Path, dtype: type = np.float16, **attributes: object) -> Template:
    write_single(path, rgba(3, 4, dtype), **attributes)
    return read_template(path, beauty())
