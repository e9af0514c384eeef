"""Thin things: plants, lattices, fences, chains, curtains; one metre high, in four materials."""

from __future__ import annotations

import math
import random
from collections.abc import Sequence

from stage.blender import mathutils
from stage.meshes import MeshBuilder, Point
from variety_props import Suit, ring

Matrix, Vector = mathutils.Matrix, mathutils.Vector


def blade(
    mesh: MeshBuilder, root: Point, tip: Point, wide: float, look: object, bend: float = 0.3
) -> None:
    """Add a leaf of two bent halves between two points."""
    first, last = Vector(root), Vector(tip)
    side = (last - first).cross(Vector((0.3, 0.2, 1))).normalized() * wide
    middle = first.lerp(last, 0.5) + Vector((0, 0, bend * (last - first).length))
    points = [first, middle - side, last, middle + side]
    mesh.faces(points, [(0, 1, 2, 3)], look)


def grass(mesh: MeshBuilder, suit: Suit, chance: random.Random) -> None:
    """A tuft of blades."""
    for _ in range(28):
        angle, lean = chance.uniform(0, 6.3), chance.uniform(0.05, 0.5)
        root = (chance.gauss(0, 0.1), chance.gauss(0, 0.1), 0)
        tip = (lean * math.cos(angle), lean * math.sin(angle), chance.uniform(0.5, 1.0))
        blade(mesh, root, tip, 0.025, chance.choice(suit[:2]), 0.1)


def fern(mesh: MeshBuilder, suit: Suit, chance: random.Random) -> None:
    """A rosette of fronds or broad leaves."""
    wide, count = chance.choice(((0.05, 14), (0.16, 9), (0.1, 12)))
    for number in range(count):
        angle = 2.4 * number + chance.uniform(-0.3, 0.3)
        away, high = chance.uniform(0.3, 0.6), chance.uniform(0.4, 1.0)
        tip = (away * math.cos(angle), away * math.sin(angle), high)
        blade(mesh, (0, 0, 0.02), tip, wide, suit[number % 2], 0.25)


def bush(mesh: MeshBuilder, suit: Suit, chance: random.Random) -> None:
    """A ball of leaves."""
    _crown(mesh, (0, 0, 0.5), 0.5, suit[:2], chance, 260)


def _crown(
    mesh: MeshBuilder, at: Point, size: float, leaves: Suit, chance: random.Random, count: int
) -> None:
    for _ in range(count):
        away = Vector([chance.gauss(0, 1) for _ in range(3)]).normalized()
        root = Vector(at) + away * size * chance.uniform(0.5, 1.0)
        tip = root + Vector([chance.gauss(0, 0.14 * size) for _ in range(3)]) + away * 0.1 * size
        blade(mesh, root, tip, chance.uniform(0.04, 0.1) * size, chance.choice(leaves))


def tree(mesh: MeshBuilder, suit: Suit, chance: random.Random) -> None:
    """A trunk with boughs and crowns of leaves, a fir, or bare branches."""
    kind = chance.choice(("round", "round", "fir", "bare"))
    mesh.tube([(0, 0, 0), (0.02, 0, 0.5), (0, 0.02, 0.95)], (0.05, 0.035, 0.01), suit[2], 7)
    if kind == "fir":
        for level in range(9):
            z, wide = 0.2 + 0.085 * level, 0.32 - 0.032 * level
            for step in range(16):
                angle = 0.39 * step + level
                tip = (wide * math.cos(angle), wide * math.sin(angle), z - 0.1)
                blade(mesh, (0, 0, z), tip, 0.03, suit[step % 2], 0.1)
        return
    for number in range(5 if kind == "round" else 14):
        angle, z = 2.4 * number, chance.uniform(0.35, 0.85)
        end = Vector((0.3 * math.cos(angle), 0.3 * math.sin(angle), z + chance.uniform(0.05, 0.3)))
        mesh.tube([(0, 0, z), end], (0.02, 0.005), suit[2], 5)
        if kind == "round":
            _crown(mesh, end, 0.2, suit[:2], chance, 110)


def potted(mesh: MeshBuilder, suit: Suit, chance: random.Random) -> None:
    """A plant in a pot."""
    mesh.tube([(0, 0, 0), (0, 0, 0.3)], (0.14, 0.2), suit[3], 14)
    keep = mesh.place.copy()
    mesh.place = keep @ Matrix.Translation((0, 0, 0.28)) @ Matrix.Scale(0.75, 4)
    chance.choice((fern, bush, grass))(mesh, suit, chance)
    mesh.place = keep


