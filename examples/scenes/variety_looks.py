"""Random procedural materials with colours, sizes and finishes that suit one shot."""

from __future__ import annotations

import colorsys
import math
import random
from typing import Any

from stage import looks
from stage.blender import bpy
from stage.looks import Colour, Nodes
from variety_patterns import OF_ROLE, PATTERNS, Pick, noise, surface
from variety_things import Stock, paint_texture

Material = bpy.types.Material


class Wardrobe:
    """The materials of one shot: they share a scheme of hues.

    Attributes
    ----------
    chance : random.Random
        Of the shot.
    unit : float
        Size of a texture's features, metres, where nothing else is asked for.
    stock : Stock or None
        From which textures come beside the patterns.
    is_wet : bool
        Whether floors and ground mirror.
    """

    def __init__(
        self,
        chance: random.Random,
        unit: float,
        stock: Stock | None = None,
        is_wet: bool = False,
    ) -> None:
        self.chance = chance
        self.unit = unit
        self.stock, self.is_wet = stock, is_wet
        self._first = chance.random()
        spread = chance.choice((0.1, 0.3, 0.5, 0.5, 0.5))
        self._hues = [self._first + chance.uniform(-spread, spread) for _ in range(5)]
        self._lively = chance.choice((0.2, 0.4, 0.6, 0.9))

    def colour(self, role: str = "any") -> Colour:
        """Draw a colour of the scheme, scene-linear."""
        chance = self.chance
        if role in ("leaf", "grass"):
            hue, strong = chance.gauss(0.27, 0.06), chance.uniform(0.5, 0.95)
            return colorsys.hsv_to_rgb(hue % 1, strong, chance.uniform(0.06, 0.5))
        if role in ("bark", "soil"):
            return colorsys.hsv_to_rgb(
                chance.uniform(0.04, 0.13), chance.uniform(0.15, 0.7), chance.uniform(0.08, 0.5)
            )
        hue = chance.choice(self._hues) if chance.random() < 0.6 else chance.random()
        bright = chance.uniform(0.04, 0.9) ** 1.2
        if role == "metal":
            hue, bright = chance.choice((0.08, 0.12, 0.6, hue)), chance.uniform(0.5, 0.95)
        strong = min(1.0, abs(chance.gauss(0, 1)) * self._lively)
        return colorsys.hsv_to_rgb(hue % 1, strong * (0.5 if role == "metal" else 1), bright)

    def look(self, role: str = "any", unit: float | None = None) -> Material:
        """Make a material: a pattern of the role in matte, glossy or metallic finish."""
        chance = self.chance
        metal = role == "metal" or (role == "any" and chance.random() < 0.25)
        kind = "metal" if metal else role
        material, nodes = looks.new(role)
        size = (unit or self.unit) * math.exp(chance.uniform(math.log(0.07), math.log(0.6)))
        colours = [self.colour(kind) for _ in range(3)]
        if abs(sum(colours[0]) - sum(colours[1])) < 0.35:
            colours[1] = tuple(0.3 * part for part in colours[0])
        pattern = chance.choice(OF_ROLE.get(kind, PATTERNS))
        spread = surface(nodes)
        pick = Pick(nodes, chance, tuple(colours), size, spread)
        shade, height = self._texture(role, pick) or pattern(pick)
        if chance.random() < 0.45:
            dirt = noise(nodes, spread, chance.uniform(0.3, 1.5) / size, 1.0)
            dark = tuple(0.3 * part for part in colours[0])
            shade = nodes.mix(nodes.step(dirt, 0.45, 0.8), shade, dark)
        rough = chance.uniform(0.06, 0.45) if metal else self._roughness(role)
        if self.is_wet and role in ("floor", "ground", "soil"):
            rough = self._wet(nodes, spread, size)
        normal = None if height is None else nodes.bump(height)
        looks.finish(nodes, shade, rough, 1.0 if metal else 0.0, normal)
        return material

    def _texture(self, role: str, pick: Pick) -> tuple[Any, None] | None:
        """Return the colour of a real texture, by chance; its tiles are wider than features."""
        found = self.stock.texture(role) if self.stock is not None else None
        if found is None:
            return None
        size = max(pick.size * 4, 0.25 * self.unit)
        where = pick.nodes.add("Mapping", {0: pick.spread, 3: (1 / size, 1 / size, 1.0)})
        return paint_texture(pick.nodes, where.outputs[0], found), None

    def _wet(self, nodes: Nodes, spread: Any, size: float) -> Any:
        """Return a low roughness: everywhere, or in puddles."""
        low = self.chance.uniform(0.02, 0.12)
        if self.chance.random() < 0.5:
            return low
        pools = nodes.step(noise(nodes, spread, 0.25 / size, 1.0), 0.42, 0.55)
        return nodes.math("SUBTRACT", 0.75, nodes.math("MULTIPLY", pools, 0.75 - low))

    def _roughness(self, role: str) -> float:
        shiny = {"floor": 0.55, "any": 0.35, "ground": 0.15}.get(role, 0.1)
        if self.chance.random() < shiny:
            return self.chance.uniform(0.04, 0.3)
        return self.chance.uniform(0.45, 1.0)

    def suit(self, unit: float | None = None, role: str = "any") -> list[Material]:
        """Make four materials that are worn together: two large ones, a metal, a plain one."""
        return [
            self.look(role, unit),
            self.look(role, unit),
            self.look("metal", unit),
            self.plain(self.colour(), self.chance.uniform(0.1, 0.9), 0.0),
        ]

    def plain(self, colour: Colour, roughness: float, metallic: float) -> Material:
        """Make a paint or a bare metal with a few stains."""
        material, nodes = looks.new("plain")
        stain = nodes.step(noise(nodes, surface(nodes), 6.0, 1.0), 0.4, 0.7)
        worn = tuple(0.6 * part for part in colour)
        looks.finish(nodes, nodes.mix(stain, colour, worn), roughness, metallic)
        return material

    def mirror(self) -> Material:
        """Make a mirror, clean or a little blind."""
        tint = tuple(self.chance.uniform(0.75, 0.95) for _ in range(3))
        return self.plain(tint, self.chance.choice((0.0, 0.02, 0.06)), 1.0)

    def glass(self) -> Material:
        """Make a clear or tinted pane that shows what is behind it, and reflects."""
        hue, strong = self.chance.random(), self.chance.choice((0.0, 0.1, 0.5))
        tint = colorsys.hsv_to_rgb(hue, strong, self.chance.uniform(0.3, 0.9))
        material, nodes = looks.new("glass")
        shader = looks.finish(nodes, tint, self.chance.uniform(0.0, 0.15))
        shader.inputs["Alpha"].default_value = self.chance.uniform(0.12, 0.65)
        return material

    def water(self) -> Material:
        """Make water with ripples."""
        material, nodes = looks.new("water")
        chance = self.chance
        spot = nodes.add("Mapping", {0: nodes.spot(), 3: (1.0, chance.uniform(1, 3), 1.0)})
        ripples = noise(nodes, spot.outputs[0], chance.uniform(0.8, 3.0), 2.0)
        deep = colorsys.hsv_to_rgb(chance.uniform(0.3, 0.62), 0.7, chance.uniform(0.02, 0.12))
        looks.finish(nodes, deep, chance.uniform(0.03, 0.12), normal=nodes.bump(ripples))
        return material

    def glow(self, strength: float | None = None) -> Material:
        """Make something that shines, stronger than 1."""
        hue = self.chance.choice((0.08, 0.1, 0.55, self.chance.random()))
        colour = colorsys.hsv_to_rgb(hue, self.chance.uniform(0.1, 0.9), 1.0)
        power = strength or math.exp(self.chance.uniform(math.log(1.5), math.log(12)))
        material, nodes = looks.new("glow")
        looks.finish(nodes, colour, 0.5, glow=power)
        return material
