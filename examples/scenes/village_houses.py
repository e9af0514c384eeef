"""The buildings of the village scene: cottages, inn, church and windmill tower."""

from __future__ import annotations

import itertools
import math
import random
from dataclasses import dataclass

from stage.blender import bpy, mathutils
from stage.meshes import MeshBuilder
from village_land import height

Matrix, Vector = mathutils.Matrix, mathutils.Vector
Materials = dict[str, bpy.types.Material]


@dataclass(frozen=True)
class House:
    """A house: place and turn in degrees, width, depth and height of eaves, and looks.

    At a turn of 0 its front faces -y; the ridge runs along its width.
    """

    spot: tuple[float, float]
    turn: float
    size: tuple[float, float, float]
    roof: str
    wall: str
    paint: str
    chimney: float = 0.35

    @property
    def ridge(self) -> float:
        """Height of the ridge."""
        steep = 1.12 if self.roof == "thatch" else 0.98
        return self.size[2] + steep * self.size[1] / 2


HOUSES = (
    House((-11.8, 4.4), 8, (8.2, 5.6, 3.0), "thatch", "cream", "green"),
    House((-22.5, 7.5), 24, (7.6, 5.2, 3.0), "tile", "stone", "blue", -0.3),
    House((-13.5, 16.5), -5, (7.4, 5.4, 3.4), "tile", "ochre", "red"),
    House((-27.0, 20.0), 12, (8.0, 5.6, 2.9), "thatch", "chalk", "blue"),
    House((3.2, 4.8), -5, (9.2, 6.0, 5.4), "tile", "chalk", "green", -0.38),
    House((15.8, 3.0), -14, (8.2, 5.4, 2.8), "thatch", "stone", "red", -0.36),
    House((16.4, 14.0), -9, (7.6, 5.4, 3.3), "tile", "blush", "teal"),
    House((2.4, 17.5), 5, (8.0, 5.6, 3.6), "slate", "stone", "blue"),
    House((25.5, 8.5), -26, (7.4, 5.4, 3.1), "tile", "cream", "green"),
    House((-1.0, 30.0), 3, (8.0, 5.6, 3.0), "thatch", "cream", "red"),
    House((16.5, 27.0), -10, (7.8, 5.4, 3.4), "slate", "chalk", "green", -0.3),
    House((-21.0, 32.0), 12, (8.0, 5.4, 3.2), "tile", "blush", "blue"),
    House((29.0, 25.0), -22, (8.2, 5.4, 2.9), "thatch", "stone", "green"),
    House((-36.0, 12.0), 30, (8.2, 5.4, 3.1), "tile", "cream", "red"),
)
INN = HOUSES[4]


def built(house: House) -> Matrix:
    """Return where a house stands."""
    place = Matrix.Translation((*house.spot, float(height(*house.spot))))
    return place @ Matrix.Rotation(math.radians(house.turn), 4, "Z")


def cottage(house: House, looks: Materials, chance: random.Random) -> None:
    """Add one house with all that is fixed to it."""
    mesh = MeshBuilder()
    wide, deep, high = house.size
    wall = looks[house.wall]
    mesh.box((0, 0, high / 2 - 0.3), (wide, deep, high + 0.6), wall)
    for side in (-1, 1):
        x = side * wide / 2
        gable = [(x, -deep / 2, high), (x, deep / 2, high), (x, 0, house.ridge)]
        mesh.faces(gable, [(0, 1, 2)], wall)
    mesh.box((0, 0, 0), (wide + 0.16, deep + 0.16, 1.0), looks["stone"])
    if house.roof == "thatch":
        _thatch(mesh, house, looks, chance)
    else:
        _tiles(mesh, house, looks, chance)
    if house.wall != "stone":
        _timber(mesh, house, looks)
    _openings(mesh, house, looks, chance)
    _chimney(mesh, house, looks, chance)
    if house.size[2] > 4.5 or chance.random() < 0.6:
        _ivy(mesh, house, looks, chance)
    mesh.object("house").matrix_world = built(house)


