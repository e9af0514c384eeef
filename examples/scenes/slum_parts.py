"""Things that fill the alleys of the slum scene: sheets, barrels, crates, cables, signs."""

from __future__ import annotations

import math
import random
from collections.abc import Sequence
from dataclasses import dataclass, field

from slum_looks import Looks
from stage.blender import mathutils
from stage.meshes import MeshBuilder, lettering

Matrix, Vector = mathutils.Matrix, mathutils.Vector
UPRIGHT = Matrix.Rotation(math.pi / 2, 4, "X")
"""Turns what lies on the ground so that it stands and faces -y."""


@dataclass
class Kit:
    """What is needed to build: materials, chance, and the mesh that everything goes to."""

    looks: Looks
    chance: random.Random
    mesh: MeshBuilder = field(default_factory=MeshBuilder)


def at(x: float, y: float, z: float = 0.0, turn: float = 0.0) -> Matrix:
    """Return a place: a spot, turned about the vertical by degrees."""
    return Matrix.Translation((x, y, z)) @ Matrix.Rotation(math.radians(turn), 4, "Z")


def corrugated(
    kit: Kit, place: Matrix, width: float, length: float, look: str, wave: float = 0.1
) -> None:
    """Add a corrugated sheet in the place's xy plane, from its origin; ridges run along y."""
    steps = max(4, round(width / wave * 6))
    points = []
    for step in range(steps + 1):
        x = width * step / steps
        z = 0.017 * math.sin(2 * math.pi * x / wave)
        points += [(x, 0, z), (x, length, z)]
    quads = [(2 * s, 2 * s + 2, 2 * s + 3, 2 * s + 1) for s in range(steps)]
    kit.mesh.place = place
    kit.mesh.faces(points, quads, kit.looks[look], smooth=True)


def barrel(kit: Kit, place: Matrix, look: str) -> None:
    """Add an oil drum with ribs."""
    kit.mesh.place = place
    profile = [(0, 0.28), (0.02, 0.29), (0.28, 0.28), (0.3, 0.3), (0.32, 0.28)]
    profile += [(0.56, 0.28), (0.58, 0.3), (0.6, 0.28), (0.86, 0.29), (0.88, 0.29), (0.88, 0.25)]
    path, radii = [(0, 0, z) for z, _ in profile], [r for _, r in profile]
    path[-1] = (0, 0, 0.83)
    kit.mesh.tube(path[:-1], radii[:-1], kit.looks[look], 20)
    kit.mesh.tube([(0.1, 0, 0.87), (0.1, 0, 0.9)], 0.04, kit.looks["black"], 8)
    kit.mesh.box((0, -0.287, 0.44), (0.2, 0.02, 0.14), kit.looks["yellow"])


def crate(kit: Kit, place: Matrix, size: float = 0.45, look: str = "crate") -> None:
    """Add a slatted crate."""
    kit.mesh.place = place
    half = size / 2
    for side in (-1, 1):
        for row in range(4):
            z = (row + 0.5) * size * 0.8 / 4
            tall = size * 0.8 / 4 - 0.025
            kit.mesh.box((0, side * half, z), (size, 0.02, tall), kit.looks[look])
            kit.mesh.box((side * half, 0, z), (0.02, size, tall), kit.looks[look])
        for end in (-1, 1):
            spot = (side * (half - 0.02), end * (half - 0.02), size * 0.4)
            kit.mesh.box(spot, (0.05, 0.05, size * 0.8), kit.looks["beam"])
    kit.mesh.box((0, 0, 0.03), (size, size, 0.02), kit.looks["beam"])
    goods = kit.looks[kit.chance.choice(("orange", "red", "green", "yellow", "white"))]
    for _ in range(12):
        x, y = (kit.chance.uniform(-0.35, 0.35) * size for _ in range(2))
        kit.mesh.ball((x, y, size * 0.75), 0.16 * size, goods, (8, 6))


def tyre(kit: Kit, place: Matrix, radius: float = 0.3) -> None:
    """Add a tyre, lying."""
    kit.mesh.place = place
    sides, ring = 18, 8
    points = []
    for side in range(sides):
        angle = 2 * math.pi * side / sides
        for part in range(ring):
            turn = 2 * math.pi * part / ring
            away = radius * (0.72 + 0.27 * math.cos(turn))
            z = 0.09 + 0.09 * math.sin(turn)
            points.append((away * math.cos(angle), away * math.sin(angle), z))
    quads = []
    for side in range(sides):
        for part in range(ring):
            one, two = side * ring, (side + 1) % sides * ring
            after = (part + 1) % ring
            quads.append((one + part, two + part, two + after, one + after))
    kit.mesh.faces(points, quads, kit.looks["rubber"], smooth=True)


