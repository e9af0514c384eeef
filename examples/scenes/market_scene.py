"""The market scene in motion: camera, sun, and seven things that move, keyed at 120 fps.

Time is counted in instants of 1/120 s. The shot spans instants 0 to 32; everything is keyed
from smooth formulas at every whole instant from -8 to 40, so that the true 30 fps set-up
(every fourth instant) and the 120 fps one show the same scene, and so that the vectors of the
first and the last frame have neighbours.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import market_town
from stage import looks
from stage.blender import bpy, mathutils
from stage.meshes import MeshBuilder, lettering

Vector, Euler, Matrix = mathutils.Vector, mathutils.Euler, mathutils.Matrix

LAST_INSTANT = 32
MARGIN = 8
Pose = Callable[[float], tuple[Vector, Euler]]
Materials = dict[str, bpy.types.Material]


def build(seed: int) -> None:
    """Build the whole scene in the current, empty Blender file.

    Parameters
    ----------
    seed : int
        Seed of the scene's small random differences.
    """
    bpy.ops.wm.read_factory_settings(use_empty=True)
    looks_of = market_town.build(seed)
    looks.sky(0.85)
    _sun()
    _camera()
    _barrel(looks_of)
    _cart(looks_of)
    _pinwheel(looks_of)
    _kite(looks_of)
    _lantern(looks_of)
    _ball(looks_of)


def _keyed(thing: bpy.types.Object, pose: Pose) -> None:
    """Key location and rotation at every instant; `pose` takes shares 0..1 of the shot."""
    thing.rotation_mode = "XYZ"
    before = None
    for instant in range(-MARGIN, LAST_INSTANT + MARGIN + 1):
        thing.location, turn = pose(instant / LAST_INSTANT)
        if before is not None:
            turn.make_compatible(before)
        thing.rotation_euler = before = turn
        thing.keyframe_insert("location", frame=instant)
        thing.keyframe_insert("rotation_euler", frame=instant)


def _eased(share: float, swing: float, phase: float) -> float:
    """Bend time: speed goes as 1 + swing * cos(2 pi share + phase), and 0 stays near 0."""
    turn = 2 * math.pi
    return share + swing / turn * (math.sin(turn * share + phase) - math.sin(phase))


def _sun() -> None:
    light = bpy.data.lights.new("sun", "SUN")
    light.energy = 4.6
    light.angle = math.radians(0.7)
    light.color = (1.0, 0.86, 0.68)
    sun = bpy.data.objects.new("sun", light)
    sun.rotation_euler = Vector((0.62, 0.55, -0.52)).to_track_quat("-Z", "Y").to_euler()
    bpy.context.scene.collection.objects.link(sun)


def _camera() -> None:
    lens = bpy.data.cameras.new("camera")
    lens.angle = math.radians(62)
    lens.clip_start = 0.05
    camera = bpy.data.objects.new("camera", lens)
    bpy.context.scene.collection.objects.link(camera)
    bpy.context.scene.camera = camera
    start, middle, end = (
        Vector((-2.3, -6.3, 1.4)),
        Vector((-0.9, -6.0, 1.5)),
        Vector((0.25, -5.05, 1.9)),
    )

    def pose(share: float) -> tuple[Vector, Euler]:
        along = _eased(share, 0.45, -2.0)
        where = start * (1 - along) ** 2 + middle * (2 * along * (1 - along)) + end * along**2
        right = math.radians(6 + 6.5 * _eased(share, 0.55, 0.9))
        up = math.radians(90 + 6.5 - 3.0 * along)
        roll = math.radians(1.6 * math.sin(2.6 * share + 0.4))
        turn = Matrix.Rotation(-right, 3, "Z") @ Matrix.Rotation(up, 3, "X")
        return where, (turn @ Matrix.Rotation(roll, 3, "Z")).to_euler("XYZ")

    _keyed(camera, pose)


def _barrel(looks_of: Materials) -> None:
    """Add index 1: a barrel that rolls from right to left, against the camera, and slows down."""
    mesh = MeshBuilder()
    staves = [looks_of["oak"], looks_of["pine"], looks_of["oak"], looks_of["beam"]]
    profile = ((-0.45, 0.27), (-0.25, 0.33), (0.0, 0.35), (0.25, 0.33), (0.45, 0.27))
    mesh.tube([(0, y, 0) for y, _ in profile], [r for _, r in profile], staves, 12, smooth=False)
    for y, radius in ((-0.36, 0.315), (-0.12, 0.355), (0.12, 0.355), (0.36, 0.315)):
        mesh.tube([(0, y - 0.03, 0), (0, y + 0.03, 0)], radius, looks_of["tin"], 16)
    mesh.box((0, -0.46, 0), (0.4, 0.02, 0.09), looks_of["red"])

    def pose(share: float) -> tuple[Vector, Euler]:
        way = 1.25 * _eased(share, 0.35, 0.0)
        return Vector((1.9 - way, 0.75 - 0.05 * way, 0.36)), Euler((0, -way / 0.36, 0.25))

    _keyed(mesh.object("barrel", 1), pose)


def _cart(looks_of: Materials) -> None:
    """Add index 2, a milk cart gathering speed, and 3 and 4, its turning wheels."""
    mesh = MeshBuilder()
    mesh.box((0, 0, 0.62), (1.7, 0.8, 0.12), looks_of["oak"])
    for side in (-1, 1):
        mesh.box((0, 0.4 * side, 0.84), (1.7, 0.05, 0.34), looks_of["blue"])
        mesh.box((0.83 * side, 0, 0.84), (0.05, 0.8, 0.34), looks_of["blue"])
        for end in (-1, 1):
            mesh.tube(
                [(0.8 * side, 0.36 * end, 0.6), (0.8 * side, 0.36 * end, 1.85)],
                0.03,
                looks_of["white"],
                6,
            )
    for strip in range(8):
        left, right = -0.95 + 1.9 * strip / 8, -0.95 + 1.9 * (strip + 1) / 8
        points = [
            (left, -0.55, 1.75),
            (right, -0.55, 1.75),
            (right, 0, 2.15),
            (left, 0, 2.15),
            (left, 0.55, 1.75),
            (right, 0.55, 1.75),
        ]
        stripe = looks_of["yellow" if strip % 2 else "red"]
        mesh.faces(points, [(0, 1, 2, 3), (3, 2, 5, 4)], stripe)
    for x in (-0.55, -0.1, 0.4):
        mesh.tube(
            [(x, 0, 0.68), (x, 0, 1.15), (x, 0, 1.25), (x, 0, 1.4)],
            (0.2, 0.2, 0.1, 0.14),
            looks_of["tin"],
            16,
        )
    cart = mesh.object("cart", 2)
    place = Matrix.Translation((0, -0.45, 0.84)) @ market_town.UPRIGHT
    letters = lettering("MILK", place, 0.36, looks_of["white"])
    letters.parent = cart
    letters.pass_index = 2

    def way(share: float) -> float:
        return 2.5 * _eased(share, 0.5, 2.4)

    def pose(share: float) -> tuple[Vector, Euler]:
        gone = way(share)
        heading = 0.10 * math.sin(0.8 * gone)
        return Vector((-2.7 + gone, 1.7 + 0.12 * gone, 0)), Euler((0, 0, 0.12 + heading))

    _keyed(cart, pose)
    for index, x in ((3, -0.55), (4, 0.55)):
        wheel = _wheel(looks_of, index)
        wheel.parent = cart
        _keyed(wheel, lambda share, x=x: (Vector((x, 0, 0.4)), Euler((0, way(share) / 0.4, 0))))


def _wheel(looks_of: Materials, index: int) -> bpy.types.Object:
    mesh = MeshBuilder()
    for side in (-0.5, 0.5):
        for part in range(16):
            first, second = (2 * math.pi * (part + step) / 16 for step in (0, 1))
            ends = [(0.37 * math.cos(a), side, 0.37 * math.sin(a)) for a in (first, second)]
            mesh.tube(ends, 0.035, looks_of["white" if part % 8 == 0 else "red"], 6)
        for spoke in range(8):
            angle = math.pi * spoke / 4
            rim = (0.37 * math.cos(angle), side, 0.37 * math.sin(angle))
            mesh.tube([(0, side, 0), rim], 0.022, looks_of["yellow"], 6)
    mesh.tube([(0, -0.58, 0), (0, 0.58, 0)], 0.05, looks_of["iron"], 8)
    return mesh.object(f"wheels {index}", index)


def _pinwheel(looks_of: Materials) -> None:
    """Add index 5: a large pinwheel over a stall, spinning ever faster."""
    mesh = MeshBuilder()
    colours = ("red", "yellow", "blue", "white", "green", "orange")
    for blade, colour in enumerate(colours):
        mesh.place = Matrix.Rotation(math.pi * blade / 3, 4, "Y")
        points = [(0, 0, 0), (0.12, -0.05, 0.4), (0.5, -0.12, 0.72), (-0.1, 0.02, 0.8)]
        mesh.faces(points, [(0, 1, 2, 3)], looks_of[colour])
    mesh.place = Matrix.Identity(4)
    mesh.ball((0, -0.06, 0), 0.09, looks_of["brass"])
    pole = MeshBuilder()
    pole.tube([(4.9, 2.06, 0), (4.9, 2.06, 2.9)], 0.04, looks_of["white"], 8)
    pole.object("pinwheel pole")

    def pose(share: float) -> tuple[Vector, Euler]:
        return Vector((4.9, 1.95, 2.75)), Euler((0, 2.3 * (share + 0.6 * share**2), -0.15))

    _keyed(mesh.object("pinwheel", 5), pose)


def _kite(looks_of: Materials) -> None:
    """Add index 6: a checked kite with a tail, swooping through the sky."""
    cloth = looks.checker("kite", (0.85, 0.10, 0.06), (0.95, 0.75, 0.10), 0.2, 0.6)
    mesh = MeshBuilder()
    points = [(0, 0, 0.75), (0.55, 0.08, 0.1), (0, 0, -0.85), (-0.55, 0.08, 0.1), (0, -0.1, 0.1)]
    mesh.faces(points, [(0, 4, 1), (4, 2, 1), (4, 3, 2), (0, 3, 4)], cloth)
    tail = [(0.12 * math.sin(1.4 * n), 0.02 * n, -0.85 - 0.2 * n) for n in range(9)]
    mesh.tube(tail, 0.015, looks_of["white"], 5)
    for number, (x, y, z) in enumerate(tail[1::2]):
        bow = [
            (x - 0.16, y, z + 0.07),
            (x - 0.16, y, z - 0.07),
            (x, y, z),
            (x + 0.16, y, z + 0.07),
            (x + 0.16, y, z - 0.07),
        ]
        mesh.faces(
            bow, [(0, 1, 2), (3, 2, 4)], looks_of[("blue", "red", "green", "violet")[number]]
        )

    def pose(share: float) -> tuple[Vector, Euler]:
        turn = 0.2 + 2.9 * share
        where = Vector((3.9 - 1.9 * math.cos(turn), 4.2 - 0.4 * share, 4.4 + 0.7 * math.sin(turn)))
        return where, Euler((0.25 + 0.3 * share, 0.7 * math.cos(turn), 0.5 * math.sin(2 * turn)))

    _keyed(mesh.object("kite", 6), pose)


def _lantern(looks_of: Materials) -> None:
    """Add index 7: a lantern swinging from the arm of the nearest lamp post."""
    mesh = MeshBuilder()
    mesh.tube([(0, 0, 0), (0, 0, -0.35)], 0.012, looks_of["iron"], 5)
    mesh.tube([(0, 0, -0.32), (0, 0, -0.42)], (0.03, 0.17), looks_of["iron"], 6, smooth=False)
    mesh.tube([(0, 0, -0.42), (0, 0, -0.72)], (0.13, 0.1), looks_of["lamp"], 6, smooth=False)
    mesh.tube([(0, 0, -0.72), (0, 0, -0.78)], (0.13, 0.1), looks_of["iron"], 6, smooth=False)
    for side in range(6):
        angle = math.pi * side / 3
        ends = [
            (r * math.cos(angle), r * math.sin(angle), z) for r, z in ((0.14, -0.4), (0.11, -0.74))
        ]
        mesh.tube(ends, 0.014, looks_of["iron"], 4)
    x, y = market_town.POSTS[1]

    def pose(share: float) -> tuple[Vector, Euler]:
        swing = 0.5 * math.sin(5.0 * share - 0.6)
        return Vector((x + 0.7, y, 2.74)), Euler((0.3 * swing, swing, 0.8 * share))

    _keyed(mesh.object("lantern", 7), pose)


def _ball(looks_of: Materials) -> None:
    """Add index 8: a beach ball that bounces towards the camera, with spin."""
    mesh = MeshBuilder()
    colours = ("red", "white", "blue", "yellow", "green", "white")
    mesh.ball((0, 0, 0), 0.3, [looks_of[name] for name in colours], (24, 14))

    def pose(share: float) -> tuple[Vector, Euler]:
        hop = (1.1 * share + 0.3) % 1.0
        high = 0.3 + 4 * 0.95 * hop * (1 - hop)
        return Vector((-1.9 + 0.9 * share, 0.3 - 1.0 * share, high)), Euler(
            (2.4 * share, 0.5 + 1.3 * share, 0.8 * share)
        )

    _keyed(mesh.object("ball", 8), pose)
