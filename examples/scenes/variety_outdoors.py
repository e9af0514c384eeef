"""Places under the sky: streets, squares, land, woods, scaffolds, yards, harbours, ruins."""

from __future__ import annotations

import math
from itertools import pairwise

import variety_props as props
import variety_thin as thin
from stage.blender import mathutils
from stage.meshes import MeshBuilder
from variety_set import ALL, PLANTS, SOLID, THIN, Height, Set

Matrix, Vector = mathutils.Matrix, mathutils.Vector


def _house(scene: Set, mesh: MeshBuilder, size: tuple[float, float, float], looks: dict) -> None:
    """Build a house whose front is the plane y = 0, facing -y, at the mesh's place."""
    w, d, h = size
    chance = scene.chance
    wall = chance.choice(looks["walls"])
    mesh.box((0, d / 2, h / 2), (w, d, h), wall)
    mesh.box((0, d / 2, h + 0.1), (w + 0.3, d + 0.4, 0.25), looks["suit"][3])
    floors, columns = max(1, round(h / 3)), max(2, round(w / scene.within(1.4, 2.2)))
    for level in range(1, floors):
        z = h * level / floors
        mesh.box((0, -0.05, z), (w, 0.12, 0.15), looks["suit"][1])
        for column in range(columns):
            x = w * ((column + 0.5) / columns - 0.5)
            pane = looks["lit"] if chance.random() < looks["share"] else looks["pane"]
            mesh.box((x, -0.02, z + 1.4), (0.9, 0.1, 1.3), looks["suit"][0])
            mesh.box((x, -0.06, z + 1.4), (0.75, 0.06, 1.15), pane)
            mesh.box((x, -0.09, z + 1.4), (0.05, 0.04, 1.15), looks["suit"][0])
    mesh.box((0.2 * w, -0.03, 1.1), (1.1, 0.1, 2.2), looks["suit"][2])
    mesh.box(
        (-0.15 * w, -0.05, 1.3),
        (0.5 * w, 0.08, 1.7),
        looks["lit" if looks["share"] > 0.3 else "pane"],
    )
    if chance.random() < 0.75:
        mesh.box((-0.1 * w, -0.1, 2.6), (0.6 * w, 0.1, 0.6), chance.choice(looks["prints"]))
        text = chance.choice(props.WORDS)
        place = Matrix.Translation((-0.1 * w, -0.16, 2.6)) @ Matrix.Rotation(math.pi / 2, 4, "X")
        glow = looks["lit"] if chance.random() < 0.4 else looks["suit"][3]
        props.letters(mesh, text, place, 0.55, glow)
    if chance.random() < 0.5:
        for strip in range(10):
            x = -0.4 * w + 0.5 * w * strip / 10
            points = [
                (x, 0, 2.4),
                (x + 0.05 * w, 0, 2.4),
                (x + 0.05 * w, -1.1, 2.0),
                (x, -1.1, 2.0),
            ]
            mesh.faces(points, [(0, 1, 2, 3)], looks["suit"][strip % 2])


def _house_looks(scene: Set) -> dict:
    wear = scene.wear
    return {
        "walls": [wear.look("wall", 1.5) for _ in range(4)],
        "prints": [wear.look("any", 0.5) for _ in range(3)],
        "suit": wear.suit(0.6),
        "lit": wear.glow(scene.within(1.2, 4)),
        "pane": wear.mirror() if scene.chance.random() < 0.5 else wear.look("metal", 0.5),
        "share": scene.chance.choice((0.0, 0.1, 0.5)),
    }


def _row(scene: Set, looks: dict, place: Matrix, length: float, low_high: tuple) -> None:
    mesh, x = MeshBuilder(), -length / 2
    while x < length / 2:
        wide = scene.within(4, 8)
        mesh.place = place @ Matrix.Translation((x + wide / 2, scene.within(-0.4, 0.4), 0))
        _house(scene, mesh, (wide, 6, scene.within(*low_high)), looks)
        x += wide
    mesh.object("row")


def _lamp_posts(scene: Set, spots: list, high: float) -> None:
    mesh, post, glow = MeshBuilder(), scene.wear.look("metal", 0.3), scene.wear.glow()
    for x, y, z in spots:
        mesh.tube([(x, y, z), (x, y, z + high)], (0.07, 0.04), post, 8)
        mesh.ball((x, y, z + high + 0.1), 0.16, glow, (10, 8))
        scene.lamps.append((x, y, z + high - 0.4))
    mesh.object("posts")


