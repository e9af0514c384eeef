"""Things of one metre, made of boxes, tubes and balls in four materials."""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Sequence

from stage.blender import bpy, mathutils
from stage.meshes import MeshBuilder, Point

Matrix, Vector = mathutils.Matrix, mathutils.Vector
Material = bpy.types.Material
Suit = Sequence[Material]
Prop = Callable[[MeshBuilder, Suit, random.Random], None]
WORDS = (
    "OPEN", "EXIT", "No 7", "TAXI", "CAFE", "GO", "HOTEL", "A-12", "radio", "SALE", "NORTH", "42",
    "fish", "STOP", "Bazar", "&", "Zoo", "88", "MILK", "Gate B", "?", "lux", "KIOSK", "R", "W3",
)  # fmt: skip


def letters(mesh: MeshBuilder, text: str, place: Matrix, size: float, look: Material) -> None:
    """Add raised letters to a mesh, reading along x of the place and facing its z axis."""
    curve = bpy.data.curves.new("letters", "FONT")
    curve.body, curve.size, curve.extrude = text, size, 0.04 * size
    curve.align_x = curve.align_y = "CENTER"
    curve.resolution_u = 2
    thing = bpy.data.objects.new("letters", curve)
    made = bpy.data.meshes.new_from_object(thing)
    points = [place @ vertex.co for vertex in made.vertices]
    mesh.faces(points, [tuple(face.vertices) for face in made.polygons], look)
    bpy.data.objects.remove(thing)
    bpy.data.meshes.remove(made)
    bpy.data.curves.remove(curve)


def ring(
    mesh: MeshBuilder, centre: Point, radii: tuple[float, float], look: Material, sides: int = 20
) -> None:
    """Add a ring around the y axis."""
    steps = [2 * math.pi * step / sides for step in range(sides + 1)]
    path = [
        (centre[0] + radii[0] * math.cos(a), centre[1], centre[2] + radii[0] * math.sin(a))
        for a in steps
    ]
    mesh.tube(path, radii[1], look, 8)


def lathe(mesh: MeshBuilder, profile: Sequence[tuple[float, float]], suit: Suit | Material) -> None:
    """Add a body turned about the z axis from (height, radius) pairs."""
    mesh.tube([(0, 0, z) for z, _ in profile], [r for _, r in profile], suit, 20)


def crate(mesh: MeshBuilder, suit: Suit, chance: random.Random) -> None:
    """A box with battens, perhaps with a smaller one on top."""
    w, d, h = (chance.uniform(0.5, 0.9) for _ in range(3))
    mesh.box((0, 0, h / 2), (w, d, h), suit[0])
    for x in (-w / 2, w / 2):
        for y in (-d / 2, d / 2):
            mesh.box((x, y, h / 2), (0.07, 0.07, 1.02 * h), suit[2])
    if chance.random() < 0.5:
        mesh.box((0.05, 0, h + 0.15), (0.5 * w, 0.6 * d, 0.3), suit[1])


def drum(mesh: MeshBuilder, suit: Suit, chance: random.Random) -> None:
    """A barrel with hoops."""
    belly = chance.uniform(0.3, 0.45)
    lathe(mesh, [(0, 0.3), (0.25, belly), (0.65, belly), (0.9, 0.3)], suit[0])
    for z in (0.2, 0.45, 0.7):
        mesh.tube([(0, 0, z), (0, 0, z + 0.05)], belly + 0.02, suit[2], 20)


def vase(mesh: MeshBuilder, suit: Suit, chance: random.Random) -> None:
    """A turned body: vase, bottle, baluster or top."""
    count = chance.randint(4, 7)
    heights = [step / count for step in range(count + 1)]
    profile = [(z, chance.uniform(0.08, 0.42)) for z in heights]
    lathe(mesh, profile, suit[0])
    z, radius = profile[chance.randrange(1, count)]
    mesh.tube([(0, 0, z - 0.03), (0, 0, z + 0.03)], radius + 0.02, suit[2], 20)


