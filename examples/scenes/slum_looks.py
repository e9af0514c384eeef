"""Materials of the slum scene: rust, peeling plaster, wet mud, worn cloth, neon."""

from __future__ import annotations

from stage import looks
from stage.blender import bpy

Looks = dict[str, bpy.types.Material]
Colour = looks.Colour

PAINTS: dict[str, Colour] = {
    "red": (0.55, 0.05, 0.04),
    "blue": (0.05, 0.14, 0.42),
    "green": (0.07, 0.27, 0.13),
    "yellow": (0.80, 0.52, 0.06),
    "orange": (0.75, 0.26, 0.04),
    "white": (0.74, 0.72, 0.66),
    "cream": (0.66, 0.57, 0.40),
    "teal": (0.07, 0.33, 0.34),
    "pink": (0.66, 0.25, 0.30),
    "grey": (0.24, 0.24, 0.24),
    "black": (0.025, 0.025, 0.028),
    "skin": (0.30, 0.16, 0.09),
    "hair": (0.02, 0.015, 0.012),
    "rubber": (0.030, 0.029, 0.028),
    "cable": (0.018, 0.018, 0.020),
}
"""Colours of plain painted, dyed or moulded things."""


def palette() -> Looks:
    """Make every material of the scene, by name."""
    made = {name: looks.paint(name, colour) for name, colour in PAINTS.items()}
    made |= {
        "mud": mud("mud"),
        "puddle": looks.paint("puddle", (0.42, 0.44, 0.47), 0.04, 0.55),
        "zinc": rusty("zinc", (0.42, 0.43, 0.44), 0.35, 0.6),
        "rust": rusty("rust", (0.34, 0.31, 0.28), 0.75, 0.2),
        "bluetin": rusty("bluetin", (0.08, 0.25, 0.40), 0.40, 0.1),
        "greentin": rusty("greentin", (0.14, 0.33, 0.22), 0.45, 0.1),
        "redtin": rusty("redtin", (0.42, 0.09, 0.05), 0.35, 0.1),
        "brick": masonry("brick", (0.44, 0.17, 0.09), (0.25, 0.09, 0.06), (0.23, 0.085)),
        "block": masonry("block", (0.36, 0.34, 0.31), (0.24, 0.23, 0.22), (0.42, 0.21)),
        "turquoise": peeling("turquoise", (0.13, 0.43, 0.43)),
        "rose": peeling("rose", (0.62, 0.27, 0.24)),
        "ochre": peeling("ochre", (0.66, 0.41, 0.12)),
        "lime": peeling("lime", (0.62, 0.60, 0.52)),
        "plank": looks.wood("plank", (0.30, 0.19, 0.11), along=2),
        "greyplank": looks.wood("greyplank", (0.24, 0.21, 0.18), along=2),
        "bamboo": looks.wood("bamboo", (0.44, 0.32, 0.12), along=2),
        "beam": looks.wood("beam", (0.15, 0.09, 0.05)),
        "crate": looks.wood("crate", (0.42, 0.26, 0.12)),
        "tarp": cloth("tarp", (0.04, 0.19, 0.48), (0.03, 0.13, 0.36), 0.06, 0.4),
        "canvas": cloth("canvas", (0.70, 0.30, 0.06), (0.58, 0.24, 0.05), 0.08, 0.5),
        "leaf": looks.foliage("leaf", (0.05, 0.15, 0.03), (0.26, 0.38, 0.07)),
        "tank": looks.paint("tank", (0.04, 0.16, 0.42), 0.3),
        "chrome": looks.paint("chrome", (0.68, 0.69, 0.71), 0.2, 1.0),
        "glass": looks.paint("glass", (0.05, 0.07, 0.09), 0.07),
        "lit": curtain("lit"),
        "bulb": looks.paint("bulb", (1.0, 0.72, 0.36), glow=22.0),
        "neonpink": looks.paint("neonpink", (1.0, 0.10, 0.42), glow=5.0),
        "neoncyan": looks.paint("neoncyan", (0.10, 0.80, 1.0), glow=4.0),
        "headlight": looks.paint("headlight", (1.0, 0.93, 0.75), glow=9.0),
    }
    bands = {
        "stripered": ((0.62, 0.06, 0.06), (0.75, 0.72, 0.66)),
        "stripeblue": ((0.06, 0.13, 0.45), (0.72, 0.73, 0.74)),
        "stripegreen": ((0.10, 0.32, 0.12), (0.70, 0.62, 0.20)),
        "denim": ((0.07, 0.11, 0.23), (0.09, 0.14, 0.28)),
        "linen": ((0.76, 0.74, 0.68), (0.70, 0.66, 0.58)),
        "magenta": ((0.55, 0.06, 0.25), (0.62, 0.10, 0.32)),
        "saffron": ((0.85, 0.43, 0.04), (0.70, 0.30, 0.03)),
    }
    for name, (first, second) in bands.items():
        made[name] = cloth(name, first, second, 0.11, 0.85)
    return made


