"""People that walk and run: bodies of our own with limbs that bend, and characters of games."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from stage import motion
from stage.blender import bpy, mathutils
from stage.meshes import MeshBuilder
from stage.motion import FPS, MARGIN
from variety_props import Suit
from variety_set import Set
from variety_things import Body

Matrix, Vector = mathutils.Matrix, mathutils.Vector
HIP, KNEE, SHOULDER, ELBOW = 0.92, 0.46, 1.42, 0.29
TALL = 1.75
"""Height of the bodies as they are built, metres."""


@dataclass(frozen=True)
class Walk:
    """How a figure moves.

    Attributes
    ----------
    start : Vector
        Where the feet are at the middle of the shot.
    heading : float
        Radians about z; 0 looks along x.
    tall : float
        Metres.
    speed : float
        Metres a second; a grown person runs from about 2.5 on.
    phase : float
        Of the steps, radians.
    """

    start: mathutils.Vector
    heading: float
    tall: float
    speed: float
    phase: float

    @property
    def runs(self) -> bool:
        """Whether it is faster than walking."""
        return self.speed * TALL / self.tall > 2.5

    @property
    def rate(self) -> float:
        """Radians a second of a pair of steps."""
        size = self.tall / TALL
        stride = (1.4 if not self.runs else 2.6) * size
        return 2 * math.pi * max(self.speed, 0.3 * size) / stride

    def place(self, seconds: float, middle: float) -> mathutils.Vector:
        """Return where the feet are at a time, without ups and downs."""
        along = Vector((math.cos(self.heading), math.sin(self.heading), 0))
        return self.start + along * self.speed * (seconds - middle)


def walk(scene: Set, suit: Suit, index: int, steps: Walk, last: int) -> bpy.types.Object:
    """Let a body of our own walk or run; all its parts have one object id."""
    body, limbs = _sewn(scene, suit)
    runs, rate, middle = steps.runs, steps.rate, last / FPS / 2
    root = _part(body, "figure", index, None)
    root.scale = [steps.tall / TALL] * 3
    lean = 0.2 if runs else 0.05

    def pose(t: float) -> tuple:
        turn = rate * t + steps.phase
        bob = (0.06 if runs else 0.025) * math.cos(2 * turn) * steps.tall / TALL
        where = steps.place(t, middle) + Vector((0, 0, bob))
        return where, (0.04 * math.sin(turn), lean, steps.heading + 0.06 * math.sin(turn))

    motion.keyed(root, pose, last)
    for side in (-1, 1):
        shift = steps.phase + (math.pi if side > 0 else 0.0)
        _leg(limbs, root, (side, rate, shift, runs), last)
        _arm(limbs, root, (side, rate, shift, runs), last)
    return root


Gait = tuple[int, float, float, bool]
"""Side, rate, phase, and whether it runs."""


def _leg(limbs: dict[str, bpy.types.Mesh], root: bpy.types.Object, gait: Gait, last: int) -> None:
    side, rate, shift, runs = gait
    reach, fold = (0.75, 1.0) if runs else (0.5, 0.45)
    thigh = _part(limbs["thigh"], "thigh", root.pass_index, root)
    motion.keyed(
        thigh, lambda t: ((0, 0.1 * side, HIP), (0, -reach * math.sin(rate * t + shift), 0)), last
    )
    shin = _part(limbs["shin"], "shin", root.pass_index, thigh)
    motion.keyed(
        shin,
        lambda t: ((0, 0, -KNEE), (0, fold * (1.02 - math.cos(rate * t + shift)), 0)),
        last,
    )


def _arm(limbs: dict[str, bpy.types.Mesh], root: bpy.types.Object, gait: Gait, last: int) -> None:
    side, rate, shift, runs = gait
    reach, fold = (0.85, 1.4) if runs else (0.5, 0.3)
    arm = _part(limbs["arm"], "arm", root.pass_index, root)
    spot = (0, 0.23 * side, SHOULDER)
    motion.keyed(arm, lambda t: (spot, (0, reach * math.sin(rate * t + shift), 0)), last)
    hand = _part(limbs["hand"], "hand", root.pass_index, arm)
    motion.keyed(
        hand,
        lambda t: ((0, 0, -ELBOW), (0, -fold - 0.2 * math.sin(rate * t + shift), 0)),
        last,
    )


def _part(
    mesh: bpy.types.Mesh, name: str, index: int, parent: bpy.types.Object | None
) -> bpy.types.Object:
    part = bpy.data.objects.new(name, mesh)
    part.pass_index, part.parent = index, parent
    bpy.context.scene.collection.objects.link(part)
    return part


def _sewn(scene: Set, suit: Suit) -> tuple[bpy.types.Mesh, dict[str, bpy.types.Mesh]]:
    """Make the meshes of a body in four materials: coat, trousers, hair, skin."""
    chance = scene.chance
    coat, trousers, hair, skin = suit
    body, thigh, shin, arm, hand = (MeshBuilder() for _ in range(5))
    hem = chance.choice((0.55, 0.86, 0.86))
    rings = (
        (hem, 0.25 if hem < 0.8 else 0.17),
        (1.0, 0.16),
        (1.25, 0.2),
        (1.43, 0.18),
        (1.5, 0.07),
    )
    body.place = Matrix.Diagonal((0.75, 1.15, 1.0, 1.0))
    body.tube([(0, 0, z) for z, _ in rings], [r for _, r in rings], coat, 12)
    body.place = Matrix.Identity(4)
    body.tube([(0, 0, 1.46), (0.01, 0, 1.56)], 0.055, skin, 8)
    body.ball((0.02, 0, 1.64), 0.11, skin, (12, 10))
    body.ball((-0.012, 0, 1.665), 0.117, hair, (12, 10))
    if chance.random() < 0.3:
        body.tube([(0, 0, 1.69), (0, 0, 1.71)], 0.2, hair, 14)
        body.tube([(0, 0, 1.71), (0, 0, 1.83)], (0.12, 0.11), hair, 14)
    if chance.random() < 0.4:
        body.box((-0.22, 0, 1.2), (0.18, 0.3, 0.42), hair)
    thigh.tube([(0, 0, 0.03), (0, 0, -KNEE)], (0.095, 0.065), trousers, 8)
    shin.tube([(0, 0, 0.02), (0, 0, -0.42)], (0.068, 0.05), trousers, 8)
    shin.box((0.06, 0, -0.42), (0.26, 0.1, 0.08), hair)
    arm.tube([(0, 0, 0.02), (0, 0, -ELBOW)], (0.065, 0.052), coat, 8)
    hand.tube([(0, 0, 0.02), (0, 0, -0.25)], (0.052, 0.04), coat, 8)
    hand.ball((0, 0, -0.29), 0.05, skin, (8, 6))
    if chance.random() < 0.25:
        hand.box((0.02, 0, -0.5), (0.34, 0.12, 0.3), hair)
    parts = {"thigh": thigh, "shin": shin, "arm": arm, "hand": hand}
    return _mesh(body, "body"), {name: _mesh(mesh, name) for name, mesh in parts.items()}


def _mesh(builder: MeshBuilder, name: str) -> bpy.types.Mesh:
    made = builder.object(name)
    mesh = made.data
    bpy.data.objects.remove(made)
    return mesh


def run(body: Body, index: int, steps: Walk, last: int) -> bpy.types.Object:
    """Let a game's character run, its frames blended into one another."""
    mesh = bpy.data.meshes.new("character")
    mesh.from_pydata(body.points[0].tolist(), [], body.faces.tolist())
    layer = mesh.uv_layers.new(name="spread")
    corners = body.spread[body.faces.ravel()].astype(np.float32)
    layer.data.foreach_set("uv", corners.ravel())
    for material in body.materials:
        mesh.materials.append(material)
    mesh.polygons.foreach_set("material_index", body.look.astype(np.int32))
    mesh.polygons.foreach_set("use_smooth", [True] * len(body.faces))
    mesh.update()
    thing = _part(mesh, "character", index, None)
    thing.scale = [steps.tall / 1.8] * 3
    thing.shape_key_add(name="rest")
    weights = blend(body, steps, last)
    for frame in np.nonzero(np.abs(weights).max(axis=0) > 1e-4)[0]:
        key = thing.shape_key_add(name=f"frame {frame}")
        key.slider_min, key.slider_max, key.value = -1.0, 2.0, 0.0
        key.data.foreach_set("co", body.points[frame].astype(np.float32).ravel())
        path = f'key_blocks["{key.name}"].value'

        def value(seconds: float, column: np.ndarray = weights[:, frame]) -> float:
            return float(column[round(seconds * FPS) + MARGIN])

        motion.keyed_value(mesh.shape_keys, path, value, last)
    middle = last / FPS / 2
    motion.keyed(thing, lambda t: (steps.place(t, middle), (0, 0, steps.heading)), last)
    return thing


def blend(body: Body, steps: Walk, last: int) -> np.ndarray:
    """Return how much of each frame is in each instant from -MARGIN on: instants x frames.

    Four frames are blended by a Catmull-Rom curve. Each instant's weights add up to 1.
    """
    count = len(body.points)
    instants = np.arange(-MARGIN, last + MARGIN + 1)
    weights = np.zeros((len(instants), count))
    for row, instant in enumerate(instants):
        place = (steps.phase / (2 * math.pi) + instant / FPS / body.seconds) * count
        first = math.floor(place)
        for step, weight in enumerate(curve(place - first), -1):
            weights[row, (first + step) % count] += weight
    return weights


def curve(share: float) -> Sequence[float]:
    """Return the weights of four points of a Catmull-Rom curve, between the second and third."""
    t = share
    return (
        0.5 * (-t + 2 * t**2 - t**3),
        0.5 * (2 - 5 * t**2 + 3 * t**3),
        0.5 * (t + 4 * t**2 - 3 * t**3),
        0.5 * (-(t**2) + t**3),
    )
