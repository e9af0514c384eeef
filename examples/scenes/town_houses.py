"""Houses of the town scene: materials, facades with recessed windows, shops, roofs, the tower."""

from __future__ import annotations

import math
import random
from dataclasses import dataclass

from stage import looks
from stage.blender import bpy, mathutils
from stage.meshes import MeshBuilder, lettering

Matrix, Vector = mathutils.Matrix, mathutils.Vector
Materials = dict[str, bpy.types.Material]
UPRIGHT = Matrix.Rotation(math.pi / 2, 4, "X")
"""Turns letters from lying on the ground to standing and facing -y."""

GROUND, STOREY, REVEAL, DEEP = 3.7, 3.05, 0.4, 9.0
WALLS = ("red brick", "yellow brick", "cream", "grey stone", "rose", "ochre", "sage", "dark brick")
SHOPS = (
    "BAKER & SONS", "CAFE CENTRAL", "BOOKS", "CHEMIST", "HOTEL ROYAL", "SHOES", "FLORIST",
    "THE CROWN", "OPTICIAN", "GROCER", "RECORDS", "TAILOR", "CINEMA", "TEA ROOM", "BANK", "TOYS",
    "WATCHES", "DELI", "POST OFFICE", "BARBER", "PIANOS", "TRAVEL", "FABRICS", "BICYCLES",
)  # fmt: skip


@dataclass(frozen=True)
class House:
    """One house of a row: width, storeys above the shop, looks and the shop's name."""

    width: float
    storeys: int
    wall: str
    trim: str
    roof: str
    shop: str
    board: str
    awning: str = ""


@dataclass(frozen=True)
class Row:
    """A row of houses: its left end, its turn in quarters, length, and where viewers come from.

    Seen from the street houses are laid from left to right; `seen` is -1 when the camera comes
    from the left, 1 from the right.
    """

    start: tuple[float, float]
    quarter: int
    length: float
    seen: int

    def place(self) -> mathutils.Matrix:
        """Return the transform from the row (front at y = 0, facing -y) to the world."""
        turn = Matrix.Rotation(self.quarter * math.pi / 2, 4, "Z")
        return Matrix.Translation((*self.start, 0)) @ turn


def stucco(name: str, colour: looks.Colour) -> bpy.types.Material:
    """Painted render with stains that run down; cheaper than `looks.plaster`."""
    material, nodes = looks.new(name)
    where = nodes.wall()
    streaks = nodes.add("Mapping", {0: where, 3: (2.6, 0.45, 1.0)}).outputs[0]
    stain = nodes.step(nodes.noise(streaks, 1.5, 3.0), 0.46, 0.75)
    fine = nodes.noise(where, 9.0, 2.0)
    dark = tuple(0.45 * part for part in colour)
    shade = nodes.mix(nodes.math("MULTIPLY", stain, 0.6), colour, dark)
    shade = nodes.mix(nodes.step(fine, 0.35, 0.75), shade, tuple(0.72 * part for part in colour))
    looks.finish(nodes, shade, 0.88)
    return material


def bricks(
    name: str, first: looks.Colour, second: looks.Colour, size: tuple[float, float]
) -> bpy.types.Material:
    """Brickwork or ashlar with soot."""
    material, nodes = looks.new(name)
    where = nodes.wall()
    mortar = tuple(0.6 * part + 0.08 for part in first)
    inputs = {"Vector": where, "Color1": first, "Color2": second, "Mortar": mortar, "Scale": 1.0}
    inputs |= {"Brick Width": size[0], "Row Height": size[1], "Mortar Size": 0.09 * size[1]}
    laid = nodes.add("TexBrick", inputs).outputs[0]
    soot = nodes.step(nodes.noise(where, 1.3, 3.0), 0.42, 0.78)
    shade = nodes.mix(nodes.math("MULTIPLY", soot, 0.6), laid, (0.06, 0.055, 0.05))
    looks.finish(nodes, shade, 0.85)
    return material


