"""The set of a shot: what places are built with, and what they tell the camera and the lamps."""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import variety_props as props
import variety_thin as thin
from stage.blender import bpy, mathutils
from stage.meshes import MeshBuilder, Point
from things_list import ThingList
from variety_looks import Material, Wardrobe
from variety_plan import Plan
from variety_props import Prop, Suit
from variety_things import Stock

Matrix, Vector = mathutils.Matrix, mathutils.Vector
Height = Callable[[float, float], float]

SOLID: tuple[Prop, ...] = (
    props.crate, props.drum, props.vase, props.cones, props.balls, props.rings, props.steps,
    props.wheel, props.word, props.arch, props.spiral, props.rock, props.totem, props.sign,
)  # fmt: skip
FURNITURE: tuple[Prop, ...] = (
    props.shelf, props.chair, props.table, props.crate, props.vase, thin.potted, thin.curtain,
    props.chair, props.shelf, props.table, thin.lattice,
)  # fmt: skip
PLANTS: tuple[Prop, ...] = (thin.grass, thin.fern, thin.bush, thin.fern)
THIN: tuple[Prop, ...] = (
    thin.lattice, thin.fence, thin.curtain, thin.chain, thin.mast, thin.grass, thin.fern,
    thin.lattice, props.rings, props.spiral, props.wheel, props.chair,
)  # fmt: skip
ALL = SOLID + FURNITURE + THIN + (thin.tree, props.vehicle)
OWN = {*PLANTS, thin.tree, props.rock, props.arch, props.steps, props.rotor, thin.curtain}
"""What no real thing stands in for."""

REAL = 0.5
"""How often a real thing stands in for an own one, in shots that have some."""


