"""What stands and hangs in the alleys of the slum scene: clutter, cables, signs, awnings."""

from __future__ import annotations

from itertools import pairwise

import slum_hangings as hangings
import slum_houses as houses
import slum_parts as parts
from slum_parts import Kit, at
from stage.blender import bpy, mathutils
from stage.meshes import MeshBuilder, lettering

Matrix, Vector = mathutils.Matrix, mathutils.Vector

LINES = (
    ((-1.1, 0.62, 2.72), (1.1, 0.78, 2.66), "first"),
    ((-1.1, 5.3, 3.35), (0.58, 5.2, 3.3), "stair"),
    ((-1.1, 6.9, 4.35), (0.58, 6.7, 4.3), "stair"),
    ((3.9, 2.3, 2.75), (4.1, 4.4, 2.7), "second"),
    ((5.9, 2.3, 2.9), (5.7, 4.4, 2.95), "second"),
    ((1.9, 2.62, 2.25), (3.7, 2.58, 2.22), "inner"),
)
"""Clothes lines: ends, and the group of what hangs on them."""


def build(kit: Kit) -> None:
    """Build everything between the walls that stands still."""
    kit.mesh.place = Matrix.Identity(4)
    kit.mesh.faces(
        [(-40, -40, 0), (60, -40, 0), (60, 60, 0), (-40, 60, 0)], [(0, 1, 2, 3)], kit.looks["mud"]
    )
    puddles = ((-0.1, 0.9, 0.34, 0.7), (0.3, 2.9, 0.5, 0.42), (-0.35, 3.7, 0.4, 0.3))
    for x, y, wide, long in (*puddles, (2.9, 3.4, 0.7, 0.3), (4.9, 3.1, 0.6, 0.35)):
        parts.puddle(kit, x, y, wide, long)
    for x, y, wide, long in ((7.9, 3.5, 0.6, 0.8), (0.2, -0.6, 0.25, 0.5)):
        parts.puddle(kit, x, y, wide, long)
    _first_alley(kit)
    _second_alley(kit)
    _pipes(kit)
    _cables(kit)
    _signs(kit)
    _balcony(kit)
    _tarp(kit)
    for start, end, _ in LINES:
        parts.cable(kit, start, end, 0.03, 0.008)


def _first_alley(kit: Kit) -> None:
    barrels = ((0.84, 0.06, "bluetin"), (0.82, 1.47, "rust"), (-0.82, 2.35, "greentin"))
    for x, y, look in barrels:
        parts.barrel(kit, at(x, y, 0, kit.chance.uniform(0, 360)), look)
    for x, y, z, turn in ((0.84, 0.72, 0, 8), (0.86, 0.75, 0.37, -14), (0.82, 2.0, 0, 20)):
        parts.crate(kit, at(x, y, z, turn))
    for spot in range(3):
        parts.tyre(kit, at(-0.8 + 0.02 * spot, 2.95 + 0.01 * spot, 0.18 * spot))
    parts.tyre(kit, at(-0.98, -0.15, 0.3) @ Matrix.Rotation(1.35, 4, "Y"))
    parts.bucket(kit, at(0.8, -0.25), "red")
    parts.bucket(kit, at(-0.92, 0.35), "blue")
    parts.bucket(kit, at(-0.95, 0.75), "yellow", 0.24)
    parts.bucket(kit, at(-0.93, 1.9), "orange")
    parts.bin_bags(kit, at(0.75, -0.7))
    parts.bin_bags(kit, at(-0.8, 3.75, 0, 90))
    parts.ladder(kit, (-0.78, 1.75, 0), (-1.12, 1.65, 3.0), (0, 1, 0))
    for plank in range(5):
        kit.mesh.place = at(-0.95, 1.12 + 0.09 * plank) @ Matrix.Rotation(-0.09, 4, "Y")
        kit.mesh.box((0, 0, 1.1), (0.03, 0.08, 2.2 + 0.1 * plank % 0.3), kit.looks["plank"])
    parts.air_conditioner(kit, at(-1.1, -0.35, 2.1, 90))
    parts.dish(kit, at(0.85, 2.05, 2.75, -60), 0.33)
    parts.dish(kit, at(-0.75, 3.3, 2.5, 30), 0.36)