def display(name: str) -> bpy.types.Material:
    """Shop window: blurred goods on shelves behind a shiny pane."""
    material, nodes = looks.new(name)
    where = nodes.wall()
    goods = nodes.add("TexNoise", {"Vector": where, "Scale": 5.0, "Detail": 2.0}).outputs[1]
    axes = nodes.add("SeparateXYZ", {0: where}).outputs
    shelf = nodes.math("PINGPONG", axes[1], 0.35)
    light = nodes.step(shelf, 0.03, 0.3)
    bright = nodes.mix(1.0, goods, (1.25, 1.0, 0.72), "MULTIPLY")
    vivid = nodes.add("HueSaturation", {"Color": bright, "Saturation": 2.4}).outputs[0]
    shade = nodes.mix(light, (0.03, 0.028, 0.026), vivid)
    looks.finish(nodes, shade, 0.06, glow=0.12)
    return material


def palette() -> Materials:
    """Make the materials of everything that is built, by name."""
    made = {
        "red brick": bricks("red brick", (0.46, 0.15, 0.08), (0.30, 0.09, 0.055), (0.5, 0.17)),
        "yellow brick": bricks("yellow brick", (0.56, 0.42, 0.22), (0.42, 0.3, 0.15), (0.5, 0.17)),
        "dark brick": bricks("dark brick", (0.25, 0.12, 0.09), (0.14, 0.08, 0.07), (0.5, 0.17)),
        "grey stone": bricks("grey stone", (0.52, 0.48, 0.42), (0.4, 0.37, 0.33), (1.1, 0.45)),
        "trim stone": bricks("trim stone", (0.66, 0.60, 0.50), (0.56, 0.5, 0.42), (1.4, 0.5)),
        "slate": bricks("slate", (0.15, 0.17, 0.21), (0.08, 0.09, 0.12), (0.5, 0.3)),
        "tiles": bricks("tiles", (0.45, 0.15, 0.07), (0.30, 0.09, 0.05), (0.4, 0.3)),
        "cream": stucco("cream", (0.74, 0.64, 0.46)),
        "rose": stucco("rose", (0.62, 0.30, 0.25)),
        "ochre": stucco("ochre", (0.68, 0.43, 0.15)),
        "sage": stucco("sage", (0.36, 0.45, 0.33)),
        "display": display("display"),
        "glass": looks.paint("glass", (0.36, 0.42, 0.48), 0.05, 1.0),
        "curtain": looks.paint("curtain", (0.42, 0.40, 0.36), 0.12),
        "lit": looks.paint("lit", (1.0, 0.62, 0.26), glow=1.4),
        "copper": looks.paint("copper", (0.18, 0.42, 0.34), 0.5),
        "gold": looks.paint("gold", (0.95, 0.66, 0.22), 0.2, 1.0),
        "neon": looks.paint("neon", (1.0, 0.22, 0.12), glow=5.0),
        "neon blue": looks.paint("neon blue", (0.15, 0.6, 1.0), glow=4.0),
        "leaf": looks.foliage("leaf", (0.06, 0.16, 0.025), (0.25, 0.36, 0.06)),
        "hill": looks.foliage("hill", (0.16, 0.26, 0.26), (0.26, 0.34, 0.32)),
    }
    paints = {
        "red": (0.60, 0.05, 0.04),
        "blue": (0.05, 0.14, 0.42),
        "green": (0.05, 0.24, 0.13),
        "orange": (0.80, 0.30, 0.04),
        "white": (0.80, 0.78, 0.73),
        "yellow": (0.85, 0.58, 0.05),
        "black": (0.025, 0.025, 0.028),
        "brown": (0.20, 0.10, 0.05),
        "grey": (0.30, 0.31, 0.33),
        "skin": (0.62, 0.38, 0.27),
        "tan": (0.50, 0.38, 0.24),
        "violet": (0.26, 0.10, 0.34),
    }
    return made | {name: looks.paint(name, colour, 0.5) for name, colour in paints.items()}


def rows(plan: tuple[Row, ...], made: Materials, chance: random.Random) -> None:
    """Build all rows of houses."""
    shops = list(SHOPS)
    chance.shuffle(shops)
    number = 0
    for row in plan:
        mesh = MeshBuilder()
        gone = 0.0
        while gone < row.length - 1.0:
            width = chance.uniform(6.5, 10.5)
            if row.length - gone - width < 6.0:
                width = row.length - gone
            one = _any_house(width, shops[number % len(shops)], chance)
            # The bodies of the first and last house stop short, so that at a street corner they
            # do not stick out of the windows of the other street's row.
            ends = (0.8 if gone == 0.0 else 0.0, 0.8 if gone + width >= row.length - 0.1 else 0.0)
            mesh.place = row.place() @ Matrix.Translation((gone, 0, 0))
            _house(mesh, one, ends, made, chance)
            _lettered(mesh, one, row.seen, made, chance)
            gone, number = gone + width, number + 1
        mesh.object("row")


