"""Running figures with limbs: the feet stand still on the ground, knees follow from them."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from stage import motion
from stage.blender import bpy, mathutils
from stage.meshes import MeshBuilder

Matrix, Vector = mathutils.Matrix, mathutils.Vector
Material = bpy.types.Material
Angles = tuple[float, float, float]

THIGH, SHIN, ANKLE = 0.44, 0.44, 0.08
HIPS = 0.85
SHOULDER, UPPER_ARM, WAIST = 0.50, 0.30, 0.06
CYCLE = 0.62
"""Seconds of two steps."""

REACH = 0.36
"""How far a foot stands before and behind the hips, metres."""


@dataclass(frozen=True)
class Suit:
    """What a runner wears.

    Attributes
    ----------
    cloth, plates, skin, light : bpy.types.Material
        Of limbs, of armour and shoes, of head and hands, and of visor and lamps.
    """

    cloth: Material
    plates: Material
    skin: Material
    light: Material


Way = Callable[[float], tuple[float, float, float]]
"""Takes seconds and returns x, y in metres and the heading in radians from +x."""


class Squad:
    """Makes runners from one set of meshes for each suit, and gives out object ids.

    Attributes
    ----------
    names : dict of int to str
        What each id is.
    """

    def __init__(self, last: int, first: int = 1) -> None:
        self.names: dict[int, str] = {}
        self._last, self._next = last, first

    def name(self, what: str) -> int:
        """Give out the next object id."""
        index, self._next = self._next, self._next + 1
        self.names[index] = what
        return index

    def run(self, suit: Suit, way: Way, speed: float, phase: float = 0.0) -> bpy.types.Object:
        """Add a runner; return the hips, which all limbs hang on.

        Parameters
        ----------
        suit : Suit
            Materials.
        way : callable
            Where the runner is, and its heading.
        speed : float
            Metres a second along the way; 0 for one who stands.
        phase : float
            Share of the cycle at the first instant, 0..1.
        """
        index, last = self.name("runner"), self._last
        gait = Gait(speed, phase)
        hips = _part(_pelvis(suit), "hips", index, None)
        motion.keyed(hips, gait.hips(way), last)
        chest = _part(_chest(suit), "chest", index, hips)
        motion.keyed(chest, gait.chest, last)
        head = _part(_head(suit), "head", index, chest)
        motion.keyed(head, lambda t: ((0.03, 0, 0.58), (0, -0.2, -gait.twist(t))), last)
        for side in (-1, 1):
            thigh = _part(_thigh(suit), "thigh", index, hips)
            motion.keyed(thigh, lambda t, s=side: gait.leg(t, s)[0], last)
            shin = _part(_shin(suit), "shin", index, thigh)
            motion.keyed(shin, lambda t, s=side: gait.leg(t, s)[1], last)
            foot = _part(_foot(suit), "foot", index, shin)
            motion.keyed(foot, lambda t, s=side: gait.leg(t, s)[2], last)
            arm = _part(_upper_arm(suit, side), "arm", index, chest)
            motion.keyed(arm, lambda t, s=side: gait.arm(t, s), last)
            fore = _part(_forearm(suit), "forearm", index, arm)
            motion.keyed(fore, lambda t, s=side: gait.forearm(t, s), last)
        return hips


@dataclass(frozen=True)
class Gait:
    """A run as angles of joints over time.

    Attributes
    ----------
    speed : float
        Metres a second.
    phase : float
        Share of the cycle at the first instant, 0..1.
    """

    speed: float
    phase: float

    def _share(self, seconds: float, side: int) -> float:
        """Share of the cycle of one leg, from its touch of the ground."""
        return (seconds / CYCLE + self.phase + (0.5 if side > 0 else 0.0)) % 1

    def hips(self, way: Way) -> motion.Pose:
        """Return the pose of the hips in the world."""

        def pose(t: float) -> tuple[Sequence[float], Angles]:
            x, y, heading = way(t)
            turn = 4 * math.pi * (t / CYCLE + self.phase)
            bob = 0.03 * math.sin(turn - 2.0) if self.speed else 0.0
            lean = 0.04 * math.sin(turn / 2)
            return (x, y, HIPS + bob), (lean, 0.0, heading + 0.12 * math.sin(turn / 2))

        return pose

    def twist(self, t: float) -> float:
        """Return how far the chest turns against the hips, radians."""
        strength = 0.3 if self.speed else 0.05
        return -strength * math.sin(2 * math.pi * (t / CYCLE + self.phase))

    def chest(self, t: float) -> tuple[Sequence[float], Angles]:
        """Return the pose of the chest on the hips."""
        lean = 0.06 * self.speed
        return (0, 0, WAIST), (0, lean, self.twist(t))

    def leg(self, t: float, side: int) -> list[tuple[Sequence[float], Angles]]:
        """Return the poses of thigh, shin and foot, each on the one before."""
        x, z, toe = self._step(self._share(t, side))
        away = min(math.hypot(x, z), 0.995 * (THIGH + SHIN))
        towards = math.atan2(x, -z)
        bend = math.acos(away / (2 * THIGH))  # thigh and shin are equally long
        upper, lower = towards + bend, towards - bend
        return [
            ((0, 0.1 * side, 0), (0, -upper, 0)),
            ((0, 0, -THIGH), (0, upper - lower, 0)),
            ((0, 0, -SHIN), (0, toe + lower, 0)),
        ]

    def _step(self, share: float) -> tuple[float, float, float]:
        """Return an ankle's x and z below the hips, and how far the toes point down."""
        low = ANKLE - HIPS
        if not self.speed:
            return 0.05, low, 0.0
        stand = 2 * REACH / (self.speed * CYCLE)
        if share < stand:
            rolled = motion.ramp(share / stand, 0.55, 1.0)
            return REACH - self.speed * CYCLE * share, low + 0.07 * rolled, 0.5 * rolled
        q = (share - stand) / (1 - stand)
        slope = -self.speed * CYCLE * (1 - stand)
        x = REACH * (-1 + 2 * q * q * (3 - 2 * q)) + slope * (q - 3 * q**2 + 2 * q**3)
        lift = 0.07 * (1 - q) ** 3 + 0.42 * math.sin(math.pi * q**0.8) ** 2
        toe = 0.5 * (1 - q) + 0.9 * math.sin(math.pi * min(1.0, 1.3 * q)) * (q < 0.77) - 0.15 * q
        return x, low + lift, toe

    def arm(self, t: float, side: int) -> tuple[Sequence[float], Angles]:
        """Return the pose of an upper arm on the chest."""
        swing = 0.8 if self.speed else 0.08
        angle = swing * math.sin(2 * math.pi * self._share(t, side) + 0.4)
        return (0, 0.23 * side, SHOULDER), (-0.18 * side, 0.2 - angle, 0)

    def forearm(self, t: float, side: int) -> tuple[Sequence[float], Angles]:
        """Return the pose of a forearm on the upper arm."""
        bend = -1.45 - 0.3 * math.sin(2 * math.pi * self._share(t, side)) if self.speed else -0.4
        return (0, 0, -UPPER_ARM), (0.15 * side, bend, 0)


