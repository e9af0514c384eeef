"""Town: a main street with tram, traffic and people; the camera whips around a street corner.

It starts calmly with a view towards the town hall, gathers speed, turns by some 70 degrees into
the side street within about half a second, and comes to rest with a long view the other way.
"""

from __future__ import annotations

import math
import random

from stage import looks, motion
from stage.blender import mathutils
from stage.options import main
from stage.quality import Quality
from stage.shooting import Script
from town_houses import Materials, Row, palette, rows, tower
from town_people import Crowd, pigeons
from town_street import CROSS_Y, furniture, ground, lamps, signals, skyline, trees, wires
from town_traffic import Garage, Ride, coach, steady

PLAN = (
    Row((8.5, 11.4), -1, 38.0, 1),
    Row((8.5, 86.0), -1, 57.4, 1),
    Row((-8.5, -26.6), 1, 38.0, -1),
    Row((-8.5, 28.6), 1, 57.4, -1),
    Row((8.5, 28.0), 0, 88.0, -1),
    Row((96.5, 12.0), 2, 88.0, 1),
    Row((-46.5, 28.0), 0, 38.0, -1),
    Row((-8.5, 12.0), 2, 38.0, 1),
)
CARS = (
    (0, (1.75, 10.5), 90, 11.0),
    (2, (-1.75, 15.0), 270, 9.0),
    (4, (31.0, 21.7), 180, 8.0),
    (1, (17.0, 18.3), 0, 8.5),
    (6, (66.0, 21.7), 180, 9.0),
    (3, (1.75, 46.0), 90, 8.0),
)
PEOPLE = (
    (-7.0, 16.0, 90), (-7.9, 18.5, 90), (-6.9, 23.0, 270), (-7.7, 24.4, 270),
    (7.2, 20.8, 90), (7.8, 21.9, 90), (7.0, 9.5, 90), (7.8, 13.4, 80), (6.6, 13.2, 265),
    (10.5, 13.4, 0), (13.5, 13.9, 180), (16.0, 13.0, 0), (20.5, 13.6, 180), (23.0, 13.2, 0),
    (13.0, 26.4, 0), (16.5, 25.9, 180), (19.0, 26.8, 0), (26.0, 26.2, 180), (10.0, 26.6, 180),
    (-7.0, 33.0, 270), (7.2, 31.5, 90), (6.8, 38.0, 270),
)  # fmt: skip


def build(seed: int, last: int) -> dict[int, str]:
    """Build the scene; return what each object id is."""
    chance = random.Random(seed)
    made = _materials()
    ground(made)
    rows(PLAN, made, chance)
    tower((0.0, 92.0), made)
    for part in (lamps, signals, furniture, wires):
        part(made)
    trees(made, chance)
    skyline(made, chance)
    looks.backdrop((0.10, 0.25, 0.66), (0.62, 0.74, 0.90), 1.0, (2.1, 1.95, 1.75))
    motion.sunlight((0.50, 0.62, -1.0), 5.0, (1.0, 0.88, 0.70), 0.6)
    _camera(last)
    return _traffic(made, chance, last) | _people(made, chance, last)


def _materials() -> Materials:
    made = palette()
    made["lamp"] = looks.paint("lamp", (1.0, 0.9, 0.72), 0.2, glow=1.6)
    made["beam"] = looks.paint("beam", (1.0, 0.94, 0.8), 0.1, glow=7.0)
    made["stop"] = looks.paint("stop", (1.0, 0.05, 0.02), 0.2, glow=2.5)
    made["go"] = looks.paint("go", (0.05, 1.0, 0.45), 0.2, glow=3.0)
    made["bark"] = looks.wood("bark", (0.16, 0.11, 0.07), 2)
    return made


def _gone(seconds: float) -> float:
    """Metres that the camera has gone along its path; it hurries between 0.5 and 1.5 s."""
    total, steps = 0.0, 200
    for step in range(steps):
        t = seconds * (step + 0.5) / steps
        fast = motion.ramp(t, 0.25, 0.95) * (1 - 0.78 * motion.ramp(t, 1.05, 1.75))
        total += (6.0 + 12.0 * fast - 3.6 * motion.ramp(t, 1.2, 1.8)) * seconds / steps
    return total


