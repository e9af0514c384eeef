"""Render a small shot whose only ids are Cryptomatte, as a Python with Blender's module does it.

    .blender/bin/python tests/blender/cryptomatte_shot.py OUT

OUT gets ``keys``, frames of a true 30 fps scene, whose vectors span 1/30 s, and ``truth``, the same
instants and those between them at 120 fps, with all passes: slot G-buffers too.

What moves: "ball" (thrown), "car" with "car wheel.001" and ".002", the spinning "sign". What stands
still: the ground, two houses, a fence of thin bars, and a pane that lets half of the light through.
One name has quotes, a backslash and letters beyond ASCII, as manifests must escape those.
"""

from __future__ import annotations

import argparse
import math
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2] / "examples" / "scenes"))

from stage import looks, motion, render
from stage.blender import bpy
from stage.meshes import MeshBuilder
from stage.options import count, size

NAME = "crypto"
FPS = 120
STEP = 4
AWKWARD = 'Würfel "B"\\2'
"""Name of the spinning sign."""

PASSES = ("z", "vector", "normal", "position", "cryptomatte_object", "cryptomatte_material")
PASSES += ("cryptomatte_asset",)


def build(last: int) -> None:
    """Build the scene, keyed to the last instant."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    looks.backdrop((0.1, 0.27, 0.68), (0.66, 0.76, 0.9))
    motion.sunlight((0.5, 0.6, -0.8), 4.0, (1.0, 0.9, 0.8))
    _town()
    _movers(last)
    motion.film(
        lambda t: ((-1.0 + 1.2 * t, -6.0, 1.6), motion.looking((0.2, 0, 0.7), (-1.0, -6, 1.6))),
        last,
        55,
    )


def _town() -> None:
    parts = (
        ("ground", (0, 4, -0.05), (30, 24, 0.1), (0.35, 0.3, 0.25)),
        ("house left", (-3.2, 3, 1.2), (2.6, 2, 2.4), (0.7, 0.5, 0.3)),
        ("house right", (2.8, 5, 1.6), (3, 2, 3.2), (0.4, 0.5, 0.7)),
    )
    for name, centre, extent, colour in parts:
        mesh = MeshBuilder()
        mesh.box(centre, extent, looks.paint(name, colour))
        mesh.object(name)
    mesh = MeshBuilder()
    iron = looks.paint("iron", (0.1, 0.1, 0.12))
    for bar in range(14):
        mesh.box((-2.2 + 0.22 * bar, 1.2, 0.35), (0.03, 0.03, 0.7), iron)
    mesh.object("fence")
    mesh = MeshBuilder()
    mesh.box((1.9, -1.0, 0.6), (0.8, 0.02, 1.2), _see_through())
    mesh.object("pane")


def _see_through() -> bpy.types.Material:
    material, nodes = looks.new("pane")
    clear = nodes.add("BsdfTransparent", {}).outputs[0]
    solid = nodes.add("BsdfDiffuse", {"Color": (0.3, 0.6, 0.5)}).outputs[0]
    mixed = nodes.add("MixShader", {0: 0.5, 1: clear, 2: solid}).outputs[0]
    nodes.add("OutputMaterial", {0: mixed})
    return material


def _movers(last: int) -> None:
    mesh = MeshBuilder()
    strips = [looks.paint("ball red", (0.8, 0.1, 0.1)), looks.paint("ball white", (0.9, 0.9, 0.9))]
    mesh.ball((0, 0, 0), 0.35, strips)

    def thrown(t: float) -> tuple:
        return (-1.9 + 6.0 * t, -0.5, 0.6 + 5.0 * t - 4.9 * t * t), (0, 9.0 * t, 0)

    motion.keyed(mesh.object("ball"), thrown, last)
    mesh = MeshBuilder()
    mesh.box((0, 0, 0.45), (1.4, 0.6, 0.45), looks.paint("car", (0.8, 0.6, 0.1)))
    car = mesh.object("car")
    motion.keyed(car, lambda t: ((1.6 - 2.4 * t, 0.4, 0), (0, 0, 0)), last)
    tyre = looks.paint("tyre", (0.05, 0.05, 0.05))
    for number, x in enumerate((-0.45, 0.45), start=1):
        mesh = MeshBuilder()
        mesh.tube([(0, -0.36, 0), (0, 0.36, 0)], 0.22, tyre, 12)
        wheel = mesh.object(f"car wheel.{number:03d}")
        wheel.parent = car
        motion.keyed(wheel, lambda t, x=x: ((x, 0, 0.22), (0, -11.0 * t, 0)), last)
    mesh = MeshBuilder()
    mesh.box((0, 0, 0), (0.7, 0.08, 0.5), looks.checker("sign", (1, 1, 1), (0.1, 0.2, 0.6), 0.12))
    motion.keyed(mesh.object(AWKWARD), lambda t: ((-0.4, 1.6, 1.9), (0, 0, math.pi * t)), last)


def shoot(chosen: argparse.Namespace) -> None:
    """Render keys and truth, as `main` reads the command line."""
    last = (chosen.keys - 1) * STEP
    for folder, step in (("keys", STEP), ("truth", 1)):
        build(last)  # anew, as Blender may crash when passes change
        product = render.Product(step, PASSES, True, chosen.samples)
        _settle(chosen.resolution, product)
        (chosen.out / folder).mkdir(parents=True, exist_ok=True)
        for frame in range(last // step + 1):
            target = (chosen.out / folder / f"{NAME}.{frame + 1:04d}.exr").resolve()
            if not target.exists():
                render.render(frame * step, product, target, 1000)
            sys.stdout.write(f"{target}\n")


def _settle(resolution: tuple[int, int], product: render.Product) -> None:
    render.prepare(resolution)
    render.configure(product, FPS)
    image = bpy.context.scene.render.image_settings
    image.media_type = "MULTI_LAYER_IMAGE"
    image.file_format = "OPEN_EXR_MULTILAYER"
    image.color_depth = "16"
    image.exr_codec = "ZIP"
    layer = bpy.context.scene.view_layers[0]
    for name in PASSES:
        setattr(layer, f"use_pass_{name}", True)
    for aov in list(layer.aovs):
        layer.aovs.remove(aov)


def main() -> None:
    """Read the command line and render."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("out", type=Path)
    parser.add_argument("--resolution", type=size, default=(160, 90))
    parser.add_argument("--samples", type=count, default=8)
    parser.add_argument("--keys", type=count, default=5)
    shoot(parser.parse_args())


if __name__ == "__main__":
    main()
