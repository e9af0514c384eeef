"""Materials of the laboratory: polished floor, brushed steel, lacquer, glass, glowing screens."""

from __future__ import annotations

from typing import Any

from stage import looks
from stage.blender import bpy
from stage.looks import Colour

Material = bpy.types.Material


def palette() -> dict[str, Material]:
    """Make every material of the scene, by name."""
    made = {
        "floor": floor("floor"),
        "wall": cladding("wall", (0.62, 0.65, 0.66), (1.2, 1.1)),
        "dado": cladding("dado", (0.05, 0.20, 0.23), (1.2, 1.1)),
        "ceiling": cladding("ceiling", (0.10, 0.115, 0.13), (0.6, 0.6)),
        "steel": brushed("steel", (0.62, 0.64, 0.66), 1, 0.24),
        "duct": brushed("duct", (0.50, 0.52, 0.54), 0, 0.33),
        "chrome": lacquer("chrome", (0.78, 0.80, 0.82), 0.09, metallic=1.0),
        "gold": lacquer("gold", (0.92, 0.62, 0.22), 0.13, metallic=1.0),
        "copper": lacquer("copper", (0.80, 0.37, 0.20), 0.22, metallic=1.0),
        "hazard": hazard("hazard", (0.80, 0.52, 0.02), (0.025, 0.025, 0.025)),
        "dusk": dusk("dusk"),
        "screen": screen("screen", 1.0, (0.10, 0.85, 1.0), (1.0, 0.45, 0.05)),
        "screen2": screen("screen2", 7.3, (0.15, 1.0, 0.35), (0.9, 0.9, 0.2)),
        "screen3": screen("screen3", 3.9, (1.0, 0.55, 0.12), (0.2, 0.6, 1.0)),
        "panel": glow("panel", (1.0, 0.97, 0.90), 8.0),
        "window": glow("window", (1.0, 0.70, 0.34), 2.2),
        "warm": glow("warm", (1.0, 0.72, 0.38), 11.0),
        "cyan": glow("cyan", (0.15, 0.85, 1.0), 3.0),
        "green": glow("green", (0.10, 1.0, 0.30), 3.0),
        "ember": glow("ember", (1.0, 0.12, 0.05), 4.0),
    }
    paints = {
        "white": ((0.72, 0.73, 0.73), 0.22),
        "board": ((0.80, 0.81, 0.82), 0.12),
        "grey": ((0.26, 0.28, 0.30), 0.35),
        "dark": ((0.035, 0.04, 0.045), 0.3),
        "black": ((0.012, 0.012, 0.014), 0.08),
        "orange": ((0.85, 0.24, 0.02), 0.2),
        "yellow": ((0.85, 0.58, 0.03), 0.25),
        "red": ((0.62, 0.03, 0.03), 0.25),
        "blue": ((0.03, 0.12, 0.48), 0.25),
        "teal": ((0.02, 0.30, 0.33), 0.25),
        "leaf": ((0.03, 0.34, 0.08), 0.3),
        "violet": ((0.30, 0.05, 0.42), 0.25),
    }
    made |= {name: lacquer(name, *look) for name, look in paints.items()}
    glasses = {
        "amber": (0.33, 0.10, 0.01),
        "bottle": (0.02, 0.16, 0.06),
        "cobalt": (0.01, 0.05, 0.36),
        "ruby": (0.42, 0.01, 0.03),
        "milk": (0.66, 0.68, 0.70),
        "lime": (0.42, 0.62, 0.04),
    }
    return made | {name: lacquer(name, look, 0.05, wear=0.0) for name, look in glasses.items()}


def lacquer(
    name: str, colour: Colour, roughness: float, metallic: float = 0.0, wear: float = 0.35
) -> Material:
    """Smooth paint, plastic, polished metal or opaque glass, with faint marks."""
    material, nodes = looks.new(name)
    shade: Any = colour
    if wear:
        marks = nodes.step(nodes.noise(nodes.spot(), 7.0, 1.0), 0.35, 0.75)
        worn = tuple((1.0 - wear) * part + 0.01 for part in colour)
        shade = nodes.mix(marks, colour, worn)
    looks.finish(nodes, shade, roughness, metallic)
    return material


