"""The plants of the tropical scene: shared meshes of fronds, leaves, blades and vines."""

from __future__ import annotations

import math
import random
from collections.abc import Sequence
from dataclasses import dataclass

from stage import looks
from stage.blender import bpy, mathutils
from stage.meshes import MeshBuilder

Vector = mathutils.Vector
Materials = dict[str, bpy.types.Material]
Meshes = dict[str, list[bpy.types.Mesh]]


@dataclass(frozen=True)
class Feather:
    """A leaf of many narrow leaflets along an arching rib that starts along +x.

    Attributes
    ----------
    length, leaflet, width : float
        Of the rib, of the longest leaflet, and of a leaflet at its widest, metres.
    count : int
        Leaflets on each side.
    rise, droop : float
        Slope of the rib at its foot, and how far it curves down.
    """

    length: float
    leaflet: float
    width: float
    count: int
    rise: float = 0.3
    droop: float = 0.55

    def point(self, share: float) -> mathutils.Vector:
        """Return the rib's point at a share 0..1 of its length."""
        height = self.rise * share - self.droop * share**2
        return Vector((self.length * (share - 0.12 * share**2), 0.0, self.length * height))


PALM = Feather(2.1, 0.52, 0.042, 34)
FERN = Feather(0.95, 0.17, 0.042, 22, rise=0.75, droop=0.8)
JOINT = 0.48
"""Share of a palm frond's length at which its outer half swings about its inner half."""


def leaf_look(name: str, young: looks.Colour, old: looks.Colour) -> bpy.types.Material:
    """Glossy leaves: every piece has a tone of its own, and blotches, some of them yellow."""
    material, nodes = looks.new(name)
    own = nodes.add("ObjectInfo", {}).outputs["Random"]
    blotch = nodes.noise(nodes.spot(), 6.5, 2.0)
    share = nodes.math("ADD", nodes.math("MULTIPLY", own, 0.55), blotch)
    shade = nodes.mix(nodes.step(share, 0.35, 1.1), old, young)
    dry = nodes.math("MULTIPLY", nodes.step(blotch, 0.62, 0.8), 0.8)
    looks.finish(nodes, nodes.mix(dry, shade, (0.42, 0.33, 0.08)), 0.42)
    return material


def palette() -> Materials:
    """Make the plants' materials, by name."""
    return {
        "palm": leaf_look("palm", (0.24, 0.42, 0.06), (0.07, 0.19, 0.03)),
        "fern": leaf_look("fern", (0.20, 0.48, 0.07), (0.06, 0.22, 0.04)),
        "banana": leaf_look("banana", (0.34, 0.56, 0.09), (0.12, 0.32, 0.05)),
        "grass": leaf_look("grass", (0.42, 0.50, 0.12), (0.14, 0.28, 0.05)),
        "reed": leaf_look("reed", (0.48, 0.46, 0.16), (0.20, 0.32, 0.08)),
        "bush": leaf_look("bush", (0.16, 0.36, 0.08), (0.04, 0.14, 0.04)),
        "rib": looks.paint("rib", (0.36, 0.38, 0.12), 0.5),
        "plume": looks.paint("plume", (0.62, 0.48, 0.28), 0.8),
        "bloom": looks.paint("bloom", (0.80, 0.06, 0.10), 0.5),
        "bark": looks.wood("bark", (0.30, 0.22, 0.15)),
        "moist bark": looks.wood("moist bark", (0.17, 0.13, 0.09)),
    }


def meshes(coats: Materials, chance: random.Random) -> Meshes:
    """Make the shared meshes, some variants of each, by name."""
    made: Meshes = {name: [] for name in KINDS}
    for name, (variants, shape) in KINDS.items():
        for variant in range(variants):
            mesh = MeshBuilder()
            shape(mesh, coats, chance)
            thing = mesh.object(f"{name} {variant + 1}")
            made[name].append(thing.data)
            bpy.data.objects.remove(thing)
    return made


