"""Courtyard: leaves in the wind, lattices and long shadows, strafed past in the first person.

The camera steps to the right, turns its head with a flick and steps back, with a lamp in its hand.
Runners cross, leaves and petals fall, water drops fly, banners and lanterns swing.
"""

from __future__ import annotations

import math
import random

import courtyard_walls as walls
from runners import Squad, Suit, Way
from stage import looks, motion
from stage.blender import bpy, mathutils
from stage.meshes import MeshBuilder
from stage.options import main
from stage.quality import Raster
from stage.shooting import Script

Matrix, Vector = mathutils.Matrix, mathutils.Vector
Spot = tuple[float, float, float]

WIND = 0.7
"""Where the wind blows to, radians from +x."""

RUNNERS = (
    (-3.2, -1.6, 8, 4.4, "red"), (4.6, 1.0, 190, 3.8, "green"), (1.2, 5.2, 250, 4.2, "white"),
    (6.4, -1.4, 172, 4.8, "green"), (-5.0, 5.0, 300, 3.6, "red"),
)  # fmt: skip
"""x, y, heading in degrees, metres a second, suit."""


def build(seed: int, last: int) -> dict[int, str]:
    """Build the scene; return what each object id is."""
    chance = random.Random(seed)
    made = walls.palette()
    walls.build(made, chance)
    walls.lights()
    squad = Squad(last)
    suits = _suits(made)
    for x, y, heading, speed, suit in RUNNERS:
        squad.run(suits[suit], _straight(x, y, heading, speed), speed, chance.random())
    _leaves(squad, made, chance, last)
    _falling(squad, made, chance, last)
    _water(squad, made, chance, last)
    _hangings(squad, made, last)
    camera = motion.film(_camera, last, 82.0)
    _hand(squad, made, camera, last)
    return squad.names


def _suits(made: walls.Materials) -> dict[str, Suit]:
    skin = looks.paint("skin", (0.55, 0.34, 0.24), 0.6)
    suits = {}
    for name, coat, cloth in (
        ("red", (0.55, 0.06, 0.05), (0.10, 0.11, 0.16)),
        ("green", (0.10, 0.34, 0.12), (0.25, 0.19, 0.12)),
        ("white", (0.80, 0.78, 0.72), (0.12, 0.20, 0.42)),
    ):
        second = tuple(0.6 * part for part in cloth)
        trousers = looks.checker(f"{name} cloth", cloth, second, 0.12)
        suits[name] = Suit(trousers, looks.paint(f"{name} coat", coat, 0.6), skin, made["brass"])
    return suits


def _straight(x: float, y: float, heading: float, speed: float) -> Way:
    turn = math.radians(heading)
    return lambda t: (x + speed * t * math.cos(turn), y + speed * t * math.sin(turn), turn)


def gust(x: float, y: float, seconds: float) -> float:
    """Return how strongly the wind blows at a place, about -1..1."""
    way = x * math.cos(WIND) + y * math.sin(WIND)
    slow = math.sin(2 * math.pi * (0.9 * seconds - way / 7.0))
    return 0.65 * slow + 0.35 * math.sin(2 * math.pi * (2.3 * seconds - way / 2.6) + 1.0)


def _leaves(squad: Squad, made: walls.Materials, chance: random.Random, last: int) -> None:
    """Hang clusters of leaves on the trees; each swings on its own."""
    shapes = []
    for _ in range(4):
        mesh = MeshBuilder()
        for _ in range(85):
            away = Vector([chance.gauss(0, 1) for _ in range(3)])
            away *= 0.62 * chance.uniform(0.35, 1.0) / away.length
            walls.leaf(mesh, Vector((away.x, away.y, 0.7 * away.z)), 0.17, made["leaf"], chance)
        made_of = mesh.object("leaves")
        shapes.append(made_of.data)
        bpy.data.objects.remove(made_of)
    for x, y in walls.TREES:
        for number in range(13):
            angle, out = 2.4 * number, 0.25 + 1.0 * math.sqrt(number / 13)
            spot = Vector((x + out * math.cos(angle), y + out * math.sin(angle), 0))
            spot.z = 3.35 - 0.45 * out**2 + chance.uniform(-0.15, 0.35)
            index = squad.name("leaves")
            cluster = bpy.data.objects.new("leaves", chance.choice(shapes))
            cluster.pass_index = index
            bpy.context.scene.collection.objects.link(cluster)
            motion.keyed(cluster, _swaying(spot, chance.uniform(0, 6.3), 0.22), last)


