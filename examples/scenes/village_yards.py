"""What stands between the houses of the village scene: walls, fences, hay, well, cart, jetty."""

from __future__ import annotations

import itertools
import math
import random

import numpy as np
from stage.blender import bpy, mathutils
from stage.meshes import MeshBuilder
from village_land import LANE, away, height, shore

Matrix, Vector = mathutils.Matrix, mathutils.Vector
Materials = dict[str, bpy.types.Material]
Run = tuple[tuple[float, float], ...]

WALLS: tuple[Run, ...] = (
    ((12.2, -8.6), (16.5, -6.4), (23, -5.5), (31, -5)),
    ((12.0, -4.2), (12.2, 0.2)),
    ((-17.8, 1.2), (-21, 2.4), (-27, 4.2), (-36, 5)),
    ((12.2, 10), (12.8, 20), (20, 21.5), (30, 20)),
    ((-20, 36), (-8, 40), (0, 43)),
    ((11, 42), (24, 46), (44, 50)),
)
FENCES: tuple[Run, ...] = (
    ((-16.6, -0.4), (-11, -1.3), (-7.5, -1.2)),
    ((9.2, -16.5), (6.4, -13), (7.6, -10.6)),
    ((15.5, -16), (14.2, -11.5), (20, -10.6), (30, -11.5)),
    ((-1.6, 10.5), (4, 11.5), (7.3, 11.3)),
    ((-32, 16), (-24, 14.5), (-18, 13.5)),
    ((14, 36), (30, 39), (48, 41)),
)
STACKS = (
    *((19.5, -3.2, 1.5), (23.2, -1.6, 1.8), (27.3, -2.6, 1.5), (-22.5, -0.5, 1.5)),
    *((-31, 8, 1.8), (28, 34, 1.9), (36, 32, 2.1), (32, 40, 1.9), (-30, 44, 2.1)),
)


def build(looks: Materials, chance: random.Random) -> None:
    """Add all of it."""
    mesh = MeshBuilder()
    for run in WALLS:
        _wall(mesh, run, looks, chance)
    for run in FENCES:
        _fence(mesh, run, looks, chance)
    _jetty(mesh, looks, chance)
    mesh.object("walls and fences")
    for x, y, size in STACKS:
        _haystack((x, y), size, looks, chance)
    _well((7.4, -2.6), looks, chance)
    _cart((14.6, -3.4), looks, chance)
    _barrels(looks, chance)


def _steps(run: Run, pace: float) -> list[tuple[Vector, float]]:
    """Return places along a run, a pace apart, and the heading at each."""
    found = []
    for (ax, ay), (bx, by) in itertools.pairwise(run):
        length, turn = math.hypot(bx - ax, by - ay), math.atan2(by - ay, bx - ax)
        for step in range(round(length / pace)):
            share = step * pace / length
            x, y = ax + share * (bx - ax), ay + share * (by - ay)
            found.append((Vector((x, y, float(height(x, y)))), turn))
    return found


def _wall(mesh: MeshBuilder, run: Run, looks: Materials, chance: random.Random) -> None:
    """Lay a dry wall of single stones in four courses, with upright stones on top."""
    kinds = [looks[name] for name in ("pale", "block", "block", "moss", "slate3")]
    for course in range(5):
        for spot, turn in _steps(run, 0.42 if course < 4 else 0.24):
            slope = Matrix.Rotation(turn + chance.gauss(0, 0.05), 4, "Z")
            where = spot + Vector((chance.uniform(-0.08, 0.08), 0, 0.1 + 0.22 * course))
            mesh.place = (
                Matrix.Translation(where) @ slope @ Matrix.Rotation(chance.gauss(0, 0.06), 4, "Y")
            )
            size = (0.43, 0.5 - 0.04 * course + chance.uniform(-0.05, 0.05), 0.23)
            if course == 4:
                size = (0.16, 0.44, 0.3 + chance.uniform(-0.06, 0.06))
            mesh.box((0, 0, 0), size, chance.choice(kinds))
    mesh.place = Matrix.Identity(4)


