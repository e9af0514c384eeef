"""An old village at a pond in late-afternoon light: nearly everything stands still.

The camera pushes in, rises and pans so gently that hardly anything is uncovered; what there is to
see is texture: tiles, stones, straw, timber, grass and leaves. A few small things move.
"""

from __future__ import annotations

import math
import random

import village_houses
import village_land
import village_looks
import village_yards
from stage import looks, motion
from stage.blender import bpy, mathutils
from stage.meshes import MeshBuilder, lettering
from stage.options import main
from stage.quality import Quality
from stage.shooting import Script
from village_land import WATER

Matrix, Vector = mathutils.Matrix, mathutils.Vector
Materials = dict[str, bpy.types.Material]
UPRIGHT = Matrix.Rotation(math.pi / 2, 4, "X")
TREES = (
    *((-24, -5.5, 6.5), (24, -3, 6.5), (19, -8.5, 3.6), (-31, -2, 8), (33, 3, 8)),
    *((-17.5, 10.5, 6), (-7.2, 11, 7.5), (-30, 12, 7), (9, 26, 8), (8.5, -0.8, 3.6), (-18, 22, 8)),
    *((22, 17, 8), (-4, 22, 8), (24, 21, 8.5), (-17, 27, 4.5), (10.5, 13.5, 5), (-9, 24, 8)),
    *((34, 16, 8), (-38, 22, 9), (12, 34, 8), (-28, 30, 8), (38, 26, 9), (6, 25, 4), (21, 33, 8)),
    *((-12, 36, 9), (3, 38, 8), (30, 36, 9), (-34, 38, 9), (-44, 12, 8), (44, 14, 9), (40, 40, 9)),
)


def build(seed: int, last: int) -> dict[int, str]:
    """Build the scene; return what each object id is."""
    chance = random.Random(seed)
    made = village_looks.palette()
    looks.backdrop((0.10, 0.25, 0.62), (0.62, 0.70, 0.80), 0.8, (1.75, 1.55, 1.3))
    motion.sunlight((0.78, 0.5, -0.5), 4.6, (1.0, 0.84, 0.64), 0.6)
    village_land.ground(made)
    village_land.roads(made, chance)
    village_land.bridge(made, chance)
    village_land.reeds(made, chance)
    for house in village_houses.HOUSES:
        village_houses.cottage(house, made, chance)
    kept = [(*h.spot, 0.45 * h.size[0]) for h in village_houses.HOUSES]
    village_land.grass(made, chance, kept)
    village_land.trees(made, chance, TREES)
    village_yards.build(made, chance)
    bell = village_houses.church(made)
    _sails(made, village_houses.mill(made), last)
    _weathercock(made, last)
    _birds(made, last)
    _sign(made, last)
    _boat(made, last)
    _ducks(made, last)
    _bell(made, bell, last)
    _camera(last)
    names = ("windmill sails", "weathercock", "birds", "inn sign", "boat", "ducks", "church bell")
    return dict(enumerate(names, 1))


def _camera(last: int) -> None:
    """Push in and rise a little, while the pan does most of the motion: it uncovers nothing."""

    def pose(t: float) -> tuple[Vector, motion.Euler]:
        go = 0.12 * t + motion.ramp(t, 0.3, 2.4)
        at = Vector((-0.8 + 0.1 * go, -42.0 + 1.9 * go, 10.6 + 0.45 * go))
        pan = math.radians(-5.6 + 0.7 * t + 7.2 * motion.ramp(t, 0.65, 1.95))
        tilt = math.radians(-7.2 - 0.4 * go)
        ahead = Vector((math.sin(pan), math.cos(pan), math.tan(tilt)))
        return at, motion.looking(at + ahead, at)

    motion.film(pose, last, 51.0)


def _sails(made: Materials, hub: tuple[float, float, float], last: int) -> None:
    mesh = MeshBuilder()
    for arm in range(4):
        mesh.place = Matrix.Rotation(math.pi / 2 * arm, 4, "Y")
        mesh.box((0, 0, 4.2), (0.5, 0.12, 8.4), made["beam"])
        mesh.box((1.05, 0, 5.0), (1.7, 0.12, 6.4), made["canvas"])
    mesh.place = Matrix.Identity(4)
    mesh.ball((0, -0.1, 0), 0.55, made["iron"], (12, 8))
    sails = mesh.object("sails", 1)
    motion.keyed(sails, lambda t: (hub, (0, 0.3 + 0.5 * t + 0.06 * math.sin(2.4 * t), 0)), last)