def _part(
    mesh: MeshBuilder, name: str, index: int, parent: bpy.types.Object | None
) -> bpy.types.Object:
    thing = mesh.object(name, index)
    thing.parent = parent
    return thing


def _pelvis(suit: Suit) -> MeshBuilder:
    mesh = MeshBuilder()
    mesh.place = Matrix.Diagonal((0.75, 1.1, 1.0, 1.0))
    mesh.tube([(0, 0, z) for z in (-0.1, 0.0, 0.14)], (0.13, 0.165, 0.14), suit.cloth, 12)
    mesh.tube([(0, 0, 0.06), (0, 0, 0.11)], 0.17, suit.plates, 12)
    return mesh


def _chest(suit: Suit) -> MeshBuilder:
    mesh = MeshBuilder()
    mesh.place = Matrix.Diagonal((0.68, 1.1, 1.0, 1.0))
    rings = ((0.0, 0.135), (0.2, 0.165), (0.38, 0.2), (0.5, 0.17), (0.55, 0.06))
    mesh.tube([(0, 0, z) for z, _ in rings], [r for _, r in rings], suit.cloth, 14)
    mesh.place = Matrix.Identity(4)
    mesh.box((0.115, 0, 0.36), (0.07, 0.3, 0.22), suit.plates)
    mesh.box((-0.17, 0, 0.32), (0.14, 0.26, 0.34), suit.plates)
    mesh.box((-0.245, 0, 0.38), (0.02, 0.16, 0.04), suit.light)
    mesh.tube([(0, 0, 0.5), (0.02, 0, 0.6)], 0.06, suit.skin, 8)
    return mesh


def _head(suit: Suit) -> MeshBuilder:
    mesh = MeshBuilder()
    mesh.place = Matrix.Diagonal((1.1, 0.92, 1.15, 1.0))
    mesh.ball((0, 0, 0.1), 0.112, suit.skin, (14, 10))
    mesh.ball((-0.015, 0, 0.125), 0.12, suit.plates, (14, 10))
    mesh.place = Matrix.Identity(4)
    mesh.box((0.1, 0, 0.13), (0.05, 0.14, 0.045), suit.light)
    return mesh


def _thigh(suit: Suit) -> MeshBuilder:
    mesh = MeshBuilder()
    mesh.ball((0, 0, 0), 0.105, suit.cloth, (10, 8))
    mesh.tube([(0, 0, 0), (0.01, 0, -0.2), (0, 0, -THIGH)], (0.1, 0.09, 0.062), suit.cloth, 10)
    mesh.ball((0, 0, -THIGH), 0.066, suit.plates, (10, 8))
    return mesh


def _shin(suit: Suit) -> MeshBuilder:
    mesh = MeshBuilder()
    calf = [(0, 0, 0), (-0.02, 0, -0.14), (0, 0, -SHIN + 0.02)]
    mesh.tube(calf, (0.06, 0.068, 0.042), suit.cloth, 10)
    mesh.box((0.055, 0, -0.18), (0.03, 0.08, 0.26), suit.plates)
    return mesh


def _foot(suit: Suit) -> MeshBuilder:
    mesh = MeshBuilder()
    mesh.ball((0, 0, 0), 0.052, suit.plates, (8, 6))
    mesh.box((0.0, 0, -0.045), (0.15, 0.09, 0.07), suit.plates)
    mesh.box((0.12, 0, -0.055), (0.13, 0.1, 0.05), suit.plates)
    return mesh


def _upper_arm(suit: Suit, side: int) -> MeshBuilder:
    mesh = MeshBuilder()
    mesh.ball((0, 0.01 * side, 0), 0.085, suit.plates, (10, 8))
    mesh.tube([(0, 0, 0), (0, 0, -UPPER_ARM)], (0.062, 0.048), suit.cloth, 8)
    return mesh


def _forearm(suit: Suit) -> MeshBuilder:
    mesh = MeshBuilder()
    mesh.ball((0, 0, 0), 0.05, suit.cloth, (8, 6))
    mesh.tube([(0, 0, 0), (0, 0, -0.25)], (0.048, 0.036), suit.cloth, 8)
    mesh.ball((0, 0, -0.29), 0.048, suit.skin, (8, 6))
    return mesh