def glow(name: str, colour: Colour, strength: float) -> Material:
    """Surface that shines evenly."""
    material, nodes = looks.new(name)
    looks.finish(nodes, (0.5, 0.5, 0.5), 0.4, light=colour, glow=strength)
    return material


def floor(name: str) -> Material:
    """Polished terrazzo tiles, 60 cm: pale and dark flecks, scuffs that dull the reflection."""
    material, nodes = looks.new(name)
    where = nodes.spot()
    inputs = {
        "Vector": where,
        "Color1": (0.235, 0.25, 0.265),
        "Color2": (0.165, 0.18, 0.20),
        "Mortar": (0.05, 0.055, 0.06),
        "Scale": 1.0,
        "Brick Width": 0.6,
        "Row Height": 0.6,
        "Mortar Size": 0.009,
    }
    tiles = nodes.add("TexBrick", inputs, offset=0.0).outputs[0]
    fleck = nodes.noise(where, 34.0, 0.0)
    shade = nodes.mix(nodes.step(fleck, 0.57, 0.64), tiles, (0.31, 0.325, 0.34))
    shade = nodes.mix(nodes.step(fleck, 0.42, 0.36), shade, (0.125, 0.135, 0.15))
    scuff = nodes.step(nodes.noise(where, 1.4, 2.0), 0.4, 0.72)
    shade = nodes.mix(nodes.math("MULTIPLY", scuff, 0.3), shade, (0.12, 0.12, 0.12))
    rough = nodes.math("MULTIPLY_ADD", scuff, 0.13, 0.045)
    looks.finish(nodes, shade, rough, ior=1.75)
    return material


def cladding(name: str, colour: Colour, size: tuple[float, float]) -> Material:
    """Wall or ceiling panels of the given size in metres, with dark joints and smears."""
    material, nodes = looks.new(name)
    where = nodes.spot() if size[0] == size[1] else nodes.wall()
    inputs = {
        "Vector": where,
        "Color1": colour,
        "Color2": tuple(0.86 * part for part in colour),
        "Mortar": tuple(0.25 * part for part in colour),
        "Scale": 1.0,
        "Brick Width": size[0],
        "Row Height": size[1],
        "Mortar Size": 0.012,
    }
    panels = nodes.add("TexBrick", inputs, offset=0.0).outputs[0]
    smear = nodes.step(nodes.noise(where, 3.1, 2.0), 0.35, 0.8)
    shade = nodes.mix(smear, panels, tuple(0.62 * part for part in colour))
    looks.finish(nodes, shade, 0.38)
    return material


def brushed(name: str, colour: Colour, along: int, roughness: float) -> Material:
    """Metal with fine scratches along one axis of the object."""
    material, nodes = looks.new(name)
    stretch = [34.0, 34.0, 34.0]
    stretch[along] = 1.2
    lines = nodes.add("Mapping", {0: nodes.spot(), 3: tuple(stretch)}).outputs[0]
    scratch = nodes.step(nodes.noise(lines, 1.0, 2.0), 0.3, 0.7)
    shade = nodes.mix(scratch, tuple(0.68 * part for part in colour), colour)
    rough = nodes.math("MULTIPLY_ADD", scratch, -0.08, roughness + 0.05)
    looks.finish(nodes, shade, rough, 1.0)
    return material


def hazard(name: str, first: Colour, second: Colour) -> Material:
    """Slanting warning stripes, scuffed."""
    material, nodes = looks.new(name)
    where = nodes.spot()
    axes = nodes.add("SeparateXYZ", {0: where}).outputs
    slant = nodes.math("ADD", nodes.math("ADD", axes[0], axes[1]), axes[2])
    band = nodes.math("FRACT", nodes.math("MULTIPLY", slant, 3.6))
    shade = nodes.mix(nodes.math("GREATER_THAN", band, 0.5), first, second)
    worn = nodes.step(nodes.noise(where, 9.0, 3.0), 0.55, 0.75)
    shade = nodes.mix(nodes.math("MULTIPLY", worn, 0.7), shade, (0.2, 0.19, 0.17))
    looks.finish(nodes, shade, 0.3)
    return material


