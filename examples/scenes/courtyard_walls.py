"""What stands still in the courtyard: paving, arcades, trellises, a fountain, tubs, trunks."""

from __future__ import annotations

import math
import random

from stage import looks, motion
from stage.blender import bpy, mathutils
from stage.meshes import MeshBuilder

Materials = dict[str, bpy.types.Material]
Matrix, Vector = mathutils.Matrix, mathutils.Vector

HALF = 9.0
TREES = ((-4.6, 3.6), (4.2, 4.8), (0.6, -1.6), (7.0, -0.5))
TRELLISES = ((-2.6, -3.4, 0.1), (1.9, -4.3, -0.15), (5.2, -3.2, 0.3), (-5.6, -2.2, 0.5))
"""x, y and turn."""

FOUNTAIN = (-1.2, 2.6)


def palette() -> Materials:
    """Make the materials, by name."""
    return {
        "paving": looks.cobbles("paving"),
        "plaster": looks.plaster("plaster", (0.72, 0.52, 0.30)),
        "pale": looks.plaster("pale", (0.74, 0.68, 0.56)),
        "brick": looks.brick("brick", (0.42, 0.17, 0.09), (0.32, 0.12, 0.07), (0.3, 0.1),
                             (0.45, 0.42, 0.38)),
        "tiles": looks.brick("tiles", (0.50, 0.18, 0.09), (0.36, 0.12, 0.07), (0.24, 0.3),
                             (0.10, 0.05, 0.04)),
        "wood": looks.wood("wood", (0.30, 0.18, 0.09), 2),
        "green wood": looks.wood("green wood", (0.10, 0.24, 0.20), 2),
        "bark": looks.wood("bark", (0.20, 0.14, 0.10), 2),
        "iron": looks.paint("iron", (0.10, 0.10, 0.11), 0.35, 0.8),
        "brass": looks.paint("brass", (0.75, 0.52, 0.20), 0.25, 1.0),
        "leaf": looks.foliage("leaf", (0.22, 0.42, 0.05), (0.06, 0.19, 0.03)),
        "ivy": looks.foliage("ivy", (0.10, 0.30, 0.05), (0.03, 0.12, 0.03)),
        "petal": looks.paint("petal", (0.85, 0.22, 0.35), 0.6),
        "water": looks.glass("water", (0.30, 0.55, 0.60), 0.45),
        "pane": looks.glass("pane", (0.45, 0.55, 0.60), 0.3),
        "flame": looks.paint("flame", (1.0, 0.55, 0.16), 0.5, glow=5.0),
        "cloth": looks.checker("cloth", (0.72, 0.08, 0.06), (0.85, 0.72, 0.30), 0.35),
        "dark": looks.paint("dark", (0.04, 0.04, 0.05), 0.4),
    }  # fmt: skip


def build(made: Materials, chance: random.Random) -> None:
    """Build all that stands still."""
    floor = MeshBuilder()
    corners = [(-HALF, -HALF, 0), (HALF, -HALF, 0), (HALF, HALF, 0), (-HALF, HALF, 0)]
    floor.faces(corners, [(0, 1, 2, 3)], made["paving"])
    floor.object("paving")
    for turn in range(4):
        _arcade(Matrix.Rotation(turn * math.pi / 2, 4, "Z"), made, turn)
    for x, y, turn in TRELLISES:
        _trellis((x, y), turn, made, chance)
    _fountain(made)
    for spot in TREES:
        _trunk(spot, made, chance)
    for x, y in ((-3.4, 5.9), (2.4, 6.2), (6.6, 2.6), (-7.0, 0.4), (3.2, -0.4)):
        _tub((x, y), made, chance)


