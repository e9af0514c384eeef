"""Random short shots, one for each seed, to train a network with; never to judge on.

A seed draws a kind of place, materials, things that stand and things that move, light, and a camera
whose median motion over a key interval is spread evenly on a logarithmic scale. Run it with
Blender's Python: `variety.py 1-400 --data FOLDER`.
"""

from __future__ import annotations

import argparse
import functools
import gc
import math
import random
from dataclasses import replace
from pathlib import Path

import things_list
import variety_acts
import variety_indoors as indoors
import variety_light
import variety_moves
import variety_noise
import variety_outdoors as outdoors
import variety_view
import variety_wind
from stage import options
from stage.quality import TRAINING
from stage.shooting import Script, say, shoot
from things_list import ThingList, default_folder
from variety_looks import Wardrobe
from variety_plan import Plan
from variety_set import Set
from variety_things import Stock

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
SEEDS = frozenset(range(1, 401))
SIZE = "256x144"
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


def build(
    seed: int, last: int, listed: ThingList, credits: list[dict[str, str]], engine: str
) -> dict[int, str]:
    """Build the shot of a seed; return what each object id is, and fill in the real things."""
    chance, plan = random.Random(seed), Plan.draw(seed)
    stock = Stock(listed, seed, plan.has("real shapes"), plan.has("real textures"))
    wear = Wardrobe(chance, 1.0, stock, plan.has("glossy ground"))
    scene = Set(chance, wear, plan=plan, stock=stock)
    PLACES[seed % len(PLACES)](scene)
    night = variety_light.light(scene, last)
    path = variety_view.choose(scene, speed_of(seed), last)
    after = (variety_wind.blow,) if plan.has("wind") else ()
    dynamic = variety_moves.Troupe(scene, path, last).cast_parts((variety_acts.play,), after)
    variety_light.expose(scene, night, engine)
    credits[:] = [stock.shown[name].credit for name in sorted(stock.shown)]
    return dynamic


def script(seed: int, listed: ThingList, engine: str | None = None) -> Script:
    """Return the shot of a seed, with the real things of a list where the seed wants some.

    `engine` renders it in place of the one that the seed draws.
    """
    plan, credits, engine = Plan.draw(seed), [], engine or engine_of(seed)
    wants = plan.has("real shapes") or plan.has("real textures")
    return Script(
        f"variety-{seed:04d}",
        f"A random shot for training: {place_of(seed)}.",
        functools.partial(build, listed=listed, credits=credits, engine=engine),
        INSTANTS,
        seed,
        "training",
        PACES[engine],
        key_step=1,
        quality=TRAINING if engine == "Cycles" else None,
        engine=engine,
        features=tuple(sorted(plan.features)),
        packages=listed.packages if wants else {},
        things=credits,
    )


def main() -> None:
    """Read the command line and render the shots of all seeds."""
    parser = argparse.ArgumentParser(description="Render random shots. Frames that exist are kept.")
    parser.add_argument(
        "seeds",
        nargs="*",
        type=options.ranges,
        default=[SEEDS],
        help=f"as in 1-150 or 7,9 ({min(SEEDS)}-{max(SEEDS)})",
    )
    parser.add_argument(
        "--things",
        type=Path,
        default=default_folder(),
        help="folder of real things, written by things.py (%(default)s)",
    )
    parser.add_argument(
        "--engine", choices=tuple(PACES), help="renders all of them (one shot in three by EEVEE)"
    )
    options.options(parser, SIZE)
    chosen = parser.parse_args()
    listed = things_list.read(chosen.things.expanduser())
    if not listed.things:
        say(f"{listed.folder} has no real things (things.py takes some); shapes are our own.")
    seeds = sorted(frozenset().union(*chosen.seeds))
    for number, seed in enumerate(seeds, 1):
        say(f"shot {number} of {len(seeds)}: seed {seed}, {place_of(seed)}")
        order = options.order(chosen)
        shot = script(seed, listed, chosen.engine)
        if shot.engine == "Cycles" and order.samples is None and order.seeds is None:
            folder = order.data / shot.name
            last = shot.instants - 1
            quality = variety_noise.quality_of(
                folder, seed, shot.build, last, order.size, order.on_gpu
            )
            shot = replace(shot, quality=quality)
        shoot(shot, order)
        gc.collect()


if __name__ == "__main__":
    main()
