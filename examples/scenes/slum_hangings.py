"""Thin things in the slum scene that much is seen through: beads, vines, gates, bird cages."""

from __future__ import annotations

import math

from slum_parts import Kit, at
from stage.blender import mathutils

Matrix, Vector = mathutils.Matrix, mathutils.Vector
Point = tuple[float, float, float]

STRINGS: tuple[tuple[Point, Point, int, float, str], ...] = (
    ((0.66, -0.35, 2.25), (0.62, 0.95, 2.3), 15, 0.8, "chilli"),
    ((-1.05, 2.25, 2.5), (-0.42, 2.35, 2.5), 9, 1.1, "beads"),
    ((-0.86, -1.1, 2.3), (-0.86, -0.5, 2.3), 8, 0.7, "garlic"),
    ((-1.05, 4.3, 2.55), (-0.35, 4.3, 2.55), 9, 0.9, "chilli"),
    ((1.15, 3.98, 2.4), (1.75, 3.94, 2.4), 9, 1.25, "beads"),
    ((2.75, 4.0, 2.5), (3.4, 3.95, 2.5), 6, 0.9, "garlic"),
    ((3.3, 2.33, 2.45), (3.35, 2.95, 2.45), 10, 1.3, "beads"),
    ((4.5, 2.75, 2.4), (5.6, 2.75, 2.4), 13, 0.9, "chilli"),
    ((5.0, 3.95, 2.4), (6.4, 3.95, 2.4), 15, 0.8, "beads"),
)
"""Rows of strings: ends of the bar they hang from, how many, how long, and what is on them."""

COLOURS = {
    "chilli": ("red", "red", "orange"),
    "garlic": ("white", "cream", "white"),
    "beads": ("teal", "yellow", "pink", "blue", "white", "orange"),
}
CAGES = ((-0.72, 0.35, 2.12), (1.95, 3.85, 1.75), (4.3, 2.75, 1.9), (0.62, 1.02, 1.85))


def build(kit: Kit) -> None:
    """Hang everything."""
    for start, end, count, length, kind in STRINGS:
        strings(kit, (start, end), count, length, kind)
    for spot in CAGES:
        cage(kit, at(*spot))
    gate(kit, at(-1.08, 4.36, 0, 4), 0.72, 2.0)
    gate(kit, at(0.6, 4.3, 0, -62), 0.55, 1.9)
    gate(kit, at(2.9, 2.8, 0, 8), 1.0, 1.25)
    for x, y in ((0.62, -0.5), (0.63, 0.38), (0.6, 1.12), (0.62, 1.82)):
        _pole(kit, x, y)
    for number in range(13):
        _pole(kit, 0.95 + 0.44 * number, 3.82 + kit.chance.gauss(0, 0.02))
    for z in (1.05, 2.15, 3.0):
        tilt = kit.chance.uniform(-0.05, 0.05)
        kit.mesh.tube([(0.8, 3.85, z), (6.5, 3.86, z + tilt)], 0.022, kit.looks["bamboo"], 7)
    kit.mesh.tube([(1.9, 3.86, 0.2), (3.3, 3.86, 3.0)], 0.02, kit.looks["bamboo"], 7)
    kit.mesh.tube([(6.2, 3.86, 0.2), (4.4, 3.86, 3.0)], 0.02, kit.looks["bamboo"], 7)
    _vines(kit)


def _pole(kit: Kit, x: float, y: float) -> None:
    """Stand a bamboo pole of a scaffold, with knots."""
    kit.mesh.place = Matrix.Identity(4)
    lean = kit.chance.gauss(0, 0.02)
    path, radii = [], []
    for knot in range(11):
        for up, radius in ((0.0, 0.027), (0.015, 0.022), (0.285, 0.021)):
            z = 0.3 * knot + up
            path.append((x + lean * z, y, z))
            radii.append(radius)
    kit.mesh.tube(path, radii, kit.looks["bamboo"], 8)


