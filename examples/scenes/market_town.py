"""The static part of the market scene: paving, houses, stalls, fountain, posts and ropes."""

from __future__ import annotations

import math
import random
from dataclasses import dataclass
from itertools import pairwise

from stage import looks
from stage.blender import bpy, mathutils
from stage.meshes import MeshBuilder, lettering

Matrix, Vector = mathutils.Matrix, mathutils.Vector

UPRIGHT = Matrix.Rotation(math.pi / 2, 4, "X")
"""Turns letters from lying on the ground to standing and facing -y."""


@dataclass(frozen=True)
class House:
    """One house of a row: left edge and width along the row, eaves height, looks."""

    left: float
    width: float
    eaves: float
    wall: str
    roof: str
    sign: str = ""
    gable: bool = False


ROW = (
    House(-13.0, 4.4, 4.6, "ochre", "slate"),
    House(-8.6, 3.6, 5.6, "brick", "tiles", "BOOKS", gable=True),
    House(-5.0, 3.9, 4.4, "cream", "tiles", "BAKERY"),
    House(-1.1, 3.2, 5.4, "teal", "slate", "TEA", gable=True),
    House(4.6, 3.6, 4.9, "rose", "tiles", "FISH & CO", gable=True),
    House(8.2, 4.3, 4.2, "brick", "slate", "TOYS"),
    House(12.5, 3.5, 5.7, "ochre", "tiles", "INN", gable=True),
    House(16.0, 5.0, 4.6, "cream", "slate"),
)
SIDE_ROW = (
    House(-9.5, 4.4, 4.8, "rose", "slate", "WINE"),
    House(-5.1, 3.7, 5.7, "brick", "tiles", gable=True),
    House(-1.4, 4.2, 4.4, "teal", "tiles", "CLOCKS"),
)
STALLS = (
    (-3.6, 4.6, ("red", "white"), "HONEY"),
    (-0.2, 6.0, ("blue", "white"), "FRUIT"),
    (5.6, 4.4, ("green", "cream"), "CHEESE"),
    (8.4, 5.8, ("orange", "white"), "SPICE"),
)
POSTS = ((-2.6, -2.4), (1.35, -1.9), (4.6, -1.0), (-5.2, 2.4), (3.9, 7.0))


def palette() -> dict[str, bpy.types.Material]:
    """Make every material of the scene, by name."""
    mortar = (0.42, 0.39, 0.35)
    made = {
        "cobbles": looks.cobbles("cobbles"),
        "paving": looks.checker("paving", (0.52, 0.40, 0.30), (0.16, 0.13, 0.13), 0.42),
        "stone": looks.brick("stone", (0.50, 0.47, 0.42), (0.34, 0.32, 0.30), (0.55, 0.25), mortar),
        "brick": looks.brick("brick", (0.46, 0.16, 0.09), (0.27, 0.09, 0.06), (0.5, 0.19), mortar),
        "tiles": looks.brick(
            "tiles", (0.52, 0.17, 0.08), (0.30, 0.09, 0.05), (0.3, 0.26), (0.09, 0.03, 0.02)
        ),
        "slate": looks.brick(
            "slate", (0.17, 0.20, 0.26), (0.09, 0.10, 0.14), (0.36, 0.24), (0.03, 0.03, 0.04)
        ),
        "ochre": looks.plaster("ochre", (0.66, 0.42, 0.14)),
        "cream": looks.plaster("cream", (0.72, 0.63, 0.46)),
        "teal": looks.plaster("teal", (0.16, 0.40, 0.42)),
        "rose": looks.plaster("rose", (0.64, 0.28, 0.24)),
        "oak": looks.wood("oak", (0.36, 0.20, 0.09)),
        "beam": looks.wood("beam", (0.16, 0.09, 0.05), along=2),
        "pine": looks.wood("pine", (0.55, 0.36, 0.18)),
        "cloth": looks.checker("cloth", (0.75, 0.72, 0.66), (0.55, 0.05, 0.05), 0.16),
        "iron": looks.paint("iron", (0.06, 0.07, 0.08), 0.45),
        "brass": looks.paint("brass", (0.85, 0.58, 0.22), 0.18, 1.0),
        "tin": looks.paint("tin", (0.70, 0.71, 0.73), 0.28, 1.0),
        "glass": looks.paint("glass", (0.05, 0.08, 0.11), 0.08),
        "lit": looks.paint("lit", (1.0, 0.56, 0.2), glow=1.1),
        "lamp": looks.paint("lamp", (1.0, 0.55, 0.18), glow=4.0),
        "leaf": looks.foliage("leaf", (0.06, 0.17, 0.03), (0.24, 0.36, 0.06)),
        "hill": looks.foliage("hill", (0.10, 0.20, 0.14), (0.20, 0.27, 0.20)),
        "water": looks.paint("water", (0.04, 0.12, 0.13), 0.12),
    }
    paints = {
        "red": (0.62, 0.05, 0.05),
        "blue": (0.06, 0.16, 0.50),
        "green": (0.08, 0.32, 0.14),
        "orange": (0.80, 0.30, 0.04),
        "white": (0.80, 0.78, 0.74),
        "yellow": (0.85, 0.60, 0.06),
        "violet": (0.30, 0.10, 0.42),
        "black": (0.03, 0.03, 0.03),
    }
    return made | {name: looks.paint(name, colour) for name, colour in paints.items()}