def _second_alley(kit: Kit) -> None:
    for x, y, look in ((2.75, 4.05, "rust"), (6.3, 4.0, "bluetin"), (6.6, 2.7, "tank")):
        parts.barrel(kit, at(x, y, 0, kit.chance.uniform(0, 360)), look)
    parts.barrel(kit, at(5.3, 4.05), "redtin")
    for x, y, z, turn in ((3.35, 4.1, 0, 10), (3.4, 4.08, 0.37, -20), (4.1, 2.62, 0, 5)):
        parts.crate(kit, at(x, y, z, turn))
    for x, y, z in ((4.7, 2.65, 0), (4.72, 2.63, 0.37), (4.45, 4.1, 0), (6.9, 4.05, 0)):
        parts.crate(kit, at(x, y, z, kit.chance.uniform(-20, 20)), 0.45, "plank")
    for x, y, look in ((2.2, 2.55, "yellow"), (3.1, 2.5, "red"), (5.6, 2.55, "blue")):
        parts.bucket(kit, at(x, y), look)
    for x, y in ((1.2, 4.15), (1.65, 4.2), (5.9, 4.15)):
        parts.bucket(kit, at(x, y), kit.chance.choice(("ochre", "red", "teal")), 0.34)
    for spot in range(4):
        parts.tyre(kit, at(3.5 + 0.03 * spot, 2.62, 0.18 * spot))
    parts.bin_bags(kit, at(9.2, 4.0))
    parts.ladder(kit, (3.85, 3.95, 0), (4.0, 4.33, 3.1), (1, 0, 0))
    parts.ladder(kit, (11.0, 2.8, 0), (11.1, 2.3, 3.3), (1, 0, 0))
    parts.dish(kit, at(4.4, 4.15, 2.9, -40), 0.36)
    parts.dish(kit, at(6.6, 2.5, 2.7, -80), 0.4)
    parts.air_conditioner(kit, at(3.0, 4.4, 2.15))
    parts.air_conditioner(kit, at(5.6, 2.3, 2.2, 180))
    _window_fan(kit, at(2.05, 4.36, 2.0))
    for x, y in ((12.0, 4.0), (13.1, 2.8), (10.4, 2.7)):
        parts.barrel(kit, at(x, y), kit.chance.choice(houses.TIN))


def _window_fan(kit: Kit, place: Matrix) -> None:
    """Add the square box of an extractor fan, open to -y, on a wall."""
    kit.mesh.place = place
    kit.mesh.box((0, -0.02, 0), (0.6, 0.02, 0.6), kit.looks["black"])
    for side in (-1, 1):
        kit.mesh.box((side * 0.31, -0.12, 0), (0.04, 0.24, 0.66), kit.looks["greentin"])
        kit.mesh.box((0, -0.12, side * 0.31), (0.66, 0.24, 0.04), kit.looks["greentin"])


def _pipes(kit: Kit) -> None:
    """Run gutters, drain pipes, meters and conduits along the walls."""
    mesh, looks, chance = kit.mesh, kit.looks, kit.chance
    for wall, start, end, storeys in houses.FACADES:
        place = houses.wall_place(wall, start, end)
        mesh.place = place
        low = storeys[0][0]
        x = chance.uniform(0.05, 0.15)
        look = looks[chance.choice(("rust", "zinc", "grey", "white"))]
        mesh.tube([(x, -0.1, 0.1), (x, -0.1, low - 0.1)], 0.035, look, 8)
        for z in (0.5, 1.5, 2.2):
            mesh.box((x, -0.07, z), (0.1, 0.1, 0.03), looks["rust"])
        for line in range(3):
            z, wide = low - 0.12 - 0.07 * line, end - start
            path = [
                (wide * s / 5, -0.09 - 0.02 * line, z - 0.04 * (s % 2) * chance.random())
                for s in range(6)
            ]
            mesh.tube(path, 0.011, looks["cable"], 5)
        if chance.random() < 0.7:
            x = chance.uniform(0.3, end - start - 0.3)
            mesh.box((x, -0.1, 1.75), (0.2, 0.14, 0.28), looks["grey"])
            mesh.tube([(x, -0.18, 1.78), (x, -0.19, 1.78)], 0.06, looks["white"], 10)
            mesh.tube([(x, -0.09, 1.9), (x, -0.09, low - 0.15)], 0.012, looks["cable"], 5)


