"""Render the scene tropical: a dash through thrashing leaves along a beach, in a strong wind.

Most of the picture is thin foliage in several layers at different distances, and every frond,
clump and twig swings on its own: the scene in which warping leaves most holes.
"""

from __future__ import annotations

import math
import random
from dataclasses import dataclass

import tropical_plants as plants
import tropical_shore as shore
from stage import looks, motion
from stage.blender import bpy, mathutils
from stage.meshes import MeshBuilder
from stage.options import main
from stage.quality import Quality
from stage.shooting import Script

Vector = mathutils.Vector
Spot = tuple[float, float, float]
WIND = 0.5
"""Where the wind blows to, radians from +x."""


@dataclass(frozen=True)
class Sway:
    """How a piece answers to the wind.

    Attributes
    ----------
    bend, side, twist : float
        Amplitudes in a full gust, radians: up and down, sideways, about its own axis.
    rate : float
        Swings per second.
    lean : float
        How far a full gust turns it downwind, radians; negative for leaves that lie along +x.
    """

    bend: float
    side: float
    twist: float
    rate: float
    lean: float


FROND = Sway(0.20, 0.16, 0.22, 1.25, -0.22)
FROND_TIP = Sway(0.17, 0.15, 0.25, 1.9, -0.14)
BANANA = Sway(0.20, 0.22, 0.30, 1.5, -0.25)
FERN = Sway(0.22, 0.24, 0.30, 1.9, -0.2)
GRASS = Sway(0.24, 0.14, 0.2, 1.8, 0.36)
REED = Sway(0.17, 0.12, 0.15, 1.3, 0.24)
TWIG = Sway(0.18, 0.24, 0.40, 2.3, -0.15)
VINE = Sway(0.22, 0.16, 0.6, 0.9, -0.3)
TRUNK = Sway(0.025, 0.02, 0.0, 0.6, 0.05)


def gust(x: float, y: float, seconds: float) -> float:
    """Return how strongly it blows at a place, 0.2..1: waves that run with the wind."""
    way = x * math.cos(WIND) + y * math.sin(WIND)
    wave = 0.5 + 0.5 * math.sin(2 * math.pi * (0.95 * seconds - way / 6.5) - 0.6)
    rise, fall = motion.ramp(seconds, 0.15, 0.85), motion.ramp(seconds, 1.45, 2.0)
    return (0.3 + 0.7 * rise * (1 - 0.55 * fall)) * (0.5 + 0.5 * wave)