def build(seed: int) -> dict[str, bpy.types.Material]:
    """Build everything that stands still.

    Parameters
    ----------
    seed : int
        Seed of the small random differences (shutters, fruit, leaves).

    Returns
    -------
    dict of str to bpy.types.Material
        The materials by name, for the moving things.
    """
    chance = random.Random(seed)
    looks_of = palette()
    _ground(looks_of)
    houses = MeshBuilder()
    for house in ROW:
        _house(houses, house, Matrix.Translation((0, 9.5, 0)), looks_of, chance)
    corner = Matrix.Translation((14.0, 0, 0)) @ Matrix.Rotation(-math.pi / 2, 4, "Z")
    for house in SIDE_ROW:
        _house(houses, house, corner, looks_of, chance)
    _church(houses, looks_of)
    houses.object("houses")
    stalls = MeshBuilder()
    for x, y, stripes, sign in STALLS:
        _stall(stalls, (x, y), [looks_of[name] for name in stripes], sign, looks_of, chance)
    stalls.object("stalls")
    furniture = MeshBuilder()
    _fountain(furniture, looks_of)
    for x, y in POSTS:
        _post(furniture, x, y, looks_of)
    _railing(furniture, looks_of)
    _bunting(furniture, looks_of, chance)
    _crates(furniture, looks_of, chance)
    furniture.object("furniture")
    for x, y, height in ((11.3, 3.4, 3.4), (-7.2, 6.4, 3.6), (2.9, 12.5, 4.4)):
        _tree(x, y, height, looks_of, chance)
    return looks_of


def _ground(looks_of: dict[str, bpy.types.Material]) -> None:
    ground = MeshBuilder()
    reach = 60.0
    square = [(-reach, -reach, 0), (reach, -reach, 0), (reach, reach, 0), (-reach, reach, 0)]
    ground.faces(square, [(0, 1, 2, 3)], looks_of["cobbles"])
    disc = [
        (2.4 + 2.7 * math.cos(a / 8 * math.pi), 3.4 + 2.7 * math.sin(a / 8 * math.pi), 0.02)
        for a in range(16)
    ]
    ground.faces(disc, [tuple(range(16))], looks_of["paving"])
    ground.object("ground")


def _house(
    mesh: MeshBuilder,
    house: House,
    row: Matrix,
    looks_of: dict[str, bpy.types.Material],
    chance: random.Random,
) -> None:
    """Add one house; its front lies in the row's plane y = 0 and faces -y."""
    deep = 4.0
    mesh.place = row @ Matrix.Translation((house.left + house.width / 2, 0, 0))
    wide, high = house.width, house.eaves
    mesh.box((0, deep / 2, high / 2), (wide, deep, high), looks_of[house.wall])
    mesh.box((0, -0.05, 0.3), (wide, 0.14, 0.6), looks_of["stone"])
    _roof(mesh, house, deep, looks_of)
    _front(mesh, house, looks_of, chance)
    if house.sign:
        mesh.box((0, -0.1, 2.42), (min(2.6, wide - 0.6), 0.12, 0.62), looks_of["black"])
        letters = mesh.place @ Matrix.Translation((0, -0.19, 2.42)) @ UPRIGHT
        lettering(house.sign, letters, 0.55, looks_of["yellow"])
    mesh.place = Matrix.Identity(4)