def bucket(kit: Kit, place: Matrix, look: str, size: float = 0.3) -> None:
    """Add a plastic bucket or a flower pot with a plant in it."""
    kit.mesh.place = place
    path = [(0, 0, 0), (0, 0, size * 0.92), (0, 0, size)]
    radii = [0.36 * size, 0.5 * size, 0.54 * size]
    kit.mesh.tube(path, radii, kit.looks[look], 14)
    if kit.chance.random() < 0.5:
        return
    for _ in range(26):
        turn, rise = kit.chance.uniform(0, 6.28), kit.chance.uniform(0.3, 1.1)
        out = Vector((math.cos(turn), math.sin(turn), 0))
        tip = out * kit.chance.uniform(0.15, 0.32) + Vector((0, 0, size + 0.4 * rise))
        wide = Vector((-out.y, out.x, 0)) * 0.035
        middle = tip * 0.55 + Vector((0, 0, 0.5 * size))
        points = [(0, 0, size), middle - wide, tip, middle + wide]
        kit.mesh.faces(points, [(0, 1, 2, 3)], kit.looks["green"])


def bin_bags(kit: Kit, place: Matrix) -> None:
    """Add a dustbin with a lid and two bags beside it."""
    kit.mesh.place = place
    kit.mesh.tube([(0, 0, 0), (0, 0, 0.6)], (0.2, 0.25), kit.looks["zinc"], 16)
    kit.mesh.tube([(0, 0, 0.6), (0, 0, 0.63), (0, 0, 0.7)], (0.28, 0.27, 0.05), kit.looks["zinc"])
    for x, y, size in ((0.38, 0.05, 0.2), (-0.05, -0.33, 0.17)):
        kit.mesh.ball((x, y, 0.75 * size), size, kit.looks["black"], (9, 6))
        kit.mesh.tube([(x, y, 1.4 * size), (x, y, 2.1 * size)], (0.03, 0.07), kit.looks["black"], 7)


def air_conditioner(kit: Kit, place: Matrix) -> None:
    """Add a unit on a wall that faces -y; its fan goes to the middle of the grille."""
    mesh, looks = kit.mesh, kit.looks
    mesh.place = place
    mesh.box((0, -0.2, 0.0), (0.78, 0.3, 0.52), looks["cream"])
    mesh.tube([(-0.12, -0.352, 0), (-0.12, -0.356, 0)], 0.21, looks["black"], 20)
    for radius in (0.09, 0.15, 0.21):
        ring = [
            (-0.12 + radius * math.cos(a / 8 * math.pi), -0.4, radius * math.sin(a / 8 * math.pi))
            for a in range(17)
        ]
        mesh.tube(ring, 0.006, looks["grey"], 4)
    for row in range(7):
        mesh.box((0.26, -0.355, -0.18 + 0.06 * row), (0.18, 0.02, 0.025), looks["grey"])
    for x in (-0.3, 0.3):
        mesh.box((x, -0.18, -0.29), (0.04, 0.36, 0.05), looks["rust"])
    mesh.tube([(0.3, -0.1, -0.2), (0.42, -0.06, -0.3), (0.42, -0.06, -1.5)], 0.02, looks["white"])


def dish(kit: Kit, place: Matrix, size: float = 0.4) -> None:
    """Add a satellite dish that looks along -y and up, on a short arm."""
    tilt = place @ Matrix.Rotation(math.radians(62), 4, "X")
    kit.mesh.place = tilt
    path = [(0, 0, 0.25 * size * (r / 4) ** 2) for r in range(5)]
    kit.mesh.tube(path, [0.01 + size * r / 4 for r in range(5)], kit.looks["white"], 20)
    kit.mesh.tube([(0, -size, 0.2 * size), (0, 0, 1.1 * size)], 0.012, kit.looks["grey"], 5)
    kit.mesh.ball((0, 0, 1.1 * size), 0.05, kit.looks["grey"], (8, 6))
    kit.mesh.place = place
    kit.mesh.tube([(0, 0, 0), (0, 0.15, -0.05), (0, 0.2, -0.5)], 0.025, kit.looks["rust"], 6)


def water_tank(kit: Kit, place: Matrix) -> None:
    """Add a ribbed plastic tank on a frame."""
    kit.mesh.place = place
    profile = [(0.5, 0.5), (0.7, 0.5), (0.73, 0.53), (0.76, 0.5), (1.0, 0.5), (1.03, 0.53)]
    profile += [(1.06, 0.5), (1.35, 0.5), (1.5, 0.3), (1.53, 0.2), (1.6, 0.2)]
    kit.mesh.tube([(0, 0, z) for z, _ in profile], [r for _, r in profile], kit.looks["tank"], 20)
    for x in (-0.4, 0.4):
        for y in (-0.4, 0.4):
            kit.mesh.box((x, y, 0.25), (0.07, 0.07, 0.5), kit.looks["beam"])
    kit.mesh.box((0, 0, 0.47), (1.0, 1.0, 0.06), kit.looks["plank"])


