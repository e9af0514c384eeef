"""What stands still in the tropical scene: beach, sea, rocks, jetty, hut and distant shores."""

from __future__ import annotations

import math
import random
from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from stage import looks
from stage.blender import bpy, mathutils
from stage.meshes import MeshBuilder

Matrix, Vector = mathutils.Matrix, mathutils.Vector
Materials = dict[str, bpy.types.Material]
SEA = -0.5
"""Height of the water."""

WALKS = (
    ((0.2, 1.2), (1.3, 4.5), (3.1, 9.3)),
    ((-5.0, 6.0), (0.5, 6.9), (6.0, 6.2), (12.0, 7.6)),
    ((4.2, 9.0), (7.0, 7.6), (10.0, 8.0)),
)
"""Where people walked on the sand, as points of broken lines."""


def height(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return the height of the ground, without footprints."""
    fall = np.clip(y - 5.0, 0.0, 40.0)
    base = -0.11 * fall - 0.004 * fall**2
    dunes = 0.07 * np.sin(0.8 * x + 0.5 * y) + 0.05 * np.sin(1.7 * y - 0.9 * x + 1.0)
    ripples = 0.007 * np.sin(17.0 * y + 3.0 * np.sin(1.3 * x) + 5.0 * x)
    return base + dunes + ripples


def level(x: float, y: float) -> float:
    """Return the height of the ground at one place."""
    return float(height(np.float64(x), np.float64(y)))


def build(chance: random.Random) -> None:
    """Build everything that stands still but the trunks and limbs of plants."""
    coats = _palette()
    _ground(coats["sand"])
    _sea(coats["water"])
    _litter(coats, chance)
    _rocks(coats["rock"], chance)
    _jetty(coats, chance)
    _hut(coats, chance)
    _far_shore(coats, chance)


def _palette() -> Materials:
    return {
        "sand": _sand(),
        "water": _water(),
        "rock": _rock(),
        "planks": looks.wood("planks", (0.40, 0.30, 0.20)),
        "posts": looks.wood("posts", (0.24, 0.17, 0.11), along=2),
        "bamboo": looks.wood("bamboo", (0.52, 0.40, 0.18), along=2),
        "thatch": looks.wood("thatch", (0.46, 0.33, 0.16), along=1),
        "dark": looks.paint("dark", (0.03, 0.025, 0.02), 0.8),
        "lamp": looks.paint("lamp", (1.0, 0.55, 0.2), glow=3.0),
        "cloth": looks.checker("cloth", (0.70, 0.10, 0.06), (0.80, 0.70, 0.50), 0.12),
        "shell": looks.paint("shell", (0.86, 0.74, 0.64), 0.3),
        "star": looks.paint("star", (0.78, 0.22, 0.08), 0.7),
        "nut": looks.paint("nut", (0.22, 0.12, 0.06), 0.7),
        "hill": looks.paint("hill", (0.03, 0.09, 0.03)),
        "leaf": looks.paint("leaf", (0.15, 0.28, 0.07)),
        "hazy": looks.foliage("hazy", (0.20, 0.34, 0.40), (0.27, 0.42, 0.44)),
    }


def _sand() -> bpy.types.Material:
    """Pale sand with darker drift lines, wet towards the water."""
    material, nodes = looks.new("sand")
    where = nodes.spot()
    grain = nodes.noise(where, 22.0, 3.0)
    drift = nodes.noise(where, 1.3, 2.0)
    dry = nodes.mix(nodes.step(grain, 0.3, 0.7), (0.40, 0.30, 0.19), (0.66, 0.54, 0.37))
    dry = nodes.mix(nodes.step(drift, 0.5, 0.72), dry, (0.33, 0.25, 0.16))
    up = nodes.add("SeparateXYZ", {0: where}).outputs[2]
    edge = nodes.math("ADD", up, nodes.math("MULTIPLY", drift, 0.12))
    wet = nodes.step(edge, SEA + 0.24, SEA + 0.1)
    shade = nodes.mix(wet, dry, (0.17, 0.13, 0.09))
    rough = nodes.math("SUBTRACT", 0.9, nodes.math("MULTIPLY", wet, 0.72))
    bump = nodes.bump(nodes.math("MULTIPLY", grain, 0.6))
    looks.finish(nodes, shade, rough, normal=bump)
    return material


def _water() -> bpy.types.Material:
    """Sea from turquoise shallows to deep blue, with waves and a line of foam."""
    material, nodes = looks.new("water")
    where = nodes.spot()
    axes = nodes.add("SeparateXYZ", {0: where}).outputs
    near = nodes.add("Mapping", {0: where, 3: (0.35, 1.0, 1.0)}).outputs[0]
    waves = nodes.noise(near, 1.6, 3.0)
    swell = nodes.math("ADD", axes[1], nodes.math("MULTIPLY", waves, 5.0))
    shade = nodes.mix(nodes.step(axes[1], 9.0, 26.0), (0.10, 0.46, 0.42), (0.02, 0.20, 0.30))
    shade = nodes.mix(nodes.step(axes[1], 40.0, 160.0), shade, (0.012, 0.07, 0.17))
    crest = nodes.math("ABSOLUTE", nodes.math("SINE", nodes.math("MULTIPLY", swell, 0.55)))
    close = nodes.step(axes[1], 24.0, 10.0)
    foam = nodes.math("MULTIPLY", nodes.step(crest, 0.93, 1.0), close)
    shade = nodes.mix(foam, shade, (0.80, 0.84, 0.84))
    looks.finish(nodes, shade, 0.12, normal=nodes.bump(waves, 0.35))
    return material


def _rock() -> bpy.types.Material:
    """Dark rock with moss on what faces up."""
    material, nodes = looks.new("rock")
    where = nodes.spot()
    grain = nodes.noise(where, 5.0, 3.0)
    stone = nodes.mix(nodes.step(grain, 0.3, 0.7), (0.05, 0.05, 0.05), (0.30, 0.27, 0.24))
    normal = nodes.add("NewGeometry", {}).outputs["Normal"]
    up = nodes.add("SeparateXYZ", {0: normal}).outputs[2]
    moss = nodes.step(nodes.math("ADD", up, grain), 0.95, 1.25)
    shade = nodes.mix(moss, stone, (0.10, 0.20, 0.03))
    looks.finish(nodes, shade, 0.8, normal=nodes.bump(grain))
    return material


def _axis(low: float, fine: tuple[float, float], high: float) -> np.ndarray:
    """Return coordinates close together within `fine` and far apart outside."""
    before = low + (fine[0] - low) * np.linspace(0, 1, 14, endpoint=False) ** 0.6
    middle = np.arange(fine[0], fine[1], 0.065)
    after = fine[1] + (high - fine[1]) * np.linspace(0, 1, 14) ** 1.7
    return np.concatenate([before, middle, after])


def _ground(coat: bpy.types.Material) -> None:
    x, y = np.meshgrid(_axis(-90, (-5.0, 13.0), 90), _axis(-30, (0.0, 10.0), 45))
    z = height(x, y)
    for foot, heading in _footprints():
        ahead = (x - foot[0]) * math.cos(heading) + (y - foot[1]) * math.sin(heading)
        aside = (y - foot[1]) * math.cos(heading) - (x - foot[0]) * math.sin(heading)
        away = (ahead / 0.15) ** 2 + (aside / 0.075) ** 2
        z += 0.03 * np.exp(-((away - 1.6) ** 2)) - 0.06 * np.exp(-(away**2))
    rows, columns = x.shape
    corner = np.arange(rows * columns).reshape(rows, columns)
    corners = (corner[:-1, :-1], corner[:-1, 1:], corner[1:, 1:], corner[1:, :-1])
    quads = np.stack(corners, axis=-1).reshape(-1, 4)
    mesh = bpy.data.meshes.new("ground")
    mesh.from_pydata(np.stack([x, y, z], axis=-1).reshape(-1, 3), [], quads)
    mesh.materials.append(coat)
    mesh.polygons.foreach_set("use_smooth", [True] * len(quads))
    mesh.update()
    bpy.context.scene.collection.objects.link(bpy.data.objects.new("ground", mesh))


def _footprints() -> list[tuple[tuple[float, float], float]]:
    """List footprints: where, and which way they point."""
    found = []
    for walk in WALKS:
        for start, end in pairwise(walk):
            way = Vector(end) - Vector(start)
            heading = math.atan2(way.y, way.x)
            for step in range(int(way.length / 0.36)):
                side = 0.13 if step % 2 else -0.13
                spot = Vector(start) + way.normalized() * 0.36 * step
                spot += Vector((-math.sin(heading), math.cos(heading))) * side
                found.append((tuple(spot), heading))
    return found


def _sea(coat: bpy.types.Material) -> None:
    mesh = MeshBuilder()
    mesh.faces([(-1900, 4, SEA), (1900, 4, SEA), (1900, 1950, SEA), (-1900, 1950, SEA)],
               [(0, 1, 2, 3)], coat)  # fmt: skip
    mesh.object("sea")


def _litter(coats: Materials, chance: random.Random) -> None:
    """Scatter shells, starfish, coconuts and a stranded log."""
    mesh = MeshBuilder()
    for number in range(70):
        x, y = chance.uniform(-4, 13), chance.uniform(3.5, 9.5)
        size = chance.uniform(0.025, 0.06)
        turn = Matrix.Rotation(chance.uniform(0, 6.3), 4, "Z")
        mesh.place = Matrix.Translation((x, y, level(x, y) + 0.4 * size)) @ turn
        if number % 9 == 0:
            for arm in range(5):
                a = 2 * math.pi * arm / 5
                end = (0.14 * math.cos(a), 0.14 * math.sin(a), 0)
                mesh.tube([(0, 0, 0.01), end], (0.045, 0.012), coats["star"], 6)
        elif number % 7 == 0:
            mesh.ball((0, 0, 0.06), 0.11, coats["nut"], (12, 8))
        else:
            mesh.tube([(0, 0, 0), (1.6 * size, 0, 0)], (size, 0.2 * size), coats["shell"], 8)
    mesh.place = Matrix.Identity(4)
    log = [(6.4, 7.1, -0.1), (7.4, 7.5, -0.08), (8.7, 7.6, -0.12), (9.2, 7.3, 0.12)]
    mesh.tube(log, (0.15, 0.17, 0.13, 0.05), coats["posts"], 10)
    mesh.object("litter")


def _rocks(coat: bpy.types.Material, chance: random.Random) -> None:
    spots = [(-3.4, 7.6, 0.8), (-4.5, 8.6, 1.2), (5.6, 5.4, 0.45), (8.2, 5.7, 0.6), (9.0, 5.2, 0.4)]
    spots += [(2.2, 5.0, 0.3), (-2.2, 6.1, 0.35), (14.5, 9.5, 1.3), (5.4, 11.3, 0.7)]
    spots += [(chance.uniform(-14, -5), chance.uniform(9, 16), 1.0) for _ in range(9)]
    for x, y, size in spots:
        mesh = MeshBuilder()
        mesh.ball((0, 0, 0), size, coat, (22, 14))
        rock = mesh.object("rock")
        a, b, c = (chance.uniform(0, 6.3) for _ in range(3))
        for vertex in rock.data.vertices:
            p = vertex.co / size
            bump = math.sin(2.6 * p.x + a) * math.sin(2.9 * p.y + b) + math.sin(4 * p.z + a)
            fine = math.sin(7 * p.x + 5 * p.y + c) * math.sin(8 * p.z - 4 * p.x + b)
            vertex.co *= 1.0 + 0.2 * bump + 0.07 * fine
        rock.location = (x, y, level(x, y) + 0.15 * size)
        rock.scale = (1.2, 0.95, 0.75)
        rock.rotation_euler = (0, 0, chance.uniform(0, 6.3))


def _jetty(coats: Materials, chance: random.Random) -> None:
    mesh = MeshBuilder()
    for step in range(52):
        y = 9.0 + 0.27 * step
        mesh.place = Matrix.Translation((3.1 + chance.uniform(-0.05, 0.05), y, 0.12))
        mesh.place @= Matrix.Rotation(chance.uniform(-0.03, 0.03), 4, "Z")
        mesh.box((0, 0, chance.uniform(-0.012, 0.012)), (1.7, 0.23, 0.06), coats["planks"])
    mesh.place = Matrix.Identity(4)
    for row in range(7):
        y = 9.6 + 2.2 * row
        for x in (2.3, 3.9):
            mesh.tube([(x, y, -3), (x, y, 0.75)], 0.085, coats["posts"], 10)
            mesh.ball((x, y, 0.76), 0.1, coats["planks"], (10, 6))
    for x in (2.3, 3.9):
        mesh.box((x, 16, 0.02), (0.1, 14.5, 0.14), coats["posts"])
        for row in range(6):
            y = 9.6 + 2.2 * row
            rope = [(x, y + 0.55 * s, 0.62 - 0.09 * s * (4 - s)) for s in range(5)]
            mesh.tube(rope, 0.022, coats["thatch"], 5)
    mesh.object("jetty")


def _slope(mesh: MeshBuilder, corners: Sequence[Sequence[float]], coats: Materials,
           chance: random.Random) -> None:  # fmt: skip
    """Cover a roof slope, given as eaves and ridge from left to right, with rows of thatch."""
    low_left, low_right, top_left, top_right = (Vector(corner) for corner in corners)
    for row in range(9):
        first, last = row / 9, (row + 1.6) / 9
        left, right = low_left.lerp(top_left, first), low_right.lerp(top_right, first)
        far_left, far_right = (
            low_left.lerp(top_left, min(1, last)),
            low_right.lerp(top_right, min(1, last)),
        )
        count = max(2, round((right - left).length / 0.13))
        for part in range(count):
            a, b = part / count, (part + 0.92) / count
            sag = Vector((0, 0, 0.05 + chance.uniform(-0.07, 0.02)))
            points = [left.lerp(right, a) + sag, left.lerp(right, b) + sag]
            points += [far_left.lerp(far_right, b), far_left.lerp(far_right, a)]
            mesh.faces(points, [(0, 1, 2, 3)], coats["thatch"])


def _hut(coats: Materials, chance: random.Random) -> None:
    """Add a hut of bamboo on stilts with a thatched roof, a porch and a lamp."""
    mesh = MeshBuilder()
    mesh.place = Matrix.Translation((10.6, 11.4, 0.45)) @ Matrix.Rotation(-0.3, 4, "Z")
    wide, deep = 1.7, 1.4
    for x in (-wide, 0, wide):
        for y in (-deep - 0.9, -deep, deep):
            mesh.tube([(x, y, -3), (x, y, 2.0)], 0.07, coats["posts"], 8)
    for step in range(16):
        mesh.box((-1.8 + 0.24 * step, -0.45, 0), (0.225, 3.9, 0.08), coats["planks"])
    mesh.box((0, 0, 1.0), (2 * wide - 0.1, 2 * deep - 0.1, 1.95), coats["dark"])
    for step in range(31):
        x = -wide + 2 * wide * step / 30
        low = 1.0 if 0.35 < abs(x + 0.1) < 1.1 and x < 0 else 0.0
        if not -0.3 < x < 0.5:
            mesh.tube([(x, -deep, low), (x, -deep, 2.0)], 0.052, coats["bamboo"], 7)
    for step in range(25):
        y = -deep + 2 * deep * step / 24
        for x in (-wide, wide):
            mesh.tube([(x, y, 0), (x, y, 2.0)], 0.055, coats["bamboo"], 7)
    mesh.box((1.0, -deep - 0.08, 0.75), (0.75, 0.03, 0.9), coats["cloth"])
    mesh.ball((-0.55, -deep - 0.7, 1.65), 0.13, coats["lamp"], (12, 8))
    out, top = 0.5, 3.4
    eaves = [(sx * (wide + out), sy * (deep + out + 0.5), 1.75) for sx in (-1, 1) for sy in (-1, 1)]
    left, right = (-0.7, 0, top), (0.7, 0, top)
    _slope(mesh, (eaves[0], eaves[2], left, right), coats, chance)
    _slope(mesh, (eaves[3], eaves[1], right, left), coats, chance)
    _slope(mesh, (eaves[1], eaves[0], left, left), coats, chance)
    _slope(mesh, (eaves[2], eaves[3], right, right), coats, chance)
    mesh.object("hut")


def _far_shore(coats: Materials, chance: random.Random) -> None:
    """Add wooded headlands on both sides and islands in the haze."""
    mesh = MeshBuilder()
    for number in range(150):
        side = -1 if number % 3 else 1
        share = chance.random() ** 1.3
        x = side * (14 + 26 * share) + chance.gauss(0, 2)
        y = 10 + 75 * (1 - share) * chance.random() if side < 0 else 15 + 55 * chance.random()
        x -= 6 if side < 0 else -14
        _crown(mesh, Vector((x, y, SEA)), chance.uniform(1.4, 3.6), coats, chance)
    mesh.object("headland")
    islands = MeshBuilder()
    for x, y, size in ((-240, 900, 95), (-120, 950, 60), (420, 1000, 120), (560, 1050, 80)):
        islands.ball((x, y, SEA - 0.45 * size), size, coats["hazy"], (40, 24))
    made = islands.object("islands")
    for vertex in made.data.vertices:
        wobble = math.sin(0.045 * vertex.co.x) + math.sin(0.11 * vertex.co.x + 1)
        vertex.co.z += 6.0 * wobble if vertex.co.z > 0 else 0.0


def _crown(
    mesh: MeshBuilder,
    foot: mathutils.Vector,
    size: float,
    coats: Materials,
    chance: random.Random,
) -> None:
    """Add a distant tree: a dark ball under loose leaves, some with a palm above it."""
    middle = foot + Vector((0, 0, 0.6 * size))
    mesh.ball(middle, 0.85 * size, coats["hill"], (9, 6))
    broad = 0.7 + 0.35 * size
    for _ in range(70):
        away = Vector([chance.gauss(0, 1) for _ in range(3)]).normalized()
        reach = size * chance.uniform(0.85, 1.12)
        one, two = (Vector([chance.gauss(0, 0.17) for _ in range(3)]) * broad for _ in range(2))
        for out in (away, Vector((-away.y, away.x, -away.z)), Vector((-away.z, away.x, away.y))):
            leaf = middle + out * reach
            corners = [leaf - one, leaf - two, leaf + one, leaf + two]
            mesh.faces(corners, [(0, 1, 2, 3)], coats["leaf"])
    if chance.random() < 0.3:
        top = middle + Vector((chance.uniform(-0.8, 0.8), 0, size + chance.uniform(1.5, 3.5)))
        mesh.tube([foot, top], (0.16, 0.1), coats["posts"], 6)
        for frond in range(9):
            turn = 0.7 * frond + chance.uniform(-0.2, 0.2)
            out = Vector((math.cos(turn), math.sin(turn), 0.0)) * 1.9
            across = Vector((-out.y, out.x, 0)) * 0.15
            half = top + 0.55 * out + Vector((0, 0, 0.35))
            tip = top + out - Vector((0, 0, chance.uniform(0.2, 0.9)))
            mesh.faces(
                [top, half - across, half + across, tip], [(0, 1, 2), (1, 3, 2)], coats["leaf"]
            )