def _roof(
    mesh: MeshBuilder, house: House, deep: float, looks_of: dict[str, bpy.types.Material]
) -> None:
    wide, high, over = house.width / 2, house.eaves, 0.3
    top = high + 1.9
    if house.gable:
        edge, low = wide + over, high - 0.2
        points = [(-edge, -over, low), (edge, -over, low), (0, -over, top)]
        points += [(-edge, deep, low), (edge, deep, low), (0, deep, top)]
        front = [(-wide, 0, high), (wide, 0, high), (0, 0, top - 0.1)]
        mesh.faces(front, [(0, 1, 2)], looks_of[house.wall])
        mesh.faces(points, [(0, 2, 5, 3), (1, 4, 5, 2)], looks_of[house.roof])
    else:
        points = [
            (-wide, -over, high - 0.2),
            (wide, -over, high - 0.2),
            (wide, deep / 2, top),
            (-wide, deep / 2, top),
            (-wide, deep, high),
            (wide, deep, high),
        ]
        mesh.faces(points, [(0, 1, 2, 3), (3, 2, 5, 4)], looks_of[house.roof])
        mesh.faces(points, [(0, 3, 4), (1, 5, 2)], looks_of[house.wall])
    mesh.box((wide * 0.5, deep / 2, top), (0.55, 0.55, 1.3), looks_of["brick"])


def _front(
    mesh: MeshBuilder,
    house: House,
    looks_of: dict[str, bpy.types.Material],
    chance: random.Random,
) -> None:
    """Add windows with shutters, a door with an awning, and beams."""
    wide, high = house.width, house.eaves
    shutter = looks_of[chance.choice(("green", "blue", "red", "oak"))]
    columns = max(2, round(wide / 1.5))
    for column in range(columns):
        x = (column + 0.5) / columns * wide - wide / 2
        levels = [3.45] if high < 5.2 else [3.3, 4.75]
        for z in levels:
            pane = looks_of["lit" if chance.random() < 0.18 else "glass"]
            mesh.box((x, 0.0, z), (0.66, 0.14, 0.95), looks_of["white"])
            mesh.box((x, -0.05, z), (0.54, 0.08, 0.83), pane)
            mesh.box((x, -0.09, z), (0.05, 0.04, 0.83), looks_of["white"])
            mesh.box((x, -0.09, z + 0.1), (0.54, 0.04, 0.05), looks_of["white"])
            mesh.box((x, -0.14, z - 0.55), (0.95, 0.22, 0.1), looks_of["oak"])
            for side in (-1, 1):
                mesh.box((x + side * 0.47, -0.06, z), (0.24, 0.06, 0.95), shutter)
    door = -wide / 4
    mesh.box((door, -0.04, 1.0), (0.95, 0.12, 2.0), looks_of["oak"])
    mesh.box((wide / 5, -0.03, 1.25), (1.25, 0.12, 1.2), looks_of["white"])
    mesh.box((wide / 5, -0.08, 1.25), (1.1, 0.08, 1.05), looks_of["glass"])
    if house.wall in ("cream", "ochre", "rose"):
        for x in (-wide / 2 + 0.1, 0.0, wide / 2 - 0.1):
            mesh.box((x, -0.03, high / 2 + 1.3), (0.16, 0.1, high - 2.6), looks_of["beam"])
        for z in (2.85, high - 0.25):
            mesh.box((0, -0.03, z), (wide, 0.1, 0.16), looks_of["beam"])


def _church(mesh: MeshBuilder, looks_of: dict[str, bpy.types.Material]) -> None:
    mesh.box((3.2, 25.0, 5.5), (4.2, 4.2, 11.0), looks_of["stone"])
    tip = [(0.9, 22.7, 11), (5.5, 22.7, 11), (5.5, 27.3, 11), (0.9, 27.3, 11), (3.2, 25, 17.5)]
    mesh.faces(tip, [(0, 1, 4), (1, 2, 4), (2, 3, 4), (3, 0, 4)], looks_of["slate"])
    mesh.tube([(3.2, 22.9, 9.3), (3.2, 22.7, 9.3)], 1.1, looks_of["white"], 24)
    mesh.box((3.2, 22.66, 9.7), (0.14, 0.1, 0.9), looks_of["black"])
    mesh.box((3.5, 22.66, 9.3), (0.7, 0.1, 0.14), looks_of["black"])
    for x in (-40, -26, -9, 14, 30, 46):
        mesh.ball((x, 75, -6), 17 + x % 7, looks_of["hill"], (24, 12))


