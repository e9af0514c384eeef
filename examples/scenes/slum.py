"""Render the slum scene: a walk through narrow alleys full of clutter, in late sun.

The camera stands nearly still in the first alley, hurries through it under washing and cables,
past a man who comes towards it, looks up a stair at the corner and turns into the second alley,
where a moped crosses. Strong parallax, many thin things, dark shade below sunlit roofs.
"""

from __future__ import annotations

import math
import random

import slum_looks
import slum_people as people
import slum_street as street
from slum_looks import Looks
from slum_parts import Kit
from slum_people import Person
from stage import looks, motion
from stage.blender import mathutils
from stage.meshes import MeshBuilder
from stage.options import main
from stage.quality import Quality
from stage.shooting import Script

Matrix, Vector = mathutils.Matrix, mathutils.Vector
Pose = tuple[tuple[float, ...], tuple[float, ...]]

PATH = ((0.16, -1.75), (0.2, -0.3), (0.2, 1.2), (0.5, 2.3), (1.3, 2.98), (2.5, 3.12))
"""Where the camera goes, on the ground."""

DYNAMIC = {
    1: "washing over the first alley",
    2: "washing over the stair",
    3: "washing in the second alley",
    4: "hanging bulb",
    5: "flap of the tarpaulin",
    6: "walking man",
    7: "walking woman with a bowl",
    8: "moped and rider",
    9: "wheels of the moped",
    10: "chicken",
    11: "ball on the stair",
    12: "fans",
}
GROUPS = {"first": 1, "stair": 2, "second": 3, "inner": 3}
CLOTHES = {
    "shirt": (
        (-0.2, 0.0),
        (0.2, 0.0),
        (0.42, -0.22),
        (0.33, -0.32),
        (0.21, -0.2),
        (0.22, -0.68),
        (-0.22, -0.68),
        (-0.21, -0.2),
        (-0.33, -0.32),
        (-0.42, -0.22),
    ),
    "trousers": (
        (-0.2, 0.0),
        (0.2, 0.0),
        (0.22, -0.85),
        (0.05, -0.85),
        (0.01, -0.3),
        (-0.01, -0.3),
        (-0.06, -0.85),
        (-0.23, -0.85),
    ),
    "towel": ((-0.24, 0.0), (0.24, 0.0), (0.24, -0.6), (-0.24, -0.6)),
    "dress": (
        (-0.12, 0.0),
        (0.12, 0.0),
        (0.15, -0.3),
        (0.32, -0.78),
        (-0.32, -0.78),
        (-0.15, -0.3),
    ),
    "sheet": ((-0.4, 0.0), (0.4, 0.0), (0.4, -0.75), (-0.4, -0.75)),
}
"""Outlines of garments in metres, below the line that they hang from."""


def build(seed: int, last: int) -> dict[int, str]:
    """Build the scene; return what each object id is."""
    chance = random.Random(seed)
    kit = Kit(slum_looks.palette(), chance)
    street.static_scene(kit)
    looks.backdrop((0.26, 0.40, 0.70), (0.80, 0.64, 0.46), 6.2, (0.95, 0.78, 0.60))
    motion.sunlight((0.52, 0.55, -0.5), 24.0, (1.0, 0.79, 0.54), 0.8)
    street.lamp((2.95, 3.6, 2.7), 24.0, (1.0, 0.15, 0.45), 0.25)
    street.lamp((6.3, 3.0, 2.5), 90.0, (1.0, 0.72, 0.40), 0.15)
    motion.film(_camera, last, 72.0)
    _washing(kit.looks, chance, last)
    _bulb(kit.looks, last)
    _flap(kit.looks, last)
    _crowd(kit.looks, last)
    _ball(kit.looks, last)
    _fans(kit.looks, last)
    return DYNAMIC


def _camera(seconds: float) -> Pose:
    """Stand, hurry on, look up the stair, turn to the right, slow down."""
    ramp = motion.ramp
    hurry = 0.6 * ramp(seconds, 0.28, 1.25) + 0.4 * ramp(seconds, 0.6, 2.05)
    gone = 0.02 * seconds + 0.94 * hurry
    x, y, _ = motion.along([(*spot, 0.0) for spot in PATH], gone)
    haste = ramp(seconds, 0.3, 0.9)
    sway = motion.shake(seconds, 1.3, 0.9)
    z = 1.58 + 0.012 * sway.z + haste * 0.022 * math.sin(13.0 * seconds)
    turned = sum(ramp(seconds, *span) for span in ((0.6, 1.6), (0.85, 1.9), (1.1, 2.2))) / 3
    right = 78.0 * turned - 2.0
    up = 3.0 + 9.0 * ramp(seconds, 0.55, 1.1) - 12.0 * ramp(seconds, 1.15, 1.85)
    tilt = motion.shake(seconds, 4.2, 0.8) * (0.35 + 0.5 * haste)
    turn = (
        Matrix.Rotation(-math.radians(right + tilt.x), 3, "Z")
        @ Matrix.Rotation(math.radians(90 + up + tilt.y), 3, "X")
        @ Matrix.Rotation(math.radians(0.9 * tilt.z), 3, "Z")
    )
    return (x + 0.012 * sway.x, y + 0.01 * sway.y, z), tuple(turn.to_euler("XYZ"))


