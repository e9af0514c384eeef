"""The street of the town scene: paving, markings, lamps, lights, wires, trees and the skyline."""

from __future__ import annotations

import math
import random

from stage import looks
from stage.blender import bpy, mathutils
from stage.meshes import MeshBuilder
from town_houses import Materials

Matrix, Vector = mathutils.Matrix, mathutils.Vector
CROSS_Y = 20.0
"""Where the side street's middle lies; the main street's is x = 0."""

ROAD = (5.5, 5.0)
"""Half widths between the kerbs, of main and side street."""

KERB = 0.15


def asphalt(name: str) -> bpy.types.Material:
    """Worn asphalt with patches, cracks and a damp gleam in places."""
    material, nodes = looks.new(name)
    where = nodes.spot()
    grain = nodes.noise(where, 16.0, 2.0)
    wide = nodes.noise(where, 0.5, 3.0)
    shade = nodes.mix(grain, (0.06, 0.06, 0.065), (0.23, 0.225, 0.22))
    shade = nodes.mix(nodes.step(wide, 0.54, 0.56), shade, (0.075, 0.075, 0.08))
    away = nodes.math("ABSOLUTE", nodes.math("SUBTRACT", wide, 0.46))
    crack = nodes.math("MULTIPLY", nodes.math("LESS_THAN", away, 0.0035), 0.8)
    shade = nodes.mix(crack, shade, (0.02, 0.02, 0.02))
    rough = nodes.math("SUBTRACT", 0.8, nodes.math("MULTIPLY", nodes.step(wide, 0.5, 0.7), 0.45))
    looks.finish(nodes, shade, rough)
    return material


def flags(name: str) -> bpy.types.Material:
    """Pavement flags in two greys, stained."""
    material, nodes = looks.new(name)
    where = nodes.spot()
    inputs = {"Vector": where, "Color1": (0.42, 0.38, 0.33), "Color2": (0.30, 0.28, 0.26)}
    inputs |= {"Mortar": (0.10, 0.09, 0.08), "Scale": 1.0, "Mortar Size": 0.022}
    laid = nodes.add("TexBrick", inputs | {"Brick Width": 0.9, "Row Height": 0.6}).outputs[0]
    stain = nodes.step(nodes.noise(where, 2.2, 3.0), 0.45, 0.75)
    shade = nodes.mix(nodes.math("MULTIPLY", stain, 0.55), laid, (0.09, 0.08, 0.075))
    looks.finish(nodes, shade, 0.75)
    return material


def marking(name: str) -> bpy.types.Material:
    """White road paint, worn through in places."""
    material, nodes = looks.new(name)
    worn = nodes.step(nodes.noise(nodes.spot(), 7.0, 3.0), 0.52, 0.66)
    looks.finish(nodes, nodes.mix(worn, (0.78, 0.77, 0.73), (0.16, 0.16, 0.16)), 0.6)
    return material


def ground(made: Materials) -> None:
    """Lay roads, pavements with kerbs, markings and tram rails."""
    made["line"], made["steel"] = marking("line"), looks.paint("steel", (0.6, 0.6, 0.62), 0.2, 1.0)
    road, paving, kerb = asphalt("asphalt"), flags("flags"), looks.paint("kerb", (0.5, 0.47, 0.43))
    mesh = MeshBuilder()
    far = 1500.0
    plain = [(-far, -far, -0.05), (far, -far, -0.05), (far, far, -0.05), (-far, far, -0.05)]
    mesh.faces(plain, [(0, 1, 2, 3)], made["hill"])
    wide = [(-130, -70, 0), (130, -70, 0), (130, 130, 0), (-130, 130, 0)]
    mesh.faces(wide, [(0, 1, 2, 3)], road)
    for sx in (-1, 1):
        for sy in (-1, 1):
            x, y = sx * ROAD[0], CROSS_Y + sy * ROAD[1]
            long = (129 - ROAD[0], 85.0)
            middle = (x + sx * long[0] / 2, y + sy * long[1] / 2)
            mesh.box((*middle, KERB / 2 - 0.02), (*long, KERB), paving)
            mesh.box((x + sx * 0.12, middle[1], KERB / 2), (0.3, long[1], KERB), kerb)
            mesh.box((middle[0], y + sy * 0.12, KERB / 2 + 0.001), (long[0], 0.3, KERB), kerb)
    for x in (-1.75, 1.75):
        for rail in (-0.72, 0.72):
            mesh.box((x + rail, 25, 0.0), (0.09, 130, 0.02), made["steel"])
    _markings(mesh, made["line"])
    for x, y in ((-0.4, 6.0), (3.4, 16.5), (0.3, 31.0), (14.0, 20.4), (27.0, 19.5), (3.0, 2.5)):
        mesh.tube([(x, y, -0.02), (x, y, 0.008)], 0.36, made["grey"], 20)
    mesh.object("ground")


