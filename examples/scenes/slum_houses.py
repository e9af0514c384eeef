"""Walls, roofs and stairs of the slum scene: storeys of tin, brick, plaster and planks."""

from __future__ import annotations

import math

import slum_parts as parts
from slum_parts import Kit, at
from stage.blender import mathutils

Matrix, Vector = mathutils.Matrix, mathutils.Vector
Storey = tuple[float, str, float]
"""Height, skin, and how far it juts out over the alley."""

TIN = ("zinc", "rust", "bluetin", "greentin", "redtin")
WORDS = ("CINE", "TONIGHT", "VOTE 7", "CIRCO", "BOXING", "SALE", "LIVE", "RADIO", "GOAL")
TURNS = {"left": 90.0, "right": -90.0, "outer": 0.0, "inner": 180.0}
LINES = {"left": -1.1, "right": 1.1, "outer": 4.4, "inner": 2.3}
"""Where the walls of the two alleys are: x of the first one's, y of the second one's."""

FACADES: tuple[tuple[str, float, float, tuple[Storey, ...]], ...] = (
    ("left", -8.0, -3.6, ((2.6, "brick", 0.0), (2.5, "ochre", 0.3))),
    ("left", -3.6, -1.2, ((2.35, "tin", 0.0),)),
    ("left", -1.2, 0.9, ((2.55, "turquoise", 0.0),)),
    ("left", 0.9, 2.7, ((2.45, "tin", 0.0),)),
    ("left", 2.7, 5.4, ((2.6, "brick", 0.0), (1.5, "rose", 0.15))),
    ("left", 5.4, 9.0, ((3.7, "lime", 0.0),)),
    ("right", -8.0, -2.4, ((2.6, "lime", 0.0), (2.4, "tin", 0.25))),
    ("right", -2.4, -0.4, ((2.6, "rose", 0.0), (2.0, "brick", 0.1))),
    ("right", -0.4, 1.0, ((2.45, "tin", 0.0), (2.1, "tin", 0.0))),
    ("right", 1.0, 2.25, ((2.6, "block", 0.0), (1.9, "ochre", 0.15))),
    ("inner", 1.16, 3.0, ((2.5, "ochre", 0.0),)),
    ("inner", 3.0, 5.0, ((2.35, "tin", 0.0),)),
    ("inner", 5.0, 7.2, ((2.55, "brick", 0.0),)),
    ("inner", 8.8, 12.0, ((2.6, "lime", 0.0),)),
    ("inner", 12.0, 16.0, ((2.6, "plank", 0.0),)),
    ("outer", 0.6, 2.5, ((2.6, "turquoise", 0.0), (2.4, "brick", 0.25))),
    ("outer", 2.5, 4.6, ((2.6, "brick", 0.0), (2.2, "tin", 0.3))),
    ("outer", 4.6, 7.2, ((2.9, "rose", 0.0),)),
    ("outer", 8.8, 11.6, ((2.6, "tin", 0.0),)),
    ("outer", 11.6, 16.0, ((2.6, "brick", 0.0), (2.0, "rose", 0.2))),
)
"""Wall, where it begins and ends along the alley, and its storeys."""


def wall_place(wall: str, start: float, end: float) -> Matrix:
    """Return the place of a facade: x to the right as seen from the alley, y into the house."""
    low, line = min(start, end), LINES[wall]
    high = max(start, end)
    spots = {"left": (line, low), "right": (line, high), "outer": (low, line)}
    x, y = spots.get(wall, (high, line))
    return at(x, y, 0, TURNS[wall])


def build(kit: Kit) -> None:
    """Build all facades, the stair, the far walls, and the hill behind."""
    for wall, start, end, storeys in FACADES:
        facade(kit, wall_place(wall, start, end), end - start, storeys, 3.0)
    facade(kit, at(0.58, 9.0, 0, -90), 4.4, ((3.6, "rose", 0.0),), 0.3)
    facade(kit, at(-9.0, -8.0, 0, 180), 18, ((3.0, "brick", 0.0),), 0.3)
    facade(kit, at(16.0, 9.0, 0, -90), 14, ((2.9, "ochre", 0.0),), 3.0)
    for x, turn in ((7.23, 90), (8.77, -90)):
        for low, high, skin in ((-6.0, 2.2, "brick"), (4.5, 12.0, "lime")):
            start = low if turn > 0 else high
            facade(kit, at(x, start, 0, turn), high - low, ((2.9, skin, 0.0),), 0.3)
    facade(kit, at(6.0, 12.0, 0, 0), 4.0, ((2.7, "turquoise", 0.0), (2.3, "tin", 0.2)), 3.0)
    facade(kit, at(10.0, -6.0, 0, 180), 4.0, ((2.7, "rose", 0.0),), 3.0)
    _stair(kit)
    _hill(kit)


