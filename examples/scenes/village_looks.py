"""Materials of the village scene."""

from __future__ import annotations

from stage import looks
from stage.blender import bpy

Colour = tuple[float, float, float]


def palette() -> dict[str, bpy.types.Material]:
    """Make every material of the scene, by name."""
    made = {
        "grass": _meadow("grass"),
        "fields": _fields("fields"),
        "water": _water("water"),
        "stone": _rubble("stone", (0.42, 0.38, 0.31), (0.27, 0.25, 0.22)),
        "ashlar": _rubble("ashlar", (0.52, 0.47, 0.38), (0.40, 0.37, 0.31)),
        "cream": _lime("cream", (0.74, 0.66, 0.50)),
        "ochre": _lime("ochre", (0.68, 0.48, 0.22)),
        "blush": _lime("blush", (0.70, 0.47, 0.37)),
        "chalk": _lime("chalk", (0.76, 0.74, 0.68)),
        "thatch": _straw("thatch", (0.46, 0.35, 0.17), (0.20, 0.15, 0.08)),
        "hay": _straw("hay", (0.62, 0.46, 0.17), (0.34, 0.23, 0.07)),
        "dirt": _soil("dirt", (0.42, 0.32, 0.20), (0.30, 0.23, 0.14)),
        "rut": _soil("rut", (0.25, 0.18, 0.11), (0.17, 0.12, 0.08)),
        "crown": _soil("crown", (0.28, 0.28, 0.11), (0.36, 0.29, 0.17)),
        "verge": _soil("verge", (0.17, 0.24, 0.07), (0.33, 0.28, 0.15)),
        "oak": looks.wood("oak", (0.30, 0.19, 0.10)),
        "beam": looks.wood("beam", (0.13, 0.08, 0.05), along=2),
        "grey wood": looks.wood("grey wood", (0.34, 0.29, 0.23), along=2),
        "canvas": looks.checker("canvas", (0.78, 0.72, 0.60), (0.62, 0.55, 0.42), 0.3),
        "brass": looks.paint("brass", (0.92, 0.62, 0.22), 0.16, 1.0),
        "iron": looks.paint("iron", (0.06, 0.06, 0.07), 0.4),
        "glass": looks.paint("glass", (0.04, 0.06, 0.08), 0.06),
        "lit": looks.paint("lit", (1.0, 0.62, 0.25), glow=1.6),
    }
    return made | {name: _flat(name, *colour) for name, colour in FLAT.items()}