def _patch(
    mesh: MeshBuilder, x: float, y: float, size: tuple[float, float], line: bpy.types.Material
) -> None:
    dx, dy = size[0] / 2, size[1] / 2
    points = [(x - dx, y - dy), (x + dx, y - dy), (x + dx, y + dy), (x - dx, y + dy)]
    mesh.faces([(*point, 0.012) for point in points], [(0, 1, 2, 3)], line)


def _markings(mesh: MeshBuilder, line: bpy.types.Material) -> None:
    """Paint zebra crossings, stop lines, dashes and the edges of parking bays."""
    for side in (-1, 1):
        for bar in range(11):
            _patch(mesh, -5.0 + bar, CROSS_Y + side * 6.9, (0.5, 2.6), line)
        for bar in range(10):
            _patch(mesh, side * 7.4, CROSS_Y - 4.5 + bar, (2.6, 0.5), line)
        _patch(mesh, -side * 2.6, CROSS_Y + side * 9.2, (5.0, 0.35), line)
        _patch(mesh, side * 9.8, CROSS_Y + side * 2.5, (0.35, 4.6), line)
    for number in range(24):
        for y in (CROSS_Y + 11 + 4 * number, CROSS_Y - 11 - 4 * number):
            _patch(mesh, 0, y, (0.15, 2.0), line)
        for x in (12 + 4 * number, -12 - 4 * number):
            _patch(mesh, x, CROSS_Y, (2.0, 0.15), line)
            for side in (-1, 1):
                _patch(mesh, x, CROSS_Y + side * 3.1, (4.0, 0.08), line)
                _patch(mesh, x, CROSS_Y + side * 4.0, (0.08, 1.8), line)


def lamps(made: Materials) -> None:
    """Set street lamps, shared by all streets."""
    mesh = MeshBuilder()
    iron = made["black"]
    profile = (
        (0, 0.2),
        (0.5, 0.18),
        (0.6, 0.1),
        (1.4, 0.09),
        (1.5, 0.13),
        (1.6, 0.07),
        (5.2, 0.06),
    )
    mesh.tube([(0, 0, z) for z, _ in profile], [r for _, r in profile], iron, 10)
    for side in (-1, 1):
        arm = [(0, 0, 4.8), (0.35 * side, 0, 5.25), (0.8 * side, 0, 5.3)]
        mesh.tube(arm, 0.035, iron, 6)
        mesh.tube([(0.8 * side, 0, 5.3), (0.8 * side, 0, 5.1)], (0.06, 0.24), iron, 8)
        mesh.ball((0.8 * side, 0, 5.0), 0.19, made["lamp"], (12, 8))
    mesh.ball((0, 0, 5.3), 0.12, made["gold"], (10, 8))
    for number in range(34):
        angle, out = 2.4 * number, 0.05 + 0.045 * (number % 6)
        spot = (out * math.cos(angle), out * math.sin(angle), 3.16 - 0.5 * out)
        mesh.ball(spot, 0.07, made[("leaf", "red", "leaf", "white")[number % 4]], (6, 4))
    shape = shared(mesh, "lamp post")
    for number in range(7):
        for side in (-1, 1):
            for y in (CROSS_Y - 8.0 - 15 * number, CROSS_Y + 9.5 + 15 * number):
                place(shape, "lamp post", (side * 6.0, y, KERB))
            for x in (12.5 + 15 * number, -12.5 - 15 * number):
                place(shape, "lamp post", (x, CROSS_Y + side * 5.5, KERB), turn=math.pi / 2)


def shared(mesh: MeshBuilder, name: str) -> bpy.types.Mesh:
    """Return the mesh of a builder without an object, for several objects."""
    made = mesh.object(name)
    data = made.data
    bpy.data.objects.remove(made)
    return data


def place(
    mesh: bpy.types.Mesh,
    name: str,
    where: tuple[float, float, float] = (0, 0, 0),
    turn: float = 0.0,
    index: int = 0,
    parent: bpy.types.Object | None = None,
) -> bpy.types.Object:
    """Put an object that shares a mesh into the scene."""
    thing = bpy.data.objects.new(name, mesh)
    thing.location, thing.rotation_euler = where, (0, 0, turn)
    thing.pass_index, thing.parent = index, parent
    bpy.context.scene.collection.objects.link(thing)
    return thing


