"""Two dozen patterns for surfaces, each with random proportions."""

from __future__ import annotations

import math
import random
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from stage.looks import Colour, Nodes


@dataclass(frozen=True)
class Pick:
    """What a pattern is made with: chance, colours, the size of its features in metres,
    and the surface's coordinates."""

    nodes: Nodes
    chance: random.Random
    colours: tuple[Colour, ...]
    size: float
    spread: Any

    def noise(self, where: Any, scale: float, detail: float) -> Any:
        """Return flat noise around 0.5."""
        return noise(self.nodes, where, scale, detail)

    def flat(self, wide: float = 1.0, turned: bool = True) -> Any:
        """Surface coordinates in units of the features, `wide` times longer along one axis."""
        angle = self.chance.choice((0.0, 0.0, math.pi / 2, self.chance.uniform(0, math.pi)))
        return self.nodes.add(
            "Mapping",
            {
                0: self.spread,
                1: (self.chance.uniform(0, 9), self.chance.uniform(0, 9), 0.37),
                2: (0.0, 0.0, angle if turned else 0.0),
                3: (1 / (wide * self.size), 1 / self.size, 1.0),
            },
        ).outputs[0]

    def axes(self, wide: float = 1.0, turned: bool = True) -> Any:
        """Return the coordinates of `flat` one by one."""
        return self.nodes.add("SeparateXYZ", {0: self.flat(wide, turned)}).outputs

    def cells(self, feature: str, wide: float = 1.0, randomness: float = 1.0) -> Any:
        """Return the outputs of a flat Voronoi texture."""
        inputs = {"Vector": self.flat(wide), "Scale": 1.0, "Randomness": randomness}
        node = self.nodes.add("TexVoronoi", inputs, feature=feature, voronoi_dimensions="2D")
        return node.outputs

    def three(self, value: Any, first: float, second: float) -> Any:
        """Mix three colours over a value's range."""
        step = self.nodes.step
        low = self.nodes.mix(step(value, first - 0.06, first), self.colours[0], self.colours[1])
        return self.nodes.mix(step(value, second - 0.04, second), low, self.colours[2])


Pattern = Callable[[Pick], tuple[Any, Any]]
"""Returns a colour and, for patterns with relief, a height, or None."""


def noise(nodes: Nodes, where: Any, scale: float, detail: float) -> Any:
    """Return noise over two coordinates, for half the time that three take."""
    inputs = {"Vector": where, "Scale": scale, "Detail": min(detail, 2.0)}
    return nodes.add("TexNoise", inputs, noise_dimensions="2D").outputs[0]


def surface(nodes: Nodes) -> Any:
    """Coordinates that suit the way a face lies: (x, y) on level ones, (x + y, z) on others."""
    spot = nodes.spot()
    normal = nodes.add("TexCoord", {}).outputs["Normal"]
    upward = nodes.math("ABSOLUTE", nodes.add("SeparateXYZ", {0: normal}).outputs[2])
    level = nodes.math("GREATER_THAN", upward, 0.71)
    return nodes.add("Mix", {0: level, 4: nodes.wall(), 5: spot}, data_type="VECTOR").outputs[1]


def _stripes(pick: Pick) -> tuple[Any, Any]:
    place = pick.nodes.math("FRACT", pick.axes()[0])
    narrow, wide = sorted(pick.chance.uniform(0.15, 0.9) for _ in range(2))
    first = pick.nodes.math("LESS_THAN", place, narrow)
    second = pick.nodes.math("GREATER_THAN", place, wide)
    shade = pick.nodes.mix(first, pick.colours[0], pick.colours[1])
    return pick.nodes.mix(second, shade, pick.colours[2]), None


def _dots(pick: Pick) -> tuple[Any, Any]:
    math_of, axes = pick.nodes.math, pick.axes()
    row = math_of("MULTIPLY", math_of("FLOOR", axes[1]), pick.chance.choice((0.0, 0.5)))
    x = math_of("SUBTRACT", math_of("FRACT", math_of("ADD", axes[0], row)), 0.5)
    y = math_of("SUBTRACT", math_of("FRACT", axes[1]), 0.5)
    away = math_of("ADD", math_of("MULTIPLY", x, x), math_of("MULTIPLY", y, y))
    radius = pick.chance.uniform(0.2, 0.45)
    dot = math_of("LESS_THAN", away, radius**2)
    inner = math_of("LESS_THAN", away, (radius * pick.chance.uniform(0, 0.8)) ** 2)
    shade = pick.nodes.mix(dot, pick.colours[0], pick.colours[1])
    return pick.nodes.mix(inner, shade, pick.colours[2]), None


def _checks(pick: Pick) -> tuple[Any, Any]:
    inputs = {"Vector": pick.flat(pick.chance.choice((1, 1, 1.6))), "Scale": 1.0}
    inputs |= {"Color1": pick.colours[0], "Color2": pick.colours[1]}
    return pick.nodes.add("TexChecker", inputs).outputs[0], None