def _fence(mesh: MeshBuilder, run: Run, looks: Materials, chance: random.Random) -> None:
    """Add a fence of upright boards, close together so that little is seen through it."""
    wood = [looks[name] for name in ("grey wood", "grey wood", "oak", "straw dark")]
    for number, (spot, turn) in enumerate(_steps(run, 0.27)):
        mesh.place = Matrix.Translation(spot) @ Matrix.Rotation(turn, 4, "Z")
        tall = 0.85 + chance.uniform(-0.05, 0.05)
        mesh.box((0, 0, tall / 2 - 0.1), (0.25, 0.06, tall + 0.2), chance.choice(wood))
        mesh.box((0, -0.05, 0.6), (0.28, 0.05, 0.1), looks["bark"])
        if number % 7 == 0:
            mesh.box((0, 0, 0.4), (0.16, 0.16, 1.25), looks["oak"])
    mesh.place = Matrix.Identity(4)


def _jetty(mesh: MeshBuilder, looks: Materials, chance: random.Random) -> None:
    for plank in range(15):
        x = 7.9 - 0.3 * plank
        wide = 1.5 + chance.uniform(-0.08, 0.08)
        mesh.box((x, -10.3, 0.02 + chance.uniform(0, 0.02)), (0.27, wide, 0.07), looks["grey wood"])
    for x in (7.4, 5.6, 3.75):
        for y in (-10.95, -9.65):
            mesh.tube([(x, y, -1.6), (x, y, 0.55)], 0.1, looks["oak"], 8)


def _haystack(
    spot: tuple[float, float], size: float, looks: Materials, chance: random.Random
) -> None:
    """Add a round stack with loose straws all over it."""
    mesh = MeshBuilder()
    profile = ((-0.2, 0.95), (0.3, 1.08), (0.8, 1.02), (1.2, 0.74), (1.5, 0.36), (1.66, 0.04))
    mesh.tube([(0, 0, z) for z, _ in profile], [r for _, r in profile], looks["hay"], 20)
    mesh.tube([(0, 0, 1.4), (0, 0, 1.95)], 0.035, looks["bark"], 5)
    for _ in range(900):
        z, turn = chance.uniform(0, 1.6), chance.uniform(0, 2 * math.pi)
        reach = 0.02 + float(np.interp(z, *zip(*profile, strict=True)))
        foot = Vector((reach * math.cos(turn), reach * math.sin(turn), z))
        side = Vector((-math.sin(turn), math.cos(turn), 0))
        tip = foot * 1.03 + side * chance.gauss(0, 0.1) - Vector((0, 0, chance.uniform(0.1, 0.26)))
        kind = looks[chance.choice(("straw", "straw pale", "straw dark", "straw"))]
        mesh.faces([foot - side * 0.03, foot + side * 0.03, tip], [(0, 1, 2)], kind)
    made = mesh.object("haystack")
    made.location = (*spot, float(height(*spot)))
    made.scale = (size, size, size)


def _well(spot: tuple[float, float], looks: Materials, chance: random.Random) -> None:
    """Add a well: ring of stones, two posts, a little tiled roof, windlass and bucket."""
    mesh = MeshBuilder()
    for course in range(4):
        for stone in range(14):
            turn = 2 * math.pi * (stone + 0.5 * (course % 2)) / 14
            mesh.place = Matrix.Rotation(turn, 4, "Z") @ Matrix.Translation(
                (0.85, 0, 0.1 + 0.24 * course)
            )
            kind = looks[chance.choice(("pale", "block", "moss"))]
            mesh.box((0, 0, 0), (0.3 + 0.06 * (course == 3), 0.39, 0.24), kind)
    mesh.place = Matrix.Identity(4)
    mesh.tube([(0, 0, 0.3), (0, 0, 0.34)], 0.75, looks["black"], 14)
    for x in (-0.85, 0.85):
        mesh.box((x, 0, 1.3), (0.15, 0.15, 2.2), looks["oak"])
    mesh.tube([(-1.05, 0, 1.6), (1.05, 0, 1.6)], 0.09, looks["oak"], 8)
    mesh.tube([(0, 0, 1.55), (0, 0, 1.2)], 0.02, looks["straw"], 5)
    mesh.tube([(0, 0, 0.9), (0, 0, 1.25)], (0.15, 0.19), looks["oak"], 10)
    for side in (-1, 1):
        base = [(x, y, z) for x in (-1.2, 1.2) for y, z in ((side * 0.95, 2.05), (0, 2.8))]
        mesh.faces(base, [(0, 1, 3, 2)], looks["beam"])
        for row in range(5):
            for column in range(8):
                x = -1.2 + 0.3 * column
                y = [side * 0.95 * (1 - (row + d) / 5) for d in (0, 1.1)]
                z = [2.05 + 0.75 * (row + d) / 5 + e for d, e in ((0, 0.08), (1.1, 0.02))]
                tile = [
                    (x, y[0], z[0]),
                    (x + 0.28, y[0], z[0]),
                    (x + 0.28, y[1], z[1]),
                    (x, y[1], z[1]),
                ]
                mesh.faces(tile, [(0, 1, 2, 3)], looks[f"tile{chance.randint(1, 4)}"])
    mesh.object("well").location = (*spot, float(height(*spot)))


