"""Render a short stereo shot, as a Python with Blender's module does it.

    .blender/bin/python tests/blender/stereo_shot.py OUT [--resolution 160x90] [--samples 6]

OUT gets ``keys`` (6, or as many as ``--keys`` says: a true 30 fps scene, whose vectors span 1/30 s)
and ``truth`` (the same instants and those between them, at 120 fps), both views in one file a
frame, as Blender writes them: a part for each pass and view. Frames that exist are kept. The scene
is one of those to train with, of things that stand near. ``python -m tests.stereo_layouts`` turns
its files into other layouts.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2] / "examples" / "scenes"))

import variety
from stage import render
from stage.blender import bpy
from stage.files import is_whole
from stage.motion import FPS
from stage.options import count, size
from things_list import ThingList

SEED = 11
STEP = 4
EYES = 0.065
"""Metres between the cameras."""

PASSES = ("z", "vector", "normal", "position", "object_index")


def main() -> None:
    """Read the command line and render what is missing."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("out", type=Path)
    parser.add_argument("--resolution", type=size, default=(160, 90))
    parser.add_argument("--samples", type=count, default=6)
    parser.add_argument("--keys", type=count, default=6)
    chosen = parser.parse_args()
    last = STEP * (chosen.keys - 1)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    variety.script(SEED, ThingList(Path()), "Cycles").build(SEED, last)
    render.settle(chosen.resolution)
    _two_eyes()
    for name, step in (("keys", STEP), ("truth", 1)):
        product = render.Product(step, PASSES, True, chosen.samples)
        render.configure(product, FPS)
        folder = chosen.out.expanduser() / name
        folder.mkdir(parents=True, exist_ok=True)
        for instant in range(0, last + 1, step):
            target = folder / f"shot.{instant // step + 1:04d}.exr"
            if not is_whole(target, chosen.resolution):
                render.render(instant, product, target, SEED)


def _two_eyes() -> None:
    """Turn on the views left and right, both in one file."""
    scene = bpy.context.scene
    scene.render.use_multiview = True
    scene.render.views_format = "STEREO_3D"
    scene.render.image_settings.views_format = "MULTIVIEW"
    scene.camera.data.stereo.interocular_distance = EYES


if __name__ == "__main__":
    main()