def _tiles(mesh: MeshBuilder, house: House, looks: Materials, chance: random.Random) -> None:
    """Cover a roof with single tiles, on a ridge that sags a little."""
    wide, deep, high = house.size
    half, over = wide / 2 + 0.3, 0.35
    top, low = house.ridge + 0.05, high - over * 0.95
    kinds = [looks[f"{house.roof}{number}"] for number in (1, 1, 2, 2, 3, 4, 5)]
    rows = round((top - low) * 1.43 / 0.32)
    columns = round(2 * half / 0.29)

    def place(x: float, share: float, side: int, lift: float) -> tuple[float, float, float]:
        sag = 0.13 * share * (1 - (x / half) ** 2)
        y = side * (deep / 2 + over) * (1 - share)
        return x, y + side * 0.7 * lift, low + (top - low) * share - sag + 0.7 * lift

    for side in (-1, 1):
        for row in range(rows):
            shares = (row / rows, min(1.0, (row + 1.2) / rows))
            shift = 0.5 * (row % 2)
            for column in range(columns):
                left, right = ((column + shift + d) / columns * 2 * half - half for d in (0, 0.96))
                lift = chance.uniform(0.07, 0.11)
                tile = [
                    place(left, shares[0], side, lift),
                    place(right, shares[0], side, lift),
                    place(right, shares[1], side, 0.03),
                    place(left, shares[1], side, 0.03),
                    place(left, shares[0], side, 0.0),
                    place(right, shares[0], side, 0.0),
                ]
                mesh.faces(tile, [(0, 1, 2, 3), (4, 5, 1, 0)], [chance.choice(kinds)] * 2)
        base = [place(x, s, side, 0.0) for x, s in ((-half, 0), (half, 0), (half, 1), (-half, 1))]
        mesh.faces(base, [(0, 1, 2, 3)], looks["beam"])
        for x in (-half, half):
            ends = [place(x, share, side, 0.03) for share in (0, 1)]
            mesh.tube(ends, 0.11, looks["beam"], 6)
    for step in range(columns // 2):
        left, right = ((step + d) / (columns // 2) * 2 * half - half for d in (0, 1.05))
        ends = [(x, 0, place(x, 1, 1, 0)[2] + 0.05) for x in (left, right)]
        mesh.tube(ends, (0.14, 0.17), chance.choice(kinds), 8)


def _thatch(mesh: MeshBuilder, house: House, looks: Materials, chance: random.Random) -> None:
    """Cover a roof with a thick, rounded coat of straw, with single straws and a cut ridge."""
    wide, deep, high = house.size
    half, over = wide / 2 + 0.35, 0.55
    top, low = house.ridge, high - over * 1.12
    profile = ((0.05, 0.0), (0.0, 0.08), (-0.02, 0.26), (0.05, 0.42), (0.3, 0.5), (0.6, 0.5))
    profile = (*profile, (0.85, 0.46), (1.0, 0.34))

    def place(x: float, share: float, lift: float, side: int) -> tuple[float, float, float]:
        sag = 0.16 * share * (1 - (x / half) ** 2)
        hip = 0.5 * max(0.0, abs(x) / half - 0.82) * share
        brow = 0.32 * (1 - share) * math.exp(-(((abs(x) - wide / 4) / 0.9) ** 2)) * (side < 0)
        y = side * (deep / 2 + over) * (1 - share) + side * lift * 0.72
        return x, y if share < 1 else 0.0, low + (top - low) * share - sag - hip + brow + lift * 0.7

    xs = [-half + 2 * half * step / 24 for step in range(25)]
    for side in (-1, 1):
        points = [place(x, s, lift, side) for s, lift in profile for x in xs]
        strips = [
            (r * 25 + c, r * 25 + c + 1, r * 25 + c + 26, r * 25 + c + 25)
            for r in range(len(profile) - 1)
            for c in range(24)
        ]
        mesh.faces(points, strips, looks["thatch"], smooth=True)
        for x in (xs[0], xs[-1]):
            end = [place(x, s, lift, side) for s, lift in profile] + [place(x, 1.0, 0.0, side)]
            mesh.faces(end, [tuple(range(len(end)))], looks["hay"])
        for _ in range(1100):
            x, s = chance.uniform(-half, half), chance.uniform(0.0, 0.97)
            span = chance.uniform(0.05, 0.12)
            lean = chance.gauss(0, 0.06)
            straw = [
                place(x, s, 0.53, side),
                place(x + 0.06, s, 0.53, side),
                place(x + 0.03 + lean, s + span, 0.51 if s < 0.75 else 0.49, side),
            ]
            kind = looks[chance.choice(("straw", "straw dark", "straw pale", "straw dark"))]
            mesh.faces(straw, [(0, 1, 2)], kind)
        for step in range(14):
            left, right = (-half + 2 * half * (step + d) / 14 for d in (0, 1))
            cap = [place(left, 0.84, 0.54, side), place((left + right) / 2, 0.72, 0.56, side)]
            cap += [place(right, 0.84, 0.54, side), place(right, 0.999, 0.44, side)]
            cap += [place(left, 0.999, 0.44, side)]
            mesh.faces(cap, [(0, 1, 2, 3, 4)], looks["straw dark" if step % 2 else "hay"])


def _timber(mesh: MeshBuilder, house: House, looks: Materials) -> None:
    """Add posts, rails and braces on the front and the gables."""
    wide, deep, high = house.size
    beam = looks["beam"]
    bays = max(3, round(wide / 1.5))
    levels = [0.55, high / 2 + 0.3, high - 0.1] if high > 4.5 else [0.55, 1.85, high - 0.1]
    for side in (-1, 1):
        for z in levels:
            mesh.box((0, side * deep / 2, z), (wide + 0.1, 0.12, 0.18), beam)
            mesh.box((side * wide / 2, 0, z), (0.12, deep + 0.1, 0.18), beam)
        for bay in range(bays + 1):
            x = -wide / 2 + wide * bay / bays
            mesh.box((x, side * deep / 2, high / 2 + 0.25), (0.17, 0.13, high - 0.6), beam)
        for bay in range(5):
            y = -deep / 2 + deep * bay / 4
            tall = high + (house.ridge - high) * (1 - abs(y) / (deep / 2)) * 0.9
            mesh.box((side * wide / 2, y, tall / 2 + 0.25), (0.13, 0.16, tall - 0.6), beam)
        for x, lean in ((-wide / 2 + 0.75, -1), (wide / 2 - 0.75, 1)):
            for low, tall in itertools.pairwise(levels):
                foot, head = x - lean * 0.55, x + lean * 0.55
                y = side * (deep / 2 + 0.045)
                brace = [(foot - 0.08, y, low), (foot + 0.08, y, low)]
                brace += [(head + 0.08, y, tall), (head - 0.08, y, tall)]
                mesh.faces(brace, [(0, 1, 2, 3)], beam)


def _openings(mesh: MeshBuilder, house: House, looks: Materials, chance: random.Random) -> None:
    wide, deep, high = house.size
    front = mesh.place @ Matrix.Translation((0, -deep / 2, 0))
    mesh.place = front
    bays = max(3, round(wide / 1.9))
    door = chance.randrange(1, bays - 1)
    for bay in range(bays):
        x = -wide / 2 + wide * (bay + 0.5) / bays
        if bay == door:
            _door(mesh, x, house, looks)
        else:
            _window(mesh, (x, 1.62), house.paint, looks, chance)
        if high > 4.5:
            _window(mesh, (x, 4.15), house.paint, looks, chance)
    for side in (-1, 1):
        turn = Matrix.Rotation(side * math.pi / 2, 4, "Z")
        mesh.place = turn @ Matrix.Translation((0, -wide / 2, 0))
        for x in (-1.2, 1.2):
            _window(mesh, (x, 1.62), house.paint, looks, chance)
        _window(mesh, (0, high + 0.35), house.paint, looks, chance)
    mesh.place = Matrix.Identity(4)


def _door(mesh: MeshBuilder, x: float, house: House, looks: Materials) -> None:
    paint = looks[house.paint]
    mesh.box((x, -0.06, 1.3), (1.3, 0.2, 2.1), looks["pale" if house.wall == "stone" else "oak"])
    for plank in range(4):
        mesh.box((x - 0.36 + 0.24 * plank, -0.17, 1.25), (0.22, 0.05, 1.9), paint)
    for z in (0.7, 1.8):
        mesh.box((x, -0.2, z), (0.9, 0.03, 0.07), looks["iron"])
    mesh.ball((x + 0.34, -0.23, 1.25), 0.06, looks["brass"], (8, 6))
    mesh.box((x, -0.4, 0.18), (1.6, 0.8, 0.24), looks["block"])
    porch = [
        (x - 0.95, -0.9, 2.45),
        (x + 0.95, -0.9, 2.45),
        (x + 0.95, 0, 2.95),
        (x - 0.95, 0, 2.95),
    ]
    if house.roof != "thatch":
        mesh.faces(porch, [(0, 1, 2, 3)], looks[f"{house.roof}2"])
        for side in (-0.85, 0.85):
            mesh.tube([(x + side, -0.8, 2.5), (x + side, 0, 1.9)], 0.06, looks["beam"], 6)
    mesh.box((x - 0.95, -0.2, 2.1), (0.2, 0.24, 0.32), looks["lit"])
    mesh.box((x - 0.95, -0.2, 2.3), (0.26, 0.3, 0.08), looks["iron"])


def _window(
    mesh: MeshBuilder,
    spot: tuple[float, float],
    paint: str,
    looks: Materials,
    chance: random.Random,
) -> None:
    """Add a window with bars, shutters and a box of flowers, in the plane y = 0."""
    x, z = spot
    pane = looks["lit" if chance.random() < 0.12 else "glass"]
    mesh.box((x, -0.03, z), (0.98, 0.16, 1.1), looks["white"])
    mesh.box((x, -0.09, z), (0.82, 0.08, 0.94), pane)
    for bar in (-0.14, 0.14):
        mesh.box((x + bar, -0.135, z), (0.05, 0.03, 0.94), looks["white"])
    mesh.box((x, -0.135, z + 0.1), (0.82, 0.03, 0.05), looks["white"])
    for side in (-1, 1):
        mesh.box((x + side * 0.72, -0.08, z), (0.42, 0.07, 1.12), looks[paint])
        for slat in range(5):
            mesh.box(
                (x + side * 0.72, -0.12, z - 0.4 + 0.2 * slat), (0.34, 0.03, 0.07), looks[paint]
            )
    mesh.box((x, -0.26, z - 0.72), (1.2, 0.3, 0.22), looks["oak"])
    bloom = chance.choice(
        (("red", "white"), ("rose", "violet"), ("yellow", "red"), ("rose", "white"))
    )
    for number in range(34):
        at = Vector((x + chance.uniform(-0.6, 0.6), -0.28 + chance.gauss(0, 0.09), z - 0.55))
        at.z += chance.uniform(-0.16, 0.2)
        one, two = (Vector([chance.gauss(0, 0.07) for _ in range(3)]) for _ in range(2))
        kind = chance.choice(bloom) if number % 2 else chance.choice(("leaf1", "leaf2"))
        mesh.faces([at - one, at - two, at + one, at + two], [(0, 1, 2, 3)], looks[kind])


def _chimney(mesh: MeshBuilder, house: House, looks: Materials, chance: random.Random) -> None:
    x, top = house.chimney * house.size[0], house.ridge + 1.25
    mesh.box((x, 0.25, top / 2 + 1.2), (0.95, 0.8, top - 2.4), looks["stone"])
    mesh.box((x, 0.25, top), (1.12, 0.97, 0.16), looks["block"])
    for side in (-0.22, 0.22):
        ends = [(x + side, 0.25, top), (x + side, 0.25, top + 0.48 + chance.uniform(0, 0.15))]
        mesh.tube(ends, (0.15, 0.12), looks["clay"], 8)


def _ivy(mesh: MeshBuilder, house: House, looks: Materials, chance: random.Random) -> None:
    """Let a climber grow round a corner of the front, with some blossoms."""
    wide, deep, high = house.size
    side = chance.choice((-1, 1))
    bloom = chance.choice(("rose", "violet", "white"))
    for _ in range(900):
        z = high * chance.random() ** 0.8
        spread = 0.35 + 0.9 * (z / high) ** 2
        x = side * (wide / 2 - abs(chance.gauss(0, spread)))
        at = Vector((x, -deep / 2 - chance.uniform(0.08, 0.22), z))
        if chance.random() < 0.4:
            at = Vector((side * (wide / 2 + 0.15), -deep / 2 + abs(chance.gauss(0, spread)), z))
        one, two = (Vector([chance.gauss(0, 0.085) for _ in range(3)]) for _ in range(2))
        kind = chance.choice(("leaf1", "leaf2", "leaf2", "leaf3", "leaf1", "blade4", bloom))
        mesh.faces([at - one, at - two, at + one, at + two], [(0, 1, 2, 3)], looks[kind])


CHURCH = (-14.0, 100.0)
MILL = (33.0, 90.0)
HUB = (0.0, -3.1, 12.6)
"""Axle of the sails, from the mill's foot."""


def church(looks: Materials) -> tuple[float, float, float]:
    """Add the church on its rise; return where the bell hangs."""
    mesh = MeshBuilder()
    stone, pale = looks["ashlar"], looks["pale"]
    mesh.box((8, 0, 3), (15, 7, 9), stone)
    roof = [(x, y, z) for x in (0, 15.8) for y, z in ((-4, 7.1), (4, 7.1), (0, 12))]
    mesh.faces(roof, [(0, 3, 5, 2), (1, 2, 5, 4)], looks["slate1"])
    mesh.faces(roof, [(3, 4, 5)], stone)
    for row in range(9):
        share = row / 9
        y, z = -4 * (1 - share) - 0.05, 7.1 + 4.9 * share
        mesh.box((8, y, z + 0.08), (15.8, 0.1, 0.12), looks["slate3" if row % 2 else "slate2"])
    for x in (3.5, 6.5, 9.5, 12.5):
        mesh.box((x, -3.52, 4), (1.0, 0.1, 3.0), looks["glass"])
        mesh.box((x, -3.55, 4), (0.12, 0.12, 3.0), pale)
        mesh.box((x + 1.5, -3.8, 2.5), (0.6, 1.0, 5), stone)
    mesh.box((-2, 0, 5.5), (5.2, 5.2, 15), stone)
    for x in (-4.2, 0.2):
        for y in (-2.2, 2.2):
            mesh.box((x, y, 15), (0.8, 0.8, 4), stone)
    mesh.box((-2, 0, 17.2), (5.6, 5.6, 0.6), pale)
    mesh.box((-2, 0, 13.0), (5.5, 5.5, 0.4), pale)
    corners = [(-2 + 2.7 * a, 2.7 * b, 17.5) for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    for number in range(4):
        side = [corners[number], corners[(number + 1) % 4], (-2, 0, 27)]
        mesh.faces(side, [(0, 1, 2)], looks["slate1"])
    for step in range(8):
        z, wide = 17.7 + 1.1 * step, 5.4 * (1 - (0.2 + 1.1 * step) / 9.5) + 0.1
        mesh.box((-2, 0, z), (wide, wide, 0.14), looks["slate3"])
    mesh.tube([(-2, -2.7, 10.6), (-2, -2.75, 10.6)], 1.25, looks["white"], 24)
    mesh.box((-2, -2.8, 11.0), (0.18, 0.06, 0.9), looks["black"])
    mesh.box((-1.6, -2.8, 10.6), (0.8, 0.06, 0.18), looks["black"])
    mesh.ball((-2, 0, 27.2), 0.35, looks["brass"])
    base = float(height(*CHURCH)) + 0.5
    made = mesh.object("church")
    made.location, made.scale = (*CHURCH, base), (0.8, 0.8, 0.8)
    return CHURCH[0] - 1.6, CHURCH[1], base + 13.3


def mill(looks: Materials) -> tuple[float, float, float]:
    """Add the windmill's tower; return where its axle ends."""
    mesh = MeshBuilder()
    rings = [(0, 0, z) for z in (-1, 4, 9, 11.2)]
    mesh.tube(rings, (4.0, 3.4, 2.8, 2.5), looks["chalk"], 16)
    for z, radius in ((3.9, 3.55), (8.0, 3.05)):
        mesh.tube([(0, 0, z), (0, 0, z + 0.25)], radius, looks["beam"], 16)
    cap = [(0, 0, z) for z in (11.1, 11.5, 13.2, 14.3, 14.8)]
    mesh.tube(cap, (2.9, 2.9, 2.2, 1.1, 0.1), looks["slate2"], 16)
    mesh.tube([(0, 0, HUB[2]), HUB], 0.35, looks["beam"], 8)
    for x, z in ((-1.2, 2), (1.2, 2), (0, 5.6), (0, 9.4)):
        mesh.box((x, -3.5 + 0.1 * z, z), (0.9, 0.5, 1.2), looks["glass"])
    base = float(height(*MILL))
    mesh.object("mill").location = (*MILL, base)
    return MILL[0] + HUB[0], MILL[1] + HUB[1], base + HUB[2]