def _cables(kit: Kit) -> None:
    """String a tangle of cables between the walls and to the pole at the corner."""
    chance = kit.chance
    kit.mesh.place = Matrix.Identity(4)
    kit.mesh.tube([(0.8, 4.22, 0), (0.78, 4.2, 5.4)], (0.11, 0.08), kit.looks["beam"], 10)
    for z in (4.3, 4.9):
        kit.mesh.box((0.79, 4.1, z), (1.3, 0.08, 0.1), kit.looks["beam"])
        for pin in range(5):
            x = 0.25 + 0.27 * pin
            kit.mesh.tube([(x, 4.1, z), (x, 4.1, z + 0.16)], (0.04, 0.03), kit.looks["white"], 8)
    kit.mesh.tube([(0.79, 3.9, 3.5), (0.79, 3.9, 4.05)], 0.17, kit.looks["grey"], 14)
    for _ in range(16):
        pin = (0.25 + 0.27 * chance.randrange(5), 4.1, chance.choice((4.46, 5.06)))
        ends = (
            (chance.choice((-1.05, 1.05)), chance.uniform(-5, 1.5), chance.uniform(2.6, 4.3)),
            (chance.uniform(3, 12), chance.choice((2.3, 4.35)), chance.uniform(2.6, 4.2)),
        )
        parts.cable(kit, pin, chance.choice(ends), chance.uniform(0.15, 0.6), 0.011)
    for _ in range(24):
        y = chance.uniform(-2.0, 3.8)
        high = chance.uniform(2.75, 4.2)
        start, end = (-1.1, y, high), (1.1, y + chance.gauss(0, 0.8), high + chance.gauss(0, 0.3))
        parts.cable(kit, start, end, chance.uniform(0.05, 0.3), chance.uniform(0.007, 0.014))
    for _ in range(30):
        x = chance.uniform(1.3, 12)
        high = chance.uniform(2.7, 4.0)
        start, end = (x, 2.3, high), (x + chance.gauss(0, 0.9), 4.4, high + chance.gauss(0, 0.3))
        parts.cable(kit, start, end, chance.uniform(0.05, 0.35), chance.uniform(0.007, 0.014))
    for x, y in ((-0.95, 2.75), (1.0, 2.2), (0.85, 4.05)):
        for coil in range(5):
            away = 0.1 + 0.02 * coil
            ring = [
                Vector((x, y, 2.55))
                + Matrix.Rotation(0.7 * coil, 3, "Z")
                @ Matrix.Rotation(step * 0.524, 3, "Y")
                @ Vector((away, 0, away))
                for step in range(13)
            ]
            kit.mesh.tube(ring, 0.009, kit.looks["cable"], 4)


def _signs(kit: Kit) -> None:
    """Hang boards into the alleys, and the neon signs."""
    bar = kit.looks["rust"]
    boards = (
        (at(0.78, -0.15, 2.28), "BARBER", (0.62, 0.34), ("white", "red")),
        (at(-0.74, 1.0, 2.36), "CAFE", (0.6, 0.36), ("yellow", "black")),
        (at(-0.2, 4.42, 3.05), "HOTEL SOL", (1.5, 0.36), ("teal", "yellow")),
        (at(2.55, 4.06, 2.5, -90), "TAILOR", (0.6, 0.3), ("blue", "white")),
        (at(5.2, 2.65, 2.35, -90), "KEYS", (0.6, 0.36), ("red", "yellow")),
        (at(6.4, 4.02, 2.4, -90), "RICE", (0.66, 0.36), ("green", "white")),
        (at(15.95, 3.4, 2.35, -90), "MERCADO", (1.7, 0.5), ("yellow", "red")),
        (at(-1.07, 2.0, 2.35, 90), "REPAIRS", (1.1, 0.34), ("blue", "yellow")),
        (at(1.07, 0.35, 2.25, -90), "FISH", (0.8, 0.3), ("cream", "blue")),
    )
    for place, text, size, colours in boards:
        parts.sign(kit, place, text, size, colours)
        kit.mesh.place = place
        kit.mesh.box((0, 0.01, size[1] / 2 + 0.04), (size[0] + 0.2, 0.025, 0.03), bar)
    for place, text, size in (
        (at(3.2, 3.98, 2.85, -90), "BAR", 0.46),
        (at(0.72, 2.1, 2.45), "OPEN", 0.24),
    ):
        look = "neonpink" if text == "BAR" else "neoncyan"
        kit.mesh.place = place
        wide, high = 0.78 * size * len(text), 1.5 * size
        kit.mesh.box((0, 0.05, 0), (wide, 0.06, high), kit.looks["black"])
        made = lettering(text, place @ parts.UPRIGHT, size, kit.looks[look])
        made.data.offset = 0.0
        corners = [
            (x * wide / 2.1, -0.01, z * high / 2.15)
            for x, z in ((-1, -1), (1, -1), (1, 1), (-1, 1), (-1, -1))
        ]
        other = kit.looks["neoncyan" if text == "BAR" else "neonpink"]
        for first, second in pairwise(corners):
            kit.mesh.tube([first, second], 0.013, other, 6)


