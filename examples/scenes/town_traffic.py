"""What drives in the town scene: cars, a tram and a bus, with turning wheels."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

from stage import looks, motion
from stage.blender import bpy, mathutils
from stage.meshes import MeshBuilder, lettering
from town_houses import UPRIGHT, Materials
from town_street import place, shared

Matrix, Vector = mathutils.Matrix, mathutils.Vector
Way = Callable[[float], float]
"""Metres gone after some seconds."""

WHEEL = 0.33


@dataclass(frozen=True)
class Ride:
    """How something travels: where from, heading in degrees, metres over seconds."""

    start: tuple[float, float]
    heading: float
    way: Way

    def pose(self, lift: float = 0.0) -> motion.Pose:
        """Return the pose over time, travelling straight."""
        angle = math.radians(self.heading)

        def at(seconds: float) -> tuple[tuple[float, ...], tuple[float, ...]]:
            gone = self.way(seconds)
            x = self.start[0] + gone * math.cos(angle)
            return (x, self.start[1] + gone * math.sin(angle), lift), (0, 0, angle)

        return at


def steady(speed: float, swing: float = 0.0) -> Way:
    """Return a way at a speed in m/s that swells and falls a little."""
    return lambda seconds: speed * seconds + swing * math.sin(1.7 * seconds)


def lacquer(name: str, colour: looks.Colour) -> bpy.types.Material:
    """Car paint under a clear coat."""
    material = looks.paint(name, colour, 0.35, 0.15)
    shader = next(n for n in material.node_tree.nodes if n.type == "BSDF_PRINCIPLED")
    shader.inputs["Coat Weight"].default_value = 1.0
    shader.inputs["Coat Roughness"].default_value = 0.04
    return material


def _loft(mesh: MeshBuilder, made: bpy.types.Material) -> None:
    """Add a car's lower body from cross sections (x, half width, bottom, top)."""
    sections = (
        (-2.12, 0.70, 0.45, 0.76), (-1.98, 0.83, 0.32, 0.92), (-1.2, 0.88, 0.24, 0.98),
        (0.0, 0.89, 0.22, 0.96), (0.9, 0.88, 0.24, 0.91), (1.7, 0.85, 0.28, 0.82),
        (2.05, 0.76, 0.34, 0.72), (2.15, 0.66, 0.44, 0.62),
    )  # fmt: skip
    points = []
    for x, half, low, top in sections:
        ring = [(0.85, low), (1.0, low + 0.1), (1.0, 0.4 * low + 0.6 * top), (0.94, top - 0.05)]
        ring.append((0.78, top))
        points += [(x, half * y, z) for y, z in ring]
        points += [(x, -half * y, z) for y, z in reversed(ring)]
    count = 10
    sides = [
        (a * count + s, a * count + (s + 1) % count, b * count + (s + 1) % count, b * count + s)
        for a, b in pairwise(range(len(sections)))
        for s in range(count)
    ]
    mesh.faces(points, sides, made, smooth=True)
    last = count * (len(sections) - 1)
    mesh.faces(points, [tuple(range(count)), tuple(range(last, last + count))], made)


