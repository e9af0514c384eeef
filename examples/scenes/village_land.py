"""The land of the village scene: terrain, pond, road, bridge, grass and trees."""

from __future__ import annotations

import itertools
import math
import random
from collections.abc import Sequence

import numpy as np
from stage.blender import bpy, mathutils
from stage.meshes import MeshBuilder

Matrix, Vector = mathutils.Matrix, mathutils.Vector
Materials = dict[str, bpy.types.Material]
Path = Sequence[tuple[float, float]]

WATER = -0.55
POND = (-3.0, -13.0, 10.2, 5.7)
STREAM: Path = ((-3.2, -9), (-3.2, -4), (-3.7, 2), (-5, 9), (-6, 16), (-4, 26), (-14, 40))
ROAD: Path = (
    *((13.5, -40), (13.2, -24), (11.6, -14), (8.4, -8.2), (4.4, -5), (0.5, -4.3)),
    *((-3.2, -4.2), (-7, -4.1), (-12, -3.4), (-19, -1.2), (-27, 1), (-42, 2)),
)
LANE: Path = ((9.6, -9.2), (10, -4), (9.8, 1), (9, 9), (10.6, 20), (7, 34), (3, 50), (-3, 70))
BUSHES: Path = (
    *((-15.5, 0.2), (-8.0, 1.2), (-26, 3.4), (-19.3, 4.1), (8.6, 3.4), (11.2, 1.7), (20.3, 0.4)),
    *((11.6, 12.5), (20.5, 9.5), (12.4, 18), (-17.5, 13.6), (-9.4, 13.2), (-1.9, 14.2), (7, 15)),
    *((20.3, -6.6), (17.5, -7.7), (29, -6.5)),
    *((-33, 6.5), (-10.6, 7.8), (6.4, 22), (13, 24), (-4.2, 27)),
)
BRIDGE = (-3.2, -4.2)
ARCH = (2.3, 1.95)
"""Half the span and the rise of the bridge's arch, from 1 m below the meadow."""


def smooth(value: np.ndarray | float, low: float, high: float) -> np.ndarray:
    """Map low..high to 0..1 with level ends."""
    share = np.clip((value - low) / (high - low), 0.0, 1.0)
    return share * share * (3 - 2 * share)


def away(x: np.ndarray, y: np.ndarray, path: Path) -> np.ndarray:
    """Return the distance from a path of straight parts."""
    found = np.full(np.broadcast(x, y).shape, 1e9)
    for (ax, ay), (bx, by) in itertools.pairwise(path):
        dx, dy = bx - ax, by - ay
        share = np.clip(((x - ax) * dx + (y - ay) * dy) / (dx * dx + dy * dy), 0, 1)
        found = np.minimum(found, np.hypot(x - ax - share * dx, y - ay - share * dy))
    return found


