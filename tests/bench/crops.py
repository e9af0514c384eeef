"""Crops of frames by two versions beside the rendered ones, four times as large, as one picture.

``python -m tests.bench.crops BEFORE NOW OUT.jpg``: BEFORE and NOW are folders that
``python -m tests.bench.pictures --out`` has filled, with the frames of `softsplat`.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

from exwarp_cli.domain.colour import round_display
from exwarp_cli.domain.frame import UInt8
from exwarp_cli.io.generated_frames import read_picture

SCALE = 4
WIDTH, HEIGHT = 72, 44
"""Of a crop, pixels."""

GAP = 4


@dataclass(frozen=True)
class Crop:
    """A part of one instant.

    Attributes
    ----------
    scene
        Its name.
    frame
        Which of the frames, from 0 at the first key frame on.
    x, y
        The upper left pixel.
    """

    scene: str
    frame: int
    x: int
    y: int


CROPS = (
    Crop("town", 2, 170, 150),
    Crop("town", 6, 350, 90),
    Crop("lab", 2, 180, 110),
    Crop("arena", 6, 180, 100),
    Crop("arena", 6, 20, 120),
    Crop("courtyard", 6, 130, 90),
    Crop("courtyard", 2, 330, 60),
)


def main(arguments: Sequence[str] | None = None) -> int:
    options = _options(arguments)
    columns = {
        "before": lambda scene: options.before / scene / "softsplat",
        "now": lambda scene: options.now / scene / "softsplat",
        "rendered": lambda scene: options.data / scene / "instants",
    }
    rows = [
        np.hstack([_framed(_cut(crop, folder(crop.scene))) for folder in columns.values()])
        for crop in CROPS
    ]
    picture = Image.fromarray(np.vstack(rows))
    draw = ImageDraw.Draw(picture)
    for place, name in enumerate(columns):
        draw.text((place * picture.width // len(columns) + 2 * GAP, GAP), name, fill="white")
    picture.save(options.out, quality=88)
    return 0


def _options(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser("python -m tests.bench.crops", description=__doc__)
    parser.add_argument("--data", type=Path, default=Path("~/.cache/exwarp/scenes").expanduser())
    for name in ("before", "now", "out"):
        parser.add_argument(name, type=Path)
    return parser.parse_args(arguments)


def _cut(crop: Crop, folder: Path) -> UInt8:
    """Return a crop as shown, enlarged without smoothing."""
    image = read_picture(sorted(folder.glob("*.exr"))[crop.frame])
    shown = round_display(np.ascontiguousarray(image.pixels[..., :3]))
    part = shown[crop.y : crop.y + HEIGHT, crop.x : crop.x + WIDTH]
    return part.repeat(SCALE, axis=0).repeat(SCALE, axis=1)


def _framed(part: UInt8) -> UInt8:
    """Return a picture with a white margin."""
    return np.pad(part, ((GAP, GAP), (GAP, GAP), (0, 0)), constant_values=255)


if __name__ == "__main__":
    sys.exit(main())