def lattice(mesh: MeshBuilder, suit: Suit, chance: random.Random) -> None:
    """A tower of struts."""
    wide, levels, thick = (
        chance.uniform(0.12, 0.3),
        chance.randint(3, 6),
        chance.uniform(0.008, 0.02),
    )
    corners = [(-wide, -wide), (wide, -wide), (wide, wide), (-wide, wide)]
    for level in range(levels):
        low, high = level / levels, (level + 1) / levels
        for a, b in zip(corners, corners[1:] + corners[:1], strict=True):
            mesh.tube([(*a, low), (*a, high)], 1.4 * thick, suit[2], 6)
            mesh.tube([(*a, low), (*b, high)], thick, suit[0], 5)
            mesh.tube([(*a, high), (*b, high)], thick, suit[1], 5)


def fence(mesh: MeshBuilder, suit: Suit, chance: random.Random) -> None:
    """Two metres of fence: pickets, rails, bars or wire net."""
    kind = chance.choice(("pickets", "bars", "net"))
    for x in (-1.0, 0.0, 1.0):
        mesh.box((x, 0.03, 0.5), (0.07, 0.07, 1.0), suit[3])
    if kind == "net":
        for step in range(-10, 21):
            x = -1 + 0.1 * step
            for lean in (-1, 1):
                ends = [(x if lean > 0 else x + 1, 0, 0), (x + 1 if lean > 0 else x, 0, 1)]
                clipped = [Vector((min(1, max(-1, p[0])), 0, p[2])) for p in ends]
                if (clipped[0] - clipped[1]).length > 0.2:
                    mesh.tube(clipped, 0.006, suit[2], 4)
        return
    for z in (0.25, 0.8):
        mesh.box((0, 0.02, z), (2.0, 0.03, 0.06), suit[1])
    for step in range(16):
        x = -0.94 + 0.125 * step
        if kind == "pickets":
            mesh.box((x, -0.01, 0.48), (0.07, 0.02, 0.92 + 0.05 * (step % 2)), suit[0])
        else:
            mesh.tube([(x, 0, 0), (x, 0, 1)], 0.012, suit[2], 6)


def curtain(mesh: MeshBuilder, suit: Suit, chance: random.Random) -> None:
    """Hanging strips from a rail at one metre."""
    mesh.tube([(-0.55, 0, 1), (0.55, 0, 1)], 0.02, suit[2], 8)
    count = chance.randint(7, 22)
    for step in range(count):
        x, wide = -0.5 + (step + 0.5) / count, 0.4 / count
        low, lean = chance.uniform(0, 0.2), chance.uniform(-0.05, 0.05)
        points = [(x - wide, lean, low), (x + wide, -lean, low), (x + wide, 0, 1), (x - wide, 0, 1)]
        mesh.faces(points, [(0, 1, 2, 3)], suit[step % 2])


def chain(mesh: MeshBuilder, suit: Suit, chance: random.Random) -> None:
    """A hanging chain with a weight."""
    keep = mesh.place.copy()
    for step in range(9):
        mesh.place = (
            keep
            @ Matrix.Translation((0, 0, 0.96 - 0.09 * step))
            @ Matrix.Rotation(math.pi / 2 * (step % 2), 4, "Z")
        )
        ring(mesh, (0, 0, 0), (0.055, 0.014), suit[2], 10)
    mesh.place = keep
    mesh.ball((0, 0, 0.1), 0.1, suit[0])


def mast(mesh: MeshBuilder, suit: Suit, chance: random.Random) -> None:
    """A mast with stays, yards and pennants."""
    mesh.tube([(0, 0, 0), (0, 0, 1)], (0.02, 0.01), suit[2], 8)
    for z in (0.5, 0.75):
        mesh.tube([(-0.25, 0, z), (0.25, 0, z)], 0.008, suit[3], 6)
    for x, y in ((-0.4, 0), (0.4, 0), (0, 0.4), (0, -0.4)):
        mesh.tube([(x, y, 0), (0, 0, 0.98)], 0.004, suit[3], 4)
    for step in range(chance.randint(2, 7)):
        z, x = 0.2 + 0.1 * step, 0.4 * (1 - 0.2 - 0.1 * step)
        points = [(x, 0, z), (x, 0, z + 0.09), (x + 0.12, 0.02, z + 0.05)]
        mesh.faces(points, [(0, 1, 2)], suit[step % 2])


def rope(
    mesh: MeshBuilder, ends: Sequence[Point], sag: float, thick: float, look: object
) -> list[mathutils.Vector]:
    """Hang a rope between two points and return points along it."""
    start, end = (Vector(point) for point in ends)
    path = []
    for step in range(13):
        share = step / 12
        path.append(start.lerp(end, share) - Vector((0, 0, 4 * sag * share * (1 - share))))
    mesh.tube(path, thick, look, 5)
    return path