FLAT: dict[str, tuple[Colour, float]] = {
    "blade1": ((0.13, 0.24, 0.04), 0.6),
    "blade2": ((0.22, 0.33, 0.06), 0.6),
    "blade3": ((0.33, 0.38, 0.10), 0.6),
    "blade4": ((0.08, 0.16, 0.03), 0.6),
    "leaf1": ((0.09, 0.19, 0.03), 0.5),
    "leaf2": ((0.17, 0.29, 0.05), 0.5),
    "leaf3": ((0.28, 0.37, 0.07), 0.5),
    "wood1": ((0.13, 0.22, 0.09), 0.6),
    "wood2": ((0.21, 0.30, 0.12), 0.6),
    "wood3": ((0.29, 0.37, 0.17), 0.6),
    "apple1": ((0.16, 0.25, 0.06), 0.5),
    "apple2": ((0.30, 0.38, 0.12), 0.5),
    "apple3": ((0.72, 0.50, 0.48), 0.6),
    "leaf core": ((0.07, 0.15, 0.025), 0.6),
    "wood core": ((0.10, 0.17, 0.06), 0.6),
    "apple core": ((0.14, 0.21, 0.06), 0.6),
    "lily": ((0.10, 0.26, 0.08), 0.35),
    "bark": ((0.13, 0.09, 0.06), 0.9),
    "straw": ((0.60, 0.47, 0.22), 0.8),
    "straw dark": ((0.26, 0.19, 0.09), 0.8),
    "straw pale": ((0.66, 0.55, 0.33), 0.8),
    "tile1": ((0.46, 0.18, 0.095), 0.7),
    "tile2": ((0.38, 0.12, 0.07), 0.7),
    "tile3": ((0.60, 0.27, 0.13), 0.7),
    "tile4": ((0.25, 0.13, 0.09), 0.8),
    "tile5": ((0.36, 0.31, 0.17), 0.8),
    "slate1": ((0.17, 0.19, 0.24), 0.45),
    "slate2": ((0.11, 0.12, 0.16), 0.45),
    "slate3": ((0.25, 0.26, 0.29), 0.5),
    "slate4": ((0.19, 0.20, 0.17), 0.6),
    "slate5": ((0.31, 0.30, 0.25), 0.6),
    "pale": ((0.55, 0.51, 0.43), 0.85),
    "block": ((0.38, 0.35, 0.30), 0.85),
    "moss": ((0.25, 0.29, 0.14), 0.9),
    "clay": ((0.52, 0.22, 0.12), 0.8),
    "red": ((0.62, 0.06, 0.05), 0.6),
    "white": ((0.82, 0.80, 0.75), 0.6),
    "yellow": ((0.88, 0.62, 0.07), 0.6),
    "violet": ((0.36, 0.14, 0.48), 0.6),
    "rose": ((0.78, 0.22, 0.36), 0.6),
    "green": ((0.10, 0.26, 0.15), 0.5),
    "blue": ((0.12, 0.24, 0.44), 0.5),
    "teal": ((0.10, 0.32, 0.33), 0.5),
    "black": ((0.03, 0.03, 0.03), 0.5),
}


def _flat(name: str, colour: Colour, roughness: float) -> bpy.types.Material:
    """One colour: for what is so small that its neighbours make the texture."""
    material, nodes = looks.new(name)
    looks.finish(nodes, (*colour, 1.0), roughness)
    return material


def _meadow(name: str) -> bpy.types.Material:
    """Grass of different ages, mown and worn."""
    material, nodes = looks.new(name)
    where = nodes.spot()
    fine = nodes.step(nodes.noise(where, 3.4, 3.0), 0.36, 0.66)
    broad = nodes.step(nodes.noise(where, 0.22, 2.0), 0.4, 0.62)
    fresh = nodes.mix(fine, (0.10, 0.19, 0.04), (0.27, 0.36, 0.08))
    dry = nodes.mix(fine, (0.19, 0.21, 0.06), (0.42, 0.40, 0.15))
    looks.finish(nodes, nodes.mix(broad, fresh, dry), 0.9)
    return material


def _fields(name: str) -> bpy.types.Material:
    """Patchwork of fields with furrows, paler with distance."""
    material, nodes = looks.new(name)
    where = nodes.spot()
    inputs = {"Vector": where, "Scale": 0.045, "Randomness": 0.9}
    cell = nodes.add(
        "TexVoronoi", inputs, feature="F1", voronoi_dimensions="2D", distance="MANHATTAN"
    )
    tones = nodes.add("SeparateColor", {0: cell.outputs["Color"]}).outputs
    fine = nodes.step(nodes.noise(where, 0.9, 3.0), 0.35, 0.68)
    crop = nodes.mix(tones[0], (0.16, 0.27, 0.06), (0.30, 0.38, 0.10))
    crop = nodes.mix(nodes.step(tones[1], 0.62, 0.7), crop, (0.58, 0.46, 0.16))
    crop = nodes.mix(nodes.step(tones[2], 0.74, 0.78), crop, (0.34, 0.23, 0.14))
    shade = nodes.mix(fine, nodes.mix(0.45, crop, (0.06, 0.10, 0.03)), crop)
    depth = nodes.add("SeparateXYZ", {0: where}).outputs[1]
    haze = nodes.math("MULTIPLY", nodes.step(depth, 40.0, 420.0), 0.6)
    looks.finish(nodes, nodes.mix(haze, shade, (0.42, 0.53, 0.66)), 0.9)
    return material