def signals(made: Materials) -> None:
    """Set traffic lights at the four corners, and signs with names of streets."""
    for sx in (-1, 1):
        for sy in (-1, 1):
            mesh = MeshBuilder()
            mesh.place = Matrix.Translation((sx * 6.0, CROSS_Y + sy * 5.5, KERB))
            mesh.tube([(0, 0, 0), (0, 0, 3.3)], 0.07, made["grey"], 8)
            for lamp, (z, colour) in enumerate(((3.2, "stop"), (2.9, "dim"), (2.6, "go"))):
                for turn in range(4):
                    mesh_turn = mesh.place
                    mesh.place = mesh.place @ Matrix.Rotation(turn * math.pi / 2, 4, "Z")
                    lit = (lamp == 0) == (turn % 2 == 1) and lamp != 1
                    glass = made[colour if lit else "black"]
                    mesh.tube([(0.1, 0, z), (0.2, 0, z)], 0.1, glass, 10)
                    mesh.place = mesh_turn
            mesh.box((0, 0, 2.9), (0.28, 0.28, 1.0), made["black"])
            mesh.box((0, -0.1, 1.2), (0.16, 0.16, 0.3), made["yellow"])
            mesh.box((0.0, 0.0, 2.15), (0.04, 0.9, 0.28), made["blue"])
            mesh.object("signal")


def furniture(made: Materials) -> None:
    """Add benches, hydrants, bins and bollards."""
    mesh = MeshBuilder()
    for x, y, quarter in ((7.3, 6.5, 1), (-7.3, 33, 3), (17.5, 27, 2), (31, 13, 0), (7.3, 36, 1)):
        mesh.place = Matrix.Translation((x, y, KERB)) @ Matrix.Rotation(quarter * 1.5708, 4, "Z")
        for slat in range(4):
            mesh.box((0, -0.2 + 0.13 * slat, 0.45), (1.8, 0.1, 0.05), made["brown"])
            mesh.box((0, -0.3, 0.55 + 0.13 * slat), (1.8, 0.05, 0.1), made["brown"])
        for side in (-0.8, 0.8):
            mesh.box((side, -0.05, 0.22), (0.08, 0.5, 0.44), made["black"])
    for x, y in ((6.1, 9.2), (-6.1, 30.5), (10.6, 14.4), (24, 25.7), (40, 14.4)):
        mesh.place = Matrix.Translation((x, y, KERB))
        rings = ((0, 0.19), (0.08, 0.19), (0.1, 0.13), (0.6, 0.13), (0.62, 0.17), (0.7, 0.15))
        mesh.tube([(0, 0, z) for z, _ in rings], [r for _, r in rings], made["red"], 12)
        mesh.ball((0, 0, 0.72), 0.14, made["red"], (12, 8))
        mesh.tube([(-0.25, 0, 0.45), (0.25, 0, 0.45)], 0.07, made["yellow"], 8)
    for x, y in ((6.3, 4.0), (9.4, 14.2), (19.5, 14.3), (14.5, 25.6), (-6.4, 12.0), (6.2, 29)):
        mesh.place = Matrix.Translation((x, y, KERB))
        mesh.tube([(0, 0, 0), (0, 0, 0.95)], (0.22, 0.27), made["green"], 12)
        mesh.tube([(0, 0, 0.95), (0, 0, 1.05)], (0.3, 0.2), made["black"], 12)
    for step in range(5):
        for x, y in ((5.9, 11.6 + 0.9 * step), (6.8 + 0.9 * step, 14.7), (5.9, 25.5 + step)):
            mesh.place = Matrix.Translation((x, y, KERB))
            mesh.tube([(0, 0, 0), (0, 0, 0.9)], 0.06, made["black"], 8)
            mesh.tube([(0, 0, 0.72), (0, 0, 0.82)], 0.065, made["white"], 8)
            mesh.ball((0, 0, 0.92), 0.09, made["black"], (8, 6))
    mesh.object("furniture")