@dataclass
class Set:
    """One place, while it is built.

    Attributes
    ----------
    chance : random.Random
        Of everything in the shot.
    wear : Wardrobe
        Its materials.
    eyes : list
        Pairs of a position and a target that the camera may take.
    lamps : list
        Where lamps may hang.
    indoor : bool
        Whether lamps must do most of the lighting.
    is_dark : bool
        Whether it is night, once that is drawn.
    night : float
        How likely it is dark outside.
    reach : float
        A usual distance from the camera to things, metres.
    sun : Vector
        Which way the sun shines.
    bulbs : list
        The lamps that are lit.
    plan : Plan
        What the shot is to show.
    stock : Stock
        Real things.
    """

    chance: random.Random
    wear: Wardrobe
    eyes: list[tuple[Point, Point]] = field(default_factory=list)
    lamps: list[Point] = field(default_factory=list)
    indoor: bool = False
    is_dark: bool = False
    night: float = 0.15
    reach: float = 6.0
    sun: mathutils.Vector = field(default_factory=lambda: Vector((0, 0, -1)))
    bulbs: list[bpy.types.Object] = field(default_factory=list)
    plan: Plan = field(default_factory=Plan)
    stock: Stock = field(default_factory=lambda: Stock(ThingList(Path()), 0, False, False))

    def within(self, low: float, high: float) -> float:
        """Draw a number."""
        return self.chance.uniform(low, high)

    def put(self, prop: Prop, at: Point, size: float, turn: float = 0.0) -> bpy.types.Object:
        """Put one thing down, in clothes of its own."""
        return self.make(prop, self.wear.suit(self.unit_of(size)), at, size, turn)

    def unit_of(self, size: float) -> float:
        """Return the size of texture features that suits a thing of a size."""
        return min(1.0, 0.5 * size)

    def make(
        self, prop: Prop, suit: Suit, at: Point, size: float, turn: float = 0.0
    ) -> bpy.types.Object:
        """Make one thing in given clothes, or a real one; its size is in the mesh."""
        mesh = MeshBuilder()
        mesh.place = Matrix.Scale(size, 4)
        prop(mesh, suit, self.chance)
        thing = mesh.object(prop.__name__)
        real = None if prop in OWN else self.stock.shape(REAL)
        if real is not None:
            thing.data = real.copy()
            thing.data.transform(Matrix.Scale(size, 4))
            thing.name = real.name
        thing.location = at
        thing.rotation_euler = (0, 0, turn)
        return thing

    def strew(
        self,
        kinds: Sequence[Prop],
        spots: Iterable[Point],
        size: tuple[float, float],
        suits: Sequence[Suit] | None = None,
        turned: bool = True,
    ) -> None:
        """Put down many things that share a few meshes."""
        suits = suits or [self.wear.suit(0.5) for _ in range(3)]
        chosen = [self.chance.choice(kinds) for _ in range(6)]
        made = [self.make(prop, self.chance.choice(suits), (0, 0, 0), 1.0) for prop in chosen]
        meshes = [thing.data for thing in made]
        for thing in made:
            bpy.data.objects.remove(thing)
        for spot in spots:
            mesh = self.chance.choice(meshes)
            copy = bpy.data.objects.new(mesh.name, mesh)
            copy.location = spot
            copy.rotation_euler = (0, 0, self.within(0, 6.3) if turned else self.within(-0.2, 0.2))
            copy.scale = [self.within(*size)] * 3
            bpy.context.scene.collection.objects.link(copy)

    def garden(self, role: str = "leaf", unit: float = 0.3) -> list[Suit]:
        """Make clothes for plants."""
        wear = self.wear
        bark, pot = wear.look("bark", unit), wear.look("any", unit)
        return [[wear.look(role, unit), wear.look(role, unit), bark, pot] for _ in range(2)]

    def spots(
        self, count: int, x: tuple[float, float], y: tuple[float, float], z: float | Height = 0.0
    ) -> list[Point]:
        """Draw places on the ground, which is level or has a height at each (x, y)."""
        found = []
        for _ in range(count):
            at = (self.within(*x), self.within(*y))
            found.append((*at, z(*at) if callable(z) else z))
        return found

    def slab(
        self, x: tuple[float, float], y: tuple[float, float], z: float, look: Material
    ) -> None:
        """Lay a level face, such as a floor."""
        mesh = MeshBuilder()
        points = [(x[0], y[0], z), (x[1], y[0], z), (x[1], y[1], z), (x[0], y[1], z)]
        mesh.faces(points, [(0, 1, 2, 3)], look)
        mesh.object("slab")

    def terrain(self, height: Height, half: float, cells: int, look: Material) -> None:
        """Lay ground with a height at each (x, y)."""
        side = [half * (2 * step / cells - 1) for step in range(cells + 1)]
        points = [(x, y, height(x, y)) for y in side for x in side]
        wide = cells + 1
        faces = [
            (r * wide + c, r * wide + c + 1, (r + 1) * wide + c + 1, (r + 1) * wide + c)
            for r in range(cells)
            for c in range(cells)
        ]
        mesh = MeshBuilder()
        mesh.faces(points, faces, look, smooth=True)
        mesh.object("ground")

    def hills(self, height: float = 14.0, away: float = 150.0) -> None:
        """Close the horizon all around with ragged hills or blocks."""
        mesh, blocks = MeshBuilder(), self.chance.random() < 0.4
        faces = [self.wear.look("wall" if blocks else "leaf", 12.0) for _ in range(3)]
        for step in range(48):
            angle = 2 * math.pi * step / 48
            spot = Vector((math.cos(angle), math.sin(angle), 0)) * away * self.within(0.8, 1.2)
            high = height * self.within(0.3, 1.2)
            if blocks:
                size = (self.within(10, 22), self.within(10, 22), 2 * high)
                mesh.box(spot, size, self.chance.choice(faces))
            else:
                points = [spot + Vector((0, 0, -1)), spot + Vector((0, 0, high))]
                mesh.tube(points, (self.within(15, 30), 5.0), self.chance.choice(faces), 9)
        mesh.object("hills")

    def look_across(
        self, x: tuple[float, float], y: tuple[float, float], z: tuple[float, float], far: float
    ) -> None:
        """Offer camera positions in a box that look about `far` metres across it."""
        middle = Vector((sum(x) / 2, sum(y) / 2, sum(z) / 2))
        for _ in range(9):
            eye = Vector((self.within(*x), self.within(*y), self.within(*z)))
            aim = middle - eye
            aim.z = 0
            turn = Matrix.Rotation(self.chance.gauss(0, 0.5), 3, "Z")
            aim = turn @ (aim.normalized() if aim.length > 0.1 else Vector((1, 0, 0)))
            self.eyes.append((eye, eye + far * aim + Vector((0, 0, far * self.within(-0.3, 0.1)))))
