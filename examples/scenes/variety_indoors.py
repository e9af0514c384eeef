"""Places with a roof: rooms, corridors, warehouses, table tops, and things afloat in a studio."""

from __future__ import annotations

import math

import variety_props as props
import variety_thin as thin
from stage.blender import bpy, mathutils
from stage.meshes import MeshBuilder
from variety_set import ALL, FURNITURE, PLANTS, SOLID, THIN, Set

Matrix, Vector = mathutils.Matrix, mathutils.Vector
Size = tuple[float, float, float]


def _shell(scene: Set, size: Size, window: bool) -> None:
    """Build floor, ceiling and walls; one wall may have openings."""
    w, d, h = size
    wear, mesh = scene.wear, MeshBuilder()
    scene.slab((-w / 2, w / 2), (-d / 2, d / 2), 0, wear.look("floor", 1.4))
    ceiling = wear.look("wall", 1.5)
    mesh.box((0, 0, h + 0.1), (w, d, 0.2), ceiling)
    looks = [wear.look("wall", 1.2) for _ in range(2)]
    base, trim = wear.look("wall", 1.0), wear.look("any", 0.4)
    for side in (-1, 1):
        mesh.box((0, side * (d / 2 + 0.1), h / 2), (w, 0.2, h), looks[side > 0])
        mesh.box((0, side * (d / 2 - 0.02), 0.1), (w, 0.05, 0.2), trim)
        mesh.box((side * (w / 2 - 0.02), 0, 0.1), (0.05, d, 0.2), trim)
    mesh.box((-w / 2 - 0.1, 0, h / 2), (0.2, d, h), base)
    if not window:
        mesh.box((w / 2 + 0.1, 0, h / 2), (0.2, d, h), base)
    else:
        count = max(2, round(d / 2.2))
        for low, high in ((0, 0.3 * h), (0.85 * h, h)):
            mesh.box((w / 2 + 0.1, 0, (low + high) / 2), (0.2, d, high - low), base)
        for step in range(count + 1):
            y = -d / 2 + d * step / count
            mesh.box((w / 2 + 0.1, y, h / 2), (0.2, 0.5, h), base)
            mesh.box((w / 2 + 0.1, y + d / count / 2, h / 2), (0.05, 0.06, h), trim)
        scene.slab((w / 2, 60), (-60, 60), -1.0, wear.look("ground", 6.0))
    mesh.object("shell")


def _pictures(scene: Set, size: Size, count: int) -> None:
    """Hang posters, words and boards on the walls."""
    w, d, h = size
    mesh = MeshBuilder()
    for _ in range(count):
        side, wide, high = (
            scene.chance.choice((-1, 1)),
            scene.within(0.5, 1.8),
            scene.within(0.4, 1.2),
        )
        x, z = scene.within(-w / 2 + 1, w / 2 - 1), scene.within(0.45 * h, 0.7 * h)
        y = side * (d / 2 - 0.05)
        mesh.box((x, y, z), (wide + 0.1, 0.05, high + 0.1), scene.wear.look("metal", 0.3))
        mesh.box((x, y - 0.03 * side, z), (wide, 0.05, high), scene.wear.look("print", 0.35))
        if scene.chance.random() < 0.4:
            turn = Matrix.Rotation(math.pi / 2, 4, "X")
            if side < 0:
                turn = Matrix.Rotation(math.pi, 4, "Z") @ turn
            place = Matrix.Translation((x, y - 0.06 * side, z)) @ turn
            text = scene.chance.choice(props.WORDS)
            look = scene.wear.glow() if scene.chance.random() < 0.4 else scene.wear.look("any")
            props.letters(mesh, text, place, min(high, 1.6 * wide / len(text)), look)
    mesh.object("pictures")


def _ceiling_lamps(scene: Set, size: Size, count: int) -> None:
    """Hang glowing lamps and name their places."""
    w, d, h = size
    mesh, glow = MeshBuilder(), scene.wear.glow()
    shade = scene.wear.look("metal", 0.2)
    strip = scene.chance.random() < 0.5
    for step in range(count):
        x = w * ((step + 0.5) / count - 0.5)
        y = scene.within(-0.25, 0.25) * d
        drop = 0.05 if strip else scene.within(0.1, 0.3) * h
        if strip:
            mesh.box((x, y, h - 0.03), (0.5 * w / count, 0.25, 0.06), glow)
        else:
            mesh.tube([(x, y, h), (x, y, h - drop)], 0.012, shade, 6)
            mesh.tube([(x, y, h - drop), (x, y, h - drop - 0.25)], (0.06, 0.3), shade, 16)
            mesh.ball((x, y, h - drop - 0.27), 0.1, glow)
        scene.lamps.append((x, y, h - drop - 0.45))
    mesh.object("lamps")