def dusk(name: str) -> Material:
    """Evening sky behind the windows, brightest at the horizon."""
    material, nodes = looks.new(name)
    where = nodes.spot()
    rise = nodes.add("SeparateXYZ", {0: where}).outputs[2]
    low = nodes.mix(nodes.step(rise, 0.6, 3.0), (2.4, 1.05, 0.42), (0.95, 0.62, 0.72))
    sky = nodes.mix(nodes.step(rise, 2.0, 5.5), low, (0.14, 0.25, 0.62))
    flat = nodes.add("Mapping", {0: where, 3: (1.0, 0.35, 2.6)}).outputs[0]
    cloud = nodes.step(nodes.noise(flat, 0.7, 3.0), 0.5, 0.68)
    sky = nodes.mix(nodes.math("MULTIPLY", cloud, 0.7), sky, (0.55, 0.30, 0.34))
    looks.finish(nodes, (0.0, 0.0, 0.0), 1.0, light=sky, glow=1.0)
    return material


def screen(name: str, seed: float, colour: Colour, accent: Colour) -> Material:
    """Dark glass with glowing curves, bars and a grid; the object is one unit wide, upright."""
    material, nodes = looks.new(name)
    axes = nodes.add("SeparateXYZ", {0: nodes.spot()}).outputs
    across, up = axes[0], axes[2]

    def near(distance: Any, width: float) -> Any:
        return nodes.step(nodes.math("ABSOLUTE", distance), width, 0.4 * width)

    left = nodes.math("LESS_THAN", across, 0.2)
    shifted = nodes.math("ADD", across, seed)
    line = nodes.noise(nodes.add("CombineXYZ", {0: shifted, 1: seed}).outputs[0], 11.0, 3.0)
    curve = nodes.math("MULTIPLY_ADD", line, 0.42, -0.13)
    trace = near(nodes.math("SUBTRACT", up, curve), 0.014)
    wave = nodes.math("SINE", nodes.math("MULTIPLY", shifted, 34.0))
    second = near(nodes.math("MULTIPLY_ADD", wave, 0.05, nodes.math("ADD", up, 0.15)), 0.013)
    cells = [nodes.math("FRACT", nodes.math("MULTIPLY", part, 12.0)) for part in (across, up)]
    grid = nodes.math("LESS_THAN", nodes.math("MINIMUM", *cells), 0.08)
    row = nodes.math("FLOOR", nodes.math("MULTIPLY_ADD", up, 22.0, seed))
    length = nodes.add("TexWhiteNoise", {"W": row}, noise_dimensions="1D").outputs[0]
    reach = nodes.math("MULTIPLY_ADD", length, 0.22, 0.24)
    gap = nodes.math("FRACT", nodes.math("MULTIPLY_ADD", up, 22.0, seed))
    bar = nodes.math("LESS_THAN", across, reach)
    bar = nodes.math("MULTIPLY", bar, nodes.math("GREATER_THAN", across, 0.23))
    bar = nodes.math("MULTIPLY", bar, nodes.math("GREATER_THAN", gap, 0.4))
    dim = tuple(0.05 * part for part in colour)
    faint = tuple(0.16 * part for part in colour)
    light = nodes.mix(nodes.math("MULTIPLY", grid, left), dim, faint)
    light = nodes.mix(nodes.math("MULTIPLY", trace, left), light, colour)
    light = nodes.mix(nodes.math("MULTIPLY", second, left), light, accent)
    light = nodes.mix(nodes.math("MULTIPLY", bar, 0.75), light, accent)
    light = nodes.mix(nodes.math("GREATER_THAN", up, 0.235), light, tuple(0.5 * c for c in colour))
    looks.finish(nodes, (0.01, 0.012, 0.015), 0.07, light=light, glow=2.6)
    return material
