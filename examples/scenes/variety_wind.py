"""Foliage in the wind: plants that sway about their roots, and shrubs of boughs that sway alone."""

from __future__ import annotations

import math

import variety_thin as thin
from stage import motion
from stage.blender import bpy, mathutils
from stage.meshes import MeshBuilder
from variety_moves import Troupe
from variety_view import Path, footing

Matrix, Vector = mathutils.Matrix, mathutils.Vector
PLANTS = ("grass", "fern", "bush", "tree", "potted", "curtain", "chain", "mast")
MOST = 50
"""Plants in view that sway; the nearest ones."""


def blow(troupe: Troupe) -> None:
    """Let the wind blow: plants in view sway, and some shrubs are added."""
    chance = troupe.chance
    strength, heading = math.exp(chance.uniform(-1.0, 0.9)), chance.uniform(0, 6.3)
    for thing in _in_view(troupe.path):
        thing.pass_index = troupe.next_id()
        troupe.named[thing.pass_index] = f"swaying {thing.name.split('.')[0]}"
        reach = (0.02 if thing.name.startswith("tree") else 0.09) * strength
        _sway(troupe, thing, heading, reach)
    for _ in range(chance.randint(1, 4)):
        _shrub(troupe, heading, strength)


def _in_view(path: Path) -> list[bpy.types.Object]:
    """Return still plants that the camera may see, nearest first."""
    wide = math.tan(math.radians(path.angle) / 2) * 1.2
    found = []
    for thing in bpy.context.scene.objects:
        if thing.pass_index or thing.name.split(".")[0] not in PLANTS or thing.parent:
            continue
        middle = thing.location + Vector((0, 0, thing.dimensions.z / 2))
        local = path.frame.transposed() @ (middle - path.eye)
        room = 0.5 * max(thing.dimensions)
        if -local.z > 0 and abs(local.x) < wide * -local.z + room and -local.z < 40:
            found.append((-local.z, thing.name, thing))
    return [thing for _, _, thing in sorted(found)[:MOST]]


def _sway(troupe: Troupe, thing: bpy.types.Object, heading: float, reach: float) -> None:
    """Key a plant that leans with the wind and trembles."""
    chance = troupe.chance
    rate, phase = chance.uniform(4, 12), chance.uniform(0, 6.3)
    where, turn = thing.location.copy(), thing.rotation_euler.copy()
    lean = Vector((-math.sin(heading), math.cos(heading), 0))
    lean.rotate(mathutils.Euler((0, 0, -turn.z)))

    def pose(t: float) -> tuple:
        bend = 0.5 + math.sin(rate * t + phase) + 0.3 * math.sin(2.7 * rate * t + 2 * phase)
        side = 0.3 * math.sin(1.6 * rate * t + 3 * phase)
        x = reach * (bend * lean.x - side * lean.y)
        y = reach * (bend * lean.y + side * lean.x)
        return where, (turn.x + x, turn.y + y, turn.z)

    motion.keyed(thing, pose, troupe.last)


def _shrub(troupe: Troupe, heading: float, strength: float) -> None:
    """Plant a shrub or small tree: boughs with leaves, each of which sways in its own time."""
    ground = footing(troupe.path, troupe.chance, 0.7)
    if ground is None or ground.away < 0.3 * troupe.scene.reach:
        return
    chance, scene, index = troupe.chance, troupe.scene, troupe.next_id()
    size = ground.away * chance.uniform(0.15, 0.4)
    leaves = scene.garden("leaf", 0.3)[0]
    stem = MeshBuilder()
    stem.tube([(0, 0, 0), (0, 0, 0.5 * size)], (0.04 * size, 0.025 * size), leaves[2], 7)
    root = stem.object("shrub", index)
    root.location = ground.at
    meshes = [_bough(troupe, leaves, size) for _ in range(2)]
    for number in range(chance.randint(8, 14)):
        bough = bpy.data.objects.new("bough", meshes[number % 2])
        bpy.context.scene.collection.objects.link(bough)
        bough.pass_index, bough.parent = index, root
        bough.location = (0, 0, size * chance.uniform(0.15, 0.5))
        bough.rotation_euler = (chance.uniform(-0.3, 0.9), 0, 2.4 * number)
        _sway(troupe, bough, heading, 0.14 * strength)
    _sway(troupe, root, heading, 0.03 * strength)
    troupe.named[index] = "shrub"


def _bough(troupe: Troupe, leaves: list, size: float) -> bpy.types.Mesh:
    mesh, chance = MeshBuilder(), troupe.chance
    end = Vector((0, 0.25 * size, 0.45 * size))
    mesh.tube([(0, 0, 0), end], (0.015 * size, 0.004 * size), leaves[2], 5)
    for number in range(50):
        root = end * chance.uniform(0.3, 1.0)
        tip = root + Vector([chance.gauss(0, 0.09 * size) for _ in range(3)])
        thin.blade(mesh, root, tip, 0.025 * size, leaves[number % 2])
    made = mesh.object("bough")
    shape = made.data
    bpy.data.objects.remove(made)
    return shape