def _swaying(spot: mathutils.Vector, late: float, strength: float) -> motion.Pose:
    """Return a pose that swings about a spot in the wind."""

    def pose(t: float) -> tuple[Spot, Spot]:
        push = strength * gust(spot.x, spot.y, t + 0.02 * late)
        shift = push * Vector((math.cos(WIND), math.sin(WIND), -0.3))
        flutter = 0.25 * strength * math.sin(19 * t + late)
        return tuple(spot + shift), (push + flutter, 1.2 * push - flutter, late + 0.6 * push)

    return pose


def _falling(squad: Squad, made: walls.Materials, chance: random.Random, last: int) -> None:
    """Let leaves and petals drift down."""
    for number in range(44):
        mesh = MeshBuilder()
        coat = made["petal" if number % 3 == 0 else "leaf"]
        walls.leaf(mesh, Vector((0, -0.06, 0)), chance.uniform(0.07, 0.12), coat, chance)
        flake = mesh.object("falling leaf", squad.name("falling leaf"))
        start = Vector((chance.uniform(-4, 6), chance.uniform(-4.8, 4.5), chance.uniform(0.4, 3.2)))
        pace = Vector(
            (chance.uniform(0.6, 1.8), chance.uniform(0.3, 1.4), -chance.uniform(0.5, 1.1))
        )
        late, spin = chance.uniform(0, 6.3), chance.uniform(4, 12)

        def pose(t: float, s=start, p=pace, late=late, spin=spin) -> tuple[Spot, Spot]:
            wave = 0.12 * math.sin(9 * t + late)
            where = s + t * p + Vector((wave, -wave, 0))
            turn = spin * t + late
            return (where.x, where.y, max(0.02, where.z)), (turn, 0.7 * turn, 0.4 * turn)

        motion.keyed(flake, pose, last)


def _water(squad: Squad, made: walls.Materials, chance: random.Random, last: int) -> None:
    """Let drops spring from the fountain, over and over."""
    x, y = walls.FOUNTAIN
    for number in range(42):
        mesh = MeshBuilder()
        mesh.ball((0, 0, 0), chance.uniform(0.018, 0.04), made["pale"], (6, 5))
        drop = mesh.object("drop", squad.name("drop"))
        angle, out = 2.4 * number, chance.uniform(0.5, 1.1)
        rise, begin = chance.uniform(2.2, 3.4), chance.uniform(0, 1)
        span = (rise + math.sqrt(rise**2 + 2 * 9.8 * 1.1)) / 9.8

        def pose(t: float, a=angle, o=out, r=rise, b=begin, span=span) -> tuple[Spot, Spot]:
            gone = (t + b) % span
            away = o * gone
            return (
                (x + away * math.cos(a), y + away * math.sin(a), 1.55 + r * gone - 4.9 * gone**2),
                (0, 0, 0),
            )

        motion.keyed(drop, pose, last)


def _hangings(squad: Squad, made: walls.Materials, last: int) -> None:
    """Hang lanterns on chains, and banners of strips that wave."""
    for number, (x, y) in enumerate(((-3.4, -1.0), (2.6, -2.6), (4.9, 2.4), (-0.4, 5.6))):
        mesh = MeshBuilder()
        mesh.tube([(0, 0, 0), (0, 0, -1.5)], 0.012, made["iron"], 5)
        mesh.ball((0, 0, -1.68), 0.09, made["flame"], (10, 8))
        for angle in range(6):
            a = angle * math.pi / 3
            foot = (0.13 * math.cos(a), 0.13 * math.sin(a))
            mesh.tube([(*foot, -1.5), (*foot, -1.86)], 0.012, made["iron"], 5)
        for high in (-1.5, -1.86):
            mesh.tube([(0, 0, high), (0, 0, high + 0.03)], 0.16, made["iron"], 12)
        lantern = mesh.object("lantern", squad.name("lantern"))
        motion.keyed(
            lantern,
            lambda t, at=(x, y, 4.1), late=1.7 * number: (
                at,
                (0.3 * gust(at[0], at[1], t), 0.24 * math.sin(5 * t + late), 0),
            ),
            last,
        )
    for number, (x, y) in enumerate(((-5.4, 6.6), (0.0, 6.6), (5.6, 6.6), (6.6, 3.0))):
        _banner(squad, made, (x, y, 5.4), math.pi / 2 if x > 6 else 0.0, 1.3 * number, last)


