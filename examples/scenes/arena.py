"""Arena: a hall with a glossy floor, runners and their shadows, seen as in a game over a shoulder.

The camera follows a runner, falls behind as he speeds up, and whips round to the side as he is
attacked. Bolts, sparks, drones and a gate move besides.
"""

from __future__ import annotations

import math
import random

import arena_hall as hall
from runners import Squad, Suit, Way
from stage import looks, motion
from stage.blender import mathutils
from stage.meshes import MeshBuilder
from stage.options import main
from stage.quality import Raster
from stage.shooting import Script

Vector = mathutils.Vector
Spot = tuple[float, float, float]

START = (-6.0, -1.2)
"""Where the one whom the camera follows is at first."""

SPEED = 4.3
OTHERS = (
    (2.5, 1.6, 195, 4.4, "red"), (6.5, -1.4, 170, 3.6, "red"), (1.5, 5.4, 265, 4.2, "blue"),
    (-2.2, -5.8, 75, 4.0, "red"), (10.0, 0.6, 185, 3.2, "blue"), (4.6, 8.8, 190, 3.4, "red"),
    (-3.0, 1.0, 20, 4.8, "blue"),
)  # fmt: skip
"""x, y, heading in degrees, metres a second, team."""

BOLTS = (
    (0.02, (8.0, -0.5, 1.3), (-26.0, 2.0, 0.0)),
    (0.10, (-7.0, -0.2, 1.25), (28.0, 4.0, 0.5)),
    (0.18, (7.0, 4.5, 1.5), (-24.0, -9.0, -0.6)),
    (0.27, (-6.0, 1.5, 1.3), (27.0, 1.0, 0.2)),
    (0.36, (3.0, 7.0, 1.4), (-18.0, -20.0, -0.4)),
)
"""Second of the shot, where, and metres a second."""


def build(seed: int, last: int) -> dict[int, str]:
    """Build the scene; return what each object id is."""
    chance = random.Random(seed)
    made = hall.palette()
    hall.build(made, chance)
    hall.lights()
    squad = Squad(last)
    suits = _suits(made)
    squad.run(suits["blue"], _lead, SPEED, 0.1)
    for x, y, heading, speed, team in OTHERS:
        squad.run(suits[team], _straight(x, y, heading, speed), speed, chance.random())
    _drones(squad, made, last)
    _bolts(squad, made, last)
    _sparks(squad, made, chance, last)
    _machines(squad, made, last)
    motion.film(_camera, last, 74.0)
    return squad.names


def _suits(made: hall.Materials) -> dict[str, Suit]:
    skin = looks.paint("skin", (0.50, 0.30, 0.21), 0.6)
    cloth = looks.checker("cloth", (0.16, 0.18, 0.22), (0.10, 0.11, 0.13), 0.09)
    return {
        team: Suit(cloth, looks.paint(f"{team} plates", colour, 0.25), skin, made[f"{lamp} light"])
        for team, colour, lamp in (
            ("blue", (0.04, 0.20, 0.62), "blue"),
            ("red", (0.62, 0.05, 0.03), "orange"),
        )
    }


def _straight(x: float, y: float, heading: float, speed: float) -> Way:
    turn = math.radians(heading)
    return lambda t: (x + speed * t * math.cos(turn), y + speed * t * math.sin(turn), turn)


def _lead(t: float) -> tuple[float, float, float]:
    """Where the followed runner is: along a wide bend to the left."""
    rate = 0.55
    turn = 0.05 + rate * t
    x = START[0] + SPEED / rate * (math.sin(turn) - math.sin(0.05))
    y = START[1] - SPEED / rate * (math.cos(turn) - math.cos(0.05))
    return x, y, turn


def _camera(t: float) -> tuple[Spot, Spot]:
    """Follow at the right shoulder; flick to the left and half back, as with a mouse."""
    x, y, heading = _lead(t - 0.03)
    flick = math.radians(52) * motion.ramp(t, 0.16, 0.30) - math.radians(30) * motion.ramp(
        t, 0.36, 0.48
    )
    yaw = heading - 0.12 + flick
    back = 2.7 + 0.35 * motion.ramp(t, 0.0, 0.5)
    along, right = (
        Vector((math.cos(yaw), math.sin(yaw), 0)),
        Vector((math.sin(yaw), -math.cos(yaw), 0)),
    )
    step = 0.025 * math.sin(4 * math.pi * t / 0.62)
    where = Vector((x, y, 1.95 + step)) - back * along + 0.55 * right
    at = where + 4.0 * along + Vector((0, 0, -0.75 + 0.2 * math.sin(9 * t)))
    return tuple(where), tuple(motion.looking(at, where, 0.03 * math.sin(6 * t)))