def strings(kit: Kit, ends: tuple[Point, Point], count: int, length: float, kind: str) -> None:
    """Hang a row of strings of beads, chillies or garlic from a bar."""
    first, second = Vector(ends[0]), Vector(ends[1])
    kit.mesh.place = Matrix.Identity(4)
    kit.mesh.tube([first, second], 0.014, kit.looks["beam"], 6)
    for number in range(count):
        top = first.lerp(second, (number + 0.5) / count)
        low = length * kit.chance.uniform(0.75, 1.0)
        kit.mesh.tube([top, top - Vector((0, 0, low))], 0.005, kit.looks["cable"], 4)
        colours = COLOURS[kind]
        shade = kit.chance.randrange(len(colours))
        step = 0.05 if kind == "beads" else 0.062
        for bead in range(2, int(low / step)):
            spot = top - Vector((0, 0, bead * step))
            look = kit.looks[colours[(bead // 3 + shade) % len(colours)]]
            if kind == "chilli":
                turn = kit.chance.uniform(0, 6.28)
                tip = spot + Vector((0.045 * math.cos(turn), 0.045 * math.sin(turn), -0.09))
                kit.mesh.tube([spot, tip], (0.013, 0.003), look, 5)
            else:
                size = 0.018 if kind == "beads" else kit.chance.uniform(0.02, 0.034)
                shift = Vector([kit.chance.gauss(0, 0.3 * size) for _ in range(3)])
                kit.mesh.ball(spot + shift, size, look, (7, 5))


def cage(kit: Kit, place: Matrix, size: float = 0.15) -> None:
    """Hang a bird cage with a bird in it."""
    mesh = kit.mesh
    mesh.place = place
    for wire in range(12):
        angle = 2 * math.pi * wire / 12
        x, y = math.cos(angle), math.sin(angle)
        path = [
            (size * x * r, size * y * r, z) for r, z in ((1, 0), (1, 0.22), (0.7, 0.32), (0, 0.36))
        ]
        mesh.tube(path, 0.005, kit.looks["yellow"], 4)
    mesh.tube([(0, 0, -0.01), (0, 0, 0.02)], size * 1.05, kit.looks["crate"], 16)
    mesh.tube([(0, 0, 0.36), (0, 0, 0.9)], 0.005, kit.looks["cable"], 4)
    mesh.tube([(-size, 0, 0.1), (size, 0, 0.1)], 0.007, kit.looks["beam"], 5)
    mesh.ball((0.02, 0, 0.15), 0.035, kit.looks["yellow"], (8, 6))


def gate(kit: Kit, place: Matrix, wide: float, high: float) -> None:
    """Stand an iron gate with upright bars along the place's x axis."""
    kit.mesh.place = place
    for z in (0.12, 0.55 * high, high - 0.12):
        kit.mesh.box((wide / 2, 0, z), (wide, 0.02, 0.035), kit.looks["rust"])
    count = int(wide / 0.085)
    for bar in range(count + 1):
        x = wide * bar / count
        thick = 0.035 if bar in (0, count) else 0.018
        kit.mesh.box((x, 0, high / 2), (thick, thick, high), kit.looks["redtin"])


def _vines(kit: Kit) -> None:
    """Let vines hang from the eaves of both alleys."""
    chance = kit.chance
    for number in range(96):
        away = chance.uniform(0.1, 0.45)
        if number % 5 < 2:
            side = chance.choice((-1, 1))
            spot = (side * (1.1 - away), chance.uniform(-1.0, 4.0))
        else:
            line = chance.choice((2.3 + away, 4.4 - away))
            spot = (chance.uniform(1.2, 8.0), line)
        _vine(kit, (*spot, chance.uniform(2.4, 2.9)), chance.uniform(0.35, 0.9))


def _vine(kit: Kit, spot: Point, length: float) -> None:
    chance = kit.chance
    kit.mesh.place = Matrix.Identity(4)
    here = Vector(spot)
    count = int(length / 0.025)
    path = [here.copy()]
    for _ in range(count):
        here += Vector((chance.gauss(0, 0.008), chance.gauss(0, 0.008), -0.025))
        path.append(here.copy())
        for _ in range(2):
            out = Vector([chance.gauss(0, 1) for _ in range(3)]).normalized()
            wide = out.cross(Vector((0, 0, 1))).normalized() * 0.02
            tip = here + out * chance.uniform(0.05, 0.09)
            middle = here.lerp(tip, 0.5)
            leaf = [here, middle - wide, tip, middle + wide]
            kit.mesh.faces(leaf, [(0, 1, 2, 3)], kit.looks["leaf"])
    kit.mesh.tube(path[::4], 0.005, kit.looks["beam"], 4)