def _weathercock(made: Materials, last: int) -> None:
    """Add a brass cock on the inn's ridge that turns to and fro in the wind."""
    inn = village_houses.INN
    foot = village_houses.built(inn) @ Vector((2.6, 0, inn.ridge))
    pole = MeshBuilder()
    pole.tube([foot, foot + Vector((0, 0, 1.5))], 0.05, made["iron"], 6)
    for axis in (Vector((0.5, 0, 0)), Vector((0, 0.5, 0))):
        middle = foot + Vector((0, 0, 0.9))
        pole.tube([middle - axis, middle + axis], 0.035, made["iron"], 5)
    pole.object("pole")
    mesh = MeshBuilder()
    spine = [(-0.5, 0, 0.25), (-0.2, 0, 0.15), (0.1, 0, 0.18), (0.35, 0, 0.4), (0.42, 0, 0.62)]
    mesh.tube(spine, (0.06, 0.2, 0.24, 0.13, 0.08), made["brass"], 10)
    mesh.ball((0.45, 0, 0.68), 0.13, made["brass"], (12, 8))
    for x, z in ((-0.75, 0.75), (-0.9, 0.5), (-0.8, 0.25)):
        mesh.tube([(-0.35, 0, 0.22), (x, 0, z)], (0.06, 0.1), made["brass"], 8)
    mesh.tube([(0.55, 0, 0.66), (0.7, 0, 0.62)], (0.06, 0.01), made["brass"], 6)
    mesh.tube([(0.38, 0, 0.78), (0.48, 0, 0.86)], (0.09, 0.03), made["red"], 6)
    top = foot + Vector((0, 0, 1.45))
    motion.keyed(
        mesh.object("weathercock", 2),
        lambda t: (top, (0, 0, 0.3 + 0.55 * math.sin(1.9 * t - 0.4) + 0.12 * math.sin(5.1 * t))),
        last,
    )


def _birds(made: Materials, last: int) -> None:
    """Add two gliding birds, small against sky and hills."""
    mesh = MeshBuilder()
    mesh.tube([(0, -0.5, 0), (0, -0.1, 0), (0, 0.35, 0.03)], (0.03, 0.12, 0.04), made["black"], 8)
    for side in (-1, 1):
        wing = [(0, 0.15, 0.05), (0, -0.2, 0.05), (side * 0.6, -0.05, 0.2), (side * 0.6, 0.2, 0.2)]
        mesh.faces(wing, [(0, 1, 2, 3)], made["iron"])
        tip = [wing[3], wing[2], (side * 1.2, -0.15, 0.1)]
        mesh.faces(tip, [(0, 1, 2)], made["slate2"])
    mesh.faces([(0, -0.4, 0), (-0.16, -0.75, 0), (0.16, -0.75, 0)], [(0, 1, 2)], made["iron"])
    first = mesh.object("bird 1", 3)
    second = bpy.data.objects.new("bird 2", first.data)
    second.pass_index = 3
    bpy.context.scene.collection.objects.link(second)
    for bird, centre, phase in ((first, (-9, 34, 15.5), 3.7), (second, (3, 42, 18.5), 4.2)):

        def pose(t: float, centre=centre, phase=phase) -> tuple[Vector, tuple]:
            turn = phase + 0.36 * t + 0.05 * math.sin(2.1 * t)
            out = Vector((12 * math.cos(turn), 12 * math.sin(turn), 0.5 * math.sin(1.7 * t)))
            return Vector(centre) + out, (0.05 * math.sin(2 * t), -0.4, turn)

        motion.keyed(bird, pose, last)


def _sign(made: Materials, last: int) -> None:
    """Add the inn's sign, which swings below its bracket at the corner."""
    inn = village_houses.INN
    wide, deep, _ = inn.size
    place = village_houses.built(inn)
    corner = place @ Vector((wide / 2 - 0.1, -deep / 2 + 0.2, 4.3))
    reach = place @ Vector((wide / 2 + 1.9, -deep / 2 - 0.1, 4.3))
    arm = MeshBuilder()
    arm.tube([corner, reach], 0.06, made["iron"], 6)
    arm.tube([corner - Vector((0, 0, 0.9)), corner.lerp(reach, 0.7)], 0.04, made["iron"], 6)
    arm.object("bracket")
    mesh = MeshBuilder()
    for x in (-0.45, 0.45):
        mesh.box((x, 0, -0.12), (0.05, 0.05, 0.26), made["iron"])
    mesh.box((0, 0, -0.75), (1.35, 0.1, 1.05), made["oak"])
    mesh.box((0, -0.04, -0.75), (1.2, 0.08, 0.9), made["green"])
    mesh.ball((0, -0.05, -0.92), 0.22, made["brass"], (14, 8))
    board = mesh.object("sign", 4)
    letters = lettering("SWAN", Matrix.Translation((0, -0.1, -0.52)) @ UPRIGHT, 0.4, made["yellow"])
    letters.parent, letters.pass_index = board, 4
    middle = corner.lerp(reach, 0.58)
    turn = math.radians(inn.turn)
    motion.keyed(board, lambda t: (middle, (0.34 * math.sin(4.4 * t + 0.5), 0, turn)), last)