def _any_house(width: float, shop: str, chance: random.Random) -> House:
    board = chance.choice(("red", "blue", "green", "black", "brown", "black"))
    return House(
        width,
        chance.choice((2, 3, 3, 4)),
        chance.choice(WALLS),
        chance.choice(("trim stone", "trim stone", "white", "cream")),
        chance.choice(("mansard", "flat", "gable")),
        shop,
        board,
        chance.choice(("", "red", "green", "blue", "orange")),
    )


def _house(
    mesh: MeshBuilder,
    house: House,
    ends: tuple[float, float],
    made: Materials,
    chance: random.Random,
) -> None:
    """Add one house over x = 0 to its width; its front lies in y = 0 and faces -y."""
    wide, top = house.width, GROUND + house.storeys * STOREY
    left, right = ends[0], wide - ends[1]
    middle, deep = (left + right) / 2, DEEP - REVEAL
    mesh.box((middle, REVEAL + deep / 2, top / 2), (right - left, deep, top), made[house.wall])
    _shop(mesh, house, made, chance)
    bays = max(3, round(wide / 2.0))
    for storey in range(house.storeys):
        _storey(mesh, house, bays, GROUND + storey * STOREY, made)
        for bay in range(bays):
            _window(mesh, house, (bay, bays), GROUND + storey * STOREY, made, chance)
    trim = made[house.trim]
    mesh.box((wide / 2, 0.05, top + 0.15), (wide, 0.95, 0.3), trim)
    mesh.box((wide / 2, 0.1, top - 0.2), (wide, 0.45, 0.18), trim)
    for tooth in range(int(wide / 0.6)):
        mesh.box((0.3 + tooth * 0.6, -0.2, top - 0.08), (0.22, 0.3, 0.2), trim)
    _roof(mesh, house, top + 0.3, made, chance)


def _storey(mesh: MeshBuilder, house: House, bays: int, low: float, made: Materials) -> None:
    """Add the piers and spandrels of one storey; windows stay open between them."""
    wide, wall = house.width, made[house.wall]
    bay = wide / bays
    pier = 0.46 * bay
    for number in range(bays + 1):
        left, right = max(0, number * bay - pier / 2), min(wide, number * bay + pier / 2)
        size = (right - left, REVEAL, STOREY)
        mesh.box(((left + right) / 2, REVEAL / 2, low + STOREY / 2), size, wall)
    for number in range(bays):
        x = (number + 0.5) * bay
        for z, high in ((low + 0.38, 0.76), (low + STOREY - 0.22, 0.44)):
            mesh.box((x, REVEAL / 2 + 0.05, z), (bay - pier, REVEAL - 0.1, high), wall)


def _window(
    mesh: MeshBuilder,
    house: House,
    bay: tuple[int, int],
    low: float,
    made: Materials,
    chance: random.Random,
) -> None:
    """Add pane, bars, sill and head of one window, sometimes a balcony."""
    span = house.width / bay[1]
    x, half = (bay[0] + 0.5) * span, 0.27 * span
    bottom, top = low + 0.76, low + STOREY - 0.44
    lean, turn = chance.uniform(-0.008, 0.008), chance.uniform(-0.012, 0.012)
    pane = [
        (x + dx, 0.3 + turn * dx + lean * (z - bottom), z)
        for dx, z in ((-half, bottom), (half, bottom), (half, top), (-half, top))
    ]
    kind = chance.choices(("glass", "curtain", "lit"), (0.81, 0.175, 0.015))[0]
    mesh.faces(pane, [(0, 1, 2, 3)], made[kind])
    white, trim = made["white"], made[house.trim]
    high = top - bottom
    mesh.box((x, 0.25, bottom + high / 2), (0.07, 0.06, high), white)
    mesh.box((x, 0.25, bottom + 0.66 * high), (2 * half, 0.06, 0.07), white)
    for side in (-1, 1):
        mesh.box((x + side * (half - 0.04), 0.25, bottom + high / 2), (0.09, 0.08, high), white)
    mesh.box((x, 0.0, bottom - 0.05), (2 * half + 0.3, 0.36, 0.11), trim)
    mesh.box((x, 0.02, top + 0.1), (2 * half + 0.24, 0.18, 0.22), trim)
    if bay[0] % 2 and low < 8.0 and house.roof == "mansard":
        mesh.box((x, -0.35, bottom - 0.16), (2 * half + 0.5, 0.75, 0.12), trim)
        for rail in range(9):
            along = x + (rail / 8 - 0.5) * (2 * half + 0.4)
            mesh.box((along, -0.68, bottom + 0.3), (0.035, 0.035, 0.85), made["black"])
        mesh.box((x, -0.68, bottom + 0.74), (2 * half + 0.46, 0.06, 0.06), made["black"])


