"""Light for a shot: sky, sun, lamps that hang or move, and an exposure that suits."""

from __future__ import annotations

import colorsys
import math
import tempfile
from pathlib import Path

import numpy as np
from stage import files, looks, motion, raster, render
from stage.blender import bpy, mathutils
from variety_set import Set

Vector = mathutils.Vector
PROBE = (32, 18)
Skies = dict[str, tuple]

SKIES: Skies = {
    "clear": ((0.10, 0.26, 0.70), (0.62, 0.74, 0.92), None, 4.5),
    "cloudy": ((0.14, 0.30, 0.70), (0.70, 0.78, 0.90), (1.35, 1.3, 1.2), 4.0),
    "sunset": ((0.10, 0.13, 0.35), (1.10, 0.50, 0.22), (1.6, 0.75, 0.4), 3.5),
    "grey": ((0.55, 0.58, 0.62), (0.75, 0.76, 0.78), (1.0, 1.0, 1.02), 0.8),
    "storm": ((0.05, 0.06, 0.09), (0.35, 0.36, 0.38), (0.7, 0.68, 0.66), 2.0),
    "studio": ((0.55, 0.55, 0.55), (0.45, 0.45, 0.45), None, 2.5),
}
CASTING = ("clear", "cloudy", "sunset", "studio")
"""Skies with a sun that casts shadows."""

NIGHT = ((0.012, 0.017, 0.04), (0.05, 0.05, 0.07), (0.09, 0.08, 0.08), 0.35)


def light(scene: Set, last: int) -> bool:
    """Add sky, sun and lamps; say whether it is night."""
    chance = scene.chance
    night = scene.is_dark = chance.random() < scene.night
    casting = scene.plan.has("cast shadows")
    kind = chance.choice(CASTING if casting else sorted(SKIES))
    zenith, horizon, clouds, sun = NIGHT if night else SKIES[kind]
    tint = [scene.within(0.8, 1.2) for _ in range(3)]
    colours = [tuple(c * t for c, t in zip(part, tint, strict=True)) for part in (zenith, horizon)]
    looks.backdrop(*colours, scene.within(0.5, 0.8 if casting else 1.3), clouds)
    _sun(scene, sun, kind == "sunset" and not night, last)
    dark = night or scene.indoor
    if dark or chance.random() < 0.25:
        _lamps(scene, last, 1.0 if dark else 0.3)
    return night


def _sun(scene: Set, strength: float, low: bool, last: int) -> None:
    up = math.radians(scene.within(6, 18) if low else scene.chance.choice((20, 35, 50, 70)))
    round_about = scene.within(0, 2 * math.pi)
    if scene.indoor and scene.chance.random() < 0.7:
        round_about, up = scene.within(-0.9, 0.9), min(up, 0.7)
    towards = -Vector(
        (math.cos(up) * math.cos(round_about), math.cos(up) * math.sin(round_about), math.sin(up))
    )
    warm = max(0.0, 1.0 - up)
    colour = (1.0, 1.0 - 0.45 * warm**2, 1.0 - 0.75 * warm**2)
    softest = 2.5 if scene.plan.has("cast shadows") else 15.0
    softness = math.exp(scene.within(math.log(0.3), math.log(softest)))
    sun = motion.sunlight(towards, strength * scene.within(0.6, 1.5), colour, softness)
    scene.sun = towards
    if scene.chance.random() < 0.15:  # shadows wander although nothing else may move
        start, pace = sun.rotation_euler.copy(), scene.within(-1.0, 1.0)

        def pose(seconds: float) -> tuple:
            turn = (start.x + 0.5 * pace * seconds, start.y, start.z + pace * seconds)
            return (0, 0, 0), turn

        motion.keyed(sun, pose, last)


