"""What stands in the laboratory: benches, cabinets, shelves of bottles, screens, instruments."""

from __future__ import annotations

import math
import random
from dataclasses import dataclass

from lab_room import FAR, LEFT, RIGHT, Looks, sign, upright
from stage.blender import bpy, mathutils
from stage.meshes import MeshBuilder

Matrix, Vector = mathutils.Matrix, mathutils.Vector

TOP = 0.92
"""Height of the benches."""

CELL = (2.1, 6.6, 0.76)
"""Middle and height of the table of the robot arm."""

GLASSES = ("amber", "bottle", "cobalt", "ruby", "milk", "lime", "amber", "milk")


@dataclass(frozen=True)
class Bench:
    """A bench from one corner to the other; `rack` is the x of its row of shelves."""

    low: tuple[float, float]
    top: tuple[float, float]
    rack: float | None = None


BENCHES = (
    Bench((-2.2, 0.2), (-1.15, 5.4), -1.95),
    Bench((1.15, -0.4), (2.2, 4.3), 1.95),
    Bench((-3.4, 7.0), (-2.5, 10.6), -3.2),
    Bench((LEFT + 0.02, -1.5), (LEFT + 0.66, 9.6)),
    Bench((RIGHT - 0.66, -1.0), (RIGHT - 0.02, 10.9)),
)


def build(looks: Looks, chance: random.Random) -> None:
    """Build the furniture and everything on it that stands still."""
    benches, things = MeshBuilder(), MeshBuilder()
    for bench in BENCHES:
        _bench(benches, bench, looks)
        if bench.rack is not None:
            _rack(things, bench, looks, chance)
    benches.object("benches")
    _wall_shelves(things, looks, chance)
    _clutter(things, looks, chance)
    for x, y in ((-0.85, 4.6), (-0.8, 6.0), (0.84, 3.3), (-2.1, 8.2), (3.2, 4.6), (3.3, 8.6)):
        _stool(things, (x, y), looks)
    _cell(things, looks)
    _servers(things, looks, chance)
    things.object("things")
    _whiteboard(looks, chance)
    _screens(looks)


def bottle(
    mesh: MeshBuilder,
    where: tuple[float, float, float],
    size: float,
    glass: bpy.types.Material,
    cap: bpy.types.Material,
    flask: bool = False,
) -> None:
    """Add a bottle or a conical flask that stands at a spot; size is its height."""
    x, y, z = where
    if flask:
        profile = ((0.0, 0.36), (0.06, 0.38), (0.62, 0.1), (0.9, 0.1))
    else:
        profile = ((0.0, 0.26), (0.03, 0.28), (0.58, 0.28), (0.74, 0.1), (0.88, 0.1))
    rings = [(x, y, z + size * high) for high, _ in profile]
    mesh.tube(rings, [size * wide for _, wide in profile], glass, 12)
    top = z + size * profile[-1][0]
    mesh.tube([(x, y, top - 0.02 * size), (x, y, z + size)], 0.13 * size, cap, 10)
    if not flask:
        label = [(x, y, z + size * high) for high in (0.18, 0.46)]
        mesh.tube(label, 0.288 * size, cap, 12)


def _bench(mesh: MeshBuilder, bench: Bench, looks: Looks) -> None:
    """Add cabinets with doors and handles on both long sides, and a steel top."""
    (left, near), (right, far) = bench.low, bench.top
    x, y, wide, long = (left + right) / 2, (near + far) / 2, right - left, far - near
    mesh.box((x, y, 0.05), (wide - 0.16, long - 0.1, 0.1), looks["dark"])
    mesh.box((x, y, 0.47), (wide - 0.08, long - 0.06, 0.76), looks["grey"])
    mesh.box((x, y, TOP - 0.03), (wide, long, 0.06), looks["steel"])
    doors = max(2, round(long / 0.62))
    for side, edge in ((-1, left), (1, right)):
        for door in range(doors):
            middle = near + long * (door + 0.5) / doors
            width = long / doors - 0.03
            face = edge - side * 0.03
            look = looks["orange" if door % 5 == 3 else "white"]
            mesh.box((face, middle, 0.37), (0.03, width, 0.5), look)
            mesh.box((face, middle, 0.74), (0.03, width, 0.19), looks["white"])
            for z in (0.56, 0.76):
                mesh.box((face + side * 0.03, middle, z), (0.03, 0.2, 0.02), looks["chrome"])
    for drawer in range(2):
        width = wide / 2 - 0.06
        middle = left + wide * (drawer + 0.5) / 2
        mesh.box((middle, near + 0.03, 0.47), (width, 0.05, 0.7), looks["white"])
        mesh.box((middle, near - 0.01, 0.7), (0.24, 0.03, 0.025), looks["chrome"])