def rusty(name: str, coat: Colour, share: float, metallic: float) -> bpy.types.Material:
    """Sheet metal whose coat gives way to rust, in streaks that run down."""
    material, nodes = looks.new(name)
    where = nodes.spot()
    long = nodes.add("Mapping", {0: where, 3: (5.0, 5.0, 0.6)}).outputs[0]
    streak = nodes.noise(long, 1.3, 3.0)
    blot = nodes.noise(where, 4.5, 3.0)
    both = nodes.math("ADD", nodes.math("MULTIPLY", streak, 0.6), nodes.math("MULTIPLY", blot, 0.4))
    edge = 0.62 - 0.24 * share
    mask = nodes.step(both, edge - 0.05, edge + 0.05)
    tone = nodes.step(blot, 0.36, 0.64)
    rust = nodes.mix(tone, (0.09, 0.035, 0.02), (0.38, 0.14, 0.045))
    dull = tuple(0.62 * part for part in coat)
    shade = nodes.mix(mask, nodes.mix(tone, dull, coat), rust)
    rough = nodes.math("ADD", 0.38, nodes.math("MULTIPLY", mask, 0.5))
    looks.finish(nodes, shade, rough, metallic)
    return material


def masonry(
    name: str, first: Colour, second: Colour, size: tuple[float, float]
) -> bpy.types.Material:
    """Bare bricks or blocks with thick mortar, soot and damp feet."""
    material, nodes = looks.new(name)
    bricks = _bricks(nodes, first, second, size)
    dirt = nodes.step(nodes.noise(nodes.spot(), 2.6, 3.0), 0.38, 0.7)
    shade = nodes.mix(nodes.math("MULTIPLY", dirt, 0.55), bricks, (0.05, 0.045, 0.04))
    looks.finish(nodes, nodes.mix(_damp(nodes), shade, (0.035, 0.032, 0.028)), 0.85)
    return material


def peeling(name: str, colour: Colour) -> bpy.types.Material:
    """Paint that comes off the plaster, and plaster that comes off the bricks."""
    material, nodes = looks.new(name)
    where = nodes.spot()
    fine = nodes.noise(where, 8.0, 3.0)
    wide = nodes.noise(where, 1.15, 3.0)
    loss = nodes.math("ADD", wide, nodes.math("MULTIPLY", fine, 0.22))
    bricks = _bricks(nodes, (0.38, 0.15, 0.09), (0.24, 0.10, 0.07), (0.23, 0.085))
    worn = tuple(0.6 * part for part in colour)
    bleached = tuple(min(1.0, 1.15 * part + 0.04) for part in colour)
    paint = nodes.mix(nodes.step(fine, 0.35, 0.65), worn, bleached)
    plaster = nodes.mix(fine, (0.20, 0.19, 0.17), (0.46, 0.43, 0.38))
    shade = nodes.mix(nodes.step(loss, 0.63, 0.645), paint, plaster)
    shade = nodes.mix(nodes.step(loss, 0.72, 0.735), shade, bricks)
    long = nodes.add("Mapping", {0: where, 3: (3.5, 3.5, 0.35)}).outputs[0]
    stain = nodes.step(nodes.noise(long, 1.4, 2.0), 0.5, 0.75)
    shade = nodes.mix(nodes.math("MULTIPLY", stain, 0.75), shade, (0.07, 0.06, 0.05))
    looks.finish(nodes, nodes.mix(_damp(nodes), shade, (0.05, 0.045, 0.04)), 0.85)
    return material


