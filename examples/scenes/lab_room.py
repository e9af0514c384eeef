"""The laboratory's shell: floor, walls, windows, corridor, ceiling services and luminaires."""

from __future__ import annotations

import math
import random

from stage.blender import bpy, mathutils
from stage.meshes import MeshBuilder, lettering

Matrix, Vector = mathutils.Matrix, mathutils.Vector
Looks = dict[str, bpy.types.Material]

LEFT, RIGHT, NEAR, FAR, HIGH = -4.4, 4.4, -3.0, 12.0, 3.3
DOOR = (-1.0, 0.7, 2.3)
"""Left and right edge, and height, of the opening in the far wall."""

FAN = (2.35, 2.3, 0.58)
"""x, z and radius of the hole for the fan in the far wall."""

LUMINAIRES = (-1.75, 1.75)
LAMP_HIGH = 2.76


def upright(where: tuple[float, float, float], turn: float = 0.0) -> Matrix:
    """Return the place of letters or boards that stand at a spot; turn 0 faces -y."""
    stand = Matrix.Rotation(turn, 4, "Z") @ Matrix.Rotation(math.pi / 2, 4, "X")
    return Matrix.Translation(where) @ stand


def sign(text: str, place: Matrix, size: float, material: bpy.types.Material) -> bpy.types.Object:
    """Add letters that are nearly flat."""
    made = lettering(text, place, size, material)
    made.data.extrude, made.data.offset = 0.004, 0.02 * size
    return made


def build(looks: Looks, chance: random.Random) -> None:
    """Build the room."""
    shell = MeshBuilder()
    _floor(looks)
    _walls(shell, looks)
    _far_wall(shell, looks)
    _corridor(shell, looks)
    shell.object("shell")
    _outside(looks, chance)
    services = MeshBuilder()
    _ducts(services, looks)
    _trays(services, looks, chance)
    services.object("services")
    _luminaires(looks)
    _signs(looks)


def _floor(looks: Looks) -> None:
    ground = MeshBuilder()
    low, top = (-6.0, NEAR), (6.0, FAR + 4.2)
    corners = [(low[0], low[1], 0), (top[0], low[1], 0), (top[0], top[1], 0), (low[0], top[1], 0)]
    ground.faces(corners, [(0, 1, 2, 3)], looks["floor"])
    ground.object("floor")
    marks = MeshBuilder()
    for centre, size in (
        ((2.1, 5.3), (2.5, 0.16)),
        ((0.93, 6.6), (0.16, 2.76)),
        ((2.1, 7.9), (2.5, 0.16)),
        ((-0.15, 11.2), (2.3, 0.2)),
    ):
        marks.box((*centre, 0.002), (*size, 0.004), looks["hazard"])
    for x in (-0.62, 0.62):
        marks.box((x, 2.0, 0.0015), (0.07, 10.0, 0.003), looks["teal"])
    marks.object("floor marks")


def _walls(shell: MeshBuilder, looks: Looks) -> None:
    """Add the side walls; the right one has a strip of windows."""
    long, middle = FAR - NEAR, (FAR + NEAR) / 2
    wide = RIGHT - LEFT
    shell.box((LEFT - 0.1, middle, HIGH / 2), (0.2, long, HIGH), looks["wall"])
    shell.box((LEFT + 0.01, middle, 0.55), (0.03, long, 1.1), looks["dado"])
    shell.box((0, NEAR - 0.1, HIGH / 2), (wide, 0.2, HIGH), looks["wall"])
    shell.box((0, middle + 2, HIGH + 0.1), (12, long + 4, 0.2), looks["ceiling"])
    sill, lintel = 1.35, 2.45
    shell.box((RIGHT + 0.1, middle, sill / 2), (0.2, long, sill), looks["wall"])
    shell.box((RIGHT - 0.01, middle, 0.55), (0.03, long, 1.1), looks["dado"])
    over = HIGH - lintel
    shell.box((RIGHT + 0.1, middle, HIGH - over / 2), (0.2, long, over), looks["wall"])
    for y, wide in ((-1.0, 4.0), (11.6, 0.8)):
        shell.box((RIGHT + 0.1, y, (sill + lintel) / 2), (0.2, wide, lintel - sill), looks["wall"])
    shell.box((RIGHT - 0.06, 6.1, sill), (0.3, 10.4, 0.05), looks["white"])
    for number in range(8):
        y = 1.0 + 10.2 * number / 7
        shell.box((RIGHT + 0.08, y, (sill + lintel) / 2), (0.1, 0.09, lintel - sill), looks["grey"])
    for z in (sill + 0.05, 2.08, lintel - 0.04):
        shell.box((RIGHT + 0.08, 6.1, z), (0.08, 10.4, 0.06), looks["grey"])