def cones(mesh: MeshBuilder, suit: Suit, chance: random.Random) -> None:
    """One cone, or several set into one another."""
    count = chance.randint(1, 4)
    for step in range(count):
        z, wide = step * 0.6 / count, 0.5 - 0.3 * step / count
        mesh.tube([(0, 0, z), (0, 0, z + 0.45)], (wide, 0.01), suit[step % 3], 18, smooth=False)


def balls(mesh: MeshBuilder, suit: Suit, chance: random.Random) -> None:
    """A ball of meridian strips, or a stack of them."""
    z = 0.0
    for radius in sorted(chance.uniform(0.1, 0.4) for _ in range(chance.randint(1, 4)))[::-1]:
        mesh.ball((0, 0, z + radius), radius, chance.choice((suit[0], suit[1], suit[:3])))
        z += 1.7 * radius


def rings(mesh: MeshBuilder, suit: Suit, chance: random.Random) -> None:
    """Rings on a stand, turned against each other."""
    keep = mesh.place.copy()
    mesh.tube([(0, 0, 0), (0, 0, 0.12)], (0.25, 0.1), suit[2])
    for step in range(chance.randint(1, 4)):
        mesh.place = (
            keep
            @ Matrix.Translation((0, 0, 0.55))
            @ Matrix.Rotation(chance.uniform(0, 3), 4, chance.choice("XYZ"))
        )
        ring(mesh, (0, 0, 0), (0.42 - 0.09 * step, chance.uniform(0.02, 0.06)), suit[step % 3])
    mesh.place = keep


def steps(mesh: MeshBuilder, suit: Suit, chance: random.Random) -> None:
    """A flight of steps, straight or winding."""
    turn = chance.choice((0.0, 0.0, 0.35))
    keep = mesh.place.copy()
    for step in range(8):
        mesh.place = keep @ Matrix.Rotation(turn * step, 4, "Z")
        x = 0.25 if turn else -0.4 + 0.1 * step
        high = 0.12 * step
        size = (0.45 if turn else 0.1, 0.6 if not turn else 0.22, 0.04 if turn else high + 0.12)
        mesh.box((x, 0, high if turn else high / 2 + 0.06), size, suit[step % 2])
    mesh.place = keep
    if turn:
        mesh.tube([(0, 0, 0), (0, 0, 1.1)], 0.05, suit[2])


def shelf(mesh: MeshBuilder, suit: Suit, chance: random.Random) -> None:
    """A shelf with books and pots."""
    for x in (-0.5, 0.5):
        mesh.box((x, 0, 0.6), (0.04, 0.3, 1.2), suit[3])
    for level in range(4):
        z = 0.05 + 0.36 * level
        mesh.box((0, 0, z), (1.0, 0.3, 0.03), suit[3])
        x = -0.45
        while x < 0.42 and level < 3:
            wide, high = chance.uniform(0.03, 0.09), chance.uniform(0.15, 0.3)
            mesh.box((x, -0.03, z + high / 2), (0.85 * wide, 0.2, high), chance.choice(suit))
            x += wide + (chance.random() < 0.1) * 0.1


def chair(mesh: MeshBuilder, suit: Suit, chance: random.Random) -> None:
    """A chair or stool."""
    for x in (-0.22, 0.22):
        for y in (-0.22, 0.22):
            mesh.tube([(x, y, 0), (0.9 * x, 0.9 * y, 0.45)], 0.025, suit[2], 6)
    mesh.box((0, 0, 0.47), (0.5, 0.5, 0.07), suit[0])
    if chance.random() < 0.8:
        for x in (-0.2, 0.0, 0.2):
            mesh.tube([(x, 0.22, 0.45), (x, 0.28, 1.0)], 0.02, suit[2], 6)
        mesh.box((0, 0.28, 0.92), (0.5, 0.04, 0.22), suit[1])


