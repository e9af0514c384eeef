"""What moves in the laboratory: robot arm, rover, centrifuge, fan, lamp, gyroscope, door."""

from __future__ import annotations

import math

import lab_benches
from lab_room import DOOR, FAN, FAR, HIGH, Looks, sign, upright
from stage import motion
from stage.blender import bpy, mathutils
from stage.meshes import MeshBuilder

Euler, Matrix, Vector = mathutils.Euler, mathutils.Matrix, mathutils.Vector

IDS = {
    1: "robot arm",
    2: "flask that the arm lifts",
    3: "rover and its wheels",
    4: "rotor of the centrifuge",
    5: "fan in the far wall",
    6: "hanging lamp",
    7: "gyroscope",
    8: "sliding door",
}
UPPER, FORE, TOOL, SHOULDER = 0.66, 0.58, 0.30, 0.34
GRIP = 0.78
"""Seconds at which the arm has the flask."""


def build(looks: Looks, last: int) -> dict[int, str]:
    """Add everything that moves; return what the ids are."""
    _arm(looks, last)
    _rover(looks, last)
    _centrifuge(looks, last)
    _fan(looks, last)
    _lamp(looks, last)
    _gyroscope(looks, last)
    _door(looks, last)
    return IDS


def ring(
    mesh: MeshBuilder,
    radius: float,
    thick: tuple[float, float],
    materials: bpy.types.Material | list[bpy.types.Material],
    around: int = 48,
) -> None:
    """Add a ring about the z axis; `thick` is its half width, across and along the axis."""
    sides = 10
    points, faces = [], []
    for step in range(around):
        angle = 2 * math.pi * step / around
        for side in range(sides):
            turn = 2 * math.pi * side / sides
            reach = radius + thick[0] * math.cos(turn)
            high = thick[1] * math.sin(turn)
            points.append((reach * math.cos(angle), reach * math.sin(angle), high))
            after, beside = (step + 1) % around * sides, (side + 1) % sides
            here = step * sides
            faces.append((here + side, after + side, after + beside, here + beside))
    dealt = materials if isinstance(materials, list) else [materials]
    strips = [dealt[face // sides * len(dealt) // around] for face in range(len(faces))]
    mesh.faces(points, faces, strips, smooth=True)


def _child(mesh: MeshBuilder, name: str, index: int, parent: bpy.types.Object) -> bpy.types.Object:
    made = mesh.object(name, index)
    made.parent = parent
    return made


def _reach(seconds: float) -> tuple[float, float, float]:
    """Return where the arm's fingers are: turn about the base, distance, height."""
    down = motion.ramp(seconds, 0.05, GRIP - 0.04)
    lift = motion.ramp(seconds, GRIP + 0.06, 1.55)
    carry = motion.ramp(seconds, GRIP + 0.2, 2.15)
    sway = 0.03 * math.sin(5.0 * seconds) * (1 - down + lift)
    turn = math.radians(196 + 20 * down + 58 * carry) + sway
    return turn, 0.62 + 0.2 * down - 0.14 * carry, 0.48 - 0.37 * down + 0.5 * lift


def _joints(seconds: float) -> tuple[float, float, float, float]:
    """Return the angles of base, shoulder, elbow and wrist; the tool points down."""
    turn, away, high = _reach(seconds)
    rise = high + TOOL - SHOULDER
    span = math.hypot(away, rise)
    bend = math.acos((UPPER**2 + span**2 - FORE**2) / (2 * UPPER * span))
    fold = math.acos((UPPER**2 + FORE**2 - span**2) / (2 * UPPER * FORE))
    shoulder = math.atan2(away, rise) - bend
    elbow = math.pi - fold
    return turn, shoulder, elbow, math.pi - shoulder - elbow


def _arm(looks: Looks, last: int) -> None:
    """Add 1, the arm, joint by joint, and 2, the flask that it lifts."""
    base_at = Vector(lab_benches.CELL) + Vector((0.2, 0.2, 0.1))
    base = MeshBuilder()
    base.tube([(0, 0, 0), (0, 0, 0.06), (0, 0, 0.2)], (0.18, 0.18, 0.14), looks["orange"], 24)
    base.box((0, 0, 0.25), (0.16, 0.26, 0.22), looks["orange"])
    base.tube([(0, -0.17, SHOULDER), (0, 0.17, SHOULDER)], 0.1, looks["dark"], 20)
    base.box((-0.12, 0, 0.2), (0.1, 0.14, 0.14), looks["dark"])
    root = base.object("arm base", 1)
    upper = _limb(looks, UPPER, 0.085)
    upper = _child(upper, "upper arm", 1, root)
    fore = _child(_limb(looks, FORE, 0.065), "forearm", 1, upper)
    wrist = MeshBuilder()
    wrist.tube([(0, -0.07, 0), (0, 0.07, 0)], 0.055, looks["dark"], 16)
    wrist.tube([(0, 0, 0), (0, 0, 0.12)], (0.05, 0.04), looks["orange"], 16)
    wrist.box((0, 0, 0.14), (0.07, 0.2, 0.05), looks["chrome"])
    hand = _child(wrist, "wrist", 1, fore)

    def still(seconds: float, part: int, high: float) -> tuple[Vector, Euler]:
        return Vector((0, 0, high)), Euler((0, _joints(seconds)[part], 0))

    motion.keyed(root, lambda t: (base_at, Euler((0, 0, _joints(t)[0]))), last)
    motion.keyed(upper, lambda t: still(t, 1, SHOULDER), last)
    motion.keyed(fore, lambda t: still(t, 2, UPPER), last)
    motion.keyed(hand, lambda t: still(t, 3, FORE), last)
    for side in (-1, 1):
        finger = MeshBuilder()
        finger.box((0, 0, 0.07), (0.04, 0.02, 0.16), looks["dark"])
        jaw = _child(finger, "finger", 1, hand)

        def grip(seconds: float, side: int = side) -> tuple[Vector, Euler]:
            shut = motion.ramp(seconds, GRIP - 0.28, GRIP)
            return Vector((0, side * (0.088 - 0.028 * shut), 0.16)), Euler((0, 0, 0))

        motion.keyed(jaw, grip, last)
    flask = MeshBuilder()
    lab_benches.bottle(flask, (0, 0, -0.11), 0.19, looks["lime"], looks["white"])

    def held(seconds: float) -> tuple[Vector, Euler]:
        turn, away, high = _reach(max(seconds, GRIP))
        out = Vector((away * math.cos(turn), away * math.sin(turn), high))
        return base_at + out, Euler((0, 0, turn))

    motion.keyed(flask.object("lifted flask", 2), held, last)


def _limb(looks: Looks, long: float, wide: float) -> MeshBuilder:
    mesh = MeshBuilder()
    path = [(0, 0, 0.02), (0, 0, 0.12), (0, 0, long - 0.1), (0, 0, long)]
    mesh.tube(path, (1.1 * wide, wide, 0.8 * wide, 0.9 * wide), looks["orange"], 16)
    mesh.tube([(0, -1.6 * wide, long), (0, 1.6 * wide, long)], wide, looks["dark"], 20)
    mesh.tube([(0, -1.7 * wide, long), (0, 1.7 * wide, long)], 0.5 * wide, looks["chrome"], 16)
    for side in (-1, 1):
        mesh.box((0, side * wide, long / 2), (0.05, 0.03, 0.5 * long), looks["white"])
        cable = [(-wide, 0.04 * side, 0.1), (-1.7 * wide, 0.04 * side, long / 2)]
        mesh.tube([*cable, (-wide, 0.04 * side, long - 0.1)], 0.014, looks["dark"], 6)
    return mesh


def _rover(looks: Looks, last: int) -> None:
    """Add 3: a wheeled robot that drives across the floor, on a bend, with changing speed."""
    mesh = MeshBuilder()
    mesh.box((0, 0, 0.22), (0.62, 0.4, 0.16), looks["white"])
    mesh.box((0, 0, 0.32), (0.54, 0.34, 0.05), looks["dark"])
    mesh.box((0.3, 0, 0.2), (0.04, 0.41, 0.08), looks["hazard"])
    mesh.box((-0.3, 0, 0.2), (0.04, 0.41, 0.08), looks["hazard"])
    for side in (-1, 1):
        mesh.box((0, 0.205 * side, 0.24), (0.36, 0.01, 0.08), looks["teal"])
        mesh.box((0.325, 0.12 * side, 0.25), (0.01, 0.07, 0.04), looks["panel"])
        mesh.box((-0.325, 0.12 * side, 0.25), (0.01, 0.07, 0.04), looks["ember"])
    mesh.tube([(-0.12, 0, 0.34), (-0.12, 0, 0.78)], 0.025, looks["chrome"], 10)
    mesh.box((-0.1, 0, 0.84), (0.14, 0.26, 0.13), looks["white"])
    for side in (-0.07, 0.07):
        mesh.tube([(-0.03, side, 0.84), (0.01, side, 0.84)], 0.045, looks["black"], 14)
        mesh.tube([(0.01, side, 0.84), (0.013, side, 0.84)], 0.018, looks["cyan"], 10)
    mesh.tube([(-0.22, 0.12, 0.34), (-0.22, 0.12, 0.46)], 0.035, looks["ember"], 10)
    for number, look in enumerate(("lime", "ruby", "cobalt")):
        where = (0.14, -0.1 + 0.1 * number, 0.345)
        lab_benches.bottle(mesh, where, 0.16, looks[look], looks["white"], flask=True)
    body = mesh.object("rover", 3)
    way = [(-2.1, 8.5, 0), (-1.1, 8.15, 0), (-0.25, 7.45, 0), (0.35, 6.3, 0)]

    def share(seconds: float) -> float:
        return 0.06 + 0.44 * seconds + 0.06 * math.sin(3.2 * seconds)

    def pose(seconds: float) -> tuple[Vector, Euler]:
        here = share(seconds)
        tangent = motion.along(way, here + 0.01) - motion.along(way, here - 0.01)
        return motion.along(way, here), Euler((0, 0, math.atan2(tangent.y, tangent.x)))

    motion.keyed(body, pose, last)
    for x in (-0.2, 0.2):
        for y in (-0.22, 0.22):
            wheel = MeshBuilder()
            wheel.tube([(0, -0.04, 0), (0, 0.04, 0)], 0.12, looks["dark"], 20)
            wheel.tube([(0, -0.045, 0), (0, 0.045, 0)], 0.07, looks["chrome"], 12)
            for spoke in range(3):
                wheel.place = Matrix.Rotation(2 * math.pi * spoke / 3, 4, "Y")
                wheel.box((0.05, 0, 0), (0.1, 0.096, 0.025), looks["orange"])
            made = _child(wheel, "wheel", 3, body)
            place = Vector((x, y, 0.12))
            motion.keyed(made, lambda t, at=place: (at, Euler((0, 25 * share(t), 0))), last)


def _centrifuge(looks: Looks, last: int) -> None:
    """Add an open centrifuge on the left bench, and 4, its rotor with coloured tubes."""
    spot = Vector((-1.46, 2.2, lab_benches.TOP))
    tilt = Matrix.Translation(spot) @ Matrix.Rotation(0.16, 4, "X")
    shell = MeshBuilder()
    shell.place = tilt
    shell.box((0, 0, 0.07), (0.5, 0.5, 0.16), looks["white"])
    rims = [(0, 0, z) for z in (0.14, 0.2, 0.25)]
    shell.tube(rims, (0.24, 0.245, 0.24), looks["steel"], 28)
    shell.box((0.12, -0.255, 0.09), (0.12, 0.01, 0.04), looks["cyan"])
    shell.place = tilt @ Matrix.Translation((0, 0.26, 0.25)) @ Matrix.Rotation(1.75, 4, "X")
    shell.box((0, 0.22, 0), (0.48, 0.44, 0.03), looks["white"])
    shell.box((0, 0.36, 0.018), (0.34, 0.07, 0.008), looks["hazard"])
    shell.box((0, 0.2, 0.018), (0.3, 0.16, 0.008), looks["teal"])
    shell.object("centrifuge")
    lid = shell.place @ Matrix.Translation((0, 0.2, 0.023))
    sign("SPIN 9", lid, 0.09, looks["white"])
    rotor = MeshBuilder()
    rotor.tube([(0, 0, 0), (0, 0, 0.05), (0, 0, 0.1)], (0.2, 0.2, 0.07), looks["chrome"], 24)
    rotor.tube([(0, 0, 0.09), (0, 0, 0.14)], 0.03, looks["dark"])
    for number in range(8):
        rotor.place = Matrix.Rotation(math.pi * number / 4, 4, "Z")
        look = looks[("ruby", "lime", "cobalt", "amber")[number % 4]]
        rotor.tube([(0.11, 0, 0.04), (0.165, 0, 0.13)], 0.026, look, 10)
    where = tilt @ Vector((0, 0, 0.25))

    def spin(seconds: float) -> tuple[Vector, Euler]:
        return where, Euler((0.16, 0, 3.0 * seconds + 1.1 * seconds**2))

    motion.keyed(rotor.object("rotor", 4), spin, last)


def _fan(looks: Looks, last: int) -> None:
    """Add 5: a large fan in the far wall."""
    x, z, radius = FAN
    mesh = MeshBuilder()
    mesh.tube([(0, -0.12, 0), (0, -0.08, 0), (0, 0.1, 0)], (0.05, 0.13, 0.13), looks["orange"], 20)
    for blade in range(5):
        mesh.place = Matrix.Rotation(2 * math.pi * blade / 5, 4, "Y")
        long = radius - 0.05
        points = [(-0.05, -0.05, 0.1), (0.06, 0.05, 0.1), (0.2, 0.07, long), (-0.1, -0.07, long)]
        mesh.faces(points, [(0, 1, 2, 3)], looks["chrome"])
        points = [(-0.1, -0.072, long), (-0.09, -0.068, 0.8 * long), (0.17, 0.056, 0.8 * long)]
        mesh.faces([*points, (0.2, 0.068, long)], [(0, 1, 2, 3)], looks["yellow"])

    def spin(seconds: float) -> tuple[Vector, Euler]:
        turn = 3.4 * seconds + 0.5 * math.sin(2.4 * seconds)
        return Vector((x, FAR + 0.2, z)), Euler((0, turn, 0))

    motion.keyed(mesh.object("fan", 5), spin, last)


def _lamp(looks: Looks, last: int) -> None:
    """Add 6: a lamp that swings over the aisle; shadows of everything below swing with it."""
    mesh = MeshBuilder()
    long = 1.22
    mesh.tube([(0, 0, 0), (0, 0, -long)], 0.012, looks["dark"], 6)
    profile = (
        (0.04, 0.03),
        (0.0, 0.06),
        (-0.06, 0.09),
        (-0.18, 0.23),
        (-0.185, 0.215),
        (-0.1, 0.1),
    )
    rings = [(0, 0, z - long) for z, _ in profile]
    mesh.tube(rings, [radius for _, radius in profile], looks["orange"], 24)
    mesh.ball((0, 0, -long - 0.13), 0.06, looks["warm"], (14, 10))
    shade = mesh.object("hanging lamp", 6)
    light = bpy.data.lights.new("hanging lamp", "SPOT")
    light.energy, light.color = 620.0, (1.0, 0.74, 0.45)
    light.spot_size, light.spot_blend = math.radians(128), 0.35
    light.shadow_soft_size = 0.035
    bulb = bpy.data.objects.new("bulb", light)
    bulb.location, bulb.parent = (0, 0, -long - 0.21), shade
    bulb.visible_camera = bulb.visible_glossy = False
    bpy.context.scene.collection.objects.link(bulb)

    def swing(seconds: float) -> tuple[Vector, Euler]:
        first = 0.34 * math.sin(3.3 * seconds + 0.4)
        second = 0.2 * math.sin(3.3 * seconds + 1.9)
        return Vector((0.75, 5.35, HIGH)), Euler((second, first, 0))

    motion.keyed(shade, swing, last)


def _gyroscope(looks: Looks, last: int) -> None:
    """Add 7: nested polished rings around a glowing core, on a pedestal."""
    spot = Vector((-1.0, 6.75, 1.42))
    stand = MeshBuilder()
    x, y, middle = spot
    steps = ((0.0, 0.3), (0.08, 0.3), (0.1, 0.2), (0.76, 0.16), (0.8, 0.24), (0.86, 0.24))
    stand.tube([(x, y, z) for z, _ in steps], [r for _, r in steps], looks["white"], 24)
    stand.tube([(x, y, 0.4), (x, y, 0.46)], 0.2, looks["cyan"], 24)
    stand.tube([(x, y, 0.86), (x, y, middle - 0.47)], 0.035, looks["chrome"])
    stand.object("pedestal")
    turns = (
        lambda t: Euler((0, 0, 1.5 * t + 0.25 * math.sin(2 * t))),
        lambda t: Euler((0.5 + 2.1 * t, 0, 0)),
        lambda t: Euler((0, 0.4 + 2.6 * t + 0.3 * math.sin(3 * t), 0)),
    )
    parent = None
    for number, (radius, look) in enumerate(((0.44, "gold"), (0.35, "chrome"), (0.26, "copper"))):
        mesh = MeshBuilder()
        # The outer ring stands upright, the next ones lie in planes across their own axes.
        mesh.place = Matrix.Rotation(math.pi / 2, 4, "XYX"[number]) if number != 1 else mesh.place
        ring(mesh, radius, (0.02, 0.035), [looks[look]] * 7 + [looks["dark"]])
        mesh.place = Matrix.Identity(4)
        axle = ((1, 0, 0), (0, 1, 0), (0, 0, 1))[number]
        for side in (-1, 1):
            ends = [Vector(axle) * side * (radius + step) for step in (-0.09, 0.03)]
            mesh.tube(ends, 0.016, looks["dark"], 8)
        if number == 2:
            mesh.ball((0, 0, 0), 0.1, [looks["cyan"], looks["dark"]] * 4, (24, 12))
        made = mesh.object("gyroscope", 7)
        made.parent = parent
        at = Vector((0, 0, 0)) if parent else spot
        motion.keyed(made, lambda t, at=at, turn=turns[number]: (at, turn(t)), last)
        parent = made


def _door(looks: Looks, last: int) -> None:
    """Add 8: two leaves that slide apart, and let the light of the corridor in."""
    left, right, high = DOOR
    wide = (right - left) / 2
    for side, text in ((-1, "0"), (1, "4")):
        mesh = MeshBuilder()
        mesh.box((0, 0, high / 2), (wide, 0.05, high), looks["grey"])
        mesh.box((0, -0.03, 1.62), (wide - 0.3, 0.02, 0.42), looks["black"])
        mesh.box((0, -0.03, 0.2), (wide - 0.06, 0.02, 0.3), looks["steel"])
        mesh.box((-side * (wide / 2 - 0.05), -0.03, 1.1), (0.08, 0.03, high - 0.3), looks["hazard"])
        leaf = mesh.object("door leaf", 8)
        number = sign(text, upright((0, -0.04, 0.95)), 0.6, looks["orange"])
        number.parent, number.pass_index = leaf, 8
        closed = Vector(((left + right) / 2 + side * wide / 2, FAR + 0.17, 0.0))

        def slide(
            seconds: float, side: int = side, closed: Vector = closed
        ) -> tuple[Vector, Euler]:
            open_by = 0.05 + 0.72 * motion.ramp(seconds, -0.15, 1.5)
            return closed + Vector((side * open_by, 0, 0)), Euler((0, 0, 0))

        motion.keyed(leaf, slide, last)
