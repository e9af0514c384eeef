"""Who moves in the town scene: people with swinging limbs, a cyclist, pigeons."""

from __future__ import annotations

import math
import random

from stage import motion
from stage.blender import bpy, mathutils
from stage.meshes import MeshBuilder
from town_houses import Materials
from town_street import place, shared
from town_traffic import Ride, roll, steady

Matrix = mathutils.Matrix

HIP, KNEE, SHOULDER = 0.90, 0.45, 1.40
OUTFITS = (
    ("blue", "black", "brown"),
    ("red", "grey", "black"),
    ("tan", "brown", "brown"),
    ("green", "blue", "yellow"),
    ("white", "black", "black"),
    ("violet", "grey", "tan"),
    ("orange", "blue", "brown"),
    ("grey", "black", "white"),
)


class Crowd:
    """Makes people from shared meshes: a body with swinging arms and legs that bend."""

    def __init__(self, made: Materials, chance: random.Random) -> None:
        self._chance = chance
        self._outfits = [self._sewn(number, made) for number in range(len(OUTFITS))]

    def _sewn(self, number: int, made: Materials) -> dict[str, bpy.types.Mesh]:
        coat, trousers, hair = (made[name] for name in OUTFITS[number])
        body, thigh, shin, arm = (MeshBuilder() for _ in range(4))
        long = number % 3 == 0
        hem = 0.55 if long else 0.86
        rings = (
            (hem, 0.24 if long else 0.17),
            (1.0, 0.16),
            (1.25, 0.19),
            (1.42, 0.18),
            (1.5, 0.07),
        )
        body.place = Matrix.Diagonal((0.78, 1.15, 1.0, 1.0))
        body.tube([(0, 0, z) for z, _ in rings], [r for _, r in rings], coat, 12)
        body.place = Matrix.Identity(4)
        body.tube([(0, 0, 1.46), (0.01, 0, 1.56)], 0.055, made["skin"], 8)
        body.ball((0.02, 0, 1.65), 0.11, made["skin"], (12, 10))
        body.ball((-0.012, 0, 1.675), 0.117, hair, (12, 10))
        if number % 4 == 1:
            body.tube([(0, 0, 1.7), (0, 0, 1.72)], 0.2, hair, 14)
            body.tube([(0, 0, 1.72), (0, 0, 1.84)], (0.12, 0.11), hair, 14)
        if number % 2:
            body.box((-0.2, 0, 1.2), (0.16, 0.28, 0.4), made["red" if number % 4 == 3 else "brown"])
        thigh.tube([(0, 0, 0.03), (0, 0, -KNEE)], (0.095, 0.065), trousers, 8)
        shin.tube([(0, 0, 0.02), (0, 0, -0.40)], (0.068, 0.05), trousers, 8)
        shin.box((0.06, 0, -0.41), (0.26, 0.1, 0.08), made["black"])
        elbow = [(0, 0, 0.02), (0, 0, -0.28), (0.08, 0, -0.52)]
        arm.tube(elbow, (0.065, 0.052, 0.045), coat, 8)
        arm.ball((0.09, 0, -0.57), 0.05, made["skin"], (8, 6))
        if number % 4 == 2:
            arm.box((0.09, 0, -0.78), (0.34, 0.12, 0.3), made["brown"])
        parts = {"body": body, "thigh": thigh, "shin": shin, "arm": arm}
        return {name: shared(mesh, name) for name, mesh in parts.items()}

    def walk(self, index: int, start: tuple[float, float], heading: float, last: int) -> None:
        """Animate a walking person, all parts with one object id."""
        meshes = self._outfits[index % len(self._outfits)]
        speed, phase = self._chance.uniform(1.2, 1.7), self._chance.uniform(0, 6.28)
        rate, tall = 4.4 * speed, self._chance.uniform(0.93, 1.08)
        ride = Ride(start, heading, steady(speed))
        on_road = abs(start[1] - 20) < 4.5 or abs(start[0]) < 5.0
        straight = ride.pose(0.0 if on_road else 0.13)
        body = place(meshes["body"], f"person {index}", index=index)
        body.scale = (tall, tall, tall)

        def pose(t: float) -> tuple[tuple[float, ...], tuple[float, ...]]:
            where, turn = straight(t)
            bob = 0.025 * math.cos(2 * (rate * t + phase))
            sway = 0.03 * math.sin(rate * t + phase)
            return (where[0], where[1], where[2] + bob), (sway, 0.06, turn[2] + sway)

        motion.keyed(body, pose, last)
        for side in (-1, 1):
            shift = phase + (math.pi if side > 0 else 0.0)
            self._leg(meshes, body, (side * 0.1, rate, shift), last)
            arm = place(meshes["arm"], "arm", index=index, parent=body)
            motion.keyed(arm, _swinging((0, 0.24 * side, SHOULDER), (0.55, rate, shift)), last)

    def _leg(
        self,
        meshes: dict[str, bpy.types.Mesh],
        body: bpy.types.Object,
        gait: tuple[float, float, float],
        last: int,
    ) -> None:
        side, rate, shift = gait
        thigh = place(meshes["thigh"], "thigh", index=body.pass_index, parent=body)
        motion.keyed(thigh, _swinging((0, side, HIP), (0.5, rate, shift + math.pi)), last)
        shin = place(meshes["shin"], "shin", index=body.pass_index, parent=thigh)

        def bend(t: float) -> tuple[tuple[float, ...], tuple[float, ...]]:
            return (0, 0, -KNEE), (0, 0.45 + 0.42 * math.cos(rate * t + shift + math.pi), 0)

        motion.keyed(shin, bend, last)

    def cycle(self, index: int, ride: Ride, made: Materials, last: int) -> None:
        """Animate a person on a bicycle, with pedalling legs."""
        meshes = self._outfits[3]
        mesh = MeshBuilder()
        tubes = [
            ((-0.5, 0.34), (-0.1, 0.34)),
            ((-0.1, 0.34), (-0.22, 0.85)),
            ((-0.5, 0.34), (-0.2, 0.75)),
        ]
        tubes += [
            ((-0.1, 0.34), (0.42, 0.8)),
            ((-0.2, 0.78), (0.4, 0.82)),
            ((0.55, 0.34), (0.4, 1.0)),
        ]
        for one, two in tubes:
            mesh.tube([(one[0], 0, one[1]), (two[0], 0, two[1])], 0.025, made["red"], 6)
        mesh.tube([(0.36, -0.25, 1.02), (0.36, 0.25, 1.02)], 0.02, made["steel"], 6)
        mesh.box((-0.24, 0, 0.88), (0.26, 0.15, 0.06), made["black"])
        mesh.ball((0.5, 0, 0.86), 0.06, made["beam"], (8, 6))
        bike = mesh.object("bicycle", index)
        motion.keyed(bike, ride.pose(), last)
        rim = MeshBuilder()
        for part in range(16):
            ends = [
                (0.33 * math.cos(a), 0, 0.33 * math.sin(a))
                for a in (part * math.pi / 8, (part + 1) * math.pi / 8)
            ]
            rim.tube(ends, 0.022, made["black"], 6)
            rim.tube([(0, 0, 0), ends[0]], 0.006, made["steel"], 4)
        shape = shared(rim, "bicycle wheel")
        for x in (-0.5, 0.55):
            roll(place(shape, "wheel", index=index, parent=bike), (x, 0.34), ride.way, last)
        rider = place(meshes["body"], "rider", (-0.55, 0, 0.06), index=index, parent=bike)
        rider.rotation_euler = (0, 0.35, 0)
        for side in (-1, 1):
            spin = (7.0, 0.0 if side > 0 else math.pi)
            self._pedalling(meshes, bike, side, spin, last)
            arm = place(meshes["arm"], "arm", (0, 0.22 * side, SHOULDER), 0.0, index, rider)
            arm.rotation_euler = (0, -1.25, 0)

    def _pedalling(
        self,
        meshes: dict[str, bpy.types.Mesh],
        bike: bpy.types.Object,
        side: int,
        spin: tuple[float, float],
        last: int,
    ) -> None:
        rate, phase = spin
        thigh = place(meshes["thigh"], "thigh", index=bike.pass_index, parent=bike)
        lift = (-0.2, 0.1 * side, 0.92)
        motion.keyed(
            thigh, lambda t: (lift, (0, -0.95 + 0.35 * math.sin(rate * t + phase), 0)), last
        )
        shin = place(meshes["shin"], "shin", index=bike.pass_index, parent=thigh)
        motion.keyed(
            shin,
            lambda t: ((0, 0, -KNEE), (0, 1.05 + 0.4 * math.cos(rate * t + phase), 0)),
            last,
        )