def table(mesh: MeshBuilder, suit: Suit, chance: random.Random) -> None:
    """A table with a few things on it."""
    mesh.box((0, 0, 0.62), (1.1, 0.7, 0.05), suit[0])
    for x in (-0.48, 0.48):
        for y in (-0.28, 0.28):
            mesh.box((x, y, 0.3), (0.06, 0.06, 0.6), suit[3])
    for _ in range(chance.randint(2, 6)):
        x, y, size = chance.uniform(-0.45, 0.45), chance.uniform(-0.25, 0.25), 0.06
        if chance.random() < 0.5:
            mesh.ball((x, y, 0.65 + size), size, suit[1])
        else:
            mesh.tube([(x, y, 0.64), (x, y, 0.85)], (size, 0.03), suit[2])


def vehicle(mesh: MeshBuilder, suit: Suit, chance: random.Random) -> None:
    """A car, van or cart with wheels, heading along x."""
    long, high = chance.uniform(0.9, 1.4), chance.uniform(0.25, 0.5)
    mesh.box((0, 0, 0.15 + high / 2), (long, 0.6, high), suit[0])
    cabin = chance.uniform(-0.2, 0.2)
    mesh.box((cabin, 0, 0.15 + high + 0.12), (0.5 * long, 0.52, 0.24), suit[2])
    mesh.box((cabin, 0, 0.15 + high + 0.25), (0.52 * long, 0.56, 0.04), suit[1])
    for x in (-0.33 * long, 0.33 * long):
        for y in (-0.31, 0.31):
            mesh.tube([(x, y - 0.05, 0.15), (x, y + 0.05, 0.15)], 0.15, suit[3], 14)
            mesh.tube([(x, y - 0.06, 0.15), (x, y + 0.06, 0.15)], 0.07, suit[2], 8)
    for y in (-0.2, 0.2):
        mesh.ball((long / 2, y, 0.32), 0.06, suit[2], (8, 6))


def wheel(mesh: MeshBuilder, suit: Suit, chance: random.Random) -> None:
    """A spoked wheel about the y axis, standing on the ground."""
    ring(mesh, (0, 0, 0.5), (0.44, 0.05), suit[0], 24)
    for spoke in range(chance.choice((5, 6, 8, 12))):
        angle = 2.4 * spoke
        rim = (0.44 * math.cos(angle), 0, 0.5 + 0.44 * math.sin(angle))
        mesh.tube([(0, 0, 0.5), rim], 0.02, suit[spoke % 3], 6)
    mesh.tube([(0, -0.1, 0.5), (0, 0.1, 0.5)], 0.09, suit[2], 10)


def rotor(mesh: MeshBuilder, suit: Suit, chance: random.Random) -> None:
    """Blades about the y axis, of paddles or of petals."""
    count, keep = chance.randint(2, 7), mesh.place.copy()
    wide = chance.uniform(0.06, 0.25)
    for blade in range(count):
        mesh.place = (
            keep
            @ Matrix.Translation((0, 0, 0.5))
            @ Matrix.Rotation(2 * math.pi * blade / count, 4, "Y")
        )
        points = [(-0.03, 0, 0.05), (0.03, 0, 0.05), (wide, 0.05, 0.5), (-0.3 * wide, -0.05, 0.5)]
        mesh.faces(points, [(0, 1, 2, 3)], suit[blade % 2])
    mesh.place = keep
    mesh.ball((0, 0, 0.5), 0.08, suit[2])


def sign(mesh: MeshBuilder, suit: Suit, chance: random.Random) -> None:
    """A board with a word on a post."""
    mesh.tube([(0, 0, 0), (0, 0, 0.7)], 0.03, suit[2], 8)
    mesh.box((0, 0, 0.75), (1.0, 0.05, 0.45), suit[0])
    word = chance.choice(WORDS)
    place = Matrix.Translation((0, -0.03, 0.75)) @ Matrix.Rotation(math.pi / 2, 4, "X")
    letters(mesh, word, place, min(0.42, 1.5 / len(word)), suit[3])