def _water(name: str) -> bpy.types.Material:
    """Still water with ripples; sparse crests catch the sun."""
    material, nodes = looks.new(name)
    where = nodes.spot()
    flat = nodes.add("Mapping", {0: where, 3: (0.6, 2.2, 1.0)}).outputs[0]
    ripple = nodes.noise(flat, 1.5, 2.0)
    sparkle = nodes.step(nodes.noise(flat, 7.0, 1.0), 0.75, 0.78)
    normal = nodes.bump(ripple, 0.03, 0.35)
    glow = nodes.math("MULTIPLY", sparkle, 5.0)
    colour, light = (0.03, 0.075, 0.085), (1.0, 0.9, 0.7)
    looks.finish(nodes, colour, 0.05, normal=normal, glow=glow, light=light, ior=2.3)
    return material


def _rubble(name: str, first: Colour, second: Colour) -> bpy.types.Material:
    """Walls of uneven field stones in rough courses."""
    material, nodes = looks.new(name)
    where = nodes.wall()
    wobble = nodes.noise(where, 2.6, 1.0)
    pushed = nodes.add("VectorMath", {0: where, 1: wobble}, operation="ADD").outputs[0]
    inputs = {
        "Vector": nodes.add("VectorMath", {0: pushed, 1: (0.5, 0.5, 0.5)}).outputs[0],
        "Color1": first,
        "Color2": second,
        "Mortar": tuple(0.3 * part for part in second),
        "Scale": 1.0,
        "Brick Width": 0.46,
        "Row Height": 0.25,
        "Mortar Size": 0.022,
        "Mortar Smooth": 0.3,
    }
    stones = nodes.add("TexBrick", inputs).outputs[0]
    grain = nodes.step(nodes.noise(where, 7.0, 2.0), 0.3, 0.7)
    light = tuple(min(1.0, 1.25 * part) for part in first)
    looks.finish(nodes, nodes.mix(nodes.math("MULTIPLY", grain, 0.4), stones, light), 0.9)
    return material


def _lime(name: str, colour: Colour) -> bpy.types.Material:
    """Limewash: blotches and streaks of rain."""
    material, nodes = looks.new(name)
    where = nodes.wall()
    blotch = nodes.step(nodes.noise(where, 2.4, 3.0), 0.35, 0.7)
    streaks = nodes.add("Mapping", {0: where, 3: (5.0, 0.8, 1.0)}).outputs[0]
    rain = nodes.step(nodes.noise(streaks, 1.5, 2.0), 0.5, 0.8)
    worn = tuple(0.72 * part for part in colour)
    dark = tuple(0.45 * part for part in colour)
    shade = nodes.mix(rain, nodes.mix(blotch, worn, colour), dark)
    looks.finish(nodes, shade, 0.9)
    return material


def _straw(name: str, light: Colour, dark: Colour) -> bpy.types.Material:
    """Straw laid downwards, weathered in patches."""
    material, nodes = looks.new(name)
    where = nodes.spot()
    strands = nodes.add("Mapping", {0: where, 3: (9.0, 1.3, 1.3)}).outputs[0]
    grain = nodes.step(nodes.noise(strands, 1.3, 3.0), 0.34, 0.66)
    patch = nodes.step(nodes.noise(where, 0.7, 2.0), 0.42, 0.62)
    mossy = (0.75 * dark[0] + 0.05, 0.9 * dark[1] + 0.07, dark[2])
    shade = nodes.mix(grain, nodes.mix(patch, dark, mossy), light)
    looks.finish(nodes, shade, 0.9)
    return material


def _soil(name: str, first: Colour, second: Colour) -> bpy.types.Material:
    """Trodden earth with pebbles."""
    material, nodes = looks.new(name)
    where = nodes.spot()
    grain = nodes.step(nodes.noise(where, 2.8, 3.0), 0.36, 0.64)
    looks.finish(nodes, nodes.mix(grain, first, second), 0.9)
    return material