class Garden:
    """Plants everything that moves, and gives out object ids.

    Attributes
    ----------
    names : dict of int to str
        What each id is.
    """

    def __init__(self, chance: random.Random, last: int) -> None:
        self.names: dict[int, str] = {}
        self.coats = plants.palette()
        self._chance = chance
        self._last = last
        self._meshes = plants.meshes(self.coats, chance)

    def name(self, what: str) -> int:
        """Return a new id."""
        index = len(self.names) + 1
        self.names[index] = what
        return index

    def put(
        self,
        kind: str,
        index: int,
        foot: Spot,
        rest: Spot,
        sway: Sway,
        size: float = 1.0,
        parent: bpy.types.Object | None = None,
    ) -> bpy.types.Object:
        """Add one piece that swings about its foot around the rotation `rest`."""
        # A mesh of its own: the renderer then keeps one tree over all triangles, and a thicket of
        # overlapping instances is traced in little more than half the time.
        mesh = self._chance.choice(self._meshes[kind]).copy()
        thing = bpy.data.objects.new(kind, mesh)
        bpy.context.scene.collection.objects.link(thing)
        thing.pass_index, thing.parent, thing.scale = index, parent, (size,) * 3
        self.swing(thing, foot, rest, sway)
        return thing

    def swing(self, thing: bpy.types.Object, foot: Spot, rest: Spot, sway: Sway) -> None:
        """Key a piece's answer to the wind."""
        turn = 2 * math.pi * sway.rate * self._chance.uniform(0.85, 1.15)
        one, two, three, four = (self._chance.uniform(0, 2 * math.pi) for _ in range(4))
        away = WIND - rest[2]
        down, across = sway.lean * math.cos(away), 0.6 * abs(sway.lean) * math.sin(away)
        # A child's place is relative; the gust is the same over one plant.
        top = thing if thing.parent is None else thing.parent
        x, y = (foot if thing.parent is None else tuple(top.get("at", (0.0, 0.0, 0.0))))[:2]
        thing["at"] = (x, y, 0.0)

        def pose(seconds: float) -> tuple[Spot, Spot]:
            blow = gust(x, y, seconds)
            a = turn * seconds
            bend = 0.65 * math.sin(a + one) + 0.35 * math.sin(2.1 * a + two)
            side = 0.7 * math.sin(0.83 * a + three) + 0.3 * math.sin(2.7 * a + four)
            twist = 0.6 * math.sin(1.6 * a + two) + 0.4 * math.sin(3.1 * a + three)
            return foot, (
                rest[0] + sway.twist * blow * twist,
                rest[1] + blow * (down + sway.bend * bend),
                rest[2] + blow * (across + sway.side * side),
            )

        motion.keyed(thing, pose, self._last)

    def palm(self, spot: tuple[float, float], trunk: float, fronds: int, size: float = 1.0) -> None:
        """Add a palm: a leaning trunk that sways, and fronds whose outer halves follow."""
        number = sum("trunk" in name for name in self.names.values()) + 1
        lean = self._chance.uniform(-0.1, 0.3) * trunk / 3
        top = (lean, 0.3 * lean, trunk)
        stem = self._trunk(top, self.name(f"palm {number}, trunk"))
        self.swing(stem, (*spot, shore.level(*spot) - 0.1), (0, 0, 0), TRUNK)
        ids = [self.name(f"palm {number}, fronds {part}") for part in "abc"]
        joint = tuple(plants.PALM.point(plants.JOINT))
        tall = trunk > 3.5
        for frond in range(fronds):
            heading = 2.4 * frond + self._chance.uniform(-0.2, 0.2)
            pitch = -0.75 + 1.15 * frond / fronds + self._chance.uniform(-0.08, 0.08)
            index = ids[frond % 3]
            long = size * self._chance.uniform(0.85, 1.1)
            rest = (self._chance.uniform(-0.3, 0.3), pitch, heading)
            kind = "palm whole" if tall else "palm inner"
            made = self.put(kind, index, top, rest, FROND, long, stem)
            if not tall:
                self.put("palm outer", index, joint, (0, 0.05, 0), FROND_TIP, 1.0, made)

    def _trunk(self, top: Spot, index: int) -> bpy.types.Object:
        mesh = MeshBuilder()
        rings = max(4, round(top[2] / 0.16))
        path, thick = [], []
        for ring in range(rings + 1):
            share = ring / rings
            path.append((top[0] * share**1.6, top[1] * share**1.6, top[2] * share))
            thick.append((0.13 - 0.04 * share) * (1.12 if ring % 2 else 0.95))
        mesh.tube(path, thick, self.coats["bark"], 10)
        for nut in range(5):
            a = 1.26 * nut
            where = (top[0] + 0.17 * math.cos(a), top[1] + 0.17 * math.sin(a), top[2] - 0.12)
            mesh.ball(where, 0.11, self.coats["bush"], (10, 8))
        return mesh.object("trunk", index)

    def rosette(self, kind: str, spot: tuple[float, float], count: int, size: float) -> None:
        """Add a fern or a banana plant: leaves from one place, all around."""
        number = len(self.names) + 1
        ids = [self.name(f"{kind} {number}, leaves {part}") for part in "ab"]
        foot = (*spot, shore.level(*spot) + (0.35 if kind == "banana" else 0.02))
        first = self._chance.uniform(0, 6.3)
        for leaf in range(count):
            rest = (
                self._chance.uniform(-0.25, 0.25),
                self._chance.uniform(-0.75, -0.1),
                first + 2 * math.pi * leaf / count + self._chance.uniform(-0.25, 0.25),
            )
            sway = BANANA if kind == "banana" else FERN
            long = size * self._chance.uniform(0.8, 1.15)
            self.put(kind, ids[leaf % 2], foot, rest, sway, long)

    def clump(self, kind: str, spot: tuple[float, float], size: float) -> None:
        """Add a clump of grass or reeds."""
        index = self.name(f"{kind} {len(self.names) + 1}")
        rest = (0.0, self._chance.uniform(-0.1, 0.1), WIND + self._chance.uniform(-0.8, 0.8))
        foot = (*spot, shore.level(*spot))
        self.put(kind, index, foot, rest, GRASS if kind == "grass" else REED, size)

    def bush(self, spot: tuple[float, float], size: float) -> None:
        """Add a bush of twigs around one root."""
        number = len(self.names) + 1
        ids = [self.name(f"bush {number}, twigs {part}") for part in "ab"]
        for twig in range(8):
            heading = 2.4 * twig
            rise = 0.1 + 0.75 * twig / 8
            foot = (
                spot[0] + 0.15 * size * math.cos(heading),
                spot[1] + 0.15 * size * math.sin(heading),
                shore.level(*spot) + 0.55 * size * rise,
            )
            rest = (0.0, -0.3 - 0.9 * rise, heading)
            self.put("cluster", ids[twig % 2], foot, rest, TWIG, 1.1 * size)

    def vine(self, foot: Spot, size: float) -> None:
        """Add a hanging vine of two lengths."""
        index = self.name(f"vine {len(self.names) + 1}")
        upper = self.put("vine", index, foot, (0, 0, self._chance.uniform(0, 6)), VINE, size)
        self.put("vine", index, (0, 0, -0.88), (0, 0, 1.0), VINE, 0.9, upper)