def _ropes(scene: Set, ends: list, thick: float) -> None:
    """Stretch ropes with pennants or bulbs."""
    suit, glow = scene.wear.suit(0.2), scene.wear.glow()
    mesh, bulbs = MeshBuilder(), scene.chance.random() < 0.5
    for pair in ends:
        path = thin.rope(mesh, pair, scene.within(0.2, 0.8), thick, suit[2])
        for step, at in enumerate(path[1:-1]):
            if bulbs:
                mesh.ball(at - Vector((0, 0, 0.1)), 0.07, glow, (8, 6))
                continue
            points = [at, at + Vector((0.25, 0.1, 0)), at + Vector((0.12, 0.05, -0.4))]
            mesh.faces(points, [(0, 1, 2)], suit[step % 2])
    mesh.object("ropes")


def street(scene: Set) -> None:
    """A street between two rows of houses, with cars, posts and wires."""
    half, looks = scene.within(3.5, 8), _house_looks(scene)
    heights = scene.chance.choice(((4, 8), (6, 14), (3, 4.5)))
    for turn in (0, math.pi):
        place = Matrix.Rotation(turn, 4, "Z") @ Matrix.Translation((0, half, 0))
        _row(scene, looks, place, 56, heights)
    for turn in (math.pi / 2, -math.pi / 2):
        place = Matrix.Rotation(turn, 4, "Z") @ Matrix.Translation((0, 32, 0))
        _row(scene, looks, place, 4 * half, heights)
    scene.slab((-60, 60), (-60, 60), 0.0, scene.wear.look("ground", 1.8))
    kerb = scene.wear.look("ground", 0.8)
    mesh = MeshBuilder()
    for side in (-1, 1):
        mesh.box((0, side * (half - 0.7), 0.06), (64, 1.6, 0.12), kerb)
    mesh.object("kerbs")
    posts = [(x, s * (half - 1.3), 0.1) for x in range(-24, 25, 8) for s in (-1, 1)]
    _lamp_posts(scene, posts, scene.within(3, 5))
    for side in (-1, 1):
        cars = [(x + scene.within(-2, 2), side * (half - 2.3), 0) for x in range(-24, 25, 7)]
        scene.strew((props.vehicle,), cars, (2.4, 3.4), turned=False)
        scene.strew(
            ALL,
            scene.spots(12, (-25, 25), (side * (half - 1), side * (half - 0.6)), 0.12),
            (0.6, 1.4),
        )
    _ropes(scene, [((x, -half, 4.5), (x + 2, half, 4.8)) for x in range(-20, 21, 8)], 0.02)
    for _ in range(9):
        eye = Vector((scene.within(-25, 0), scene.within(-0.4, 0.4) * half, scene.within(0.5, 4)))
        aim = eye + Vector((10, scene.within(-8, 8), scene.within(-2, 1.5)))
        scene.eyes.append((eye, aim))
    scene.night, scene.reach = 0.4, 7.0


def square(scene: Set) -> None:
    """A square with stalls, ropes and trees in front of houses."""
    looks = _house_looks(scene)
    for step in range(4):
        place = Matrix.Rotation(step * math.pi / 2, 4, "Z") @ Matrix.Translation((0, 16, 0))
        _row(scene, looks, place, 34, (4, 10))
    scene.slab((-60, 60), (-60, 60), 0.0, scene.wear.look("ground", 1.4))
    suits = [scene.wear.suit(0.5) for _ in range(4)]
    mesh = MeshBuilder()
    for x, y, _ in scene.spots(12, (-12, 12), (-12, 12)):
        mesh.place = Matrix.Translation((x, y, 0)) @ Matrix.Rotation(scene.within(0, 6), 4, "Z")
        suit = scene.chance.choice(suits)
        mesh.tube([(0, 0, 0), (0, 0, 2.4)], 0.04, suit[2], 8)
        high = scene.within(2.1, 2.6)
        mesh.tube([(0, 0, high), (0, 0, high + 0.6)], (1.5, 0.05), suit[:2], 10, smooth=False)
        mesh.box((0.5, 0, 0.45), (1.4, 0.9, 0.9), suit[1])
        for _ in range(12):
            at = (scene.within(-0.1, 1.1), scene.within(-0.35, 0.35), 0.97)
            mesh.ball(at, 0.09, scene.chance.choice(suit), (10, 8))
    mesh.object("stalls")
    scene.strew(ALL, scene.spots(26, (-14, 14), (-14, 14)), (0.7, 1.6), suits)
    scene.strew((thin.tree,), scene.spots(5, (-13, 13), (-13, 13)), (4, 7), scene.garden())
    posts = scene.spots(5, (-11, 11), (-11, 11))
    _lamp_posts(scene, posts, 3.4)
    tops = [(x, y, 3.3) for x, y, _ in posts]
    _ropes(scene, list(pairwise(tops)), 0.02)
    scene.look_across((-11, 11), (-11, 11), (0.6, 4.5), 8.0)
    scene.night, scene.reach = 0.4, 6.0