def _stall(
    mesh: MeshBuilder,
    spot: tuple[float, float],
    stripes: list[bpy.types.Material],
    sign: str,
    looks_of: dict[str, bpy.types.Material],
    chance: random.Random,
) -> None:
    """Add a stall: four poles, striped canopy with scallops, counter with cloth and goods."""
    mesh.place = Matrix.Translation((*spot, 0))
    for x in (-1.15, 1.15):
        for y, high in ((-0.6, 2.05), (0.7, 2.5)):
            mesh.tube([(x, y, 0), (x, y, high)], 0.045, looks_of["pine"], 8)
    strips = 10
    for strip in range(strips):
        left, right = (-1.3 + 2.6 * (strip + side) / strips for side in (0, 1))
        points = [
            (left, -0.85, 2.0),
            (right, -0.85, 2.0),
            (right, 0.8, 2.6),
            (left, 0.8, 2.6),
            (left, -0.86, 1.72),
            (right, -0.86, 1.72),
        ]
        mesh.faces(points, [(0, 1, 2, 3), (4, 5, 1, 0)], stripes[strip % 2])
    mesh.box((0, 0, 0.42), (2.2, 0.9, 0.84), looks_of["pine"])
    mesh.box((0, -0.02, 0.88), (2.35, 1.0, 0.06), looks_of["cloth"])
    mesh.box((0, -0.48, 0.68), (2.35, 0.04, 0.4), looks_of["cloth"])
    for heap in range(5):
        goods = looks_of[chance.choice(("red", "orange", "yellow", "green", "violet", "brass"))]
        for _ in range(14):
            x = -0.9 + 0.45 * heap + chance.uniform(-0.16, 0.16)
            where = (x, chance.uniform(-0.38, 0.3), 0.98 + chance.uniform(0, 0.16))
            mesh.ball(where, 0.075, goods, (8, 6))
    mesh.place = Matrix.Identity(4)
    board = Vector((spot[0], spot[1] - 0.92, 2.28))
    mesh.box(board, (1.7, 0.06, 0.46), looks_of["oak"])
    place = Matrix.Translation(board + Vector((0, -0.06, 0))) @ UPRIGHT
    lettering(sign, place, 0.42, looks_of["white"])


def _fountain(mesh: MeshBuilder, looks_of: dict[str, bpy.types.Material]) -> None:
    x, y = 2.4, 3.4
    mesh.tube([(x, y, 0), (x, y, 0.6)], (1.35, 1.25), looks_of["stone"], 8, smooth=False)
    mesh.tube([(x, y, 0.6), (x, y, 0.62)], 1.1, looks_of["water"], 16)
    profile = ((0.6, 0.34), (0.9, 0.2), (1.5, 0.17), (1.62, 0.62), (1.72, 0.66), (1.78, 0.2))
    rings = [(x, y, z) for z, _ in profile]
    mesh.tube(rings, [r for _, r in profile], looks_of["stone"], 16)
    mesh.ball((x, y, 2.15), 0.42, looks_of["brass"], (32, 16))
    mesh.tube([(x, y, 2.5), (x, y, 3.1)], (0.07, 0.01), looks_of["brass"])


def _post(mesh: MeshBuilder, x: float, y: float, looks_of: dict[str, bpy.types.Material]) -> None:
    """Add a lamp post with a ringed foot and a glowing lantern."""
    profile = (
        (0, 0.17),
        (0.25, 0.15),
        (0.32, 0.08),
        (0.9, 0.07),
        (0.95, 0.1),
        (1.02, 0.06),
        (3.0, 0.045),
    )
    rings = [(x, y, z) for z, _ in profile]
    mesh.tube(rings, [r for _, r in profile], looks_of["iron"], 10)
    mesh.tube([(x, y, 3.0), (x, y, 3.35)], (0.1, 0.17), looks_of["lamp"], 6, smooth=False)
    mesh.tube([(x, y, 3.35), (x, y, 3.55)], (0.24, 0.03), looks_of["iron"], 6, smooth=False)
    mesh.tube([(x, y, 2.7), (x + 0.75, y, 2.75)], 0.03, looks_of["iron"], 6)