def _shop(mesh: MeshBuilder, house: House, made: Materials, chance: random.Random) -> None:
    """Add the ground floor: piers, a glazed front with a door, board and awning."""
    wide, board, trim = house.width, made[house.board], made[house.trim]
    for x in (0.25, wide - 0.25):
        mesh.box((x, 0.17, GROUND / 2), (0.5, 0.46, GROUND), trim)
    mesh.box((wide / 2, 0.22, 0.3), (wide - 1, 0.36, 0.6), board)
    pane = [(0.5, 0.33, 0.6), (wide - 0.5, 0.33, 0.6), (wide - 0.5, 0.33, 2.9), (0.5, 0.33, 2.9)]
    mesh.faces(pane, [(0, 1, 2, 3)], made["display"])
    parts = max(3, round((wide - 1) / 1.3))
    for part in range(parts + 1):
        x = 0.5 + (wide - 1) * part / parts
        mesh.box((x, 0.25, 1.6), (0.1, 0.2, 2.6), board)
    mesh.box((wide / 2, 0.25, 2.35), (wide - 1, 0.12, 0.08), board)
    door = 0.5 + (wide - 1) * (chance.randrange(parts) + 0.5) / parts
    mesh.box((door, 0.18, 1.15), (1.1, 0.2, 2.3), board)
    mesh.box((door, 0.06, 1.45), (0.7, 0.06, 1.3), made["glass"])
    mesh.box((door + 0.4, 0.02, 1.1), (0.06, 0.12, 0.2), made["gold"])
    mesh.box((wide / 2, 0.08, 3.2), (wide - 0.1, 0.5, 0.68), board)
    mesh.box((wide / 2, 0.0, GROUND - 0.08), (wide, 0.7, 0.2), trim)
    if house.awning:
        strips = round((wide - 1.2) / 0.4)
        stripes = (made[house.awning], made["white"])
        for strip in range(strips):
            left, right = (0.6 + (wide - 1.2) * (strip + side) / strips for side in (0, 1))
            points = [(left, -0.18, 2.86), (right, -0.18, 2.86), (right, -1.6, 2.35)]
            points += [(left, -1.6, 2.35), (left, -1.6, 2.12), (right, -1.6, 2.12)]
            mesh.faces(points, [(0, 3, 2, 1), (3, 4, 5, 2)], stripes[strip % 2])


def _lettered(
    mesh: MeshBuilder, house: House, seen: int, made: Materials, chance: random.Random
) -> None:
    """Write the shop's name on its board, and add a sign that hangs out over the pavement."""
    size = min(0.62, 1.25 * (house.width - 1.2) / len(house.shop))
    ink = made[chance.choice(("gold", "white", "white", "yellow"))]
    board = Matrix.Translation((house.width / 2, -0.19, 3.18)) @ UPRIGHT
    lettering(house.shop, mesh.place @ board, size, ink)
    x = 0.7 if seen < 0 else house.width - 0.7
    z = chance.uniform(4.3, 4.9)
    mesh.box((x, -0.95, z), (0.12, 1.5, 0.62), made[house.board])
    mesh.box((x, -0.8, z + 0.38), (0.05, 1.7, 0.05), made["black"])
    hung = Matrix.Translation((x + 0.09 * seen, -0.95, z - 0.02))
    face = Matrix.Rotation(seen * math.pi / 2, 4, "Z") @ UPRIGHT
    word = house.shop.split()[-1]
    glow = made[chance.choice(("neon", "neon blue", "yellow", "white", "lit"))]
    lettering(word, mesh.place @ hung @ face, min(0.5, 2.0 / len(word)), glow)