def _masonry(pick: Pick, wide: float, offset: float, joint: float) -> tuple[Any, Any]:
    inputs = {"Vector": pick.flat(turned=wide < 1.5), "Scale": 1.0, "Mortar Smooth": 0.1}
    inputs |= dict(zip(("Color1", "Color2", "Mortar"), pick.colours, strict=False))
    inputs |= {"Brick Width": wide, "Row Height": 1.0, "Mortar Size": joint}
    node = pick.nodes.add("TexBrick", inputs, offset=offset)
    height = pick.nodes.math("SUBTRACT", 1.0, node.outputs[1])
    return node.outputs[0], height if pick.chance.random() < 0.15 else None


def _bricks(pick: Pick) -> tuple[Any, Any]:
    return _masonry(pick, pick.chance.uniform(1.6, 3.2), 0.5, pick.chance.uniform(0.04, 0.12))


def _tiles(pick: Pick) -> tuple[Any, Any]:
    return _masonry(pick, 1.0, pick.chance.choice((0.0, 0.0, 0.33)), 0.035)


def _planks(pick: Pick) -> tuple[Any, Any]:
    shade, _ = _masonry(pick, pick.chance.uniform(5, 12), 0.37, 0.03)
    grain = pick.noise(pick.flat(9.0, turned=False), 5.0, 2.0)
    dark = tuple(0.35 * part for part in pick.colours[0])
    return pick.nodes.mix(pick.nodes.step(grain, 0.35, 0.75), shade, dark), None


def _marble(pick: Pick) -> tuple[Any, Any]:
    inputs = {"Vector": pick.flat(), "Scale": 0.5, "Detail": 2.0}
    inputs["Distortion"] = pick.chance.uniform(0.6, 2.5)
    cloud = pick.nodes.add("TexNoise", inputs, noise_dimensions="2D").outputs[0]
    vein = pick.nodes.math("SUBTRACT", cloud, 0.5)
    vein = pick.nodes.step(pick.nodes.math("ABSOLUTE", vein), 0.0, 0.12)
    return pick.nodes.mix(vein, pick.colours[1], pick.colours[0]), None


def _rust(pick: Pick) -> tuple[Any, Any]:
    spread = pick.noise(pick.flat(), 1.3, 3.0)
    grain = pick.noise(pick.flat(), 9.0, 2.0)
    rust = pick.nodes.mix(grain, (0.10, 0.03, 0.015), (0.62, 0.24, 0.07))
    edge = pick.chance.uniform(0.4, 0.6)
    return pick.nodes.mix(pick.nodes.step(spread, edge, edge + 0.08), pick.colours[0], rust), None


def _cracks(pick: Pick) -> tuple[Any, Any]:
    edge = pick.nodes.step(pick.cells("DISTANCE_TO_EDGE")["Distance"], 0.015, 0.06)
    patch = pick.nodes.step(pick.noise(pick.flat(), 0.8, 2.0), 0.45, 0.5)
    shade = pick.nodes.mix(patch, pick.colours[0], pick.colours[1])
    return pick.nodes.mix(edge, tuple(0.25 * c for c in pick.colours[2]), shade), None


def _weave(pick: Pick) -> tuple[Any, Any]:
    axes, math_of = pick.axes(), pick.nodes.math
    waves = [math_of("ABSOLUTE", math_of("SINE", math_of("MULTIPLY", a, 6.3))) for a in axes[:2]]
    over = math_of("GREATER_THAN", waves[0], waves[1])
    shade = pick.nodes.mix(over, pick.colours[0], pick.colours[1])
    light = math_of("MAXIMUM", waves[0], waves[1])
    return pick.nodes.mix(pick.nodes.step(light, 0.3, 1.0), pick.colours[2], shade), None


def _gravel(pick: Pick) -> tuple[Any, Any]:
    cells = pick.cells("F1")
    tone = pick.nodes.add("SeparateColor", {0: cells["Color"]}).outputs[0]
    shade = pick.nodes.mix(tone, pick.colours[0], pick.colours[1])
    dome = pick.nodes.step(cells["Distance"], 0.62, 0.2)
    return pick.nodes.mix(dome, tuple(0.3 * c for c in pick.colours[0]), shade), None


def _litter(pick: Pick) -> tuple[Any, Any]:
    cells = pick.cells("F1", pick.chance.uniform(1.5, 3.5))
    tone = pick.nodes.add("SeparateColor", {0: cells["Color"]}).outputs
    shade = pick.three(tone[0], 0.4, 0.75)
    return pick.nodes.mix(0.45, shade, tuple(0.2 * c for c in pick.colours[1])), None


def _terrazzo(pick: Pick) -> tuple[Any, Any]:
    cells = pick.cells("F1")
    chips = pick.nodes.math("LESS_THAN", cells["Distance"], pick.chance.uniform(0.25, 0.4))
    tone = pick.nodes.add("SeparateColor", {0: cells["Color"]}).outputs[1]
    return pick.nodes.mix(
        chips, pick.colours[0], pick.nodes.mix(tone, pick.colours[1], pick.colours[2])
    ), None