def _cart(spot: tuple[float, float], looks: Materials, chance: random.Random) -> None:
    """Add a hay cart at rest on its shafts."""
    mesh = MeshBuilder()
    mesh.box((0, 0, 0.85), (2.6, 1.3, 0.1), looks["oak"])
    for side in (-1, 1):
        for rail in range(3):
            mesh.box((0, 0.68 * side, 1.02 + 0.22 * rail), (2.7, 0.06, 0.15), looks["oak"])
        for x in (-1.2, -0.4, 0.4, 1.2):
            mesh.box((x, 0.72 * side, 1.2), (0.08, 0.08, 0.8), looks["beam"])
        rim = [2 * math.pi * step / 20 for step in range(21)]
        points = [(0.62 * math.cos(a), 0.85 * side, 0.64 + 0.62 * math.sin(a)) for a in rim]
        mesh.tube(points, 0.06, looks["oak"], 6)
        for spoke in range(10):
            mesh.tube([(0, 0.85 * side, 0.64), points[2 * spoke]], 0.035, looks["straw dark"], 5)
        mesh.tube([(0, 0.7 * side, 0.64), (0, 0.95 * side, 0.64)], 0.12, looks["iron"], 8)
        mesh.tube([(1.2, 0.5 * side, 0.85), (3.4, 0.4 * side, 0.12)], 0.055, looks["oak"], 6)
    for _ in range(1500):
        x, y = chance.uniform(-1.3, 1.3), chance.uniform(-0.75, 0.75)
        top = 0.75 * (1 - (x / 1.7) ** 2) * (1 - (y / 1.1) ** 2)
        at = Vector((x, y, 1.25 + top * chance.uniform(0.6, 1.0)))
        one = Vector([chance.gauss(0, 0.13) for _ in range(3)])
        two = Vector([chance.gauss(0, 0.03) for _ in range(3)])
        kind = looks[chance.choice(("straw", "straw pale", "straw dark", "straw"))]
        mesh.faces([at - one, at - two, at + one, at + two], [(0, 1, 2, 3)], kind)
    made = mesh.object("cart")
    made.location = (*spot, float(height(*spot)))
    made.rotation_euler = (0, 0, -2.7)


def _barrels(looks: Materials, chance: random.Random) -> None:
    """Add barrels, a bench and sacks before the inn, logs by the first cottage."""
    mesh = MeshBuilder()
    for x, y in ((-1.2, 0.9), (-0.5, 0.7), (-0.9, 0.2), (12.8, -1.2)):
        base = float(height(x, y))
        rings = [(x, y, base + z) for z in (0, 0.3, 0.5, 0.7, 1.0)]
        mesh.tube(
            rings, (0.3, 0.38, 0.4, 0.38, 0.3), [looks["oak"], looks["bark"]], 14, smooth=False
        )
        for z in (0.22, 0.78):
            mesh.tube([(x, y, base + z), (x, y, base + z + 0.07)], 0.385, looks["iron"], 14)
    for row in range(4):
        for log in range(9 - row):
            x, z = -7.0 + 0.27 * (log + row / 2) - 1.0, 0.15 + 0.23 * row
            ends = [(x, 1.4, z), (x, 2.3, z)]
            mesh.tube(ends, chance.uniform(0.11, 0.14), [looks["bark"]], 8)
            mesh.tube([(x, 1.38, z), (x, 1.4, z)], 0.1, looks["straw"], 8)
    mesh.box((5.8, 0.75, 0.5), (1.9, 0.4, 0.08), looks["grey wood"])
    for x in (5.1, 6.5):
        mesh.box((x, 0.75, 0.22), (0.12, 0.36, 0.5), looks["grey wood"])
    for _ in range(70):
        x, y = chance.uniform(-18, 20), chance.uniform(-9, 0)
        if (
            float(shore(np.array(x), np.array(y))) < 0.6
            or float(away(np.array(x), np.array(y), LANE)) < 2
        ):
            continue
        size = chance.uniform(0.08, 0.2)
        mesh.ball(
            (x, y, float(height(x, y))), size, looks[chance.choice(("pale", "block"))], (7, 5)
        )
    mesh.object("barrels")