def wires(made: Materials) -> None:
    """Hang the tram's wires along the main street and lines across both streets."""
    mesh = MeshBuilder()
    for x in (-1.75, 1.75):
        mesh.tube([(x, -40, 5.9), (x, 88, 5.9)], 0.022, made["black"], 4)
    for y in (-6, 5, 30, 44, 58, 72):
        for x in (-1.75, 1.75):
            mesh.tube([(x, y, 5.9), (x, y, 6.7)], 0.02, made["black"], 4)
        _slack(mesh, (-8.4, y, 7.6), (8.4, y, 7.6), 0.9, made)
    for x in (14, 30, 46, 62, 78):
        _slack(mesh, (x, 12, 7.4), (x, 28, 7.4), 0.8, made)
        mesh.tube([(x, 20, 6.6), (x, 20, 6.2)], (0.05, 0.3), made["black"], 8)
        mesh.ball((x, 20, 6.15), 0.2, made["lamp"], (12, 8))
    for z in (8.2, 8.6):
        _slack(mesh, (9.0, 12, z), (46, 12.2, z + 0.5), 1.3, made)
    mesh.object("wires")


def _slack(
    mesh: MeshBuilder,
    start: tuple[float, float, float],
    end: tuple[float, float, float],
    sag: float,
    made: Materials,
) -> None:
    one, two = Vector(start), Vector(end)
    path = [
        one.lerp(two, n / 12) - Vector((0, 0, 4 * sag * n / 12 * (1 - n / 12))) for n in range(13)
    ]
    mesh.tube(path, 0.018, made["black"], 4)


def trees(made: Materials, chance: random.Random) -> None:
    """Plant street trees; they share two meshes."""
    shapes = []
    for size in (1.5, 1.8):
        mesh = MeshBuilder()
        mesh.tube([(0, 0, 0), (0.05, 0, 1.5), (0, 0.05, 3.4)], (0.17, 0.12, 0.08), made["bark"], 8)
        for _ in range(3400):
            away = Vector([chance.gauss(0, 1) for _ in range(3)]).normalized()
            middle = Vector((0, 0, 3.6)) + away * chance.uniform(0.45, 1.0) * size
            middle.z += 0.25 * size * away.z
            one = Vector([chance.gauss(0, 0.075) for _ in range(3)])
            two = Vector([chance.gauss(0, 0.075) for _ in range(3)])
            leaf = [middle - one, middle - two, middle + one, middle + two]
            mesh.faces(leaf, [(0, 1, 2, 3)], made["leaf"])
        shapes.append(shared(mesh, "tree"))
    spots = [(side * 6.2, CROSS_Y + 17 + 15 * n) for n in range(4) for side in (-1, 1)]
    spots += [(20 + 15 * n, CROSS_Y + side * 5.6) for n in range(6) for side in (-1, 1)]
    spots += [(6.3, 1.0), (-6.3, 5.5), (-18, 25.6), (-33, 25.6)]
    spots += [(100 + chance.uniform(0, 14), CROSS_Y + 5.0 * n) for n in range(-5, 6)]
    for number, (x, y) in enumerate(spots):
        tree = place(shapes[number % 2], "tree", (x, y, KERB), chance.uniform(0, 6))
        tree.scale = (1, 1, chance.uniform(0.9, 1.2) * (1.7 if x > 95 else 1.0))


def skyline(made: Materials, chance: random.Random) -> None:
    """Close the far ends of the streets: hills, gasholders, chimneys and roofs."""
    mesh = MeshBuilder()
    for number in range(26):
        angle = math.radians(-40 + 7 * number)
        far = chance.uniform(420, 620)
        spot = (far * math.cos(angle), far * math.sin(angle), -60)
        mesh.ball(spot, chance.uniform(90, 145), made["hill"], (28, 18))
    for _ in range(36):
        x, y = 125 + chance.uniform(0, 120), CROSS_Y + chance.uniform(-90, 90)
        high = chance.uniform(6, 17)
        wall = made[chance.choice(("cream", "red brick", "grey stone", "rose"))]
        mesh.box((x, y, high / 2), (chance.uniform(8, 15), chance.uniform(8, 15), high), wall)
    mesh.tube([(210, 6, 0), (210, 6, 46)], (2.6, 1.7), made["red brick"], 14)
    mesh.tube([(160, 44, 0), (160, 44, 24)], 13.0, made["grey"], 28)
    mesh.ball((150, 16, 20), 8.0, made["copper"], (24, 14))
    mesh.box((150, 16, 10), (14, 14, 20), made["trim stone"])
    mesh.tube([(150, 16, 28), (150, 16, 34)], (0.9, 0.05), made["gold"], 8)
    mesh.object("skyline")