def _car_mesh(colour: looks.Colour, made: Materials, roof: float) -> bpy.types.Mesh:
    """Make a car that faces +x; `roof` is how far back the roof reaches."""
    mesh, body = MeshBuilder(), lacquer("lacquer", colour)
    _loft(mesh, body)
    low = [(1.0, 0.8, 0.9), (1.0, -0.8, 0.9), (roof - 0.5, -0.8, 0.93), (roof - 0.5, 0.8, 0.93)]
    top = [(0.3, 0.62, 1.42), (0.3, -0.62, 1.42), (roof, -0.62, 1.4), (roof, 0.62, 1.4)]
    panes = [(n, (n + 1) % 4, 4 + (n + 1) % 4, 4 + n) for n in range(4)]
    mesh.faces(low + top, panes, made["glass"])
    crown = [(x * 0.96 - 0.01, 0.8 * y, 1.47) for x, y, _ in top]
    mesh.faces(top + crown, [*panes, (4, 5, 6, 7)], body, smooth=True)
    for foot, head in zip(low, top, strict=True):
        mesh.tube([foot, head], 0.045, body, 6)
    for side in (-1, 1):
        mesh.tube([(-0.3, 0.81 * side, 0.93), (-0.35, 0.63 * side, 1.42)], 0.045, body, 6)
        mesh.box((0.75, 0.95 * side, 0.98), (0.14, 0.2, 0.14), body)
        mesh.box((2.07, 0.55 * side, 0.64), (0.14, 0.3, 0.15), made["beam"])
        mesh.box((-2.05, 0.6 * side, 0.78), (0.1, 0.3, 0.16), made["stop"])
        mesh.box((-0.3, 0.885 * side, 0.8), (0.2, 0.03, 0.04), made["steel"])
        mesh.box((0.0, 0.89 * side, 0.3), (1.7, 0.04, 0.12), made["black"])
        for x in (-1.3, 1.3):
            mesh.tube([(x, 0.8 * side, 0.36), (x, 0.893 * side, 0.36)], 0.42, made["black"], 18)
    mesh.box((2.12, 0, 0.56), (0.1, 0.7, 0.16), made["black"])
    mesh.box((2.1, 0, 0.4), (0.16, 1.4, 0.1), made["steel"])
    mesh.box((2.19, 0, 0.4), (0.02, 0.5, 0.12), made["white"])
    mesh.box((-2.1, 0, 0.45), (0.16, 1.5, 0.12), made["steel"])
    mesh.box((-2.13, 0, 0.62), (0.03, 0.52, 0.13), made["yellow"])
    return shared(mesh, "car")


def axle(made: Materials, radius: float, half: float) -> bpy.types.Mesh:
    """Make a pair of wheels on the y axis, with spokes that show how they turn."""
    mesh = MeshBuilder()
    for side in (-1, 1):
        ends = [(0, side * (half - 0.1), 0), (0, side * (half + 0.09), 0)]
        mesh.tube(ends, radius, made["black"], 18)
        for spoke in range(5):
            mesh.place = Matrix.Rotation(spoke * 2 * math.pi / 5, 4, "Y")
            size = (0.34 * radius, 0.03, 0.55 * radius)
            mesh.box((0, side * (half + 0.095), 0.4 * radius), size, made["steel"])
        mesh.place = Matrix.Identity(4)
    return shared(mesh, "wheels")


class Garage:
    """Makes cars of all colours from shared meshes, driving or parked."""

    def __init__(self, made: Materials) -> None:
        colours = (
            (0.55, 0.03, 0.03), (0.05, 0.16, 0.42), (0.75, 0.74, 0.70), (0.05, 0.05, 0.06),
            (0.70, 0.45, 0.05), (0.08, 0.27, 0.20), (0.34, 0.36, 0.40),
        )  # fmt: skip
        roofs = (-1.1, -1.5, -0.9, -1.4, -1.2, -1.0, -1.5)
        self._made = made
        self._bodies = [_car_mesh(c, made, r) for c, r in zip(colours, roofs, strict=True)]
        self._axle = axle(made, WHEEL, 0.84)

    def park(self, kind: int, where: tuple[float, float], heading: float) -> None:
        """Park a car."""
        car = place(self._bodies[kind % 7], "parked", (*where, 0), math.radians(heading))
        for x in (-1.3, 1.3):
            place(self._axle, "wheels", (x, 0, WHEEL), parent=car)

    def drive(self, kind: int, index: int, ride: Ride, last: int) -> None:
        """Send a car along the street, its wheels turning."""
        car = place(self._bodies[kind % 7], f"car {index}", index=index)
        motion.keyed(car, ride.pose(), last)
        for x in (-1.3, 1.3):
            roll(place(self._axle, "wheels", index=index, parent=car), (x, WHEEL), ride.way, last)


def roll(wheels: bpy.types.Object, spot: tuple[float, float], way: Way, last: int) -> None:
    """Turn wheels of a vehicle, at x and height (= radius), as it goes."""
    x, radius = spot
    motion.keyed(wheels, lambda t: ((x, 0, radius), (0, way(t) / radius, 0)), last)