def room(scene: Set) -> None:
    """A furnished room, perhaps with a mirror wall or sun through windows."""
    size = (scene.within(5, 10), scene.within(4, 8), scene.within(2.5, 4.2))
    w, d, h = size
    _shell(scene, size, scene.chance.random() < 0.6)
    _pictures(scene, size, scene.chance.randint(3, 7))
    _ceiling_lamps(scene, size, scene.chance.randint(1, 3))
    if scene.chance.random() < 0.5:
        mesh, side = MeshBuilder(), scene.chance.choice((-1, 1))
        y = side * (d / 2 - 0.12)
        mesh.box((0, y, 0.5 * h), (0.5 * w, 0.1, 0.7 * h), scene.wear.look("metal", 0.4))
        mesh.box((0, y - 0.03 * side, 0.5 * h), (0.45 * w, 0.1, 0.62 * h), scene.wear.mirror())
        mesh.object("mirror")
    edge = [
        (x * scene.within(0.7, 0.9) * w / 2, scene.within(-0.45, 0.45) * d, 0)
        for x in (-1, 1)
        for _ in range(3)
    ]
    edge += [(scene.within(-0.4, 0.4) * w, y * 0.42 * d, 0) for y in (-1, 1) for _ in range(3)]
    suits = [scene.wear.suit(0.5) for _ in range(3)]
    scene.strew(FURNITURE, edge, (0.8, 1.7), suits)
    scene.strew(FURNITURE + SOLID, scene.spots(6, (-w / 3, w / 3), (-d / 3, d / 3)), (0.5, 1.0))
    rug = (scene.within(1, 2), scene.within(0.8, 1.5))
    scene.slab((-rug[0], rug[0]), (-rug[1], rug[1]), 0.012, scene.wear.look("any", 0.7))
    scene.look_across((-0.44 * w, 0.44 * w), (-0.42 * d, 0.42 * d), (0.5, 0.7 * h), 0.6 * w)
    scene.indoor, scene.reach = True, 3.0


def corridor(scene: Set) -> None:
    """A long corridor with ribs, doors, pipes and, often, a glossy floor."""
    size = (scene.within(18, 34), scene.within(2.2, 5.0), scene.within(2.3, 4.0))
    w, d, h = size
    _shell(scene, size, False)
    _pictures(scene, size, scene.chance.randint(5, 9))
    _ceiling_lamps(scene, size, scene.chance.randint(3, 5))
    suit = scene.wear.suit(0.6)
    glow = scene.wear.glow()
    mesh, gap = MeshBuilder(), scene.within(1.5, 4)
    for step in range(int(w / gap)):
        x = -w / 2 + gap * (step + 0.5)
        for side in (-1, 1):
            mesh.box((x, side * d / 2, h / 2), (0.25, 0.3, h), suit[0])
            mesh.box((x + gap / 2, side * (d / 2 - 0.02), 1.0), (0.8, 0.08, 2.0), suit[1])
            mesh.ball((x + gap / 2 + 0.3, side * (d / 2 - 0.08), 1.0), 0.05, suit[2], (8, 6))
            if step % 2:
                mesh.box((x + gap / 2, side * (d / 2 - 0.05), 2.1), (0.4, 0.06, 0.12), glow)
        mesh.box((x, 0, h - 0.12), (0.2, d, 0.24), suit[0])
    for side in (-1, 1):
        for number in range(scene.chance.randint(0, 3)):
            y, z = side * (d / 2 - 0.2 - 0.15 * number), h - 0.4
            mesh.tube([(-w / 2, y, z), (w / 2, y, z)], 0.05, suit[2], 8)
    mesh.object("ribs")
    for side in (-1, 1):
        spots = scene.spots(7, (-w / 2, w / 2), (side * d * 0.36, side * d * 0.44))
        scene.strew(ALL, spots, (0.4, 0.9))
    end = MeshBuilder()
    for side in (-1, 1):
        at = (side * (w / 2 - 0.05), 0, h / 2)
        end.box(at, (0.06, 0.6 * d, 0.6 * h), scene.wear.look("print", 0.4))
    end.object("ends")
    for _ in range(9):
        eye = Vector(
            (scene.within(-0.45, 0.2) * w, scene.within(-0.2, 0.2) * d, scene.within(0.4, 0.6 * h))
        )
        scene.eyes.append(
            (eye, eye + Vector((8, scene.within(-0.5, 0.5) * d, scene.within(-1, 0.6))))
        )
    scene.indoor, scene.reach = True, 4.0