def _arcade(place: Matrix, made: Materials, side: int) -> None:
    """Add one side: a wall with windows above arches on columns, and a roof."""
    mesh = MeshBuilder()
    mesh.place = place
    coat = made[("plaster", "pale", "plaster", "brick")[side]]
    bays, wide = 6, 2 * HALF / 6
    for bay in range(bays + 1):
        x = -HALF + wide * bay
        mesh.box((x, HALF - 2.0, 0.15), (0.55, 0.55, 0.3), made["pale"])
        mesh.tube([(x, HALF - 2.0, 0.3), (x, HALF - 2.0, 2.3)], (0.2, 0.16), made["pale"], 14)
        mesh.box((x, HALF - 2.0, 2.4), (0.5, 0.5, 0.22), made["pale"])
    for bay in range(bays):
        _arch(mesh, -HALF + wide * (bay + 0.5), wide, coat)
        x = -HALF + wide * (bay + 0.5)
        mesh.box((x, HALF - 2.18, 4.75), (1.1, 0.1, 1.3), made["dark"])
        for edge in (-0.8, 0.8):
            mesh.box((x + edge, HALF - 2.22, 4.75), (0.5, 0.06, 1.35), made["green wood"])
            for slat in range(9):
                spot = (x + edge, HALF - 2.27, 4.2 + 0.14 * slat)
                mesh.box(spot, (0.44, 0.03, 0.05), made["green wood"])
    mesh.box((0, HALF - 2.0, 4.9), (2 * HALF, 0.3, 2.6), coat)
    mesh.box((0, HALF - 2.25, 3.72), (2 * HALF, 0.2, 0.16), made["pale"])
    mesh.box((0, HALF, 3.1), (2 * HALF, 0.3, 6.2), made["brick"])
    mesh.box((0, HALF - 1.0, 3.65), (2 * HALF, 2.0, 0.14), made["wood"])
    eaves = [(-HALF, HALF - 2.7, 6.1), (HALF, HALF - 2.7, 6.1), (HALF, HALF + 0.6, 7.3),
             (-HALF, HALF + 0.6, 7.3)]  # fmt: skip
    mesh.faces(eaves, [(0, 1, 2, 3)], made["tiles"])
    mesh.object("arcade")


def _arch(mesh: MeshBuilder, x: float, wide: float, coat: bpy.types.Material) -> None:
    """Add the wall between an arch and the storey above, as a strip of faces."""
    y, low, top, radius = HALF - 2.15, 2.5, 3.7, wide / 2 - 0.25
    points, faces = [], []
    for step in range(13):
        angle = math.pi * step / 12
        at = x - radius * math.cos(angle)
        rise = low + 1.0 * math.sin(angle)
        points += [(at, y, rise), (at, y, top), (at, y + 0.3, rise)]
    for step in range(12):
        p = 3 * step
        faces += [(p, p + 3, p + 4, p + 1), (p, p + 2, p + 5, p + 3)]
    mesh.faces(points, faces, coat)
    for side in (-1, 1):
        mesh.box((x + side * (wide / 2 - 0.125), y + 0.15, 3.1), (0.25, 0.3, 1.2), coat)


def _trellis(
    spot: tuple[float, float], turn: float, made: Materials, chance: random.Random
) -> None:
    """Add a lattice of crossed slats in a frame, overgrown in places."""
    mesh = MeshBuilder()
    mesh.place = Matrix.Translation((*spot, 0)) @ Matrix.Rotation(turn, 4, "Z")
    wide, high = 1.9, 2.2
    for edge in (-wide / 2, wide / 2):
        mesh.box((edge, 0, high / 2), (0.08, 0.08, high), made["green wood"])
    for rail in (0.25, high):
        mesh.box((0, 0, rail), (wide, 0.07, 0.07), made["green wood"])
    count = 11
    for step in range(count):
        for slope in (-1, 1):
            begin = -wide + 2 * wide * (step + 0.5) / count
            ends = []
            for share in range(21):
                x = begin + slope * (share / 20 - 0.5) * (high - 0.3)
                if abs(x) < wide / 2:
                    ends.append((x, 0.015 * slope, 0.28 + share / 20 * (high - 0.33)))
            if len(ends) > 1:
                mesh.tube([ends[0], ends[-1]], 0.014, made["green wood"], 4, smooth=False)
    for _ in range(150):
        where = Vector((chance.uniform(-0.95, 0.95), chance.gauss(0, 0.05), 0))
        where.z = min(2.3, abs(chance.gauss(0, 0.7)) * (1.4 if where.x > 0.2 else 0.6) + 0.1)
        leaf(mesh, where, 0.11, made["ivy"], chance)
    mesh.object("trellis")