def _camera(last: int) -> None:
    """Drive up the right-hand lane and around the corner; look ahead of the turn."""
    lane, corner, radius = 1.75, (8.2, 11.8), 6.45
    start = -3.5
    straight = corner[1] - start
    quarter = radius * math.pi / 2

    def pose(t: float) -> tuple[tuple[float, ...], mathutils.Euler]:
        gone = _gone(t)
        bend = min(max((gone - straight) / radius, 0.0), math.pi / 2)
        x = corner[0] - radius * math.cos(bend) + max(gone - straight - quarter, 0.0)
        y = corner[1] + radius * math.sin(bend) + min(gone - straight, 0.0)
        if gone <= straight:
            x = lane
        wobble = 0.004 * motion.shake(t, 1.0, 1.3)
        turn = math.radians(-1.0 + 72.0 * motion.ramp(t, 0.9, 1.7))
        lean = 0.09 * motion.ramp(t, 0.85, 1.25) * (1 - motion.ramp(t, 1.3, 1.75))
        spin = mathutils.Matrix.Rotation(-turn + wobble[0], 3, "Z")
        tilt = mathutils.Matrix.Rotation(math.radians(92.5) + wobble[1], 3, "X")
        roll = mathutils.Matrix.Rotation(-lean, 3, "Z")
        height = 2.6 + 0.35 * motion.ramp(t, 0.4, 1.8)
        return (x, y, height), (spin @ tilt @ roll).to_euler("XYZ")

    motion.film(pose, last, 66.0)


def _traffic(made: Materials, chance: random.Random, last: int) -> dict[int, str]:
    """Add what drives and what is parked."""
    garage = Garage(made)
    names = {}
    for index, (kind, start, heading, speed) in enumerate(CARS, 1):
        way = steady(speed, chance.uniform(-0.6, 0.6))
        garage.drive(kind, index, Ride(start, heading, way), last)
        names[index] = "car"
    coach(
        7, Ride((-1.75, 44.0), 270, steady(7.0, 0.8)), "4 TOWN HALL", ("red", "white"), made, last
    )
    coach(8, Ride((50.0, 21.7), 180, steady(7.5, 0.7)), "CITY BUS", ("green", "white"), made, last)
    for number, x in enumerate((20, 26.5, 38, 44, 50.5, 62, 68, 81)):
        garage.park(chance.randrange(7), (x, CROSS_Y - 4.0), 0)
        if number % 3:
            garage.park(chance.randrange(7), (x - 3.5, CROSS_Y + 4.0), 180)
    for y in (34.5, 40.5, 52.0, 58.5, 70.0):
        garage.park(chance.randrange(7), (4.5, y), 90)
        garage.park(chance.randrange(7), (-4.5, y + 6.0), 270)
    garage.park(5, (-4.5, 8.0), 270)
    return names | {7: "tram", 8: "bus"}


def _people(made: Materials, chance: random.Random, last: int) -> dict[int, str]:
    """Add people, a cyclist and pigeons."""
    crowd = Crowd(made, chance)
    names = {9: "cyclist"}
    crowd.cycle(9, Ride((11.0, 17.35), 0, steady(5.0)), made, last)
    for index, (x, y, heading) in enumerate(PEOPLE, 10):
        crowd.walk(index, (x, y), heading, last)
        names[index] = "person"
    spots = [(0.4, 17.5), (1.4, 18.3), (2.3, 17.0), (3.1, 18.9), (2.0, 20.3), (3.9, 17.6)]
    spots += [(4.4, 19.6), (0.6, 19.8)]
    first = 10 + len(PEOPLE)
    pigeons(first, spots, made, last)
    return names | {first + number: "pigeon" for number in range(len(spots))}


SCENE = Script(
    "town",
    "A town's main street with tram, traffic and people, and a whip around a corner.",
    build,
    seed=41,
    pace=5.1,
    clean=Quality(32, 3),
    span=(97, 157),
)

if __name__ == "__main__":
    main(SCENE)