def _rolling(scene: Set, high: float, long: float) -> Height:
    shift = scene.within(0, 100)

    def height(x: float, y: float) -> float:
        where = Vector((x / long + shift, y / long, 0.3))
        return high * (mathutils.noise.fractal(where, 1.0, 2.0, 3))

    return height


def land(scene: Set) -> None:
    """Open land: hills, fields, rocks, trees, fences, a few houses."""
    height = _rolling(scene, scene.within(1.5, 7), scene.within(15, 40))
    field = scene.chance.choice(("soil", "leaf", "ground"))
    scene.terrain(height, 110, 110, scene.wear.look(field, scene.within(1.5, 4)))
    scene.hills(scene.within(10, 40), 120)
    rocks = [[scene.wear.look("ground", 1.2)] * 4 for _ in range(3)]
    scene.strew((props.rock,), scene.spots(110, (-30, 30), (-30, 30), height), (0.3, 2.5), rocks)
    garden = scene.garden("leaf", 0.6)
    scene.strew((thin.tree,), scene.spots(70, (-60, 60), (-60, 60), height), (3, 9), garden)
    scene.strew(PLANTS, scene.spots(500, (-25, 25), (-25, 25), height), (0.3, 1.1), garden)
    scene.strew(
        (thin.fence,),
        [
            (2.0 * step - 20, 4 + math.sin(0.3 * step), height(2.0 * step - 20, 4))
            for step in range(20)
        ],
        (1.0, 1.2),
        turned=False,
    )
    mesh, looks = MeshBuilder(), _house_looks(scene)
    for x, y, z in scene.spots(4, (-22, 22), (8, 26), height):
        mesh.place = Matrix.Translation((x, y, z - 0.5)) @ Matrix.Rotation(
            scene.within(-0.7, 0.7), 4, "Z"
        )
        _house(scene, mesh, (scene.within(4, 8), 5, scene.within(3, 7)), looks)
    mesh.object("houses")
    _eyes_above(scene, height, 16, (0.7, 5.0))
    scene.reach = 9.0


def _eyes_above(scene: Set, height: Height, half: float, high: tuple[float, float]) -> None:
    for x, y, z in scene.spots(10, (-half, half), (-half, half), height):
        aim = scene.spots(1, (-half, half), (-half, half), height)[0]
        eye = Vector((x, y, z + scene.within(*high)))
        away = Vector((aim[0] - x, aim[1] - y, 0)).normalized() * 10
        away.z = scene.within(-3.5, 0.5)
        scene.eyes.append((eye, eye + away))


def wood(scene: Set) -> None:
    """A wood with undergrowth: thin leaves, grass, trunks."""
    height = _rolling(scene, scene.within(0.3, 1.5), 9)
    scene.terrain(height, 60, 90, scene.wear.look("soil", 0.7))
    scene.hills(16, 58)
    garden = scene.garden("leaf", 0.4)
    scene.strew((thin.tree,), scene.spots(70, (-24, 24), (-24, 24), height), (4, 10), garden)
    count = scene.chance.choice((350, 800))
    scene.strew(PLANTS, scene.spots(count, (-14, 14), (-14, 14), height), (0.25, 0.9), garden)
    mesh, bark = MeshBuilder(), garden[0][2]
    for x, y, z in scene.spots(45, (-20, 20), (-20, 20), height):
        lean = (x + scene.within(-0.5, 0.5), y + scene.within(-0.5, 0.5), z + 8)
        mesh.tube([(x, y, z - 0.2), lean], (scene.within(0.1, 0.35), 0.1), bark, 9)
    mesh.object("trunks")
    rocks = [[scene.wear.look("ground", 0.6)] * 4]
    scene.strew((props.rock,), scene.spots(25, (-12, 12), (-12, 12), height), (0.3, 1.2), rocks)
    scene.strew(SOLID, scene.spots(5, (-8, 8), (-8, 8), height), (0.5, 1.5))
    _eyes_above(scene, height, 9, (0.4, 2.5))
    scene.reach = 4.0