def leaf(
    mesh: MeshBuilder,
    where: mathutils.Vector,
    size: float,
    coat: bpy.types.Material,
    chance: random.Random,
) -> None:
    """Add a folded leaf of four corners, turned at random."""
    turn = mathutils.Euler([chance.uniform(0, 6.3) for _ in range(3)]).to_matrix()
    corners = [(0, 0, 0), (0.4, 0.5, 0.12), (0, 1.2, 0), (-0.4, 0.5, 0.12)]
    points = [where + turn @ (size * Vector(corner)) for corner in corners]
    mesh.faces(points, [(0, 1, 2), (0, 2, 3)], coat)


def _fountain(made: Materials) -> None:
    x, y = FOUNTAIN
    mesh = MeshBuilder()
    mesh.place = Matrix.Translation((x, y, 0))
    for radius, low, high in ((1.45, 0.0, 0.5), (0.75, 1.05, 1.2)):
        ring = [
            (radius * math.cos(a), radius * math.sin(a))
            for a in (k * math.pi / 12 for k in range(25))
        ]
        mesh.tube([(*at, (low + high) / 2) for at in ring], (high - low) / 2, made["pale"], 8)
    mesh.tube([(0, 0, 0), (0, 0, 0.9), (0, 0, 1.05)], (0.22, 0.14, 0.7), made["pale"], 16)
    mesh.tube([(0, 0, 1.05), (0, 0, 1.55)], (0.1, 0.06), made["brass"], 10)
    mesh.tube([(0, 0, 0.38), (0, 0, 0.40)], 1.4, made["water"], 24)
    mesh.object("fountain")


def _trunk(spot: tuple[float, float], made: Materials, chance: random.Random) -> None:
    mesh = MeshBuilder()
    mesh.place = Matrix.Translation((*spot, 0))
    crown = Vector((0.1, 0.05, 2.1))
    mesh.tube([(0, 0, 0), (0.05, 0, 1.1), crown], (0.17, 0.12, 0.1), made["bark"], 10)
    for number in range(6):
        angle = number * 1.05 + chance.uniform(-0.2, 0.2)
        tip = crown + Vector((math.cos(angle), math.sin(angle), chance.uniform(0.6, 1.3)))
        mesh.tube([crown, (crown + tip) / 2 + Vector((0, 0, 0.1)), tip], (0.06, 0.04, 0.02),
                  made["bark"], 6)  # fmt: skip
    ring = [(0.6 * math.cos(a), 0.6 * math.sin(a), 0.12) for a in (k * 0.5236 for k in range(13))]
    mesh.tube(ring, 0.1, made["brick"], 6)
    mesh.object("trunk")


def _tub(spot: tuple[float, float], made: Materials, chance: random.Random) -> None:
    mesh = MeshBuilder()
    mesh.place = Matrix.Translation((*spot, 0))
    mesh.tube([(0, 0, 0), (0, 0, 0.5), (0, 0, 0.55)], (0.26, 0.36, 0.38), made["brick"], 14)
    for number in range(60):
        away = Vector((chance.gauss(0, 0.22), chance.gauss(0, 0.22), chance.uniform(0.5, 1.0)))
        leaf(mesh, away, 0.14, made["petal" if number % 4 == 0 else "leaf"], chance)
    mesh.object("tub")


def lights() -> None:
    """Add sky, a sun between the roofs, and fill light without shadows in the arcades."""
    looks.backdrop((0.10, 0.26, 0.68), (0.60, 0.68, 0.80), 0.55, (1.8, 1.7, 1.55))
    motion.sunlight((0.46, 0.34, -0.85), 4.6, (1.0, 0.88, 0.70), 0.5)
    for x, y in ((0.0, 8.0), (-6.0, 8.0), (6.0, 8.0), (8.0, 1.0), (-8.0, 1.0)):
        lamp = bpy.data.lights.new("fill", "POINT")
        lamp.energy, lamp.color, lamp.use_shadow = 45.0, (1.0, 0.78, 0.52), False
        thing = bpy.data.objects.new("fill", lamp)
        thing.location = (x, y, 2.6)
        bpy.context.scene.collection.objects.link(thing)
