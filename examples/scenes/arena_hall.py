"""The arena's hall: glossy marked floor, panelled walls, pillars, catwalks with lattice, lights."""

from __future__ import annotations

import math
import random

from stage import looks, motion
from stage.blender import bpy, mathutils
from stage.meshes import MeshBuilder, lettering

Materials = dict[str, bpy.types.Material]
Matrix = mathutils.Matrix

HALF, HIGH = 15.0, 6.5
PILLARS = [(x, y) for x in (-8.0, 0.0, 8.0) for y in (-7.5, 7.5)]
CRATES = (
    (3.4, -2.9, 1.0), (4.5, -3.3, 1.2), (4.0, -3.1, 0.7), (-2.6, 3.6, 1.1), (-3.9, 4.1, 0.9),
    (9.5, 2.6, 1.3), (10.6, 3.6, 1.0), (-7.2, -5.9, 1.2), (7.0, -6.0, 0.9),
)  # fmt: skip


def palette() -> Materials:
    """Make the materials, by name."""
    return {
        "floor": _floor_look(),
        "wall": _panels("wall", (0.20, 0.23, 0.28), (0.12, 0.14, 0.18), 1.6),
        "crate": _panels("crate", (0.42, 0.24, 0.06), (0.30, 0.16, 0.05), 0.6),
        "concrete": looks.plaster("concrete", (0.40, 0.39, 0.37)),
        "steel": looks.paint("steel", (0.55, 0.57, 0.60), 0.28, 1.0),
        "dark": looks.paint("dark", (0.05, 0.055, 0.065), 0.4),
        "stripe": looks.checker("stripe", (0.75, 0.55, 0.03), (0.03, 0.03, 0.03), 0.25, 0.4),
        "blue light": looks.paint("blue light", (0.08, 0.36, 1.0), 0.4, glow=2.2),
        "orange light": looks.paint("orange light", (1.0, 0.30, 0.05), 0.4, glow=2.2),
        "white light": looks.paint("white light", (1.0, 0.95, 0.85), 0.4, glow=2.0),
        "glass": looks.glass("glass", (0.55, 0.75, 0.85), 0.22),
        "field": looks.glass("field", (0.15, 0.75, 1.0), 0.22, 0.9),
    }


def _floor_look() -> bpy.types.Material:
    """Return polished tiles with joints, scuffs, and painted lines and circles."""
    material, nodes = looks.new("floor")
    spot = nodes.spot()
    inputs = {"Vector": spot, "Color1": (0.10, 0.11, 0.13), "Color2": (0.16, 0.17, 0.19)}
    inputs |= {"Mortar": (0.02, 0.02, 0.02), "Scale": 1.0, "Brick Width": 1.5, "Row Height": 1.5}
    tiles = nodes.add("TexBrick", inputs | {"Mortar Size": 0.015}, offset=0.0).outputs[0]
    scuffs = nodes.step(nodes.noise(spot, 2.2, 6.0), 0.45, 0.72)
    shade = nodes.mix(nodes.math("MULTIPLY", scuffs, 0.55), tiles, (0.27, 0.26, 0.25))
    axes = nodes.add("SeparateXYZ", {0: spot}).outputs
    away = nodes.add("VectorMath", {0: spot}, operation="LENGTH").outputs["Value"]
    for ring in (2.6, 5.4):
        near = nodes.math("ABSOLUTE", nodes.math("SUBTRACT", away, ring))
        shade = nodes.mix(nodes.math("LESS_THAN", near, 0.09), shade, (0.72, 0.20, 0.03))
    for axis, where in ((0, 0.0), (1, -4.6), (1, 4.6)):
        near = nodes.math("ABSOLUTE", nodes.math("SUBTRACT", axes[axis], where))
        shade = nodes.mix(nodes.math("LESS_THAN", near, 0.07), shade, (0.68, 0.68, 0.64))
    rough = nodes.math("ADD", 0.09, nodes.math("MULTIPLY", scuffs, 0.2))
    looks.finish(nodes, shade, rough)
    return material