def _far_wall(shell: MeshBuilder, looks: Looks) -> None:
    """Add the wall with the door opening and the fan's square hole."""
    left, right, head = DOOR
    x, z, radius = FAN
    y = FAR + 0.06

    def slab(low: tuple[float, float], top: tuple[float, float], look: str = "wall") -> None:
        middle = ((low[0] + top[0]) / 2, y, (low[1] + top[1]) / 2)
        shell.box(middle, (top[0] - low[0], 0.12, top[1] - low[1]), looks[look])

    slab((-6, 0), (left, HIGH))
    slab((left, head), (right, HIGH))
    slab((right, 0), (x - radius, HIGH))
    slab((x - radius, 0), (x + radius, z - radius))
    slab((x - radius, z + radius), (x + radius, HIGH))
    slab((x + radius, 0), (6, HIGH))
    for edge, inward in ((left, -1), (right, 1)):
        shell.box((edge + 0.06 * inward, FAR - 0.03, head / 2), (0.12, 0.1, head), looks["hazard"])
    width = right - left + 0.24
    shell.box(((left + right) / 2, FAR - 0.03, head + 0.07), (width, 0.1, 0.14), looks["hazard"])
    for centre, wide in (((LEFT + left) / 2 - 0.06, left - LEFT - 0.12), (2.6, 3.55)):
        shell.box((centre, FAR - 0.01, 0.55), (wide, 0.03, 1.1), looks["dado"])
    shell.box((x, FAR + 0.75, z), (2 * radius, 0.04, 2 * radius), looks["dark"])
    for side in (-1, 1):
        shell.box((x + side * radius, FAR + 0.4, z), (0.03, 0.7, 2 * radius), looks["duct"])
        shell.box((x, FAR + 0.4, z + side * radius), (2 * radius, 0.7, 0.03), looks["duct"])
        shell.box((x + side * radius, FAR - 0.02, z), (0.08, 0.07, 2 * radius + 0.1), looks["grey"])
        shell.box((x, FAR - 0.02, z + side * radius), (2 * radius, 0.07, 0.08), looks["grey"])
    for number in range(9):
        shell.box((-3.1, FAR - 0.03, 2.62 + 0.05 * number), (1.3, 0.05, 0.022), looks["steel"])


def _corridor(shell: MeshBuilder, looks: Looks) -> None:
    """Add what is behind the door: a bright passage with crates and a notice."""
    back = FAR + 3.4
    shell.box((0, back, HIGH / 2), (12, 0.1, HIGH), looks["wall"])
    shell.box((0, back - 0.06, 0.5), (12, 0.02, 1.0), looks["orange"])
    for x in (-4.0, 4.0):
        shell.box((x, FAR + 1.7, HIGH / 2), (0.1, 3.4, HIGH), looks["wall"])
    shell.box((-0.1, back - 0.1, 2.55), (2.4, 0.05, 0.16), looks["panel"])
    for x, z in ((-0.85, 0.3), (-0.35, 0.25), (-0.8, 0.8)):
        shell.box((x, back - 0.45, z), (0.45, 0.5, 0.5), looks["blue" if z < 0.3 else "yellow"])


def _outside(looks: Looks, chance: random.Random) -> None:
    """Add the evening behind the windows: a sky and blocks with lit rooms."""
    away = MeshBuilder()
    x = RIGHT + 9.0
    corners = [(x, -30, -8), (x, 60, -8), (x, 60, 14), (x, -30, 14)]
    away.faces(corners, [(0, 1, 2, 3)], looks["dusk"])
    y = -12.0
    while y < 46:
        wide, high = chance.uniform(1.2, 2.6), chance.uniform(1.5, 3.2)
        near = x - chance.uniform(1.0, 4.0)
        away.box((near, y, high / 2 - 1), (0.8, wide, high + 2), looks["dark"])
        for _ in range(9):
            spot = y + chance.uniform(-0.4, 0.4) * wide
            level = chance.uniform(0.9, max(1.1, high - 0.2))
            away.box((near - 0.41, spot, level), (0.02, 0.13, 0.16), looks["window"])
        y += wide + chance.uniform(-0.2, 0.9)
    away.object("outside")


def _ducts(services: MeshBuilder, looks: Looks) -> None:
    """Add the air duct with its seams and outlets, and bundles of pipes."""
    services.tube([(-3.15, NEAR, 2.82), (-3.15, FAR, 2.82)], 0.27, looks["duct"], 20)
    for number in range(13):
        y = NEAR + 0.6 + 1.15 * number
        services.tube([(-3.15, y, 2.82), (-3.15, y + 0.05, 2.82)], 0.285, looks["steel"], 20)
        if number % 3 == 1:
            services.box((-2.9, y + 0.5, 2.72), (0.12, 0.5, 0.26), looks["dark"])
            for slat in range(5):
                where = (-2.83, y + 0.5, 2.62 + 0.05 * slat)
                services.box(where, (0.03, 0.5, 0.018), looks["white"])
    for number, (look, radius) in enumerate(
        (("copper", 0.05), ("blue", 0.065), ("red", 0.045), ("chrome", 0.04))
    ):
        x = 2.85 + 0.19 * number
        services.tube([(x, NEAR, 2.98), (x, FAR, 2.98)], radius, looks[look], 12)
        drop = 8.6 + 0.3 * number
        services.tube([(x, drop, 2.98), (4.3, drop, 2.98)], 0.8 * radius, looks[look], 10)
        services.tube([(4.25, drop, 3.0), (4.25, drop, 0.9)], 0.8 * radius, looks[look], 10)
        services.ball((4.25, drop, 2.98), 0.07, looks[look], (10, 8))
    for number in range(9):
        y = NEAR + 1.2 + 1.7 * number
        services.box((3.14, y, 3.08), (0.85, 0.05, 0.04), looks["grey"])
        for x in (2.75, 3.53):
            services.box((x, y, 3.16), (0.03, 0.04, 0.3), looks["grey"])
    for y in (3.4, 9.3):
        services.tube([(LEFT, y, 3.12), (RIGHT, y, 3.12)], 0.045, looks["red"], 10)


