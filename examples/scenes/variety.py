"""Random short shots, one for each seed, to train a network with; never to judge on.

A seed draws a kind of place, materials, things that stand and things that move, light, and a camera
whose median motion over a key interval is spread evenly on a logarithmic scale. Run it with
Blender's Python: `variety.py 1-150 --data FOLDER`.
"""

from __future__ import annotations

import argparse
import gc
import math
import random

import variety_indoors as indoors
import variety_light
import variety_moves
import variety_outdoors as outdoors
import variety_view
from stage import options
from stage.shooting import Script, say, shoot
from variety_looks import Wardrobe
from variety_set import Set

PLACES = (
    outdoors.street, indoors.room, outdoors.land, indoors.still_life, outdoors.scaffold,
    indoors.corridor, outdoors.wood, outdoors.yard, indoors.afloat, outdoors.harbour,
    indoors.warehouse, outdoors.square, outdoors.ruins,
)  # fmt: skip
SLOWEST, FASTEST = 0.3, 25.0
"""Median motion over 1/30 s, pixels of a picture 427 wide."""
STILL = 0.06
"""Share of shots whose camera stands still."""
RASTER = 1 / 3
"""Share of shots that EEVEE renders, as a game engine would."""
INSTANTS = 13
PACES = {"Cycles": 3.6, "EEVEE": 13.0}
GOLDEN = (math.sqrt(5) - 1) / 2


def place_of(seed: int) -> str:
    """Return the kind of place that a seed shows."""
    return PLACES[seed % len(PLACES)].__name__.replace("_", " ")


def speed_of(seed: int) -> float:
    """Return the median motion that a seed's camera makes, 0 for a still one.

    Multiples of the golden ratio spread evenly for any run of seeds.
    """
    if (seed * math.sqrt(2)) % 1 < STILL:
        return 0.0
    return SLOWEST * (FASTEST / SLOWEST) ** ((seed * GOLDEN) % 1)


def engine_of(seed: int) -> str:
    """Return what renders a seed's shot, whatever its place and speed are."""
    return "EEVEE" if (seed * math.sqrt(3)) % 1 < RASTER else "Cycles"


def build(seed: int, last: int) -> dict[int, str]:
    """Build the shot of a seed; return what each object id is."""
    chance = random.Random(seed)
    scene = Set(chance, Wardrobe(chance, 1.0))
    PLACES[seed % len(PLACES)](scene)
    night = variety_light.light(scene, last)
    path = variety_view.choose(scene, speed_of(seed), last)
    dynamic = variety_moves.Troupe(scene, path, last).cast_parts()
    variety_light.expose(scene, night, engine_of(seed))
    return dynamic


def script(seed: int) -> Script:
    """Return the shot of a seed."""
    about = f"A random shot for training: {place_of(seed)}."
    name = f"variety-{seed:04d}"
    engine = engine_of(seed)
    pace = PACES[engine]
    return Script(name, about, build, INSTANTS, seed, "training", pace, key_step=1, engine=engine)


def main() -> None:
    """Read the command line and render the shots of all seeds."""
    parser = argparse.ArgumentParser(description="Render random shots. Frames that exist are kept.")
    parser.add_argument(
        "seeds",
        nargs="*",
        type=options.ranges,
        default=[frozenset(range(1, 151))],
        help="as in 1-150 or 7,9 (1-150)",
    )
    options.options(parser)
    chosen = parser.parse_args()
    seeds = sorted(frozenset().union(*chosen.seeds))
    for number, seed in enumerate(seeds, 1):
        say(f"shot {number} of {len(seeds)}: seed {seed}, {place_of(seed)}")
        shoot(script(seed), options.order(chosen))
        gc.collect()


if __name__ == "__main__":
    main()