def scaffold(scene: Set) -> None:
    """Scaffolds, fences, wires and masts one behind the other."""
    scene.slab((-80, 80), (-80, 80), 0.0, scene.wear.look("ground", 1.2))
    suits = [scene.wear.suit(0.5) for _ in range(4)]
    mesh, looks = MeshBuilder(), _house_looks(scene)
    for step, suit in enumerate(suits[:3]):
        y, wide = 3.0 + 5 * step, scene.within(1.2, 2.2)
        for column in range(12):
            x = wide * (column - 6)
            for depth in (0, 1.2):
                mesh.tube([(x, y + depth, 0), (x, y + depth, 7)], 0.035, suit[2], 6)
            for z in (1.9, 3.8, 5.7):
                mesh.tube([(x, y, z), (x + wide, y, z)], 0.03, suit[2], 6)
                mesh.tube([(x, y, z - 1.8), (x + wide, y, z)], 0.02, suit[0], 5)
                if scene.chance.random() < 0.55:
                    mesh.box((x + wide / 2, y + 0.6, z), (wide, 1.0, 0.05), suit[1])
    mesh.object("scaffolds")
    for turn in range(4):
        place = Matrix.Rotation(turn * math.pi / 2, 4, "Z") @ Matrix.Translation((0, 21, 0))
        _row(scene, looks, place, 44, (5, 11))
    scene.strew(THIN, scene.spots(40, (-11, 11), (-9, 16)), (0.8, 2.4), suits)
    scene.strew((thin.fence,), [(2 * x, -2.0, 0) for x in range(-6, 7)], (1, 1.3), suits, False)
    spans = [((x, -8, 5), (x + scene.within(-6, 6), 14, 6)) for x in range(-10, 11, 4)]
    _ropes(scene, spans, 0.015)
    for _ in range(10):
        eye = Vector((scene.within(-8, 8), scene.within(-9, 0), scene.within(0.6, 5)))
        aim = (scene.within(-6, 6), 6, scene.within(0.5, 4))
        scene.eyes.append((eye, aim))
    scene.reach = 6.0


def yard(scene: Set) -> None:
    """Abstract sculptures, large letters and mirrors in a paved yard."""
    scene.slab((-80, 80), (-80, 80), 0.0, scene.wear.look("ground", 1.5))
    mesh = MeshBuilder()
    for step in range(4):
        mesh.place = Matrix.Rotation(step * math.pi / 2, 4, "Z")
        mesh.box((0, 15, 2), (32, 0.4, scene.within(4, 9)), scene.wear.look("wall", 2.0))
        for x in range(-12, 13, 6):
            mesh.box((x, 14.6, 2), (0.8, 0.5, 5), scene.wear.look("any", 0.8))
    mesh.place = Matrix.Identity(4)
    for x, y, _ in scene.spots(4, (-10, 10), (-10, 10)):
        mesh.place = Matrix.Translation((x, y, 0)) @ Matrix.Rotation(scene.within(0, 6), 4, "Z")
        mesh.box((0, 0, 1.5), (scene.within(1, 3), 0.1, 3), scene.wear.mirror())
    mesh.object("walls")
    suits = [scene.wear.suit(0.8) for _ in range(5)]
    scene.strew(SOLID, scene.spots(34, (-12, 12), (-12, 12)), (0.8, 3.5), suits)
    scene.strew(SOLID + PLANTS, scene.spots(30, (-10, 10), (-10, 10)), (0.3, 1.0))
    scene.hills(20, 90)
    scene.look_across((-10, 10), (-10, 10), (0.5, 4), 8.0)
    scene.lamps += [(x, y, 4.0) for x, y, _ in scene.spots(3, (-8, 8), (-8, 8))]
    scene.reach = 6.0