def _rack(mesh: MeshBuilder, bench: Bench, looks: Looks, chance: random.Random) -> None:
    """Add two shelves above the bench, full of bottles."""
    near, far = bench.low[1] + 0.9, bench.top[1] - 0.5
    for z in (1.24, 1.56):
        mesh.box((bench.rack, (near + far) / 2, z), (0.26, far - near, 0.025), looks["white"])
        mesh.box((bench.rack, (near + far) / 2, z - 0.03), (0.05, far - near, 0.03), looks["grey"])
        row(mesh, (bench.rack, near, z + 0.013), far - near, looks, chance)
    for y in (near + 0.02, (near + far) / 2, far - 0.02):
        mesh.box((bench.rack, y, 1.3), (0.05, 0.05, 0.8), looks["steel"])


def row(
    mesh: MeshBuilder,
    start: tuple[float, float, float],
    long: float,
    looks: Looks,
    chance: random.Random,
) -> None:
    """Add a row of bottles, flasks and boxes along y."""
    x, y, z = start
    end = y + long - 0.1
    y += 0.12
    while y < end:
        size = chance.uniform(0.14, 0.27)
        where = (x + chance.uniform(-0.04, 0.04), y, z)
        if chance.random() < 0.14:
            look = looks[chance.choice(("orange", "teal", "white", "blue", "yellow"))]
            mesh.box((x, y + 0.05, z + 0.09), (0.16, 0.2, 0.18), look)
            y += 0.24
            continue
        glass = looks[chance.choice(GLASSES)]
        cap = looks[chance.choice(("white", "dark", "white", "red"))]
        bottle(mesh, where, size, glass, cap, chance.random() < 0.3)
        y += 0.65 * size + chance.uniform(0.02, 0.09)


def _wall_shelves(mesh: MeshBuilder, looks: Looks, chance: random.Random) -> None:
    x = LEFT + 0.18
    for z in (1.25, 1.62, 1.99, 2.36):
        mesh.box((x, 7.4, z), (0.32, 4.6, 0.03), looks["steel"])
        row(mesh, (x, 5.1, z + 0.015), 4.6, looks, chance)
    for y in (5.1, 6.6, 8.2, 9.7):
        mesh.box((x, y, 1.8), (0.32, 0.04, 1.2), looks["white"])


def _clutter(mesh: MeshBuilder, looks: Looks, chance: random.Random) -> None:
    """Add instruments, racks of tubes, boxes and papers on the benches."""
    for x, y in ((-1.5, 1.6), (-1.45, 4.9), (1.5, 0.9), (1.55, 3.9), (4.05, 5.2)):
        _tubes(mesh, (x, y), looks, chance)
    for x, y in ((-1.45, 4.05), (1.45, 2.3), (-2.85, 7.5)):
        _microscope(mesh, (x, y), looks)
    for x, y in ((-1.4, 2.85), (-1.35, 4.5), (1.4, 3.1), (1.6, 3.5), (-4.0, 4.4), (4.05, 6.2)):
        glass, cap = looks[chance.choice(GLASSES)], looks["dark"]
        bottle(mesh, (x, y, TOP), chance.uniform(0.2, 0.3), glass, cap, chance.random() < 0.6)
    for number in range(14):
        side = number % 2
        x = LEFT + 0.33 if side else RIGHT - 0.33
        y = 0.4 + 0.68 * number
        high = chance.uniform(0.12, 0.42)
        look = looks[chance.choice(("white", "grey", "white", "teal", "dark"))]
        mesh.box((x, y, TOP + high / 2), (0.4, chance.uniform(0.3, 0.52), high), look)
        face = x + (0.205 if side else -0.205)
        lit = looks[chance.choice(("cyan", "green", "ember"))]
        mesh.box((face, y, TOP + 0.7 * high), (0.01, 0.1, 0.035), lit)
    for _ in range(16):
        place = Matrix.Translation((chance.choice((-1.4, 1.4)), chance.uniform(0.4, 4.2), TOP))
        mesh.place = place @ Matrix.Rotation(chance.uniform(-0.6, 0.6), 4, "Z")
        mesh.box((0, 0, 0.004), (0.2, 0.28, 0.006), looks["board"])
        for line in range(5):
            width = chance.uniform(0.08, 0.15)
            mesh.box((0, 0.1 - 0.045 * line, 0.008), (width, 0.012, 0.002), looks["dark"])
    mesh.place = Matrix.Identity(4)


