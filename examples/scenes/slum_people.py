"""The moving things of the slum scene that have many parts: people, a moped, a chicken."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from slum_looks import Looks
from stage import motion
from stage.blender import bpy, mathutils
from stage.meshes import MeshBuilder

Matrix, Vector = mathutils.Matrix, mathutils.Vector
Way = Callable[[float], tuple[float, float, float, float]]
"""Takes seconds; returns x, y, heading (radians; 0 is towards -y) and metres gone so far."""


@dataclass(frozen=True)
class Person:
    """How a walker looks: colours by name, and whether there is a bowl on the head."""

    name: str
    index: int
    shirt: str
    trousers: str
    skirt: bool = False
    bowl: bool = False
    stride: float = 0.75


def walker(looks: Looks, person: Person, way: Way, last: int) -> None:
    """Add a person who walks: body, and arms and legs that swing from it."""
    body = _body(looks, person)
    hip = 0.93

    def pose(seconds: float) -> tuple[tuple[float, ...], tuple[float, ...]]:
        x, y, heading, gone = way(seconds)
        phase = math.pi * gone / person.stride
        bob = 0.02 * math.cos(2 * phase)
        return (x, y, hip + bob), (0.05, 0.03 * math.sin(phase), heading)

    motion.keyed(body, pose, last)
    for side in (-1, 1):

        def phase(seconds: float, side: int = side) -> float:
            return math.pi * way(seconds)[3] / person.stride + (math.pi / 2) * (side + 1)

        thigh = _limb(looks, person, (0.085, 0.07, 0.45), person.trousers)
        shin = _limb(looks, person, (0.065, 0.045, 0.44), person.trousers, foot=True)
        arm = _limb(looks, person, (0.055, 0.045, 0.3), person.shirt)
        fore = _limb(looks, person, (0.042, 0.035, 0.3), "skin", hand=True)
        thigh.parent, shin.parent, arm.parent, fore.parent = body, thigh, body, arm
        joints = (
            (thigh, (0.1 * side, 0, 0), lambda s, f=phase: -0.5 * math.sin(f(s))),
            (shin, (0, 0, -0.45), lambda s, f=phase: 0.45 + 0.4 * math.sin(f(s) + 2.3)),
            (arm, (0.225 * side, 0, 0.5), lambda s, f=phase: 0.4 * math.sin(f(s))),
            (fore, (0, 0, -0.3), lambda s, f=phase: -0.5 + 0.15 * math.sin(f(s))),
        )
        for part, spot, bend in joints:
            motion.keyed(part, lambda s, spot=spot, bend=bend: (spot, (bend(s), 0.0, 0.0)), last)


def _body(looks: Looks, person: Person) -> bpy.types.Object:
    """Make trunk, neck and head; the origin is at the hips, the face looks to -y."""
    mesh = MeshBuilder()
    mesh.place = Matrix.Diagonal((1.0, 0.62, 1.0, 1.0))
    trunk = ((-0.08, 0.15), (0.0, 0.17), (0.18, 0.155), (0.42, 0.2), (0.52, 0.17), (0.57, 0.06))
    mesh.tube([(0, 0, z) for z, _ in trunk], [r for _, r in trunk], looks[person.shirt], 14)
    mesh.tube([(0, 0, -0.02), (0, 0, 0.03)], 0.178, looks["beam"], 14)
    if person.skirt:
        mesh.place = Matrix.Diagonal((1.0, 0.9, 1.0, 1.0))
        mesh.tube([(0, 0, 0.02), (0, 0, -0.35)], (0.165, 0.25), looks[person.trousers], 14)
    mesh.place = Matrix.Identity(4)
    mesh.tube([(0, 0, 0.54), (0, -0.01, 0.64)], 0.05, looks["skin"], 10)
    mesh.ball((0, -0.01, 0.73), 0.105, looks["skin"], (14, 10))
    mesh.ball((0, 0.02, 0.76), 0.112, looks["hair"], (14, 10))
    mesh.ball((0, -0.115, 0.71), 0.02, looks["skin"], (6, 5))
    for side in (-1, 1):
        mesh.ball((0.04 * side, -0.098, 0.735), 0.017, looks["white"], (8, 6))
        mesh.ball((0.04 * side, -0.11, 0.735), 0.009, looks["black"], (6, 5))
        mesh.box((0.04 * side, -0.105, 0.765), (0.04, 0.02, 0.01), looks["hair"])
        mesh.ball((0.105 * side, 0.0, 0.72), 0.025, looks["skin"], (8, 6))
    mesh.box((0, -0.108, 0.67), (0.045, 0.012, 0.012), looks["redtin"])
    if person.bowl:
        path = [(0, 0.01, z) for z in (0.86, 0.9, 1.02, 1.03)]
        mesh.tube(path, (0.14, 0.2, 0.27, 0.24), looks["chrome"], 18)
        for fruit in range(12):
            turn = fruit * 2.4
            spot = (0.17 * math.cos(turn) * (fruit % 3) / 2, 0.17 * math.sin(turn), 1.05)
            mesh.ball(spot, 0.06, looks[("orange", "red", "yellow")[fruit % 3]], (8, 6))
    return mesh.object(person.name, person.index)


def _limb(
    looks: Looks,
    person: Person,
    size: tuple[float, float, float],
    look: str,
    foot: bool = False,
    hand: bool = False,
) -> bpy.types.Object:
    """Make a limb that hangs from its joint; size is upper radius, lower radius, length."""
    upper, lower, length = size
    mesh = MeshBuilder()
    mesh.ball((0, 0, 0), upper, looks[look], (10, 6))
    mesh.tube([(0, 0, 0), (0, 0, -length)], (upper, lower), looks[look], 10)
    mesh.ball((0, 0, -length), lower, looks[look], (10, 6))
    if foot:
        mesh.box((0, -0.07, -length - 0.02), (0.09, 0.25, 0.07), looks["black"])
    if hand:
        mesh.ball((0, 0, -length - 0.05), 0.05, looks["skin"], (8, 6))
    return mesh.object(f"{person.name} limb", person.index)


def moped(looks: Looks, indices: tuple[int, int], way: Way, last: int) -> None:
    """Add a moped with its rider and a crate, and its turning wheels."""
    index, wheels = indices
    mesh = MeshBuilder()
    mesh.tube([(0, -0.55, 0.3), (0, -0.42, 0.75), (0, -0.36, 1.0)], 0.035, looks["chrome"], 8)
    mesh.tube(
        [(0, -0.42, 0.7), (0, -0.2, 0.32), (0, 0.35, 0.35), (0, 0.5, 0.62)], 0.06, looks["red"], 8
    )
    mesh.tube([(-0.3, -0.3, 1.04), (0, -0.38, 1.0), (0.3, -0.3, 1.04)], 0.018, looks["black"], 6)
    mesh.ball((0, -0.46, 0.86), 0.1, looks["red"], (12, 8))
    mesh.tube([(0, -0.52, 0.87), (0, -0.57, 0.87)], (0.08, 0.085), looks["headlight"], 14)
    mesh.box((0, 0.02, 0.33), (0.26, 0.32, 0.26), looks["grey"])
    mesh.box((0, 0.28, 0.7), (0.24, 0.62, 0.12), looks["black"])
    mesh.box((0, 0.62, 0.95), (0.46, 0.42, 0.42), looks["crate"])
    mesh.box((0, 0.62, 0.95), (0.48, 0.1, 0.44), looks["blue"])
    for y in (-0.55, 0.55):
        mesh.box((0, y, 0.62), (0.13, 0.36, 0.03), looks["red"])
    trunk = ((0.74, 0.17), (0.95, 0.16), (1.2, 0.2), (1.32, 0.16), (1.37, 0.06))
    path = [(0, 0.18 - 0.2 * (z - 0.74), z) for z, _ in trunk]
    mesh.tube(path, [r for _, r in trunk], looks["stripegreen"], 12)
    mesh.ball((0, 0.02, 1.52), 0.13, looks["yellow"], (14, 10))
    mesh.ball((0, -0.06, 1.48), 0.09, looks["skin"], (10, 8))
    for side in (-1, 1):
        arm = [(0.2 * side, 0.08, 1.28), (0.3 * side, -0.08, 1.1), (0.27 * side, -0.3, 1.05)]
        mesh.tube(arm, (0.06, 0.05, 0.04), looks["skin"], 8)
        leg = [(0.1 * side, 0.18, 0.78), (0.19 * side, -0.22, 0.74), (0.17 * side, -0.1, 0.3)]
        mesh.tube(leg, (0.09, 0.08, 0.05), looks["denim"], 8)
        mesh.box((0.17 * side, -0.14, 0.25), (0.09, 0.25, 0.08), looks["black"])
    body = mesh.object("moped", index)

    def pose(seconds: float) -> tuple[tuple[float, ...], tuple[float, ...]]:
        x, y, heading, gone = way(seconds)
        return (x, y, 0.012 * math.sin(9 * gone)), (0, 0.05 * math.sin(2.0 * gone), heading)

    motion.keyed(body, pose, last)
    for y in (-0.58, 0.55):
        wheel = _wheel(looks, wheels)
        wheel.parent = body
        spot = (0.0, y, 0.29)
        motion.keyed(wheel, lambda s, spot=spot: (spot, (way(s)[3] / 0.29, 0.0, 0.0)), last)


def _wheel(looks: Looks, index: int) -> bpy.types.Object:
    mesh = MeshBuilder()
    for radius, thick, look in ((0.25, 0.045, "rubber"), (0.19, 0.018, "chrome")):
        ring = [
            (0, radius * math.cos(a / 10 * math.pi), radius * math.sin(a / 10 * math.pi))
            for a in range(21)
        ]
        mesh.tube(ring, thick, looks[look], 6)
    for spoke in range(5):
        angle = 2 * math.pi * spoke / 5
        rim = (0, 0.2 * math.cos(angle), 0.2 * math.sin(angle))
        mesh.tube([(0, 0, 0), rim], 0.014, looks["chrome"], 5)
    mesh.tube([(-0.06, 0, 0), (0.06, 0, 0)], 0.05, looks["grey"], 8)
    return mesh.object("moped wheel", index)


def chicken(looks: Looks, index: int, way: Way, last: int) -> None:
    """Add a chicken that hurries up the stair, nodding."""
    mesh = MeshBuilder()
    mesh.place = Matrix.Translation((0, 0, 0.24)) @ Matrix.Diagonal((0.75, 1.15, 0.85, 1.0))
    mesh.ball((0, 0, 0), 0.14, looks["orange"], (14, 10))
    mesh.place = Matrix.Translation((0, 0, 0.24))
    for side in (-1, 1):
        mesh.ball((0.1 * side, 0.03, 0.01), 0.07, looks["beam"], (10, 8))
        mesh.tube(
            [(0.05 * side, 0, -0.1), (0.05 * side, 0.02 * side, -0.23)], 0.012, looks["yellow"], 6
        )
    for feather in range(6):
        tip = (0.05 * (feather - 2.5), 0.3, 0.1 + 0.03 * (feather % 3))
        points = [(-0.02, 0.12, 0.03), (0.02, 0.12, 0.03), tip]
        mesh.faces(points, [(0, 1, 2)], looks["black"])
    mesh.tube([(0, -0.1, 0.06), (0, -0.16, 0.18)], (0.06, 0.045), looks["orange"], 10)
    body = mesh.object("chicken", index)
    head = MeshBuilder()
    head.ball((0, 0, 0), 0.05, looks["orange"], (10, 8))
    head.tube([(0, -0.04, 0), (0, -0.1, -0.01)], (0.02, 0.003), looks["yellow"], 6)
    head.box((0, -0.01, 0.055), (0.012, 0.06, 0.04), looks["red"])
    face = head.object("chicken head", index)
    face.parent = body

    def pose(seconds: float) -> tuple[tuple[float, ...], tuple[float, ...]]:
        x, y, heading, gone = way(seconds)
        hop = 0.015 * (1 + math.sin(40 * gone))
        stair = 0.175 * ((y - 4.45) / 0.29 + 1)
        return (x, y, stair + hop), (0, 0.1 * math.sin(20 * gone), heading)

    def nod(seconds: float) -> tuple[tuple[float, ...], tuple[float, ...]]:
        gone = way(seconds)[3]
        return (0, -0.17 + 0.03 * math.sin(22 * gone), 0.44), (0.2 * math.sin(22 * gone), 0, 0)

    motion.keyed(body, pose, last)
    motion.keyed(face, nod, last)