def _washing(materials: Looks, chance: random.Random, last: int) -> None:
    """Add indices 1 to 3: garments, each stiff, that swing about their line in the wind."""
    fabrics = ("stripered", "stripeblue", "stripegreen", "denim", "linen", "magenta", "saffron")
    number = 0
    for start, end, group in street.LINES:
        first, second = Vector(start), Vector(end)
        length = (second - first).length
        turn = math.atan2(second.y - first.y, second.x - first.x)
        place = 0.42
        while place < length - 0.35:
            kind = ("shirt", "towel", "trousers", "dress", "shirt", "sheet")[number % 6]
            share = place / length
            spot = first.lerp(second, share) - Vector((0, 0, 0.12 * share * (1 - share)))
            mesh = _garment(materials, kind, fabrics[(number * 3 + number // 7) % len(fabrics)])
            made = mesh.object(f"{kind} {number}", GROUPS[group])
            phase, rate = chance.uniform(0, 6.28), chance.uniform(0.7, 1.1)

            def pose(
                seconds: float,
                spot: Vector = spot,
                turn: float = turn,
                phase: float = phase,
                rate: float = rate,
            ) -> Pose:
                wave = 2 * math.pi * rate * seconds + phase
                swing = 0.10 + 0.26 * math.sin(wave) + 0.08 * math.sin(2.3 * wave + 1)
                return tuple(spot), (swing, 0.05 * math.sin(wave + 1.0), turn)

            motion.keyed(made, pose, last)
            place += 0.95 if kind == "sheet" else 0.72
            number += 1


def _garment(materials: Looks, kind: str, fabric: str) -> MeshBuilder:
    """Make a garment with two pegs, its folds standing off the plane of the line."""
    mesh = MeshBuilder()
    outline = CLOTHES[kind]
    for side in (-1, 1):
        points = [(x, side * 0.012 + 0.05 * math.sin(9 * x + 2) * -z, z - 0.01) for x, z in outline]
        mesh.faces(points, [tuple(range(len(points)))], materials[fabric])
    if kind in ("towel", "sheet"):
        wide, low = outline[1][0], outline[2][1]
        mesh.box((0, -0.03, 0.7 * low), (2 * wide, 0.012, 0.06), materials["white"])
    for x in (outline[0][0] * 0.8, outline[1][0] * 0.8):
        mesh.box((x, 0, 0.0), (0.02, 0.035, 0.09), materials["crate"])
    return mesh


def _bulb(materials: Looks, last: int) -> None:
    """Add index 4: a naked bulb that swings on its wire, with the lamp that casts shadows."""
    wire = MeshBuilder()
    wire.tube([(0, 0, 0), (0, 0, -0.62)], 0.008, materials["cable"], 5)
    wire.tube([(0, 0, -0.6), (0, 0, -0.7)], (0.022, 0.026), materials["black"], 10)
    wire.tube([(0, 0, -0.62), (0, 0, -0.64), (0, 0, -0.7)], (0.03, 0.1, 0.15), materials["zinc"])
    hanging = wire.object("bulb wire", 4)
    glass = MeshBuilder()
    profile = ((-0.7, 0.024), (-0.74, 0.04), (-0.78, 0.045), (-0.82, 0.03), (-0.835, 0.008))
    glass.tube([(0, 0, z) for z, _ in profile], [r for _, r in profile], materials["bulb"], 14)
    bulb = glass.object("bulb", 4)
    bulb.visible_shadow = False  # else the lamp inside would light nothing
    bulb.parent = hanging
    street.lamp((0, 0, -0.77), 80.0, (1.0, 0.66, 0.34), 0.04).parent = hanging

    def pose(seconds: float) -> Pose:
        swing = 0.34 * math.sin(4.1 * seconds + 0.4)
        return (-0.3, 2.95, 2.86), (0.5 * swing * math.cos(0.8 * seconds), swing, 0.0)

    motion.keyed(hanging, pose, last)
    street_wire = MeshBuilder()
    street_wire.tube(
        [(-1.1, 3.0, 2.9), (-0.3, 2.95, 2.86), (1.1, 2.2, 2.95)], 0.008, materials["cable"], 5
    )
    street_wire.object("wire of the bulb")


def _flap(materials: Looks, last: int) -> None:
    """Add index 5: the loose flap at the edge of the tarpaulin, hinged and flapping."""
    mesh = MeshBuilder()
    points = []
    for row in range(5):
        for column in range(9):
            v = column / 8
            points.append((0.03 * math.sin(11 * v) * row / 4, v, -0.11 * row - 0.03 * (column % 2)))
    quads = [
        (9 * r + c, 9 * r + c + 1, 9 * r + c + 10, 9 * r + c + 9)
        for r in range(4)
        for c in range(8)
    ]
    mesh.faces(points, quads, materials["tarp"], smooth=True)

    def pose(seconds: float) -> Pose:
        swing = -0.25 + 0.3 * math.sin(6.2 * seconds) + 0.14 * math.sin(14.0 * seconds + 1)
        return (0.48, 1.1, 2.3), (0.0, swing, 0.0)

    motion.keyed(mesh.object("tarpaulin flap", 5), pose, last)


def _crowd(materials: Looks, last: int) -> None:
    """Add indices 6 to 10: the walkers, the moped and the chicken."""

    def man(seconds: float) -> tuple[float, float, float, float]:
        gone = 1.25 * seconds + 0.1 * math.sin(2.5 * seconds)
        return -0.46 + 0.03 * math.sin(gone), 1.75 - gone, 0.04, gone

    def woman(seconds: float) -> tuple[float, float, float, float]:
        gone = 1.1 * seconds
        return 6.4 - gone, 3.5 + 0.05 * math.sin(gone), -math.pi / 2, gone

    def rider(seconds: float) -> tuple[float, float, float, float]:
        gone = 3.2 * seconds + 0.5 * seconds * seconds
        return 7.95, -3.1 + gone, math.pi, gone

    def hen(seconds: float) -> tuple[float, float, float, float]:
        gone = 0.9 * seconds + 0.06 * math.sin(5 * seconds)
        return 0.3 - 0.04 * gone, 4.75 + gone, math.pi + 0.04, gone

    people.walker(materials, Person("man", 6, "stripeblue", "denim"), man, last)
    woman_looks = Person("woman", 7, "saffron", "magenta", True, True, 0.62)
    people.walker(materials, woman_looks, woman, last)
    people.moped(materials, (8, 9), rider, last)
    people.chicken(materials, 10, hen, last)


def _ball(materials: Looks, last: int) -> None:
    """Add index 11: a ball that hops down the stair and rolls on."""
    mesh = MeshBuilder()
    mesh.ball((0, 0, 0), 0.13, [materials[n] for n in ("white", "red", "white", "blue")], (20, 12))

    def pose(seconds: float) -> Pose:
        gone = 1.9 * seconds
        y = 7.0 - gone
        stair = max(0.0, 0.175 * (y - 4.3) / 0.29)
        ease = motion.ramp(y, 4.1, 4.9)
        hop = ease * 0.22 * abs(math.sin(math.pi * gone / 0.58))
        return (-0.15 + 0.04 * gone, y, 0.14 + stair + 0.12 * ease + hop), (gone / 0.13, 0.3, 0.0)

    motion.keyed(mesh.object("ball", 11), pose, last)


def _fans(materials: Looks, last: int) -> None:
    """Add index 12: the fans of the air conditioners, and a large one in a window."""
    spots = (
        ((-0.74, -0.47, 2.1), 90.0, 0.2, 7.0),
        ((2.88, 4.03, 2.15), 0.0, 0.2, 9.0),
        ((5.72, 2.67, 2.2), 180.0, 0.2, 8.0),
        ((2.05, 4.22, 2.0), 0.0, 0.27, 6.0),
    )
    for number, (spot, turn, radius, speed) in enumerate(spots):
        mesh = MeshBuilder()
        for blade in range(4):
            mesh.place = Matrix.Rotation(math.pi * blade / 2, 4, "Y")
            points = [
                (0.03, -0.02, 0.02),
                (0.08, 0.02, 0.02),
                (0.55, 0.03, 0.95),
                (-0.35, -0.04, 0.9),
            ]
            scaled = [tuple(radius * c if abs(c) > 0.05 else c for c in p) for p in points]
            mesh.faces(scaled, [(0, 1, 2, 3)], materials["chrome" if blade else "red"])
        mesh.place = Matrix.Identity(4)
        mesh.ball((0, 0, 0), 0.18 * radius, materials["grey"], (10, 6))

        def pose(
            seconds: float,
            spot: tuple[float, ...] = spot,
            turn: float = turn,
            speed: float = speed,
        ) -> Pose:
            angle = speed * seconds + 0.6 * math.sin(2 * seconds)
            return spot, (0.0, angle, math.radians(turn))

        motion.keyed(mesh.object(f"fan {number}", 12), pose, last)


SCENE = Script(
    "slum",
    "A hurried walk through narrow alleys full of clutter, washing and cables, in late sun.",
    build,
    seed=17,
    pace=6.7,
    clean=Quality(32, 8),
)

if __name__ == "__main__":
    main(SCENE)