def _tubes(
    mesh: MeshBuilder, spot: tuple[float, float], looks: Looks, chance: random.Random
) -> None:
    x, y = spot
    for z in (0.02, 0.1):
        mesh.box((x, y, TOP + z), (0.14, 0.36, 0.016), looks["orange"])
    for end in (-0.17, 0.17):
        mesh.box((x, y + end, TOP + 0.06), (0.14, 0.016, 0.12), looks["orange"])
    for number in range(14):
        where = Vector((x - 0.03 + 0.06 * (number % 2), y - 0.14 + 0.047 * (number // 2), TOP))
        glass = looks[chance.choice(GLASSES)]
        mesh.tube([where + Vector((0, 0, 0.02)), where + Vector((0, 0, 0.14))], 0.017, glass, 8)
        mesh.tube([where + Vector((0, 0, 0.14)), where + Vector((0, 0, 0.17))], 0.019, looks["red"])


def _microscope(mesh: MeshBuilder, spot: tuple[float, float], looks: Looks) -> None:
    mesh.place = Matrix.Translation((*spot, TOP)) @ Matrix.Rotation(0.7, 4, "Z")
    mesh.box((0, 0, 0.02), (0.2, 0.3, 0.04), looks["white"])
    mesh.box((0, 0.11, 0.18), (0.08, 0.07, 0.32), looks["white"])
    mesh.box((0, 0.0, 0.14), (0.16, 0.16, 0.015), looks["dark"])
    mesh.box((0, 0.02, 0.33), (0.1, 0.24, 0.07), looks["white"])
    mesh.tube([(0, -0.04, 0.3), (0, -0.04, 0.18)], (0.03, 0.014), looks["chrome"])
    mesh.tube([(0, -0.06, 0.34), (0, -0.18, 0.45)], 0.024, looks["dark"])
    mesh.place = Matrix.Identity(4)


def _stool(mesh: MeshBuilder, spot: tuple[float, float], looks: Looks) -> None:
    x, y = spot
    mesh.tube([(x, y, 0.62), (x, y, 0.64), (x, y, 0.69)], (0.17, 0.19, 0.18), looks["teal"], 20)
    mesh.tube([(x, y, 0.1), (x, y, 0.62)], 0.025, looks["chrome"], 10)
    for foot in range(5):
        angle = 2 * math.pi * foot / 5
        end = (x + 0.24 * math.cos(angle), y + 0.24 * math.sin(angle), 0.04)
        mesh.tube([(x, y, 0.13), end], 0.018, looks["chrome"], 6)
        mesh.ball(end, 0.035, looks["dark"], (8, 6))


def _cell(mesh: MeshBuilder, looks: Looks) -> None:
    """Add the robot arm's table with a striped edge, coloured bins and low guard rails."""
    x, y, top = CELL
    mesh.box((x, y, top - 0.03), (1.9, 1.9, 0.06), looks["steel"])
    mesh.box((x, y, top - 0.1), (1.84, 1.84, 0.1), looks["hazard"])
    mesh.box((x, y, 0.34), (1.5, 1.5, 0.64), looks["dark"])
    for side in (-0.86, 0.86):
        for end in (-0.86, 0.86):
            mesh.box((x + side, y + end, top / 2), (0.09, 0.09, top), looks["yellow"])
    for number, look in enumerate(("blue", "leaf", "red")):
        middle = (x + 0.1 + 0.34 * number, y - 0.72)
        for dx, dy, size in ((0, -0.1, (0.3, 0.02)), (0, 0.1, (0.3, 0.02))):
            where = (middle[0] + dx, middle[1] + dy, top + 0.06)
            mesh.box(where, (*size, 0.12), looks[look])
        for dx in (-0.15, 0.15):
            mesh.box((middle[0] + dx, middle[1], top + 0.06), (0.02, 0.22, 0.12), looks[look])
    for number in range(3):
        spot = (x - 0.72, y - 0.72 + 0.16 * number, top)
        bottle(mesh, spot, 0.17, looks[("lime", "ruby", "cobalt")[number]], looks["white"])
    mesh.tube([(x + 0.2, y + 0.2, top), (x + 0.2, y + 0.2, top + 0.1)], 0.2, looks["dark"], 20)


def _servers(mesh: MeshBuilder, looks: Looks, chance: random.Random) -> None:
    """Add cabinets of computers at the far wall, with rows of small lights."""
    for number in range(3):
        x = 1.75 + 0.72 * number
        mesh.box((x, FAR - 0.42, 0.78), (0.68, 0.8, 1.5), looks["dark"])
        for unit in range(9):
            z = 0.16 + 0.155 * unit
            mesh.box((x, FAR - 0.83, z), (0.58, 0.03, 0.12), looks["grey"])
            for light in range(7):
                if chance.random() < 0.4:
                    look = looks[chance.choice(("cyan", "green", "green", "ember", "window"))]
                    where = (x - 0.24 + 0.055 * light, FAR - 0.85, z)
                    mesh.box(where, (0.024, 0.01, 0.024), look)


def _whiteboard(looks: Looks, chance: random.Random) -> None:
    """Add the board with formulas, boxes and a curve on the left wall."""
    mesh = MeshBuilder()
    face, y, z = LEFT + 0.05, 3.2, 1.75
    mesh.box((LEFT + 0.02, y, z), (0.04, 2.9, 1.15), looks["board"])
    for end in (-1.45, 1.45):
        mesh.box((face, y + end, z), (0.05, 0.05, 1.2), looks["steel"])
    for level in (-0.58, 0.58):
        mesh.box((face, y, z + level), (0.05, 2.95, 0.05), looks["steel"])
    for start, look in ((2.0, "red"), (3.15, "blue"), (3.2, "leaf")):
        path = [
            (face, start + 0.06 * n, z - 0.3 + 0.14 * math.sin(0.5 * n + start) + 0.012 * n)
            for n in range(18)
        ]
        mesh.tube(path, 0.011, looks[look], 5)
    for middle in (2.2, 2.75):
        corners = [(face, middle + dy, z + dz) for dy, dz in ((-0.2, 0.0), (0.2, 0.02))]
        corners += [(face, middle + 0.19, z + 0.26), (face, middle - 0.2, z + 0.24)]
        mesh.tube([*corners, corners[0]], 0.009, looks["dark"], 5)
    mesh.object("whiteboard")
    lines = ("x' = Ax + Bu", "F = m a + k v", "J(q) dq = v", "TODO: calibrate!")
    for number, text in enumerate(lines):
        look = looks[("dark", "blue", "dark", "red")[number]]
        where = (face - 0.005, 3.85 + chance.uniform(-0.08, 0.08), z + 0.42 - 0.19 * number)
        place = upright(where, math.pi / 2) @ Matrix.Rotation(chance.uniform(-0.05, 0.05), 4, "Z")
        sign(text, place, 0.17, look)


def _screens(looks: Looks) -> None:
    """Add monitors on the benches and large ones on the far wall and over the right counter."""
    for x, y, z, turn, wide, look in (
        (-1.55, 3.35, TOP + 0.36, 0.15, 0.62, "screen2"),
        (1.55, 3.0, TOP + 0.36, -0.62, 0.66, "screen"),
        (1.55, 1.6, TOP + 0.36, -0.7, 0.6, "screen3"),
        (-2.8, 8.6, TOP + 0.36, 0.5, 0.66, "screen"),
        (-2.8, 9.6, TOP + 0.36, 0.45, 0.66, "screen3"),
        (3.45, 7.6, TOP + 0.5, -0.75, 0.9, "screen2"),
        (3.6, 9.7, TOP + 0.5, -0.6, 0.9, "screen"),
        (-2.95, FAR - 0.06, 1.85, 0.0, 1.75, "screen"),
        (3.9, FAR - 0.1, 2.3, -0.25, 1.2, "screen3"),
    ):
        mesh = MeshBuilder()
        mesh.box((0, 0.02, 0), (1.06, 0.06, 0.64), looks["dark"])
        mesh.box((0, -0.012, 0), (1.0, 0.006, 0.58), looks[look])
        if wide < 1.0:
            mesh.box((0, 0.05, -0.4), (0.1, 0.05, 0.4), looks["grey"])
            mesh.box((0, 0.03, -0.3 / wide), (0.4, 0.3, 0.03), looks["grey"])
        made = mesh.object("monitor")
        made.matrix_world = Matrix.Translation((x, y, z)) @ Matrix.Rotation(turn, 4, "Z")
        made.matrix_world @= Matrix.Scale(wide, 4)