def facade(
    kit: Kit, place: Matrix, width: float, storeys: tuple[Storey, ...], depth: float
) -> None:
    """Add one house: its storeys with doors and windows, and a tin roof with things on it."""
    low = 0.0
    for level, (height, skin, jut) in enumerate(storeys):
        floor = place @ Matrix.Translation((0, -jut, low))
        _skin(kit, floor, (width, height, depth + jut), skin)
        if jut:
            kit.mesh.place = floor
            for beam in range(int(width / 0.5) + 1):
                spot = (0.06 + beam * 0.5, 0.1, 0.0)
                kit.mesh.box(spot, (0.09, 0.6 + jut, 0.1), kit.looks["beam"])
            kit.mesh.box((width / 2, -0.03, 0.06), (width, 0.06, 0.12), kit.looks["beam"])
        _openings(kit, floor, width, height, level)
        low += height
    if depth > 1:
        _roof(kit, place @ Matrix.Translation((0, -storeys[-1][2], low)), width)


def _skin(kit: Kit, place: Matrix, size: tuple[float, float, float], skin: str) -> None:
    width, height, depth = size
    sheet = skin in ("tin", "plank")
    kit.mesh.place = place
    back = kit.looks["greyplank" if sheet else skin]
    kit.mesh.box((width / 2, depth / 2, height / 2), (width, depth, height), back)
    if skin == "tin":
        x = 0.0
        while x < width - 0.05:
            wide = min(kit.chance.choice((0.6, 0.8)), width - x + 0.04)
            tilt = Matrix.Rotation(kit.chance.gauss(0, 0.012), 4, "Z")
            drop = kit.chance.uniform(-0.06, 0.03)
            where = at(x, -0.03 - kit.chance.uniform(0, 0.02), max(0.0, drop))
            look = kit.chance.choices(TIN, (4, 5, 3, 2, 1))[0]
            wave = kit.chance.choice((0.085, 0.1, 0.12))
            upright = place @ where @ parts.UPRIGHT @ tilt
            parts.corrugated(kit, upright, wide + 0.04, height + drop, look, wave)
            x += wide
    elif skin == "plank":
        x = 0.0
        while x < width - 0.02:
            wide = min(kit.chance.uniform(0.1, 0.2), width - x)
            tall = height - kit.chance.uniform(0, 0.06)
            look = kit.looks[kit.chance.choice(("plank", "greyplank", "plank", "beam"))]
            y = -0.015 - kit.chance.uniform(0, 0.015)
            kit.mesh.box((x + wide / 2, y, tall / 2), (wide - 0.012, 0.025, tall), look)
            x += wide


def _openings(kit: Kit, place: Matrix, width: float, height: float, level: int) -> None:
    """Deal out doors, windows, shutters, air conditioners and posters along a storey."""
    cells = max(1, round(width / 1.05))
    choices = (
        ("door", "window", "shutter", "posters") if level == 0 else ("window", "window", "air")
    )
    for cell in range(cells):
        x = (cell + 0.5) * width / cells
        spot = place @ Matrix.Translation((x, -0.05, 0))
        kind = kit.chance.choice(choices)
        if kind == "door":
            _door(kit, spot)
        elif kind == "window":
            _window(kit, spot, min(1.45, height - 0.75))
        elif kind == "shutter":
            _shutter(kit, spot)
        elif kind == "air":
            parts.air_conditioner(kit, spot @ Matrix.Translation((0, 0, 0.5 * height)))
        else:
            for column in (-0.36, 0.0, 0.36):
                shift = (column + kit.chance.uniform(-0.03, 0.03), 0, kit.chance.uniform(1.2, 2.0))
                wide = kit.chance.uniform(0.26, 0.36)
                where = spot @ Matrix.Translation(shift)
                parts.poster(kit, where, wide, kit.chance.choice(WORDS))


