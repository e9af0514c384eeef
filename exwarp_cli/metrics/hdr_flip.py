"""HDR-FLIP: FLIP for images whose exposure a viewer may still choose.

Andersson, Nilsson, Shirley, Akenine-Möller, "Visualizing Errors in Rendered High Dynamic Range
Images", Eurographics 2021 (short papers). Both images are tone-mapped at several exposures, and the
largest FLIP error of each pixel counts. The numbers are those of the authors' own package.
"""

from __future__ import annotations

import math

import numpy as np

from exwarp_cli.domain.frame import Float32
from exwarp_cli.kernels.flip import differ
from exwarp_cli.kernels.flip_colour import PLANES, SATURATED, expose
from exwarp_cli.metrics.display import Measured
from exwarp_cli.metrics.flip import seen

BRIGHTEST = 65504.0
"""What counts as the brightest value: the largest half float, as EXR colour mostly is."""

DARK = 1e-6
"""Luminance below which a whole reference counts as black."""

LEAST_MEDIAN = np.float32(2.0**-23)
"""A median luminance below this, as of an image that is mostly black, counts as this."""

LUMINANCE = np.array([0.2126, 0.7152, 0.0722], np.float32)
"""Weights of Rec. 709 primaries."""


def usable(pixels: Float32) -> Float32:
    """Return colour as HDR-FLIP takes it: float32 [H, W, 3], finite, 0 to `BRIGHTEST`.

    NaN and negative values count as 0, infinities and what is brighter as `BRIGHTEST`; channels
    after the third are left out.
    """
    colour = np.nan_to_num(pixels[..., :3].astype(np.float32), nan=0.0, posinf=BRIGHTEST)
    return np.ascontiguousarray(np.clip(colour, 0, np.float32(BRIGHTEST)))


def exposures(reference: Float32) -> list[float]:
    """Return the exposures that a pair is compared at, in stops, ascending.

    From the one that brings the largest luminance to 0.85 of white to the one that does so with
    the median (the upper one, if there are two), in steps of a stop or a little more; section 3.

    Parameters
    ----------
    reference
        float32 [H, W, 3], as `usable` returns it.

    Returns
    -------
    list of float
        One, if both are the same; [0.0] for a black reference, which tells no exposure.
    """
    r, g, b = (reference[..., c] * LUMINANCE[c] for c in range(3))
    luminance = (r + g + b).ravel()
    largest = luminance.max()
    if largest < DARK:
        return [0.0]
    middle = luminance.size // 2
    median = max(np.partition(luminance, middle)[middle], LEAST_MEDIAN)
    # In float32 as the package has it, since near whole stops the last digit decides on the count;
    # numpy's own logarithm of float32 is not always the nearest one.
    start, stop = (np.float32(math.log2(SATURATED / value)) for value in (largest, median))
    if start == stop:
        return [float(start)]
    count = max(2, math.ceil(stop - start))
    return [float(value) for value in np.linspace(start, stop, count)]


def measure(reference: Float32, test: Float32) -> Measured:
    """Compare two scene-linear images, float32 [H, W, 3] or more, with any values.

    67 pixels per degree, ACES as the tone mapper, and the exposures of `exposures`: the package's
    defaults. A black reference is compared as it stands. The value is the mean of the error map,
    0 to 1.
    """
    images = usable(reference), usable(test)
    shape = reference.shape[:2]
    planes, error = np.empty((PLANES, *shape), np.float32), np.zeros(shape, np.float32)
    for stops in exposures(images[0]):
        views = []
        for image in images:
            expose(image, np.float32(2.0**stops), planes)
            views.append(seen(planes))
        differ(*views, error)
    return Measured(error)