def _panels(
    name: str, first: looks.Colour, second: looks.Colour, size: float
) -> bpy.types.Material:
    """Return metal panels with joints and rust."""
    material, nodes = looks.new(name)
    where = nodes.wall()
    inputs = {"Vector": where, "Color1": first, "Color2": second, "Mortar": (0.015, 0.015, 0.02)}
    inputs |= {"Scale": 1.0, "Brick Width": size, "Row Height": 0.6 * size}
    plates = nodes.add("TexBrick", inputs | {"Mortar Size": 0.02 * size}, offset=0.33).outputs[0]
    rust = nodes.step(nodes.noise(where, 1.1, 6.0), 0.52, 0.7)
    shade = nodes.mix(nodes.math("MULTIPLY", rust, 0.8), plates, (0.23, 0.09, 0.04))
    looks.finish(nodes, shade, 0.5, 0.2)
    return material


def build(made: Materials, chance: random.Random) -> None:
    """Build all that stands still."""
    floor = MeshBuilder()
    corners = [(-HALF, -HALF, 0), (HALF, -HALF, 0), (HALF, HALF, 0), (-HALF, HALF, 0)]
    floor.faces(corners, [(0, 1, 2, 3)], made["floor"])
    floor.object("floor")
    _walls(made)
    for x, y in PILLARS:
        _pillar((x, y), made)
    for side in (-1, 1):
        _catwalk(side, made)
    _crates(made, chance)
    _screens(made)


def _walls(made: Materials) -> None:
    mesh = MeshBuilder()
    for side in (-1, 1):
        mesh.box((0, side * HALF, HIGH / 2), (2 * HALF, 0.4, HIGH), made["wall"])
        mesh.box((side * HALF, 0, HIGH / 2), (0.4, 2 * HALF, HIGH), made["wall"])
        mesh.box((0, side * (HALF - 0.3), 0.3), (2 * HALF, 0.3, 0.6), made["stripe"])
        mesh.box((side * (HALF - 0.3), 0, 0.3), (0.3, 2 * HALF, 0.6), made["stripe"])
        lamp = made["blue light" if side > 0 else "orange light"]
        mesh.box((0, side * (HALF - 0.24), 2.6), (2 * HALF, 0.06, 0.12), lamp)
        mesh.box((side * (HALF - 0.24), 0, 2.6), (0.06, 2 * HALF, 0.12), lamp)
        for step in range(-4, 5):
            post = (3.3 * step, side * (HALF - 0.35), HIGH / 2)
            mesh.box(post, (0.35, 0.35, HIGH), made["concrete"])
            mesh.box((side * (HALF - 0.35), *post[::2]), (0.35, 0.35, HIGH), made["concrete"])
    mesh.object("walls")


def _pillar(spot: tuple[float, float], made: Materials) -> None:
    mesh = MeshBuilder()
    x, y = spot
    mesh.box((x, y, 0.25), (1.3, 1.3, 0.5), made["stripe"])
    mesh.tube([(x, y, 0.5), (x, y, HIGH)], 0.42, made["concrete"], 16)
    for high in (1.3, 2.9):
        mesh.tube([(x, y, high), (x, y, high + 0.12)], 0.46, made["blue light"], 16)
    mesh.tube([(x, y, HIGH - 0.9), (x, y, HIGH)], (0.45, 0.95), made["steel"], 16)
    mesh.object("pillar")