def _door(kit: Kit, place: Matrix) -> None:
    mesh, looks = kit.mesh, kit.looks
    mesh.place = place
    mesh.box((0, 0, 1.0), (0.9, 0.08, 2.06), looks["beam"])
    look = looks[kit.chance.choice(("teal", "red", "plank", "green", "blue"))]
    for board in range(5):
        mesh.box((-0.32 + 0.16 * board, -0.045, 0.98), (0.15, 0.03, 1.9), look)
    for z in (0.4, 1.5):
        mesh.box((0, -0.07, z), (0.76, 0.025, 0.09), looks["beam"])
    mesh.ball((0.3, -0.09, 1.0), 0.03, looks["chrome"], (8, 6))
    mesh.box((0, -0.15, 0.06), (1.0, 0.25, 0.12), looks["block"])


def _window(kit: Kit, place: Matrix, z: float) -> None:
    """Add a window: glass or a lit curtain in a frame, behind bars or beside shutters."""
    mesh, looks = kit.mesh, kit.looks
    mesh.place = place
    pane = looks["lit" if kit.chance.random() < 0.25 else "glass"]
    frame = looks[kit.chance.choice(("white", "teal", "beam", "green"))]
    mesh.box((0, 0.03, z), (0.6, 0.06, 0.75), pane)
    for side in (-1, 1):
        mesh.box((side * 0.32, 0, z), (0.07, 0.14, 0.88), frame)
        mesh.box((0, 0, z + side * 0.4), (0.7, 0.14, 0.07), frame)
    mesh.box((0, 0, z), (0.03, 0.08, 0.8), frame)
    mesh.box((0, -0.08, z - 0.46), (0.8, 0.24, 0.05), looks["block"])
    if kit.chance.random() < 0.5:
        for bar in range(6):
            mesh.box((-0.25 + 0.1 * bar, -0.09, z), (0.014, 0.014, 0.8), looks["rust"])
        for high in (-0.25, 0.25):
            mesh.box((0, -0.09, z + high), (0.66, 0.014, 0.014), looks["rust"])
    else:
        look = looks[kit.chance.choice(("green", "blue", "teal", "plank"))]
        for side in (-1, 1):
            for slat in range(8):
                spot = (side * 0.52, -0.05, z - 0.36 + 0.1 * slat)
                mesh.box(spot, (0.32, 0.05, 0.075), look)
    if kit.chance.random() < 0.4:
        awning = place @ Matrix.Translation((-0.45, -0.03, z + 0.6))
        slope = awning @ Matrix.Rotation(math.radians(-25), 4, "X")
        parts.corrugated(kit, slope @ Matrix.Translation((0, -0.45, 0)), 0.9, 0.45, "rust")


def _shutter(kit: Kit, place: Matrix) -> None:
    """Add a rolled-down steel shutter of a small shop, with its board above."""
    kit.mesh.place = place
    kit.mesh.box((0, 0, 1.0), (0.98, 0.06, 2.0), kit.looks["beam"])
    sideways = Matrix(((0, 1, 0, -0.44), (0, 0, 1, -0.05), (1, 0, 0, 0.1), (0, 0, 0, 1)))
    look = kit.chance.choice(("bluetin", "zinc", "greentin"))
    parts.corrugated(kit, place @ sideways, 1.8, 0.88, look, 0.09)
    colours = kit.chance.choice((("yellow", "red"), ("white", "blue"), ("red", "white")))
    word = kit.chance.choice(("TELE", "PAN", "FRUTA", "MOTO", "ARROZ", "AGUA"))
    parts.sign(kit, place @ Matrix.Translation((0, -0.07, 2.2)), word, (0.95, 0.3), colours)