def coach(
    index: int, ride: Ride, text: str, paints: tuple[str, str], made: Materials, last: int
) -> None:
    """Run a tram (with a bow to the wire, when the text starts with a digit) or a bus."""
    tram = text[0].isdigit()
    half, wide, top = (6.6, 1.15, 2.9) if tram else (5.2, 1.2, 3.7)
    mesh = MeshBuilder()
    lower, upper = (made[name] for name in paints)
    layers = [(0.3, 1.2, lower, 0.0), (1.2, 2.1, made["glass"], 0.05), (2.1, 2.5, upper, 0.0)]
    layers += [(2.5, 2.9, upper, 0.03)] if tram else [(2.5, 3.3, made["glass"], 0.05)]
    layers.append((top, top + 0.14, made["white"], 0.12) if tram else (3.3, 3.8, lower, 0.0))
    for low, high, made_of, inset in layers:
        _prism(mesh, (half - inset, wide - inset), (low, high), made_of)
    _fittings(mesh, (half, wide, top), tram, upper, made)
    body = mesh.object("tram" if tram else "bus", index)
    motion.keyed(body, ride.pose(), last)
    front = Matrix.Translation((half + 0.06, 0, 2.29)) @ Matrix.Rotation(math.pi / 2, 4, "Z")
    flank = Matrix.Translation((0, -wide - 0.02, 0.78))
    for spot, size, ink in ((front, 0.26, "lit"), (flank, 0.5, "gold")):
        letters = lettering(text, spot @ UPRIGHT, size, made[ink])
        letters.parent, letters.pass_index = body, index
    wheels = axle(made, 0.45, wide - 0.12)
    for x in (-0.62 * half, -0.42 * half, 0.42 * half, 0.62 * half) if tram else (-2.9, 3.2):
        roll(place(wheels, "wheels", index=index, parent=body), (x, 0.45), ride.way, last)


def _fittings(
    mesh: MeshBuilder,
    size: tuple[float, float, float],
    tram: bool,
    upper: bpy.types.Material,
    made: Materials,
) -> None:
    """Add a coach's window posts, lamps, bumper and, to a tram, the bows that reach the wire."""
    half, wide, top = size
    count = round(half * 2 / 1.3)
    for number in range(count):
        x = (number / (count - 1) - 0.5) * 2 * (half - 0.8)
        for side in (-1, 1):
            for z in (1.65,) if tram else (1.65, 2.9):
                mesh.box((x, side * (wide - 0.03), z), (0.12, 0.08, 0.95), upper)
    for side in (-1, 1):
        mesh.box((0, side * wide, 1.12), (2 * half - 2, 0.04, 0.08), made["gold"])
        mesh.ball((half - 0.04, side * 0.62, 0.75), 0.14, made["beam"], (12, 8))
        mesh.box((-half + 0.1, side * 0.7, 0.75), (0.1, 0.2, 0.2), made["stop"])
        for end in (-1, 1):
            mesh.box((end * (half - 0.2), side * 0.32, 1.65), (0.12, 0.07, 0.9), upper)
    mesh.box((half - 0.05, 0, 2.3), (0.16, 1.3, 0.34), made["black"])
    mesh.box((half + 0.02, 0, 0.42), (0.14, 1.5, 0.16), made["steel"])
    if tram:
        for side in (-0.5, 0.5):
            bow = [(0, side, top), (-1.3, side, top + 1.3), (0.3, side, 5.85)]
            mesh.tube(bow, 0.035, made["black"], 5)
        mesh.box((0.3, 0, 5.87), (0.1, 1.4, 0.06), made["black"])


def _prism(
    mesh: MeshBuilder,
    size: tuple[float, float],
    span: tuple[float, float],
    made: bpy.types.Material,
) -> None:
    """Add one layer of a coach: a long outline with rounded ends."""
    long, wide = size
    ends = [(long, 0.55 * wide), (long - 0.15, 0.82 * wide), (long - 0.6, wide)]
    ring = ends + [(-x, y) for x, y in reversed(ends)]
    ring += [(-x, -y) for x, y in ends] + [(x, -y) for x, y in reversed(ends)]
    count = len(ring)
    points = [(x, y, z) for z in span for x, y in ring]
    sides = [(n, (n + 1) % count, count + (n + 1) % count, count + n) for n in range(count)]
    mesh.faces(points, [*sides, tuple(range(count)), tuple(range(count, 2 * count))], made)