def _trays(services: MeshBuilder, looks: Looks, chance: random.Random) -> None:
    """Add a cable tray along the room, full of sagging cables."""
    middle, long = (FAR + NEAR) / 2, FAR - NEAR
    for x in (-0.72, -0.22):
        services.box((x, middle, 2.95), (0.025, long, 0.09), looks["steel"])
    for number in range(42):
        services.box((-0.47, NEAR + 0.36 * number, 2.92), (0.5, 0.035, 0.02), looks["steel"])
    for number in range(7):
        x = -0.67 + 0.065 * number
        look = looks[("dark", "blue", "orange", "dark", "yellow", "dark", "teal")[number]]
        path = [
            (x + chance.uniform(-0.03, 0.03), NEAR + 0.75 * step, 2.955 + chance.uniform(0, 0.03))
            for step in range(21)
        ]
        services.tube(path, 0.02, look, 6)
    for number in range(8):
        for x in (-0.72, -0.22):
            where = (x, NEAR + 0.9 + 1.9 * number, 3.12)
            services.box(where, (0.015, 0.015, 0.36), looks["grey"])


def _luminaires(looks: Looks) -> None:
    """Add two rows of ceiling lights: panels that are seen, area lamps that light.

    The lamps stand in for the panels in reflections too, because only lamps are sampled.
    """
    long, middle = FAR - NEAR - 0.6, (FAR + NEAR) / 2
    frame, panels = MeshBuilder(), MeshBuilder()
    for x in LUMINAIRES:
        frame.box((x, middle, LAMP_HIGH + 0.06), (0.46, long, 0.07), looks["white"])
        for side in (-0.21, 0.21):
            frame.box((x + side, middle, LAMP_HIGH + 0.005), (0.04, long, 0.06), looks["white"])
        for number in range(11):
            y = middle - long / 2 + long * number / 10
            frame.box((x, y, LAMP_HIGH), (0.42, 0.16, 0.06), looks["white"])
            frame.tube([(x, y, LAMP_HIGH), (x, y, HIGH)], 0.012, looks["grey"], 6)
        panels.box((x, middle, LAMP_HIGH + 0.02), (0.38, long, 0.01), looks["panel"])
        data = bpy.data.lights.new("ceiling", "AREA")
        data.shape, data.size, data.size_y = "RECTANGLE", 0.36, long
        data.energy, data.color = 175.0, (1.0, 0.97, 0.90)
        lamp = bpy.data.objects.new("ceiling", data)
        lamp.location = (x, middle, LAMP_HIGH + 0.01)
        lamp.visible_camera = False
        bpy.context.scene.collection.objects.link(lamp)
    frame.object("luminaires")
    panels.object("panels").visible_glossy = False


def _signs(looks: Looks) -> None:
    boards = MeshBuilder()
    boards.box((-0.15, FAR - 0.03, 2.78), (2.5, 0.06, 0.42), looks["teal"])
    boards.box((0.0, FAR - 0.4, 2.52), (0.62, 0.05, 0.22), looks["dark"])
    boards.box((1.22, FAR - 0.02, 1.75), (0.62, 0.03, 0.62), looks["yellow"])
    boards.box((1.22, FAR - 0.02, 1.28), (0.62, 0.03, 0.22), looks["white"])
    boards.box((LEFT + 0.02, 10.6, 1.75), (0.03, 1.1, 0.7), looks["blue"])
    triangle = [(1.0, FAR - 0.05, 1.55), (1.44, FAR - 0.05, 1.55), (1.22, FAR - 0.05, 1.96)]
    boards.faces(triangle, [(0, 1, 2)], looks["black"])
    boards.object("boards")
    sign("LAB 04 ROBOTICS", upright((-0.15, FAR - 0.07, 2.77)), 0.27, looks["white"])
    sign("EXIT", upright((0.0, FAR - 0.43, 2.52)), 0.2, looks["green"])
    sign("!", upright((1.22, FAR - 0.06, 1.7)), 0.34, looks["yellow"])
    sign("CAUTION", upright((1.22, FAR - 0.05, 1.28)), 0.14, looks["red"])
    sign("EYE WASH", upright((LEFT + 0.05, 10.6, 1.75), math.pi / 2), 0.22, looks["white"])
    flat = Matrix.Translation((0.3, 4.55, 0.003))
    sign("KEEP CLEAR", flat, 0.26, looks["yellow"]).data.extrude = 0.001