def _bricks(
    nodes: looks.Nodes, first: Colour, second: Colour, size: tuple[float, float]
) -> bpy.types.NodeSocket:
    inputs = {
        "Vector": nodes.wall(),
        "Color1": first,
        "Color2": second,
        "Mortar": (0.36, 0.33, 0.29),
        "Scale": 1.0,
        "Brick Width": size[0],
        "Row Height": size[1],
        "Mortar Size": 0.1 * size[1],
        "Mortar Smooth": 0.2,
    }
    return nodes.add("TexBrick", inputs).outputs[0]


def _damp(nodes: looks.Nodes) -> bpy.types.NodeSocket:
    """Rise from 0 to 0.7 towards the ground."""
    high = nodes.add("SeparateXYZ", {0: nodes.spot()}).outputs[2]
    return nodes.math("MULTIPLY", 0.7, nodes.math("SUBTRACT", 1.0, nodes.step(high, 0.0, 0.8)))


def mud(name: str) -> bpy.types.Material:
    """Trodden ground: broken slabs, mud over them, wet where it is low."""
    material, nodes = looks.new(name)
    where = nodes.spot()
    inputs = {
        "Vector": where,
        "Color1": (0.30, 0.28, 0.25),
        "Color2": (0.19, 0.175, 0.16),
        "Mortar": (0.05, 0.042, 0.035),
        "Scale": 1.0,
        "Brick Width": 0.62,
        "Row Height": 0.44,
        "Mortar Size": 0.014,
        "Mortar Smooth": 0.4,
    }
    slabs = nodes.add("TexBrick", inputs).outputs[0]
    wide = nodes.noise(where, 1.5, 3.0)
    grit = nodes.noise(where, 13.0, 3.0)
    earth = nodes.mix(nodes.step(grit, 0.3, 0.7), (0.07, 0.05, 0.035), (0.24, 0.18, 0.12))
    shade = nodes.mix(nodes.step(wide, 0.44, 0.56), slabs, earth)
    wet = nodes.step(wide, 0.5, 0.62)
    shade = nodes.mix(nodes.math("MULTIPLY", wet, 0.6), shade, (0.03, 0.025, 0.02))
    shade = nodes.mix(nodes.step(grit, 0.58, 0.66), shade, (0.34, 0.31, 0.27))
    rough = nodes.math("SUBTRACT", 0.85, nodes.math("MULTIPLY", wet, 0.6))
    looks.finish(nodes, shade, rough, normal=nodes.bump(grit))
    return material


def cloth(
    name: str, first: Colour, second: Colour, size: float, roughness: float
) -> bpy.types.Material:
    """Cloth with level bands of the given width in metres, faded and creased."""
    material, nodes = looks.new(name)
    where = nodes.spot()
    high = nodes.add("SeparateXYZ", {0: where}).outputs[2]
    share = nodes.math("FRACT", nodes.math("DIVIDE", high, 2.0 * size))
    band = nodes.math("GREATER_THAN", share, 0.5)
    long = nodes.add("Mapping", {0: where, 3: (2.0, 2.0, 0.6)}).outputs[0]
    crease = nodes.step(nodes.noise(long, 5.0, 3.0), 0.34, 0.7)
    faded = nodes.math("MULTIPLY", crease, 0.5)
    shade = nodes.mix(faded, nodes.mix(band, first, second), (0.12, 0.11, 0.10))
    looks.finish(nodes, shade, roughness)
    return material


def curtain(name: str) -> bpy.types.Material:
    """A drawn curtain in folds with a lamp behind it, brighter than white in the middle."""
    material, nodes = looks.new(name)
    where = nodes.wall()
    long = nodes.add("Mapping", {0: where, 3: (11.0, 0.7, 1.0)}).outputs[0]
    fold = nodes.step(nodes.noise(long, 1.5, 2.0), 0.3, 0.7)
    warm = nodes.mix(fold, (0.30, 0.08, 0.02), (1.0, 0.50, 0.16))
    looks.finish(nodes, warm, 0.9, glow=1.5)
    return material