def build(seed: int, last: int) -> dict[int, str]:
    """Build the scene; return what each object id is."""
    chance = random.Random(seed)
    shore.build(chance)
    garden = Garden(chance, last)
    _palms(garden)
    _undergrowth(garden, chance)
    _limb(garden, chance)
    _boats(garden, last)
    looks.backdrop((0.07, 0.22, 0.62), (0.62, 0.76, 0.92), 0.95, clouds=(1.75, 1.68, 1.6))
    # The renderer makes its map of the sky's light anew for every frame, by default a large one.
    light_map = bpy.context.scene.world.cycles
    light_map.sampling_method, light_map.sample_map_resolution = "MANUAL", 64
    motion.sunlight((0.66, -0.18, -0.72), 5.2, (1.0, 0.90, 0.74), 0.55)
    motion.film(_camera, last, 66.0)
    return garden.names


def _palms(garden: Garden) -> None:
    for spot, trunk, fronds in (
        ((-2.4, 4.6), 2.0, 13),
        ((3.3, 4.3), 1.5, 13),
        ((5.6, 3.7), 0.5, 12),
        ((8.0, 5.2), 2.1, 13),
    ):
        garden.palm(spot, trunk, fronds)
    for spot, trunk in (
        ((-1.4, 9.0), 4.4),
        ((6.2, 8.8), 4.8),
        ((14.4, 10.0), 4.3),
        ((-1.6, -1.6), 4.0),
        ((3.4, -1.8), 4.2),
    ):
        garden.palm(spot, trunk, 11, 1.15)


def _undergrowth(garden: Garden, chance: random.Random) -> None:
    for spot in ((2.2, 3.1), (4.3, 2.8), (6.9, 3.2), (-3.3, 3.2)):
        garden.rosette("banana", spot, 8, 1.0)
    for _ in range(13):
        garden.rosette("fern", (chance.uniform(1.9, 7.6), chance.uniform(1.35, 2.6)), 7, 1.0)
    for spot in ((-2.2, 2.4), (-1.5, 4.9), (9.2, 4.1), (8.7, 2.6), (-0.9, 2.0)):
        garden.rosette("fern", spot, 6, 1.0)
    for _ in range(62):
        spot = (chance.uniform(1.4, 8.0), 1.0 + 3.0 * chance.random() ** 1.3)
        garden.clump("grass", spot, chance.uniform(0.8, 1.25))
    for _ in range(26):
        x = chance.choice((chance.uniform(-4.5, -0.6), chance.uniform(8.0, 11.5)))
        garden.clump("grass", (x, chance.uniform(1.6, 6.5)), chance.uniform(0.6, 1.0))
    for _ in range(15):
        spot = (chance.uniform(2.2, 7.6), chance.uniform(1.7, 3.6))
        garden.clump("reed", spot, chance.uniform(0.9, 1.15))
    for spot in ((1.5, 4.6), (4.9, 4.9), (7.2, 4.4), (-3.4, 5.3), (9.8, 6.2), (2.9, 2.2)):
        garden.bush(spot, 1.0)