def _lamps(scene: Set, last: int, share: float) -> None:
    """Hang up to three lamps: points, areas and spots; some swing, some flicker."""
    chance = scene.chance
    places = list(scene.lamps) or [(0.0, 0.0, 3.0), (3.0, 2.0, 4.0)]
    if scene.eyes and not scene.indoor:
        eye = scene.eyes[0][0]
        places.sort(key=lambda at: (Vector(at) - Vector(eye)).length)
        places = places[:4]
    for at in chance.sample(places, min(len(places), chance.choice((2, 3, 3)))):
        kind = chance.choice(("POINT", "POINT", "AREA", "SPOT"))
        lamp = bpy.data.lights.new("lamp", kind)
        hue, strong = chance.choice((0.08, 0.1, 0.6, chance.random())), chance.uniform(0.05, 0.7)
        lamp.color = colorsys.hsv_to_rgb(hue, strong, 1.0)
        lamp.energy = share * 16.0 * scene.reach**2 * scene.within(0.5, 2.0)
        if kind == "AREA":
            lamp.shape, lamp.size = "DISK", scene.within(0.1, 0.5) * scene.reach
        else:
            lamp.shadow_soft_size = math.exp(scene.within(-4.5, -1.2)) * scene.reach / 3
        if kind == "SPOT":
            lamp.spot_size, lamp.spot_blend = scene.within(1.2, 2.4), scene.within(0.1, 0.9)
        thing = bpy.data.objects.new("lamp", lamp)
        bpy.context.scene.collection.objects.link(thing)
        thing.location = at
        scene.bulbs.append(thing)
        if chance.random() < 0.45:
            _swing(scene, thing, last)
        if chance.random() < 0.15:
            mean, depth, phase = lamp.energy, scene.within(0.1, 0.5), scene.within(0, 6.3)
            motion.keyed_value(
                lamp,
                "energy",
                lambda t, m=mean, d=depth, p=phase: m * (1 + d * math.sin(30 * t + p)),
                last,
            )


def _swing(scene: Set, thing: bpy.types.Object, last: int) -> None:
    start = Vector(thing.location)
    pace = Vector([scene.within(-1, 1) for _ in range(3)]) * scene.reach * scene.within(0.1, 1.0)

    def pose(seconds: float) -> tuple:
        share = seconds + 2 * seconds**2
        return start + pace * share, (0.4 * seconds, 0.6 * seconds, 0.0)

    motion.keyed(thing, pose, last)


def expose(scene: Set, night: bool, engine: str) -> None:
    """Set the exposure from a tiny render by an engine, to a mean that is drawn at random."""
    lowest, highest = (0.09, 0.2) if night else (0.15, 0.42)
    aim = math.exp(scene.within(math.log(lowest), math.log(highest)))
    seen = np.clip(_probe(engine), 0.0, None)
    luminance = seen @ np.array([0.2126, 0.7152, 0.0722], np.float32)
    low, high = -9.0, 9.0
    for _ in range(24):
        middle = 0.5 * (low + high)
        mean = float(np.minimum(luminance * 2.0**middle, 0.7).mean())
        low, high = (middle, high) if mean < aim else (low, middle)
    # No more than a tenth of the picture may burn out, unless most of it stayed black.
    limit = 1.2 / max(1e-6, float(np.quantile(luminance, 0.9)))
    least = 0.035 / max(1e-6, float(np.median(luminance)))
    bpy.context.scene.cycles.film_exposure = max(min(2.0**low, limit), min(least, 4 * limit))


def _probe(engine: str) -> np.ndarray:
    """Render the middle of the shot at a thumbnail's size; return its colours."""
    product: render.Product
    if engine == "Cycles":
        renderer, product = render, render.Product(1, (), True, 8)
        render.settle(PROBE)
    else:
        renderer, product = raster, raster.RasterProduct(1, ("z",), True, 1, 9)
        raster.settle(PROBE)
    renderer.configure(product, motion.FPS)
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder, "probe.exr")
        renderer.render(6, product, target, 1)
        return files.read_colour(target)