def harbour(scene: Set) -> None:
    """Water with boats, a quay with bollards, containers and cranes."""
    scene.slab((-300, 300), (-300, 300), 0.0, scene.wear.water())
    quay, suits = MeshBuilder(), [scene.wear.suit(0.9) for _ in range(4)]
    quay.box((0, -10, 0.2), (120, 12, 1.6), scene.wear.look("ground", 1.4))
    quay.box((0, 34, 0.5), (120, 12, 2.0), scene.wear.look("ground", 2.0))
    for x in range(-24, 25, 4):
        quay.tube([(x, -4.6, 1.0), (x, -4.6, 1.5)], (0.16, 0.24), suits[0][2], 10)
    quay.object("quay")
    for _ in range(9):
        _boat(scene, (scene.within(-18, 18), scene.within(-2, 22)))
    stack = MeshBuilder()
    boxes = [scene.wear.look("any", 1.2) for _ in range(5)]
    for x in range(-40, 41, 7):
        for level in range(scene.chance.randint(1, 4)):
            at = (x, 33 + scene.within(-1, 1), 2.8 + 2.6 * level)
            stack.box(at, (6, 2.6, 2.5), scene.chance.choice(boxes))
    stack.object("containers")
    cranes = [(x, 30, 1.4) for x in (-18, 4, 22)] + [(scene.within(-12, 12), -9, 1.0)]
    scene.strew((thin.lattice,), cranes, (6, 14), suits)
    scene.strew(ALL, scene.spots(22, (-16, 16), (-8, -5), 1.0), (0.5, 1.4), suits)
    _lamp_posts(scene, [(x, -6, 1.0) for x in range(-16, 17, 8)], 3.5)
    scene.hills(scene.within(10, 30), 140)
    for _ in range(10):
        eye = Vector((scene.within(-12, 12), scene.within(-9, 3), scene.within(1.6, 5)))
        aim = (scene.within(-12, 12), 12, scene.within(0, 2))
        scene.eyes.append((eye, aim))
    scene.night, scene.reach = 0.25, 8.0


def _boat(scene: Set, at: tuple[float, float]) -> None:
    mesh, suit = MeshBuilder(), scene.wear.suit(0.5)
    long = scene.within(1.5, 4)
    rings = [(-long, 0, 0.35), (-0.5 * long, 0, 0.3), (0.4 * long, 0, 0.3), (long, 0, 0.6)]
    mesh.tube(rings, (0.5, 0.75, 0.7, 0.03), suit[0], 12)
    mesh.box((-0.2 * long, 0, 1.1), (0.7 * long, 0.8, 0.7), suit[1])
    mesh.box((-0.2 * long, 0, 1.15), (0.5 * long, 0.84, 0.3), suit[2])
    mesh.place = Matrix.Translation((0.1 * long, 0, 0.6)) @ Matrix.Scale(scene.within(3, 6), 4)
    thin.mast(mesh, suit, scene.chance)
    boat = mesh.object("boat")
    boat.location = (*at, 0)
    boat.rotation_euler = (scene.within(-0.08, 0.08), 0, scene.within(0, 6.3))


def ruins(scene: Set) -> None:
    """Rocks, arches, columns and stairs in a valley."""
    height = _rolling(scene, scene.within(0.6, 2.0), 14)
    scene.terrain(height, 80, 90, scene.wear.look("soil", 1.3))
    stone = [[scene.wear.look("wall", 0.9), scene.wear.look("ground", 0.7)] * 2 for _ in range(3)]
    scene.strew((props.rock,), scene.spots(130, (-22, 22), (-22, 22), height), (0.4, 4), stone)
    kinds = (props.arch, props.steps, props.vase, props.totem, props.crate, props.arch)
    scene.strew(kinds, scene.spots(34, (-14, 14), (-14, 14), height), (1.5, 4.5), stone)
    scene.strew(PLANTS, scene.spots(220, (-15, 15), (-15, 15), height), (0.3, 1.0), scene.garden())
    far = [(40 * math.cos(a), 40 * math.sin(a), -3.0) for a in (0.21 * s for s in range(30))]
    scene.strew((props.rock,), far, (14, 30), stone)
    _eyes_above(scene, height, 10, (0.6, 4.0))
    scene.lamps += [(x, y, z + 3) for x, y, z in scene.spots(3, (-6, 6), (-6, 6), height)]
    scene.reach = 6.0