def feather(
    mesh: MeshBuilder,
    shape: Feather,
    span: tuple[float, float],
    coats: Sequence[bpy.types.Material],
    chance: random.Random,
) -> None:
    """Add the part of a feather leaf between two shares of its rib, its lower end at the origin."""
    foot = shape.point(span[0])
    steps = [span[0] + (span[1] - span[0]) * step / 6 for step in range(7)]
    thick = [shape.length * (0.011 - 0.008 * share) for share in steps]
    mesh.tube([shape.point(share) - foot for share in steps], thick, coats[1], 5)
    count = max(2, round(shape.count * (span[1] - span[0])))
    for step in range(count):
        share = span[0] + (span[1] - span[0]) * (step + 0.5) / count
        if share < 0.08:
            continue
        long = shape.leaflet * math.sin(math.pi * min(0.97, 0.16 + 0.8 * share)) ** 0.6
        for side in (-1, 1):
            reach = chance.uniform(0.45, 0.75)
            out = Vector((reach, side, chance.uniform(-0.25, 0.2))).normalized() * long
            _leaflet(mesh, shape.point(share) - foot, out, shape.width, coats[0])


def _leaflet(
    mesh: MeshBuilder,
    foot: mathutils.Vector,
    out: mathutils.Vector,
    width: float,
    coat: bpy.types.Material,
) -> None:
    """Add one pointed leaflet, folded downwards at its widest place."""
    across = out.cross(Vector((0, 0, 1))).normalized() * width / 2
    middle = foot + 0.42 * out
    tip = foot + out - Vector((0, 0, 0.22 * out.length))
    mesh.faces([foot, middle - across, middle + across, tip], [(0, 1, 2), (1, 3, 2)], coat)


def _palm_inner(mesh: MeshBuilder, coats: Materials, chance: random.Random) -> None:
    feather(mesh, PALM, (0.0, JOINT), (coats["palm"], coats["rib"]), chance)


def _palm_outer(mesh: MeshBuilder, coats: Materials, chance: random.Random) -> None:
    feather(mesh, PALM, (JOINT, 1.0), (coats["palm"], coats["rib"]), chance)


def _palm_whole(mesh: MeshBuilder, coats: Materials, chance: random.Random) -> None:
    feather(mesh, PALM, (0.0, 1.0), (coats["palm"], coats["rib"]), chance)


def _fern(mesh: MeshBuilder, coats: Materials, chance: random.Random) -> None:
    feather(mesh, FERN, (0.0, 1.0), (coats["fern"], coats["rib"]), chance)


def _banana(mesh: MeshBuilder, coats: Materials, chance: random.Random) -> None:
    """Add a broad leaf that the wind has torn into strips."""
    shape = Feather(1.55, 0.3, 0.0, 15, rise=0.75, droop=0.62)
    steps = [step / 8 for step in range(9)]
    mesh.tube([shape.point(s) for s in steps], [0.022 - 0.016 * s for s in steps], coats["rib"], 6)
    for side in (-1, 1):
        for step in range(shape.count):
            first, last = (0.2 + 0.8 * (step + part) / shape.count for part in (0.0, 0.93))
            drop = chance.uniform(0.05, 0.5)
            points = []
            for share in (first, last):
                wide = shape.leaflet * math.sin(math.pi * min(0.98, 0.1 + 0.82 * share)) ** 0.5
                foot = shape.point(share)
                for far, sink in ((0.0, 0.0), (0.55, 0.25), (1.0, 1.0)):
                    fall = 0.02 - drop * sink * wide + 0.06 * far
                    points.append(foot + Vector((0.12 * far, side * wide * far, fall)))
            mesh.faces(points, [(0, 1, 4, 3), (1, 2, 5, 4)], coats["banana"])


def _blade(
    mesh: MeshBuilder, foot: mathutils.Vector, size: tuple[float, float], turn: float, bow: float
) -> list[mathutils.Vector]:
    """Return the points of a blade of grass: pairs up to the tip, bending outwards."""
    long, wide = size
    out, across = (
        Vector((math.cos(turn + quarter), math.sin(turn + quarter), 0))
        for quarter in (0.0, math.pi / 2)
    )
    points = []
    for share in (0.0, 0.35, 0.7, 1.0):
        middle = foot + out * long * bow * share**2
        middle.z += long * (share - 0.45 * bow * share**2.5)
        half = across * wide / 2 * (1.0, 0.95, 0.6, 0.05)[round(3 * share)]
        points += [middle - half, middle + half]
    return points