def _boat(made: Materials, last: int) -> None:
    """Add a rowing boat adrift on the pond."""
    mesh = MeshBuilder()
    stations = ((-1.4, 0.42), (-0.8, 0.58), (0, 0.64), (0.8, 0.5), (1.35, 0.2), (1.6, 0.02))
    rings = ((0.45, -0.12), (0.85, 0.1), (1.0, 0.42), (0.93, 0.42), (0.75, 0.12), (0.4, -0.04))
    for side in (-1, 1):
        points = [
            (x, side * wide * share, z + 0.07 * abs(x) * (z > 0.3))
            for x, wide in stations
            for share, z in rings
        ]
        for r in range(len(rings) - 1):
            strip = [(c * 6 + r, c * 6 + r + 1, c * 6 + r + 7, c * 6 + r + 6) for c in range(5)]
            mesh.faces(points, strip, made[("blue", "white", "oak", "oak", "oak")[r]])
    floor = [(-1.4, -0.3, -0.03), (1.2, -0.1, -0.03), (1.2, 0.1, -0.03), (-1.4, 0.3, -0.03)]
    mesh.faces(floor, [(0, 1, 2, 3)], made["oak"])
    mesh.box((-1.4, 0, 0.18), (0.06, 0.8, 0.56), made["blue"])
    cover = [(x, side * 0.95 * wide, 0.44) for side in (-1, 1) for x, wide in stations]
    mesh.faces(cover, [(c, c + 1, c + 7, c + 6) for c in range(5)], made["canvas"])

    def pose(t: float) -> tuple[Vector, tuple]:
        where = Vector((1.4 - 0.34 * t - 0.05 * math.sin(2 * t), -12.6 + 0.12 * t, WATER + 0.1))
        return where, (0.03 * math.sin(2.6 * t), 0.02 * math.sin(2.1 * t), 2.75 + 0.14 * t)

    motion.keyed(mesh.object("boat", 5), pose, last)


def _ducks(made: Materials, last: int) -> None:
    """Add three ducks that paddle across the pond."""
    mesh = MeshBuilder()
    body = [(-0.38, 0, 0.2), (-0.25, 0, 0.1), (0, 0, 0.08), (0.2, 0, 0.1), (0.32, 0, 0.14)]
    mesh.tube(body, (0.02, 0.14, 0.2, 0.17, 0.05), made["white"], 10)
    mesh.tube(
        [(0.2, 0, 0.12), (0.28, 0, 0.3), (0.3, 0, 0.42)], (0.09, 0.06, 0.06), made["white"], 8
    )
    mesh.ball((0.32, 0, 0.45), 0.1, made["green"], (10, 7))
    mesh.tube([(0.38, 0, 0.43), (0.54, 0, 0.4)], (0.05, 0.03), made["yellow"], 6)
    for side in (-1, 1):
        mesh.tube([(-0.3, 0.12 * side, 0.18), (0.1, 0.17 * side, 0.14)], (0.03, 0.08), made["bark"])
    first = mesh.object("duck 1", 6)
    for number, (x, y, turn) in enumerate(
        ((-5.4, -11, 0.3), (-6.5, -10.5, 0.1), (-6.3, -11.9, 0.5))
    ):
        duck = first
        if number:
            duck = bpy.data.objects.new(f"duck {number + 1}", first.data)
            duck.pass_index = 6
            bpy.context.scene.collection.objects.link(duck)

        def pose(t: float, x=x, y=y, turn=turn, phase=1.3 * number) -> tuple[Vector, tuple]:
            way = 0.45 * t + 0.06 * math.sin(3.2 * t + phase)
            heading = turn + 0.25 * math.sin(1.2 * t + phase)
            where = Vector((x + way * math.cos(heading), y + way * math.sin(heading), WATER))
            return where, (0.05 * math.sin(6 * t + phase), 0, heading)

        motion.keyed(duck, pose, last)


def _bell(made: Materials, spot: tuple[float, float, float], last: int) -> None:
    mesh = MeshBuilder()
    rings = [(0, 0, z) for z in (0, -0.4, -0.7, -1.5, -2.0, -2.3)]
    mesh.tube(rings, (0.1, 0.12, 0.65, 0.85, 1.15, 1.35), made["brass"], 16)
    mesh.tube([(0, 0, -2.2), (0, 0, -2.6)], 0.2, made["iron"], 8)
    motion.keyed(mesh.object("bell", 7), lambda t: (spot, (0, 0.5 * math.sin(3.1 * t), 0)), last)


SCENE = Script(
    "village",
    "An old village at a pond: still, full of fine texture, a gentle camera.",
    build,
    seed=7,
    pace=4.3,
    clean=Quality(32, 3),
)

if __name__ == "__main__":
    main(SCENE)