def word(mesh: MeshBuilder, suit: Suit, chance: random.Random) -> None:
    """A large letter or short word that stands by itself."""
    place = Matrix.Translation((0, 0, 0.4)) @ Matrix.Rotation(math.pi / 2, 4, "X")
    text = chance.choice("ABEFGHKMRSWXZ&?358")
    letters(mesh, text, place @ Matrix.Diagonal((1, 1, 4, 1)), 1.1, chance.choice(suit[:3]))
    mesh.box((0, 0, 0.02), (0.8, 0.4, 0.04), suit[3])


def arch(mesh: MeshBuilder, suit: Suit, chance: random.Random) -> None:
    """A gate: two pillars and a bow or beam."""
    if chance.random() < 0.5:
        points = [
            (0.42 * math.cos(a), 0, 0.5 + 0.42 * math.sin(a))
            for a in (math.pi * step / 10 for step in range(11))
        ]
        mesh.tube([(0.42, 0, 0), *points, (-0.42, 0, 0)], 0.09, suit[:2], 10, smooth=False)
        return
    for x in (-0.42, 0.42):
        mesh.box((x, 0, 0.45), (0.16, 0.2, 0.9), suit[0])
    mesh.box((0, 0, 0.98), (1.1, 0.26, 0.16), suit[1])


def spiral(mesh: MeshBuilder, suit: Suit, chance: random.Random) -> None:
    """A helix of pipe."""
    turns, thick = chance.uniform(1.5, 4), chance.uniform(0.02, 0.07)
    points = []
    for step in range(60):
        share = step / 59
        angle = 2 * math.pi * turns * share
        wide = 0.4 - 0.25 * share * chance.choice((0.0, 1.0, 1.0))
        points.append((wide * math.cos(angle), wide * math.sin(angle), thick + share))
    mesh.tube(points, thick, chance.choice(suit[:3]), 8)


def rock(mesh: MeshBuilder, suit: Suit, chance: random.Random) -> None:
    """A boulder."""
    around, rows = 12, 8
    shift = Vector([chance.uniform(0, 50) for _ in range(3)])
    flat = chance.uniform(0.5, 1.1)
    points = []
    for row in range(rows + 1):
        for side in range(around):
            a, p = 2 * math.pi * side / around, math.pi * row / rows
            away = Vector((math.sin(p) * math.cos(a), math.sin(p) * math.sin(a), math.cos(p)))
            size = 0.42 * (1 + 0.8 * mathutils.noise.noise(1.4 * away + shift))
            points.append((size * away.x, size * away.y, flat * size * away.z + 0.25))
    faces = [
        (r * around + s, (r + 1) * around + s, (r + 1) * around + t, r * around + t)
        for r in range(rows)
        for s, t in ((s, (s + 1) % around) for s in range(around))
    ]
    mesh.faces(points, faces, suit[0], smooth=chance.random() < 0.5)


def totem(mesh: MeshBuilder, suit: Suit, chance: random.Random) -> None:
    """Simple bodies stacked at random."""
    z, keep = 0.0, mesh.place.copy()
    for _ in range(chance.randint(3, 5)):
        size = chance.uniform(0.15, 0.3)
        mesh.place = (
            keep @ Matrix.Translation((0, 0, z)) @ Matrix.Rotation(chance.uniform(0, 3), 4, "Z")
        )
        look, kind = chance.choice(suit), chance.randrange(4)
        if kind == 0:
            mesh.box((0, 0, size / 2), (2.2 * size, 1.4 * size, size), look)
        elif kind == 1:
            mesh.ball((0, 0, size / 2), 0.6 * size, look)
        elif kind == 2:
            mesh.tube([(0, 0, 0), (0, 0, size)], (size, 0.4 * size), look, 14, smooth=False)
        else:
            ring(mesh, (0, 0, size / 2), (0.8 * size, 0.25 * size), look)
        z += size
    mesh.place = keep