def shore(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return about how far a place is from the water, negative in it."""
    px, py, rx, ry = POND
    angle = np.arctan2((y - py) / ry, (x - px) / rx)
    wobble = 1 + 0.07 * np.sin(3 * angle + 0.6) + 0.04 * np.sin(7 * angle)
    pond = (np.hypot((x - px) / rx, (y - py) / ry) / wobble - 1) * ry
    return np.minimum(pond, away(x, y, STREAM) - 1.5)


def height(x: np.ndarray | float, y: np.ndarray | float) -> np.ndarray:
    """Return the height of the land: level at the village, hills behind it, a bed for water."""
    x, y = np.asarray(x, float), np.asarray(y, float)
    low = 0.16 * np.sin(0.31 * x + 1) * np.sin(0.27 * y) + 0.1 * np.sin(0.11 * x - 0.2 * y)
    roll = 0.55 + 0.3 * np.sin(0.021 * x + 0.9) + 0.15 * np.sin(0.053 * x + 0.02 * y)
    far = 22 * smooth(y, 120, 330) * (0.7 + 0.45 * np.sin(0.0115 * x + 2.2))
    sides = 0.02 * np.maximum(np.abs(x) - 20, 0) * smooth(y, 0, 40)
    land = low + 9 * smooth(y, 22, 110) * roll + far + sides
    return land + (-1.6 - land) * smooth(-shore(x, y), -1.3, 0.9)


def ground(looks: Materials) -> None:
    """Add terrain, finer near the camera, and water."""
    rows = [-42.0]
    while rows[-1] < 430:
        rows.append(rows[-1] + 0.34 + 0.012 * max(0.0, rows[-1] + 6))
    y = np.array(rows)[:, None]
    x = np.linspace(-1, 1, 221)[None, :] * (14 + 0.95 * np.maximum(y + 34, 0))
    y = np.broadcast_to(y, x.shape)
    points = np.stack([x, y, height(x, y)], -1)
    across = x.shape[1]
    near = MeshBuilder()
    for kind, first, last in (("grass", 0, 140), ("fields", 140, len(rows) - 1)):
        last = min(last, len(rows) - 1)
        cells = [
            (r * across + c, r * across + c + 1, (r + 1) * across + c + 1, (r + 1) * across + c)
            for r in range(last - first)
            for c in range(across - 1)
        ]
        near.faces(points[first : last + 1].reshape(-1, 3), cells, looks[kind], smooth=True)
    near.object("terrain")
    water = MeshBuilder()
    sheet = [(x, y, WATER) for x, y in ((-18, -22), (11, -22), (11, 30), (-18, 30))]
    water.faces(sheet, [(0, 1, 2, 3)], looks["water"])
    water.object("water")


def deck(x: float) -> float:
    """Return how far the road over the bridge lies above the meadow."""
    return 1.55 * float(smooth(-abs(x - BRIDGE[0]), -6.6, -0.6))


def roads(looks: Materials, chance: random.Random) -> None:
    """Add the road and the lane: verges, two ruts, a grassy crown."""
    mesh = MeshBuilder()
    columns = (-1.7, -1.25, -0.85, -0.4, 0.4, 0.85, 1.25, 1.7)
    kinds = [looks[n] for n in ("verge", "dirt", "rut", "crown", "rut", "dirt", "verge")]
    for path, wide in ((ROAD, 1.0), (LANE, 0.8)):
        points = []
        places = _paced([Vector((*p, 0)) for p in path], 0.4)
        for number, spot in enumerate(places):
            ahead = places[min(number + 1, len(places) - 1)] - places[max(number - 1, 0)]
            side = Vector((ahead.y, -ahead.x, 0)).normalized()
            raised = deck(spot.x) if path is ROAD else 0.0
            for column in columns:
                swing = 0.12 * chance.uniform(-1, 1) if abs(column) != 0.85 else 0.0
                p = spot + side * (column * wide + swing)
                base = max(float(height(p.x, p.y)), 0.0) if raised > 0.05 else height(p.x, p.y)
                dip = {0.85: -0.02, 1.7: 0.0}.get(abs(column), 0.05)
                points.append((p.x, p.y, float(base) + raised + 0.03 + dip))
        count = len(columns)
        strips = [
            (r * count + c, r * count + c + 1, (r + 1) * count + c + 1, (r + 1) * count + c)
            for r in range(len(places) - 1)
            for c in range(count - 1)
        ]
        mesh.faces(points, strips, kinds, smooth=True)
    mesh.object("roads")


def _paced(path: Sequence[Vector], pace: float) -> list[Vector]:
    """Round a path off and return points on it at about equal distances."""
    for _ in range(3):
        cut = [path[0]]
        for a, b in itertools.pairwise(path):
            cut += [a.lerp(b, 0.25), a.lerp(b, 0.75)]
        path = [*cut, path[-1]]
    found = [path[0]]
    for a, b in itertools.pairwise(path):
        steps = max(1, round((b - a).length / pace))
        found += [a.lerp(b, (step + 1) / steps) for step in range(steps)]
    return found


def bridge(looks: Materials, chance: random.Random) -> None:
    """Add the humped stone bridge: body with an arch, ring stones, parapets with copings."""
    mesh = MeshBuilder()
    half, rise = ARCH
    xs = [-6.4 + 0.2 * step for step in range(65)]

    def under(x: float) -> float:
        return -1.0 + rise * math.sqrt(max(0.0, 1 - (x / half) ** 2)) if abs(x) < half else -1.8

    for y in (-1.75, 1.75):
        for a, b in itertools.pairwise(xs):
            tops = [deck(x + BRIDGE[0]) + 0.5 for x in (a, b)]
            face = [(a, y, under(a)), (b, y, under(b)), (b, y, tops[1]), (a, y, tops[0])]
            mesh.faces(face, [(0, 1, 2, 3)], looks["stone"])
            inner = [
                (x, y - math.copysign(0.35, y), z - d)
                for x, y, z, d in (
                    (a, y, tops[0], 0.7),
                    (b, y, tops[1], 0.7),
                    (b, y, tops[1], 0),
                    (a, y, tops[0], 0),
                )
            ]
            mesh.faces(inner, [(0, 1, 2, 3)], looks["stone"])
    for step in range(36):
        first, second = (math.pi * (step + d) / 36 for d in (0, 1))
        vault = [
            (half * math.cos(a), y, -1 + rise * math.sin(a))
            for a in (first, second)
            for y in (-1.75, 1.75)
        ]
        mesh.faces(vault, [(0, 1, 3, 2)], looks["stone"])
    for step in range(25):
        angle = math.pi * (step + 0.5) / 25
        mesh.place = Matrix.Translation(
            (half * math.cos(angle), -1.76, -1 + rise * math.sin(angle))
        ) @ Matrix.Rotation(math.pi / 2 - angle, 4, "Y")
        mesh.box((0, 0, 0.17), (0.25, 0.16, 0.42), looks[chance.choice(("pale", "block"))])
    for side in (-1, 1):
        for x in xs[::2]:
            z = deck(x + BRIDGE[0]) + 0.53 + chance.uniform(-0.02, 0.03)
            slope = (deck(x + 0.2 + BRIDGE[0]) - deck(x - 0.2 + BRIDGE[0])) / 0.4
            mesh.place = Matrix.Translation((x, 1.58 * side, z)) @ Matrix.Rotation(
                -math.atan(slope), 4, "Y"
            )
            mesh.box((0, 0, 0), (0.4, 0.46, 0.14), looks[chance.choice(("pale", "block", "moss"))])
    made = mesh.object("bridge")
    made.location = (*BRIDGE, 0)


def open_land(x: float, y: float, houses: Sequence[tuple[float, float, float]]) -> bool:
    """Say whether grass may grow at a place: not in water, on roads or in houses."""
    if shore(np.array(x), np.array(y)) < 0.35 or away(np.array(x), np.array(y), ROAD) < 1.5:
        return False
    if away(np.array(x), np.array(y), LANE) < 1.3:
        return False
    return all(math.hypot(x - hx, y - hy) > reach for hx, hy, reach in houses)


def grass(
    looks: Materials, chance: random.Random, houses: Sequence[tuple[float, float, float]]
) -> None:
    """Add tufts of grass, more of them along roads and shores, and meadow flowers."""
    mesh = MeshBuilder()
    greens = [looks[name] for name in ("blade1", "blade2", "blade3", "blade4")]
    blooms = [looks[name] for name in ("red", "white", "yellow", "violet", "white")]
    for number in range(7500):
        y = -24 + 52 * chance.random() ** 1.4
        x = chance.uniform(-1, 1) * (16 + 0.62 * (y + 24))
        if not open_land(x, y, houses):
            continue
        spot = Vector((x, y, float(height(x, y)) - 0.02))
        size = chance.uniform(0.1, 0.22)
        for _ in range(5):
            lean = Vector((chance.gauss(0, 0.5), chance.gauss(0, 0.5), chance.uniform(0.6, 1.1)))
            foot = spot + Vector((chance.gauss(0, 0.1), chance.gauss(0, 0.1), 0))
            half = Vector((0.05, chance.uniform(-0.03, 0.03), 0))
            blade = [foot - half, foot + half, foot + lean * size]
            mesh.faces(blade, [(0, 1, 2)], chance.choice(greens))
        if number % 9 == 0:
            top = spot + Vector((0, 0, size + 0.08))
            petals = [
                top + Vector(d) * 0.08 for d in ((1, 0, 0), (0, 0.6, 1), (-1, 0, 0), (0, -0.6, -1))
            ]
            mesh.faces(petals, [(0, 1, 2, 3)], chance.choice(blooms))
    mesh.object("grass")


def reeds(looks: Materials, chance: random.Random) -> None:
    """Add reeds and stones at the shore, and lily pads."""
    mesh = MeshBuilder()
    for _ in range(1300):
        angle = chance.choice(
            (chance.gauss(2.6, 0.35), chance.gauss(0.4, 0.3), chance.gauss(4.6, 0.7))
        )
        px, py, rx, ry = POND
        reach = chance.gauss(1.0, 0.03)
        foot = Vector((px + rx * reach * math.cos(angle), py + ry * reach * math.sin(angle), -0.7))
        lean = Vector((chance.gauss(0, 0.1), chance.gauss(0, 0.06), chance.uniform(0.2, 0.42)))
        half = Vector((0.04, 0, 0))
        kind = looks[chance.choice(("blade1", "blade3", "blade4", "straw"))]
        mesh.faces([foot - half, foot + half, foot + lean], [(0, 1, 2)], kind)
    for _ in range(150):
        angle = chance.uniform(0, 2 * math.pi)
        where = (px + 1.03 * rx * math.cos(angle), py + 1.03 * ry * math.sin(angle))
        size = chance.uniform(0.1, 0.28)
        kind = looks[chance.choice(("pale", "block", "moss"))]
        mesh.ball((*where, max(WATER, float(height(*where)))), size, kind, (7, 5))
    for _ in range(75):
        x, y = chance.gauss(-8.3, 1.3), chance.gauss(-13.4, 0.9)
        size = chance.uniform(0.14, 0.3)
        rim = [
            (x + size * math.cos(0.5 + 0.7 * n), y + size * math.sin(0.5 + 0.7 * n), WATER + 0.012)
            for n in range(9)
        ]
        mesh.faces(rim, [tuple(range(9))], looks[chance.choice(("lily", "blade2"))])
        if chance.random() < 0.12:
            mesh.ball((x, y, WATER + 0.09), 0.09, looks[chance.choice(("white", "rose"))], (8, 5))
    mesh.object("reeds")


def _crown(
    name: str, looks: Materials, chance: random.Random, leaves: int, size: float
) -> bpy.types.Mesh:
    """Make a tree of height about 1 with single leaves, for instancing; remove its object."""
    mesh = MeshBuilder()
    bend = chance.uniform(-0.03, 0.03)
    mesh.tube([(0, 0, -0.05), (bend, 0, 0.3), (0, 0, 0.62)], (0.04, 0.026, 0.012), looks["bark"], 8)
    lumps = [(Vector((0, 0, 0.62)), 0.3)]
    for _ in range(9):
        turn, up = chance.uniform(0, 6.3), chance.uniform(0.4, 0.86)
        reach = 0.25 * math.sin(math.pi * min(1, (up - 0.2) / 0.8))
        lumps.append(
            (
                Vector((reach * math.cos(turn), reach * math.sin(turn), up)),
                chance.uniform(0.11, 0.2),
            )
        )
        mesh.tube([(0, 0, 0.25), lumps[-1][0]], (0.018, 0.005), looks["bark"], 5)
    greens = [looks[f"{name}{number}"] for number in (1, 2, 3)]
    for middle, reach in lumps:  # closed inside, or every gap between leaves would be a hole
        mesh.ball(middle, 0.93 * reach, looks[f"{name} core"], (12, 8))
    for _ in range(leaves):
        middle, reach = chance.choice(lumps)
        out = Vector([chance.gauss(0, 1) for _ in range(3)]).normalized()
        spot = middle + out * reach * chance.uniform(0.94, 1.03)
        one = (Vector([chance.gauss(0, 1) for _ in range(3)]).cross(out)).normalized() * size
        two = (one.cross(out).normalized() + out * chance.uniform(-0.3, 0.3)) * size * 0.55
        kind = chance.choice(greens)
        mesh.faces([spot - one, spot - two, spot + one, spot + two], [(0, 1, 2, 3)], kind)
    made = mesh.object(f"{name} tree")
    shared = made.data
    bpy.data.objects.remove(made)
    return shared


def trees(
    looks: Materials, chance: random.Random, near: Sequence[tuple[float, float, float]]
) -> None:
    """Add the named trees near the village, hedges and woods on the hills."""
    crowns = [_crown("leaf", looks, chance, 4200, 0.03) for _ in range(3)]
    crowns.append(_crown("apple", looks, chance, 2600, 0.034))
    wood = [_crown("wood", looks, chance, 420, 0.085) for _ in range(3)]
    for number, (x, y, tall) in enumerate(near):
        _plant(crowns[number % 4], (x, y), tall, chance)
    for x, y in BUSHES:
        bush = _plant(chance.choice(crowns), (x, y), chance.uniform(1.7, 2.6), chance)
        bush.location.z -= 0.42 * bush.scale.z
    for _ in range(240):
        row = chance.choice((46, 58, 76, 98, 130, 170, 215))
        x = chance.uniform(-1, 1) * (25 + 0.8 * row)
        y = row + 7 * math.sin(0.05 * x + row) + chance.gauss(0, 1.2)
        if away(np.array(x), np.array(y), LANE) < 3 or _kept_free(x, float(y)):
            continue
        tree = _plant(
            chance.choice(wood), (x, y), chance.uniform(2.2, 5.5 if row < 100 else 7.5), chance
        )
        tree.location.z -= 0.22 * tree.scale.z  # no gap below the crown


def _kept_free(x: float, y: float) -> bool:
    """Say whether a tree would hide the church or the windmill, seen from 38 m before the pond."""
    share = 0.0 if y < 40 else (x + 1) / (y + 38)
    return any(
        y < 1.15 * far and low < share < high
        for far, low, high in ((100, -0.14, -0.005), (90, 0.19, 0.33))
    )


def _plant(
    mesh: bpy.types.Mesh, spot: tuple[float, float], tall: float, chance: random.Random
) -> bpy.types.Object:
    """Plant a tree and return it."""
    made = bpy.data.objects.new("tree", mesh)
    made.location = (*spot, float(height(*spot)))
    made.rotation_euler = (0, 0, chance.uniform(0, 6.3))
    wide = tall * chance.uniform(0.9, 1.25)
    made.scale = (wide, wide, tall)
    bpy.context.scene.collection.objects.link(made)
    return made