def _roof(
    mesh: MeshBuilder, house: House, low: float, made: Materials, chance: random.Random
) -> None:
    wide = house.width
    cover = made["tiles" if house.roof == "gable" else "slate"]
    if house.roof == "flat":
        mesh.box((wide / 2, 0.1, low + 0.45), (wide, 0.3, 0.9), made[house.wall])
        mesh.box((wide / 2, 0.1, low + 0.95), (wide, 0.45, 0.12), made[house.trim])
        mesh.box((wide / 2, 0.05, low + 0.9), (wide * 0.3, 0.4, 1.5), made[house.trim])
    else:
        inner, rise = (1.3, 2.5) if house.roof == "mansard" else (DEEP / 2, 3.0)
        points = [(0, -0.2, low), (wide, -0.2, low), (wide, inner, low + rise)]
        points += [(0, inner, low + rise), (0, DEEP - inner, low + rise)]
        points += [(wide, DEEP - inner, low + rise), (wide, DEEP, low), (0, DEEP, low)]
        mesh.faces(points, [(0, 1, 2, 3), (3, 2, 5, 4), (4, 5, 6, 7)], cover)
        mesh.faces(points, [(0, 3, 4, 7), (1, 6, 5, 2)], made[house.wall])
    if house.roof == "mansard":
        for number in range(round(wide / 3)):
            x = (number + 0.5) * wide / round(wide / 3)
            mesh.box((x, 0.7, low + 1.05), (1.25, 1.5, 1.5), made["trim stone"])
            mesh.box((x, -0.06, low + 1.05), (0.85, 0.06, 1.15), made["glass"])
            mesh.box((x, 0.6, low + 1.9), (1.55, 1.9, 0.16), cover)
    for x in (0.6, wide - 0.6)[: chance.randint(1, 2)]:
        mesh.box((x, 4.2, low + 2.6), (0.8, 1.5, 3.2), made["red brick"])
        for pot in (-0.4, 0.0, 0.4):
            mesh.tube(
                [(x, 4.2 + pot, low + 4.2), (x, 4.2 + pot, low + 4.7)], 0.14, made["tiles"], 8
            )


def tower(spot: tuple[float, float], made: Materials) -> None:
    """Add the town hall with its clock tower, front at y = 0 of the spot, facing -y."""
    mesh = MeshBuilder()
    mesh.place = Matrix.Translation((*spot, 0))
    stone, trim = made["yellow brick"], made["trim stone"]
    mesh.box((0, 6, 6), (34, 12, 12), made["red brick"])
    mesh.box((0, 5.9, 12.3), (35, 13, 0.6), trim)
    for column in range(13):
        x = -15.6 + 2.6 * column
        for z in (2.6, 7.4):
            mesh.box((x, -0.05, z + 0.3), (1.6, 0.2, 3.2), trim)
            mesh.box((x, -0.12, z + 0.3), (1.2, 0.2, 2.8), made["glass"])
    mesh.box((0, 3, 14), (7.4, 7.4, 28), stone)
    for z in (13, 20.5, 27.8):
        mesh.box((0, 3, z), (8.2, 8.2, 0.6), trim)
    for x in (-3.5, 3.5):
        mesh.box((x, -0.7, 14), (0.9, 0.4, 28), trim)
    for x in (-1.6, 0, 1.6):
        mesh.box((x, -0.72, 16.6), (0.8, 0.1, 4.2), made["black"])
    mesh.tube([(0, -0.5, 24.1), (0, -0.95, 24.1)], 2.7, made["gold"], 32, smooth=False)
    mesh.tube([(0, -0.6, 24.1), (0, -1.0, 24.1)], 2.45, made["white"], 32, smooth=False)
    for hour in range(12):
        angle = math.pi * hour / 6
        spot_on = (2.05 * math.sin(angle), -1.03, 24.1 + 2.05 * math.cos(angle))
        mesh.box(spot_on, (0.3, 0.1, 0.3), made["black"])
    mesh.box((0.0, -1.08, 25.0), (0.2, 0.1, 1.9), made["black"])
    mesh.box((0.55, -1.08, 24.1), (1.3, 0.1, 0.24), made["black"])
    tip = [(-3.9, -0.9, 28.1), (3.9, -0.9, 28.1), (3.9, 6.9, 28.1), (-3.9, 6.9, 28.1), (0, 3, 39)]
    mesh.faces(tip, [(0, 1, 4), (1, 2, 4), (2, 3, 4), (3, 0, 4)], made["copper"])
    mesh.ball((0, 3, 39.2), 0.6, made["gold"])
    mesh.object("town hall")