def _roof(kit: Kit, place: Matrix, width: float) -> None:
    """Add a roof of sheets that falls towards the alley, stones on it, perhaps a tank or a dish."""
    slope = place @ Matrix.Translation((-0.1, -0.12, 0.02)) @ Matrix.Rotation(0.14, 4, "X")
    x = 0.0
    while x < width + 0.1:
        wide = min(0.8, width + 0.2 - x)
        lift = kit.chance.uniform(0, 0.03)
        where = slope @ Matrix.Translation((x, -kit.chance.uniform(0, 0.1), lift))
        look = kit.chance.choices(TIN, (4, 6, 1, 1, 1))[0]
        parts.corrugated(kit, where, wide + 0.06, 3.2, look, 0.12)
        x += wide
    for _ in range(int(width)):
        spot = (kit.chance.uniform(0, width), kit.chance.uniform(0.1, 1.5), 0.13)
        kit.mesh.place = slope
        kit.mesh.ball(spot, kit.chance.uniform(0.07, 0.12), kit.looks["block"], (7, 5))
    for thing, chance in ((parts.water_tank, 0.3), (parts.dish, 0.55), (parts.tyre, 0.4)):
        if kit.chance.random() < chance:
            y = 0.1 if thing is parts.dish else kit.chance.uniform(0.7, 1.6)
            z = 0.55 if thing is parts.dish else 0.14 * y
            thing(kit, place @ at(kit.chance.uniform(0.4, width - 0.4), y, z))


def _stair(kit: Kit) -> None:
    """Add the stair that goes on where the first alley ends, with rails and a landing."""
    chance, mesh = kit.chance, kit.mesh
    for step in range(16):
        mesh.place = Matrix.Identity(4)
        z, y = 0.175 * (step + 1), 4.45 + 0.29 * step
        mesh.box((-0.26, y + 0.3, z / 2), (1.7, 0.6, z), kit.looks["block"])
        mesh.box((-0.26, y + 0.02, z - 0.02), (1.7, 0.08, 0.05), kit.looks["lime"])
        if step % 3 == 1:
            x = chance.choice((-0.95, 0.42))
            look = chance.choice(("red", "blue", "ochre"))
            parts.bucket(kit, at(x, y + 0.15, z), look, 0.26)
    mesh.place = Matrix.Identity(4)
    mesh.box((-0.26, 10.5, 1.4), (1.7, 3.6, 2.8), kit.looks["block"])
    mesh.tube([(0.48, 4.5, 1.0), (0.48, 9.0, 3.75)], 0.022, kit.looks["rust"], 6)
    for post in range(8):
        y = 4.6 + 0.6 * post
        low = 0.175 * (1 + (y - 4.45) // 0.29)
        high = 1.0 + 2.75 * (y - 4.5) / 4.5
        mesh.tube([(0.48, y, low), (0.48, y, high)], 0.014, kit.looks["rust"], 5)


def _hill(kit: Kit) -> None:
    """Pile small houses up the hill beyond the stair, and behind the end of the second alley."""
    chance = kit.chance
    skins = ("brick", "ochre", "rose", "turquoise", "lime", "block", "brick")
    for row in range(8):
        for column in range(17):
            x = -15.0 + 2.9 * column + chance.uniform(-0.5, 0.5)
            y, z = 12.6 + 2.2 * row, 0.3 + 0.8 * row + 0.06 * column
            wide, tall = chance.uniform(2.2, 3.2), chance.uniform(2.2, 3.4)
            kit.mesh.place = at(x, y, 0, chance.uniform(-6, 6))
            skin = kit.looks[chance.choice(skins)]
            kit.mesh.box((0, 1.3, (z + tall) / 2), (wide, 2.6, z + tall), skin)
            for spot in (-0.28, 0.28):
                pane = kit.looks["lit" if chance.random() < 0.12 else "black"]
                where = (spot * wide, -0.02, z + tall - 1.1)
                kit.mesh.box(where, (0.6, 0.06, 0.8), pane)
                kit.mesh.box((where[0], -0.1, where[2] - 0.5), (0.8, 0.2, 0.08), kit.looks["lime"])
            cover = kit.looks[chance.choice(("rust", "zinc", "rust", "redtin"))]
            kit.mesh.box((0, 1.2, z + tall + 0.06), (wide + 0.4, 3.0, 0.1), cover)
            if chance.random() < 0.3:
                parts.water_tank(kit, at(x, y + 1.0, z + tall))