def ladder(kit: Kit, foot: Sequence[float], top: Sequence[float], side: Sequence[float]) -> None:
    """Add a ladder from foot to top; `side` points along its rungs."""
    kit.mesh.place = Matrix.Identity(4)
    low, high, half = Vector(foot), Vector(top), Vector(side) * 0.2
    for sign in (-1, 1):
        kit.mesh.tube([low + half * sign, high + half * sign], 0.025, kit.looks["crate"], 6)
    count = int((high - low).length / 0.28)
    for rung in range(1, count + 1):
        spot = low.lerp(high, rung / (count + 1))
        kit.mesh.tube([spot - half, spot + half], 0.017, kit.looks["crate"], 6)


def cable(kit: Kit, start: Sequence[float], end: Sequence[float], sag: float, thick: float) -> None:
    """Add a cable that hangs between two points."""
    kit.mesh.place = Matrix.Identity(4)
    first, second = Vector(start), Vector(end)
    count = max(6, int((second - first).length * 3))
    path = []
    for step in range(count + 1):
        share = step / count
        path.append(first.lerp(second, share) - Vector((0, 0, 4 * sag * share * (1 - share))))
    kit.mesh.tube(path, thick, kit.looks["cable"], 4)


def sign(
    kit: Kit, place: Matrix, text: str, size: tuple[float, float], colours: tuple[str, str]
) -> None:
    """Add a painted board that faces -y with lettering, centred on the place."""
    wide, high = size
    kit.mesh.place = place
    kit.mesh.box((0, 0, 0), (wide, 0.03, high), kit.looks[colours[0]])
    for z in (-0.46, 0.46):
        kit.mesh.box((0, -0.018, z * high), (wide, 0.012, 0.03), kit.looks[colours[1]])
    letters = 1.45 * min(0.62 * high, wide / (0.92 * max(len(text), 1)))
    where = place @ Matrix.Translation((0, -0.03, 0)) @ UPRIGHT
    made = lettering(text, where, letters, kit.looks[colours[1]])
    made.data.extrude = 0.006


def poster(kit: Kit, place: Matrix, wide: float, text: str) -> None:
    """Add a printed poster: a coloured sheet, a disc or bars as its picture, and a headline."""
    high = 1.4 * wide
    first, second, third = kit.chance.sample(
        ("red", "yellow", "white", "teal", "black", "pink", "orange", "blue", "cream"), 3
    )
    kit.mesh.place = place
    kit.mesh.box((0, -0.004, 0), (wide, 0.006, high), kit.looks[first])
    if kit.chance.random() < 0.5:
        disc = [(0, -0.007, -0.1 * high), (0, -0.011, -0.1 * high)]
        kit.mesh.tube(disc, 0.32 * wide, kit.looks[second], 20)
        kit.mesh.tube([(0, -0.011, 0), (0, -0.014, 0)], 0.16 * wide, kit.looks[third], 16)
    else:
        for row in range(4):
            long = wide * kit.chance.uniform(0.4, 0.85)
            spot = (0, -0.009, high * (0.1 - 0.13 * row))
            kit.mesh.box(spot, (long, 0.006, 0.06 * high), kit.looks[second])
    where = place @ Matrix.Translation((0, -0.012, 0.36 * high)) @ UPRIGHT
    made = lettering(text, where, 1.35 * wide / len(text), kit.looks[third])
    made.data.extrude = 0.002


def railing(kit: Kit, place: Matrix, width: float, look: str = "rust") -> None:
    """Add a balustrade along the place's x axis."""
    kit.mesh.place = place
    for z in (0.08, 0.85):
        kit.mesh.box((width / 2, 0, z), (width, 0.035, 0.035), kit.looks[look])
    for post in range(int(width / 0.13) + 1):
        kit.mesh.box((0.02 + post * 0.13, 0, 0.45), (0.018, 0.018, 0.82), kit.looks[look])


def puddle(kit: Kit, x: float, y: float, wide: float, long: float) -> None:
    """Add a puddle of uneven outline."""
    kit.mesh.place = Matrix.Identity(4)
    phase = kit.chance.uniform(0, 6.28)
    points = []
    for step in range(28):
        turn = 2 * math.pi * step / 28
        away = 1 + 0.22 * math.sin(3 * turn + phase) + 0.12 * math.sin(5 * turn + 2 * phase)
        points.append((x + wide * away * math.cos(turn), y + long * away * math.sin(turn), 0.004))
    kit.mesh.faces(points, [tuple(range(28))], kit.looks["puddle"])