def _balcony(kit: Kit) -> None:
    """Add balconies over both alleys, with pots and a blanket over the rail."""
    for place, wide in (
        (at(-1.1, 3.2, 2.75, 90), 1.6),
        (at(4.9, 4.4, 2.72), 2.0),
        (at(2.2, 2.25, 2.7, -90), 1.1),
    ):
        kit.mesh.place = place
        kit.mesh.box((wide / 2, -0.35, 0), (wide, 0.7, 0.08), kit.looks["plank"])
        for x in (0.1, wide - 0.1):
            kit.mesh.tube([(x, 0, -0.5), (x, -0.6, -0.05)], 0.03, kit.looks["beam"], 6)
        parts.railing(kit, place @ Matrix.Translation((0, -0.68, 0.04)), wide)
        for pot in range(3):
            where = place @ at(0.25 + pot * (wide - 0.5) / 2, -0.55, 0.04)
            parts.bucket(kit, where, kit.chance.choice(("red", "orange", "blue")), 0.24)
        kit.mesh.place = place
        look = kit.looks[kit.chance.choice(("stripered", "saffron", "magenta"))]
        kit.mesh.box((0.45 * wide, -0.715, 0.55), (0.55, 0.025, 0.8), look)


def _tarp(kit: Kit) -> None:
    """Spread a sagging tarpaulin on poles over the right side of the first alley."""
    points = []
    for row in range(7):
        for column in range(7):
            u, v = row / 6, column / 6
            sag = 0.5 * (u * (1 - u)) * (0.4 + v * (1 - v) * 2)
            points.append((1.1 - 0.62 * u, 1.1 + 1.0 * v, 2.5 - 0.18 * u - sag * 0.5))
    quads = [
        (7 * r + c, 7 * r + c + 1, 7 * r + c + 8, 7 * r + c + 7) for r in range(6) for c in range(6)
    ]
    kit.mesh.place = Matrix.Identity(4)
    kit.mesh.faces(points, quads, kit.looks["tarp"], smooth=True)
    for y in (1.12, 2.08):
        kit.mesh.tube([(0.5, y, 2.32), (1.1, y, 2.5)], 0.02, kit.looks["beam"], 6)


def lamp(
    at_spot: tuple[float, float, float],
    energy: float,
    colour: tuple[float, float, float],
    size: float,
) -> bpy.types.Object:
    """Add a point lamp."""
    light = bpy.data.lights.new("lamp", "POINT")
    light.energy, light.color, light.shadow_soft_size = energy, colour, size
    made = bpy.data.objects.new("lamp", light)
    made.location = at_spot
    bpy.context.scene.collection.objects.link(made)
    return made


def static_scene(kit: Kit) -> None:
    """Build all that stands still, as three objects."""
    houses.build(kit)
    kit.mesh.object("houses")
    kit.mesh = MeshBuilder()
    build(kit)
    kit.mesh.object("street")
    kit.mesh = MeshBuilder()
    hangings.build(kit)
    kit.mesh.object("hangings")
