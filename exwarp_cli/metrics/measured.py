"""What every metric returns: an error or similarity per pixel, and how it becomes one number."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from exwarp_cli.domain.frame import Bool


@dataclass(frozen=True)
class Measured:
    """A metric's map for one pair of images.

    Attributes
    ----------
    per_pixel
        float [H, W], finite: what is averaged.
    margin
        Pixels left out at every edge when all pixels are averaged; a mask's pixels all count.
    finish
        Turns the average into the metric's value.
    """

    per_pixel: npt.NDArray[np.floating]
    margin: int = 0
    finish: Callable[[float], float] = float

    def overall(self) -> float:
        """Value over all pixels."""
        height, width = self.per_pixel.shape
        m = self.margin
        inner = self.per_pixel[m : height - m, m : width - m]
        return self.finish(float(inner.mean(dtype=np.float64)))

    def within(self, mask: Bool) -> float:
        """Value over the pixels where `mask`, bool [H, W], is true; at least one must be."""
        return self.finish(float(self.per_pixel[mask].mean(dtype=np.float64)))