def _swinging(spot: tuple[float, ...], swing: tuple[float, float, float]) -> motion.Pose:
    """Return a pose that swings about y: reach (radians), rate (radians a second), phase."""
    reach, rate, phase = swing
    return lambda t: (spot, (0, reach * math.sin(rate * t + phase), 0))


def pigeons(first: int, spots: list[tuple[float, float]], made: Materials, last: int) -> None:
    """Let pigeons take off one after the other, with beating wings."""
    body, wing = MeshBuilder(), MeshBuilder()
    body.place = Matrix.Diagonal((2.1, 1.0, 0.9, 1.0))
    body.ball((0, 0, 0), 0.085, made["grey"], (10, 8))
    body.place = Matrix.Identity(4)
    body.ball((0.18, 0, 0.08), 0.05, made["blue"], (8, 6))
    body.faces([(-0.12, 0.05, 0), (-0.12, -0.05, 0), (-0.34, -0.08, 0), (-0.34, 0.08, 0)],
               [(0, 1, 2, 3)], made["grey"])  # fmt: skip
    feather = [(0.1, 0, 0), (0.08, 0.2, 0.02), (-0.02, 0.42, 0), (-0.12, 0.2, 0), (-0.12, 0, 0)]
    wing.faces(feather, [(0, 1, 2, 3, 4)], made["white"])
    shapes = shared(body, "pigeon"), shared(wing, "wing")
    for number, (x, y) in enumerate(spots):
        index, begin, turn = first + number, 0.1 + 0.09 * number, 2.0 + 0.45 * (number % 4)
        bird = place(shapes[0], f"pigeon {index}", index=index)

        def pose(
            t: float, x: float = x, y: float = y, begin: float = begin, turn: float = turn
        ) -> tuple[tuple[float, ...], tuple[float, ...]]:
            up = motion.ramp(t, begin, begin + 3.2)
            gone, bob = 30 * up, 0.05 * math.sin(9 * t + x)
            where = (x + gone * math.cos(turn), y + gone * math.sin(turn), 0.2 + 16 * up + bob)
            return where, (0, -0.5 * min(1.0, 3 * up), turn)

        motion.keyed(bird, pose, last)
        for side in (-1, 1):
            beat = place(shapes[1], "wing", index=index, parent=bird)
            beat.scale = (1, side, 1)

            def flap(t: float, side: int = side, n: int = number) -> tuple:
                return (0, 0.05 * side, 0.04), (side * 0.9 * math.sin(34 * t + n), 0, 0)

            motion.keyed(beat, flap, last)