def _drones(squad: Squad, made: hall.Materials, last: int) -> None:
    """Add flying machines with four rotors each, which cast spinning shadows."""
    for number, (spot, pace) in enumerate(
        (((1.0, -2.6, 2.5), (-3.6, 2.0, 0.1)), ((5.0, 4.0, 3.0), (-2.0, -3.0, -0.4)))
    ):
        body = MeshBuilder()
        body.ball((0, 0, 0), 0.2, made["dark"], (14, 8))
        body.ball((0.17, 0, -0.03), 0.07, made["orange light"], (8, 6))
        for angle in (0.8, 2.3, 3.9, 5.5):
            tip = (0.5 * math.cos(angle), 0.5 * math.sin(angle), 0.06)
            body.tube([(0, 0, 0), tip], 0.025, made["steel"], 6)
        drone = body.object("drone", squad.name("drone"))

        def pose(t: float, spot=spot, pace=pace, late=2.0 * number) -> tuple[Spot, Spot]:
            where = Vector(spot) + t * Vector(pace) + Vector((0, 0, 0.15 * math.sin(7 * t + late)))
            return tuple(where), (0.25 * math.sin(5 * t + late), 0.2, 1.2 * t + late)

        motion.keyed(drone, pose, last)
        for corner, angle in enumerate((0.8, 2.3, 3.9, 5.5)):
            blade = MeshBuilder()
            blade.box(
                (0, 0, 0), (0.5, 0.06, 0.012), made["white light" if corner == 0 else "steel"]
            )
            rotor = blade.object("rotor", drone.pass_index)
            rotor.parent = drone
            at = (0.5 * math.cos(angle), 0.5 * math.sin(angle), 0.1)
            motion.keyed(rotor, lambda t, at=at, c=corner: (at, (0, 0, 31 * t + c)), last)


def _bolts(squad: Squad, made: hall.Materials, last: int) -> None:
    """Add bolts of light, which cross the picture in a few instants."""
    for begin, start, pace in BOLTS:
        mesh = MeshBuilder()
        way = Vector(pace).normalized()
        mesh.tube([-0.35 * way, 0.2 * way, 0.35 * way], (0.015, 0.05, 0.02),
                  made["orange light" if pace[0] < 0 else "blue light"], 8)  # fmt: skip
        bolt = mesh.object("bolt", squad.name("bolt"))
        motion.keyed(
            bolt,
            lambda t, b=begin, s=start, p=pace: (Vector(s) + (t - b) * Vector(p), (0, 0, 0)),
            last,
        )


def _sparks(squad: Squad, made: hall.Materials, chance: random.Random, last: int) -> None:
    """Let sparks burst from a pillar and bounce on the floor."""
    source = Vector((0.0, -6.9, 1.9))
    for _ in range(36):
        begin = chance.uniform(-0.35, 0.3)
        pace = Vector((chance.gauss(0, 1.6), chance.uniform(1.0, 4.5), chance.uniform(0.5, 4.0)))
        mesh = MeshBuilder()
        mesh.ball((0, 0, 0), chance.uniform(0.012, 0.03), made["white light"], (6, 4))
        spark = mesh.object("spark", squad.name("spark"))

        def pose(t: float, begin=begin, pace=pace) -> tuple[Spot, Spot]:
            gone = max(0.0, t - begin)
            where = source + gone * pace
            high = where.z - 4.9 * gone**2
            return (where.x, where.y, abs(high) + 0.02), (0, 0, 0)

        motion.keyed(spark, pose, last)


def _machines(squad: Squad, made: hall.Materials, last: int) -> None:
    """Add a gate that slides, a fan that turns in the light, and a moving field of light."""
    gate = MeshBuilder()
    for step in range(12):
        gate.box((0.22 * step - 1.2, 0, 1.4), (0.05, 0.08, 2.8), made["steel"])
    for high in (0.2, 1.4, 2.7):
        gate.box((0, 0, high), (2.7, 0.06, 0.08), made["stripe"])
    leaf = gate.object("gate", squad.name("gate"))
    motion.keyed(leaf, lambda t: ((2.0 + 2.6 * t, 6.2, 0), (0, 0, 0)), last)
    fan = MeshBuilder()
    for blade in range(5):
        fan.place = mathutils.Matrix.Rotation(blade * 2 * math.pi / 5, 4, "Z")
        fan.box((1.0, 0, 0), (1.7, 0.45, 0.04), made["dark"])
    wheel = fan.object("fan", squad.name("fan"))
    motion.keyed(wheel, lambda t: ((3.6, -4.6, 6.2), (0.0, 0.0, 7.0 * t)), last)
    field = MeshBuilder()
    field.ball((0, 0, 0), 1.15, made["field"], (24, 14))
    shield = field.object("field", squad.name("field of light"))
    motion.keyed(shield, lambda t: ((6.5 - 3.55 * t, -1.4 + 0.6 * t, 1.0), (0, 0, 2 * t)), last)


SCENE = Script(
    "arena",
    "Runners in a hall with a glossy floor, followed over a shoulder as in a game.",
    build,
    instants=61,
    seed=23,
    pace=6.0,
    clean=Raster(100),
    engine="EEVEE",
)

if __name__ == "__main__":
    main(SCENE)