def _brushed(pick: Pick) -> tuple[Any, Any]:
    grain = pick.noise(pick.flat(pick.chance.uniform(15, 50)), 4.0, 2.0)
    return pick.nodes.mix(pick.nodes.step(grain, 0.3, 0.7), pick.colours[0], pick.colours[1]), None


def _gradient(pick: Pick) -> tuple[Any, Any]:
    wave = pick.nodes.math("PINGPONG", pick.axes()[0], 3.0)
    shade = pick.nodes.mix(pick.nodes.step(wave, 0.0, 3.0), pick.colours[0], pick.colours[1])
    grain = pick.noise(pick.flat(), 7.0, 2.0)
    return pick.nodes.mix(pick.nodes.step(grain, 0.5, 0.8), shade, pick.colours[2]), None


def _fine(pick: Pick) -> tuple[Any, Any]:
    grain = pick.noise(pick.flat(), pick.chance.uniform(2, 6), 3.0)
    return pick.three(grain, pick.chance.uniform(0.4, 0.5), pick.chance.uniform(0.52, 0.65)), None


def _blobs(pick: Pick) -> tuple[Any, Any]:
    return pick.three(pick.noise(pick.flat(), 0.9, 1.0), 0.45, 0.58), None


def _rings(pick: Pick) -> tuple[Any, Any]:
    inputs = {"Vector": pick.flat(), "Scale": pick.chance.uniform(0.1, 0.3), "Detail": 1.0}
    inputs["Distortion"] = pick.chance.choice((0.0, 2.0, 5.0))
    wave = pick.nodes.add("TexWave", inputs, wave_type="RINGS").outputs[1]
    return pick.three(wave, 0.35, 0.8), None


def _zigzag(pick: Pick) -> tuple[Any, Any]:
    axes, math_of = pick.axes(), pick.nodes.math
    bend = math_of("MULTIPLY", math_of("PINGPONG", axes[0], 0.5), pick.chance.uniform(0.7, 2))
    return pick.three(math_of("FRACT", math_of("ADD", axes[1], bend)), 0.35, 0.7), None


def _print(pick: Pick) -> tuple[Any, Any]:
    """Rows of marks of random lengths, as of a printed page seen from afar."""
    axes, math_of = pick.axes(pick.chance.uniform(0.4, 0.9), turned=False), pick.nodes.math
    row = math_of("FLOOR", axes[1])
    mark = math_of("FLOOR", math_of("MULTIPLY", axes[0], 1.7))
    cell = pick.nodes.add("CombineXYZ", {0: mark, 1: row}).outputs[0]
    ink = pick.nodes.add("TexWhiteNoise", {"Vector": cell}, noise_dimensions="2D").outputs[0]
    line = math_of("LESS_THAN", math_of("FRACT", axes[1]), 0.62)
    inked = math_of("MULTIPLY", line, math_of("GREATER_THAN", ink, 0.3))
    coloured = pick.nodes.mix(math_of("GREATER_THAN", ink, 0.93), pick.colours[1], pick.colours[2])
    return pick.nodes.mix(inked, pick.colours[0], coloured), None


def _stains(pick: Pick) -> tuple[Any, Any]:
    patch = pick.nodes.step(pick.noise(pick.flat(), 0.5, 3.0), 0.4, 0.62)
    shade = pick.nodes.mix(patch, pick.colours[0], pick.colours[1])
    streak = pick.nodes.step(pick.noise(pick.flat(0.25, False), 0.9, 2.0), 0.5, 0.75)
    dark = tuple(0.45 * part for part in pick.colours[0])
    return pick.nodes.mix(pick.nodes.math("MULTIPLY", streak, 0.7), shade, dark), None


PATTERNS: tuple[Pattern, ...] = (
    _stripes, _dots, _checks, _bricks, _tiles, _planks, _marble, _rust, _cracks, _weave,
    _gravel, _litter, _terrazzo, _brushed, _gradient, _fine, _blobs, _rings, _zigzag, _print,
    _stains,
)  # fmt: skip
OF_ROLE: dict[str, tuple[Pattern, ...]] = {
    "any": PATTERNS,
    "ground": (_tiles, _gravel, _stains, _cracks, _fine, _bricks, _planks, _litter),
    "soil": (_gravel, _litter, _fine, _litter, _stains, _blobs),
    "floor": (_tiles, _checks, _planks, _terrazzo, _marble, _zigzag, _fine, _weave),
    "wall": (_bricks, _stains, _planks, _tiles, _cracks, _stripes, _gradient, _fine, _marble),
    "print": (_print, _print, _blobs, _stripes, _zigzag),
    "metal": (_brushed, _fine, _stains, _rust, _brushed, _gradient, _stripes),
    "leaf": (_fine, _blobs, _brushed),
    "bark": (_brushed, _cracks, _fine),
}