def _catwalk(side: int, made: Materials) -> None:
    """Add a grated walk along the pillars, whose lattice lets light through."""
    mesh = MeshBuilder()
    y, high = 9.4 * side, 3.1
    for step in range(101):
        mesh.box((-10 + 0.2 * step, y, high), (0.04, 1.5, 0.05), made["steel"])
    for edge in (-0.75, 0.0, 0.75):
        mesh.box((0, y + edge, high - 0.04), (20.0, 0.06, 0.1), made["dark"])
    for step in range(21):
        for edge in (-0.75, 0.75):
            x = -10 + step
            mesh.tube([(x, y + edge, high), (x, y + edge, high + 1.1)], 0.022, made["steel"], 6)
            if step < 20:
                cross = [(x, y + edge, high + 0.1), (x + 1, y + edge, high + 1.0)]
                mesh.tube(cross, 0.012, made["steel"], 5)
                cross = [(x, y + edge, high + 1.0), (x + 1, y + edge, high + 0.1)]
                mesh.tube(cross, 0.012, made["steel"], 5)
    for edge in (-0.75, 0.75):
        mesh.tube([(-10, y + edge, high + 1.1), (10, y + edge, high + 1.1)], 0.03,
                  made["stripe"], 8)  # fmt: skip
    for x in (-10.0, -3.4, 3.4, 10.0):
        mesh.tube([(x, y, 0), (x, y, high)], 0.09, made["dark"], 10)
    mesh.object("catwalk")


def _crates(made: Materials, chance: random.Random) -> None:
    for x, y, size in CRATES:
        mesh = MeshBuilder()
        mesh.place = Matrix.Translation((x, y, size / 2)) @ Matrix.Rotation(
            chance.uniform(0, 1.5), 4, "Z"
        )
        mesh.box((0, 0, 0), (size, size, size), made["crate"])
        for edge in (-0.5, 0.5):
            mesh.box((0, edge * size, 0.5 * size), (1.04 * size, 0.06, 0.06), made["steel"])
            mesh.box((edge * size, 0, 0.5 * size), (0.06, 1.04 * size, 0.06), made["steel"])
            for other in (-0.5, 0.5):
                mesh.box((edge * size, other * size, 0), (0.06, 0.06, size), made["steel"])
        mesh.object("crate")


def _screens(made: Materials) -> None:
    """Add glass walls in frames, and words on the walls."""
    mesh = MeshBuilder()
    for x, y in ((5.6, 1.4), (-1.2, -5.2)):
        mesh.box((x, y, 1.0), (2.4, 0.03, 1.8), made["glass"])
        for edge in (-1.25, 1.25):
            mesh.box((x + edge, y, 1.0), (0.1, 0.1, 2.0), made["steel"])
        mesh.box((x, y, 1.95), (2.6, 0.1, 0.08), made["steel"])
    mesh.object("screens")
    for text, x, y, turn in (("SECTOR 7", 4.0, 14.6, 0.0), ("ARENA", 14.6, -1.0, -math.pi / 2)):
        stand = Matrix.Rotation(turn, 4, "Z") @ Matrix.Rotation(math.pi / 2, 4, "X")
        lettering(text, Matrix.Translation((x, y, 4.2)) @ stand, 1.5, made["white light"])


def lights() -> None:
    """Add the flood light that casts the long shadows, coloured lamps, and a sky at dusk."""
    looks.backdrop((0.05, 0.08, 0.20), (0.30, 0.24, 0.30), 0.55, (0.5, 0.32, 0.3))
    motion.sunlight((-0.62, 0.5, -0.62), 3.4, (1.0, 0.90, 0.76), 0.4)
    for at, colour, power in (
        ((6.0, 10.0, 5.0), (0.25, 0.5, 1.0), 420.0),
        ((-7.0, -10.0, 5.0), (1.0, 0.4, 0.12), 420.0),
        ((11.0, -3.0, 4.5), (1.0, 0.45, 0.15), 300.0),
    ):
        lamp = bpy.data.lights.new("lamp", "POINT")
        lamp.energy, lamp.color, lamp.shadow_soft_size = power, colour, 0.12
        thing = bpy.data.objects.new("lamp", lamp)
        thing.location = at
        bpy.context.scene.collection.objects.link(thing)