def warehouse(scene: Set) -> None:
    """Racks full of goods under a high roof."""
    size = (scene.within(16, 26), scene.within(12, 18), scene.within(5, 8))
    w, d, _ = size
    _shell(scene, size, scene.chance.random() < 0.6)
    _pictures(scene, size, 5)
    _ceiling_lamps(scene, size, 4)
    suits = [scene.wear.suit(0.7) for _ in range(4)]
    mesh = MeshBuilder()
    rows = [y * d for y in (-0.36, -0.12, 0.12, 0.36)]
    spots = []
    for y in rows:
        for x in range(int(-w / 2 + 2), int(w / 2 - 1), 3):
            for z in (0.1, 1.5, 2.9):
                mesh.box((x, y, z), (2.9, 1.1, 0.08), suits[0][1])
                spots += [(x + s, y + scene.within(-0.2, 0.2), z + 0.04) for s in (-0.9, 0, 0.9)]
            for side in (-0.5, 0.5):
                mesh.box((x - 1.45, y + side, 1.9), (0.08, 0.08, 3.8), suits[0][2])
                mesh.tube(
                    [(x - 1.45, y - side, 0.2), (x - 1.45, y + side, 3.6)], 0.02, suits[0][2], 5
                )
    mesh.object("racks")
    kept = [spot for spot in spots if scene.chance.random() < 0.8]
    kinds = (props.crate, props.drum, props.crate, scene.chance.choice(SOLID), props.balls)
    scene.strew(kinds, kept, (0.6, 1.0), suits)
    scene.strew(SOLID, scene.spots(8, (-w / 3, w / 3), (-d / 2.2, d / 2.2)), (0.5, 1.1))
    for y in (-0.24 * d, 0.0, 0.24 * d):
        for _ in range(4):
            eye = Vector(
                (scene.within(-0.45, 0.1) * w, y + scene.within(-0.8, 0.8), scene.within(0.8, 4))
            )
            away = Vector((8, scene.within(-5, 5), scene.within(-2.5, 1)))
            scene.eyes.append((eye, eye + away))
    scene.indoor, scene.reach = True, 5.0


def still_life(scene: Set) -> None:
    """A table top seen from near, crowded with small things before a wall or a curtain."""
    wear = scene.wear
    scene.slab((-1.5, 1.5), (-1.5, 1.2), 0.0, wear.look("any", 0.5))
    mesh = MeshBuilder()
    mesh.box((0, 1.3, 1.0), (5, 0.1, 4.4), wear.look("wall", 0.8))
    for side in (-1, 1):
        mesh.box((side * 2.2, 0, 1.0), (0.1, 3, 4.4), wear.look("wall", 0.7))
    mesh.box((0, 0.2, -1.0), (4.5, 4, 0.1), wear.look("floor", 0.8))
    mesh.object("walls")
    suits = [wear.suit(0.5) for _ in range(5)]
    kinds = tuple(
        scene.chance.sample((*SOLID, props.vase, props.balls, thin.potted, props.crate), 7)
    )
    scene.strew(kinds, scene.spots(26, (-1.2, 1.2), (-0.5, 0.3)), (0.08, 0.25), suits)
    scene.strew(kinds + THIN, scene.spots(16, (-1.4, 1.4), (0.4, 1.1)), (0.25, 0.6), suits)
    if scene.chance.random() < 0.5:
        back = scene.put(thin.curtain, (0, 1.18, -0.3), 2.2)
        back.scale = (1.6, 1, 1)
    _pictures(scene, (4.2, 2.5, 2.0), 2)
    for _ in range(10):
        eye = Vector((scene.within(-0.7, 0.7), scene.within(-1.5, -0.8), scene.within(0.12, 0.7)))
        aim = (scene.within(-0.4, 0.4), scene.within(0, 0.6), scene.within(0.0, 0.25))
        scene.eyes.append((eye, aim))
    scene.lamps += [(-1.4, -1.0, 1.8), (1.4, -0.8, 1.5), (0.1, 0.2, 2.2)]
    scene.reach, scene.night = 1.0, 0.25


def afloat(scene: Set) -> None:
    """Things of all kinds that float at random before large patterned walls."""
    wear = scene.wear
    mesh = MeshBuilder()
    for angle in range(0, 360, 60):
        mesh.place = Matrix.Rotation(math.radians(angle), 4, "Z")
        mesh.box((14, 0, 0), (0.2, 17, 24), wear.look("any", 3.5))
    mesh.place = Matrix.Identity(4)
    mesh.box((0, 0, -9), (40, 40, 0.2), wear.look("floor", 3.5))
    mesh.object("walls")
    suits = [wear.suit(0.4) for _ in range(5)]
    kinds = tuple(scene.chance.sample(ALL + PLANTS, 9))
    before = len(scene_objects())
    spots = [(scene.within(-10, 10), scene.within(-10, 10), scene.within(-5, 6)) for _ in range(90)]
    scene.strew(kinds, spots, (0.6, 3.0), suits)
    for thing in scene_objects()[before:]:
        thing.rotation_euler = [scene.within(0, 6.3) for _ in range(3)]
    scene.look_across((-7, 7), (-7, 7), (-2, 3), 7.0)
    scene.lamps += [(0, 0, 8), (-6, 4, 6), (6, -4, 6)]
    scene.reach, scene.night = 5.0, 0.2


def scene_objects() -> list:
    """List the objects made so far."""
    return list(bpy.context.scene.collection.objects)