def _banner(
    squad: Squad, made: walls.Materials, at: Spot, turn: float, late: float, last: int
) -> None:
    """Add a banner of six strips, each of which turns on the one above."""
    index, above = squad.name("banner"), None
    for strip in range(6):
        mesh = MeshBuilder()
        corners = [(-0.4, 0, 0), (0.4, 0, 0), (0.4, 0, -0.36), (-0.4, 0, -0.36)]
        mesh.faces(corners, [(0, 1, 2, 3)], made["cloth"])
        piece = mesh.object("banner", index)
        piece.parent = above
        spot = (0.0, 0.0, -0.36) if above else at

        def pose(t: float, spot=spot, strip=strip) -> tuple[Spot, Spot]:
            wave = 0.10 + 0.24 * math.sin(8 * t - 0.9 * strip + late)
            return spot, (wave, 0.0, turn if strip == 0 else 0.0)

        motion.keyed(piece, pose, last)
        above = piece


def _camera(t: float) -> tuple[Spot, Spot]:
    """Strafe to the right and back to the left; flick the view once each way."""
    side = -1.9 + 4.4 * (t - 2 * _after(t, 0.27))
    bob = 0.03 * math.sin(2 * math.pi * 3.2 * t)
    where = Vector((side, -5.6 + 0.9 * t, 1.62 + bob))
    yaw = math.radians(
        90 + 9 * math.sin(3 * t) - 58 * motion.ramp(t, 0.09, 0.21) + 47 * motion.ramp(t, 0.33, 0.44)
    )
    pitch = -0.10 + 0.05 * math.sin(7 * t)
    at = where + Vector((math.cos(yaw), math.sin(yaw), pitch))
    return tuple(where), tuple(motion.looking(at, where, 0.02 * math.sin(5 * t)))


def _after(t: float, begin: float) -> float:
    """Seconds since a moment, 0 before it, with a soft start of 0.08 s."""
    soft = 0.08
    gone = t - begin
    if gone <= 0:
        return 0.0
    return gone**2 / (2 * soft) if gone < soft else gone - soft / 2


def _hand(squad: Squad, made: walls.Materials, camera: bpy.types.Object, last: int) -> None:
    """Put a lamp into the hand at the lower right, which goes with the camera."""
    mesh = MeshBuilder()
    mesh.tube([(0, 0, 0.16), (0, 0, -0.16)], 0.03, made["brass"], 12)
    mesh.tube([(0, 0, -0.16), (0, 0, -0.22), (0, 0, -0.26)], (0.035, 0.06, 0.062), made["iron"], 14)
    mesh.tube([(0, 0, -0.262), (0, 0, -0.268)], 0.052, made["flame"], 14)
    mesh.ball((0.02, -0.03, 0.02), 0.055, made["dark"], (10, 8))
    mesh.tube([(0.02, -0.04, 0.03), (0.14, -0.2, 0.32)], (0.05, 0.07), made["cloth"], 10)
    lamp = mesh.object("lamp", squad.name("hand lamp"))
    lamp.parent = camera
    motion.keyed(
        lamp,
        lambda t: (
            (0.2 + 0.012 * math.sin(20 * t), -0.17 + 0.012 * math.cos(20 * t), -0.36),
            (0.12, 0.18 + 0.04 * math.sin(10 * t), 0.05),
        ),
        last,
    )


SCENE = Script(
    "courtyard",
    "A courtyard with trees in the wind, lattices and runners, strafed past in the first person.",
    build,
    instants=61,
    seed=29,
    pace=6.0,
    clean=Raster(100),
    engine="EEVEE",
)

if __name__ == "__main__":
    main(SCENE)