def _limb(garden: Garden, chance: random.Random) -> None:
    """Add a great limb that reaches over the path, with vines hanging from it."""
    mesh = MeshBuilder()
    path = [(9.6, 4.9, -0.4), (9.3, 4.5, 1.4), (8.2, 3.6, 2.6), (5.8, 2.9, 2.95), (2.6, 2.6, 3.1)]
    bark = garden.coats["moist bark"]
    mesh.tube(path, (0.34, 0.27, 0.2, 0.13, 0.06), bark, 10)
    mesh.tube([path[2], (7.0, 4.6, 3.4), (5.0, 5.6, 3.6)], (0.15, 0.1, 0.04), bark, 8)
    mesh.object("limb")
    for number in range(13):
        share = number / 12
        spot = (8.0 - 5.3 * share, 3.45 - 0.85 * share, 2.66 + 0.4 * share)
        garden.vine(spot, chance.uniform(0.6, 0.95))


def _boats(garden: Garden, last: int) -> None:
    """Add two boats that bob at anchor, one under a sail."""
    hull, inside = looks.paint("hull", (0.05, 0.22, 0.42), 0.4), looks.wood("deck", (0.5, 0.4, 0.3))
    cloth = looks.checker("sail", (0.92, 0.88, 0.78), (0.74, 0.13, 0.07), 1.37)
    for number, (spot, heading, size) in enumerate((((-1.3, 16.5), 0.4, 1.0), ((9, 34), 2.8, 2.0))):
        mesh = MeshBuilder()
        _hull(mesh, hull, inside)
        if number:
            mesh.tube([(0.3, 0, 0.1), (0.3, 0, 4.2)], 0.05, inside, 8)
            sail = [(0.3, 0.0, 4.1), (0.3, 0.0, 0.8), (-1.7, 0.35, 0.9), (-0.8, 0.3, 2.3)]
            mesh.faces(sail, [(0, 1, 2, 3)], cloth)
        boat = mesh.object("boat", garden.name(f"boat {number + 1}"))
        boat.scale = (size,) * 3

        def pose(t: float, spot=spot, heading=heading, late=1.7 * number) -> tuple[Spot, Spot]:
            heave = shore.SEA + 0.06 + 0.08 * math.sin(3.3 * t + late)
            roll, pitch = 0.12 * math.sin(3.9 * t + late), 0.06 * math.sin(3.3 * t + 1 + late)
            return (*spot, heave), (roll, pitch, heading + 0.05 * math.sin(1.3 * t))

        motion.keyed(boat, pose, last)


def _hull(mesh: MeshBuilder, coat: bpy.types.Material, inside: bpy.types.Material) -> None:
    """Add an open hull with a pale gunwale and three thwarts."""
    points, rims = [], ([], [])
    for step in range(9):
        along = step / 4 - 1
        wide, rise = 0.55 * (1 - along**4) + 0.02, 0.35 * along**4
        x, rim = 2.1 * along, 0.42 + rise
        points += [(x, -wide, rim), (x, -0.75 * wide, 0.05 + 0.7 * rise), (x, 0, rise - 0.12)]
        points += [(x, 0.75 * wide, 0.05 + 0.7 * rise), (x, wide, rim)]
        rims[0].append((x, -wide, rim))
        rims[1].append((x, wide, rim))
    strips = [5 * step + part for step in range(8) for part in range(4)]
    mesh.faces(points, [(p, p + 1, p + 6, p + 5) for p in strips], coat, smooth=True)
    for rim in rims:
        mesh.tube(rim, 0.045, inside, 6)
    for x in (-1.1, 0.0, 1.1):
        mesh.box((x, 0, 0.3), (0.26, 0.9, 0.05), inside)


def _camera(t: float) -> tuple[Spot, Spot]:
    """Dwell at a gap in the leaves, dash past the thicket, come to rest at the next gap."""
    dash = motion.ramp(t, 0.1, 1.95)
    hand = motion.shake(t, 1.0, 1.3)
    step = math.sin(2 * math.pi * 2.6 * t) * 0.02 * motion.ramp(t, 0.2, 0.6)
    where = Vector((0.2 * t + 6.0 * dash, 0.3 * dash, 1.5 + step)) + 0.008 * hand
    at = Vector((1.0 + 8.4 * dash + 0.3 * t, 10.0 + dash, 0.85 + 0.25 * dash)) + 0.05 * hand
    return tuple(where), tuple(motion.looking(at, where, 0.02 * math.sin(1.9 * t)))


SCENE = Script(
    "tropical",
    "A dash through leaves in a strong wind along a beach.",
    build,
    seed=11,
    pace=5.7,
    clean=Quality(32, 4),
)

if __name__ == "__main__":
    main(SCENE)