BLADE = [(0, 1, 3, 2), (2, 3, 5, 4), (4, 5, 7, 6)]


def _grass(mesh: MeshBuilder, coats: Materials, chance: random.Random) -> None:
    for _ in range(26):
        turn = chance.uniform(0, 2 * math.pi)
        foot = Vector((chance.gauss(0, 0.07), chance.gauss(0, 0.07), -0.03))
        size = (chance.uniform(0.45, 1.0), chance.uniform(0.013, 0.024))
        mesh.faces(
            _blade(mesh, foot, size, turn, chance.uniform(0.15, 0.75)), BLADE, coats["grass"]
        )


def _reed(mesh: MeshBuilder, coats: Materials, chance: random.Random) -> None:
    for number in range(13):
        turn = chance.uniform(0, 2 * math.pi)
        foot = Vector((chance.gauss(0, 0.08), chance.gauss(0, 0.08), -0.03))
        size = (chance.uniform(1.2, 1.9), chance.uniform(0.018, 0.032))
        points = _blade(mesh, foot, size, turn, chance.uniform(0.08, 0.4))
        mesh.faces(points, BLADE, coats["reed"])
        if number % 4 == 0:
            top = points[-1]
            stalk = [foot, foot.lerp(top, 0.6), top]
            mesh.tube(stalk, 0.006, coats["rib"], 4)
            ear = [top, top + Vector((0.02, 0.01, 0.1)), top + Vector((0.07, 0.03, 0.22))]
            mesh.tube(ear, (0.008, 0.018, 0.003), coats["plume"], 6)


def _heart(
    mesh: MeshBuilder,
    foot: mathutils.Vector,
    out: mathutils.Vector,
    width: float,
    coat: bpy.types.Material,
) -> None:
    """Add an oval leaf, folded along its middle."""
    across = out.cross(Vector((0.1, 0.2, 1))).normalized() * width / 2
    lift = Vector((0, 0, 0.25 * width))
    points = [foot, foot + out]
    points += [foot + far * out + side * across + lift for side in (-1, 1) for far in (0.3, 0.7)]
    mesh.faces(points, [(0, 2, 3, 1), (0, 1, 5, 4)], coat)


def _cluster(mesh: MeshBuilder, coats: Materials, chance: random.Random) -> None:
    """Add a twig with oval leaves along +x, for bushes, with a flower at times."""
    mesh.tube([(0, 0, 0), (0.3, 0, 0.08), (0.6, 0, 0.05)], (0.014, 0.01, 0.004), coats["bark"], 5)
    for step in range(30):
        foot = Vector((0.12 + 0.5 * step / 30, 0, 0.05))
        turn = chance.uniform(0, 2 * math.pi)
        spread = Vector((0.7, math.cos(turn), 0.8 * math.sin(turn) + 0.15)).normalized()
        _heart(mesh, foot, spread * chance.uniform(0.14, 0.26), 0.085, coats["bush"])
    if chance.random() < 0.6:
        for petal in range(5):
            turn = 2 * math.pi * petal / 5
            out = Vector((0.05, 0.09 * math.cos(turn), 0.09 * math.sin(turn)))
            _heart(mesh, Vector((0.64, 0, 0.1)), out, 0.07, coats["bloom"])


def _vine(mesh: MeshBuilder, coats: Materials, chance: random.Random) -> None:
    """Add a length of hanging vine from the origin down."""
    path = [(0.02 * math.sin(2.0 * step), 0.02 * math.cos(step), -0.15 * step) for step in range(7)]
    mesh.tube(path, 0.012, coats["moist bark"], 5)
    for step in range(20):
        turn = chance.uniform(0, 2 * math.pi)
        out = Vector((math.cos(turn), math.sin(turn), -0.7)) * chance.uniform(0.09, 0.16)
        _heart(mesh, Vector((0, 0, -0.9 * step / 20)), out, 0.1, coats["fern"])


KINDS = {
    "palm inner": (3, _palm_inner),
    "palm outer": (3, _palm_outer),
    "palm whole": (2, _palm_whole),
    "fern": (4, _fern),
    "banana": (4, _banana),
    "grass": (6, _grass),
    "reed": (4, _reed),
    "cluster": (5, _cluster),
    "vine": (3, _vine),
}
