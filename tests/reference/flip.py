"""FLIP and HDR-FLIP as their papers define them, in float64, by whole images.

Andersson et al., "FLIP: A Difference Evaluator for Alternating Images" (2020), and Andersson et
al., "Visualizing Errors in Rendered High Dynamic Range Images" (2021); filters in one dimension and
edges repeated, as in the authors' C++.
"""

from __future__ import annotations

import numpy as np

PPD = 0.7 * (3840 / 0.7) * np.pi / 180
TO_XYZ = np.array(
    [
        [10135552 / 24577794, 8788810 / 24577794, 4435075 / 24577794],
        [2613072 / 12288897, 8788810 / 12288897, 887015 / 12288897],
        [1425312 / 73733382, 8788810 / 73733382, 70074185 / 73733382],
    ]
)
WHITE = TO_XYZ.sum(axis=1)
RADIUS = int(np.ceil(3 * np.sqrt(0.04 / (2 * np.pi**2)) * PPD))
SIGMA = 0.5 * 0.082 * PPD


def convolve(plane: np.ndarray, down: np.ndarray, along: np.ndarray) -> np.ndarray:
    radius = len(down) // 2
    padded = np.pad(plane, radius, mode="edge")
    height, width = plane.shape
    lines = sum(w * padded[k : k + height] for k, w in enumerate(down))
    return sum(w * lines[:, k : k + width] for k, w in enumerate(along))


def opponent(linear: np.ndarray) -> tuple[np.ndarray, ...]:
    x, y, z = np.moveaxis(linear @ TO_XYZ.T / WHITE, -1, 0)
    return 116 * y - 16, 500 * (x - y), 200 * (y - z)


def linear_colour(y: np.ndarray, cx: np.ndarray, cz: np.ndarray) -> np.ndarray:
    y = (y + 16) / 116
    xyz = np.stack([y + cx / 500, y, y - cz / 200], axis=-1) * WHITE
    return xyz @ np.linalg.inv(TO_XYZ).T


def hunt_lab(linear: np.ndarray) -> tuple[np.ndarray, ...]:
    xyz = linear @ TO_XYZ.T / WHITE
    toe = xyz * (29 / 6) ** 2 / 3 + 4 / 29
    x, y, z = np.moveaxis(np.where(xyz > (6 / 29) ** 3, np.cbrt(xyz), toe), -1, 0)
    lightness = 116 * y - 16
    return lightness, 0.01 * lightness * 500 * (x - y), 0.01 * lightness * 200 * (y - z)


def gaussian(b: float) -> np.ndarray:
    x = np.arange(-RADIUS, RADIUS + 1) / PPD
    return np.exp(-(np.pi**2) * x**2 / b)


def blurred(opponents: tuple[np.ndarray, ...]) -> np.ndarray:
    y, cx, cz = opponents
    bright, red_green = gaussian(0.0047), gaussian(0.0053)
    pair = [(a * np.sqrt(np.pi / b), gaussian(b)) for a, b in ((34.1, 0.04), (13.5, 0.025))]
    volume = sum(a * g.sum() ** 2 for a, g in pair)
    linear = linear_colour(
        convolve(y, bright, bright) / bright.sum() ** 2,
        convolve(cx, red_green, red_green) / red_green.sum() ** 2,
        sum(a * convolve(cz, g, g) for a, g in pair) / volume,
    )
    return np.clip(linear, 0, 1)


def features(y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    radius = int(np.ceil(3 * SIGMA))
    x = np.arange(-radius, radius + 1)
    bell = np.exp(-(x**2) / (2 * SIGMA**2))
    found = []
    for weights in (-x * bell, (x**2 / SIGMA**2 - 1) * bell):
        positive, negative = weights[weights > 0].sum(), -weights[weights < 0].sum()
        scaled = np.where(weights > 0, weights / positive, weights / negative)
        grey, even = (y + 16) / 116, bell / bell.sum()
        found.append(np.hypot(convolve(grey, even, scaled), convolve(grey, scaled, even)))
    return found[0], found[1]


def distance(one: tuple[np.ndarray, ...], other: tuple[np.ndarray, ...]) -> np.ndarray:
    lightness, a, b = (p - q for p, q in zip(one, other, strict=True))
    return (np.abs(lightness) + np.hypot(a, b)) ** 0.7


def flip(reference: np.ndarray, test: np.ndarray) -> np.ndarray:
    """Error of linear colours, 0 to 1."""
    opponents = opponent(reference), opponent(test)
    colour = distance(*(hunt_lab(blurred(each)) for each in opponents))
    largest = distance(*(hunt_lab(np.array(c, np.float64)) for c in ((0, 1, 0), (0, 0, 1))))
    bend = 0.4 * largest
    above = 0.95 + (colour - bend) / (largest - bend) * 0.05
    colour = np.where(colour < bend, colour * 0.95 / bend, above)
    (edge, point), (edge_of_test, point_of_test) = (features(each[0]) for each in opponents)
    apart = np.maximum(np.abs(edge - edge_of_test), np.abs(point - point_of_test))
    return colour ** (1 - np.sqrt(apart / np.sqrt(2)))


def ldr_flip(reference: np.ndarray, test: np.ndarray) -> np.ndarray:
    """Error of display-encoded colours, 0 to 255."""
    linear = []
    for image in (reference, test):
        v = image.astype(np.float64) / 255
        linear.append(np.where(v <= 0.04045, v / 12.92, ((v + 0.055) / 1.055) ** 2.4))
    return flip(*linear)


def aces(colour: np.ndarray) -> np.ndarray:
    x = 0.6 * colour
    return np.clip(x * (2.51 * x + 0.03) / (x * (2.43 * x + 0.59) + 0.14), 0, 1)


def exposures(reference: np.ndarray) -> np.ndarray:
    luminance = np.sort((reference @ np.array([0.2126, 0.7152, 0.0722])).ravel())
    median = max(luminance[luminance.size // 2], 2.0**-23)
    a, b, c = 2.51 - 0.85 * 2.43, 0.03 - 0.85 * 0.59, -0.85 * 0.14
    saturated = (-b + np.sqrt(b * b - 4 * a * c)) / (2 * a) / 0.6
    start, stop = np.log2(saturated / luminance[-1]), np.log2(saturated / median)
    return np.linspace(start, stop, max(2, int(np.ceil(stop - start))))


def hdr_flip(reference: np.ndarray, test: np.ndarray) -> np.ndarray:
    """Error of scene-linear colours, 0 or more."""
    pair = [image.astype(np.float64) for image in (reference, test)]
    maps = [flip(*(aces(c * 2.0**stops) for c in pair)) for stops in exposures(pair[0])]
    return np.max(maps, axis=0)