def _railing(mesh: MeshBuilder, looks_of: dict[str, bpy.types.Material]) -> None:
    for number in range(15):
        x = 1.9 + 0.4 * number
        mesh.tube([(x, -1.6, 0), (x, -1.6, 0.95)], 0.022, looks_of["iron"], 6)
        mesh.ball((x, -1.6, 0.98), 0.05, looks_of["brass"], (8, 6))
    for z in (0.2, 0.85):
        mesh.tube([(1.9, -1.6, z), (7.5, -1.6, z)], 0.025, looks_of["iron"], 6)


def _bunting(
    mesh: MeshBuilder, looks_of: dict[str, bpy.types.Material], chance: random.Random
) -> None:
    """Hang ropes with coloured pennants between posts and houses."""
    spans = (
        ((-2.6, -2.4, 2.95), (-3.1, 9.4, 4.3)),
        ((1.35, -1.9, 2.95), (6.4, 9.4, 4.6)),
        ((4.6, -1.0, 2.95), (13.9, 3.0, 4.4)),
        ((-5.2, 2.4, 2.95), (3.9, 7.0, 3.0)),
    )
    colours = [looks_of[name] for name in ("red", "yellow", "blue", "white", "green", "orange")]
    for start, end in ((Vector(a), Vector(b)) for a, b in spans):
        steps = round((end - start).length / 0.42)
        rope = []
        for step in range(steps + 1):
            share = step / steps
            rope.append(start.lerp(end, share) - Vector((0, 0, 1.6 * share * (1 - share))))
        mesh.tube(rope, 0.018, looks_of["white"], 5)
        for first, second in pairwise(rope):
            left, right = first.lerp(second, 0.1), first.lerp(second, 0.9)
            tip = first.lerp(second, 0.5) - Vector((chance.uniform(-0.05, 0.05), 0.06, 0.42))
            mesh.faces([left, right, tip], [(0, 1, 2)], chance.choice(colours))


def _crates(
    mesh: MeshBuilder, looks_of: dict[str, bpy.types.Material], chance: random.Random
) -> None:
    for x, y, z in (
        (-2.2, 3.9, 0),
        (-1.65, 3.8, 0),
        (-1.95, 3.85, 0.5),
        (7.1, 3.6, 0),
        (4.2, 2.6, 0),
    ):
        mesh.place = Matrix.Translation((x, y, z)) @ Matrix.Rotation(
            chance.uniform(-0.4, 0.4), 4, "Z"
        )
        for slat in range(3):
            mesh.box((0, 0, 0.09 + 0.16 * slat), (0.5, 0.5, 0.12), looks_of["pine"])
        mesh.box((0, 0, 0.24), (0.44, 0.44, 0.46), looks_of["beam"])
    mesh.place = Matrix.Identity(4)
    for x, y in ((0.75, 2.2), (1.15, 1.75), (8.0, 3.2)):
        mesh.tube(
            [(x, y, 0), (x, y, 0.55), (x, y, 0.66), (x, y, 0.8)],
            (0.2, 0.2, 0.1, 0.14),
            looks_of["tin"],
            16,
        )


def _tree(
    x: float,
    y: float,
    height: float,
    looks_of: dict[str, bpy.types.Material],
    chance: random.Random,
) -> None:
    """Add a tree: a trunk and a round crown of single leaves."""
    mesh = MeshBuilder()
    mesh.tube([(x, y, 0), (x + 0.1, y, height * 0.7)], (0.2, 0.1), looks_of["beam"], 8)
    for _ in range(2600):
        away = Vector([chance.gauss(0, 1) for _ in range(3)]).normalized()
        middle = Vector((x, y, height)) + away * chance.uniform(0.55, 1.0) * 1.5
        middle.z -= 0.25 * abs(away.x)
        one = Vector([chance.gauss(0, 0.1) for _ in range(3)])
        two = Vector([chance.gauss(0, 0.1) for _ in range(3)])
        mesh.faces(
            [middle - one, middle - two, middle + one, middle + two],
            [(0, 1, 2, 3)],
            looks_of["leaf"],
        )
    mesh.object("tree")
