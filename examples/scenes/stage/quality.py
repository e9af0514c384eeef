"""How clean a scene is rendered, by either engine; this module does without Blender."""

from __future__ import annotations

import math
import sys
from dataclasses import dataclass


@dataclass(frozen=True)
class Quality:
    """What decides how much noise is left in a frame.

    Attributes
    ----------
    samples : int
        Per pixel of each render.
    seeds : int
        Renders of a frame, each with its own noise and denoised. Their mean is the frame.
    accurate : bool
        Whether the denoiser cleans its guides, albedo and normals, at full quality first. Measured
        in slum at 16 samples: 0.2 dB less noise for 1.5 core-s.
    light_tree : bool
        Whether lights are sampled by their share. Measured at equal samples: 1.4 dB less noise in
        slum and 0.8 dB in town for a tenth of the time; lab is slower by a third for 0.4 dB.
    clamp : float
        Bound of a sample's direct light, 0 for none. Bright lamps are noisy at their edges and in
        glossy things. A bound of 2 takes 1.4 dB off in lab, and the display shows nothing above 1.
    """

    samples: int
    seeds: int
    accurate: bool = True
    light_tree: bool = True
    clamp: float = 0.0

    @property
    def total(self) -> int:
        """Samples of all renders of a frame."""
        return self.samples * self.seeds

    @property
    def denoiser(self) -> str:
        """Name of the denoiser, and how it is set up where that is not the quick way."""
        return "OpenImageDenoise" + (", accurate albedo and normal guides" if self.accurate else "")

    @property
    def sampling(self) -> str:
        """What differs from the quick way of sampling, or ""."""
        parts = ["light tree"] if self.light_tree else []
        if self.clamp:
            parts.append(f"direct light clamped at {self.clamp:g}")
        return ", ".join(parts)


@dataclass(frozen=True)
class Raster:
    """How finely a scene is rendered with EEVEE.

    Attributes
    ----------
    samples : int
        Per pixel: a grid with one at the centre, so the square of an odd number, or 4 times that,
        where each point of the grid gets four samples of EEVEE's own.
    seeds : int
        Always 1: EEVEE's noise is the same in every render.
    """

    samples: int
    seeds: int = 1

    @property
    def own(self) -> int:
        """EEVEE's own samples at each point of the grid."""
        return 1 if self.samples % 4 else 4

    @property
    def grid(self) -> int:
        """Samples along each side of a pixel.

        Raises
        ------
        SystemExit
            With one sentence, if the samples form no such grid.
        """
        side = math.isqrt(self.samples // self.own)
        if side * side * self.own != self.samples or side % 2 == 0 or self.seeds != 1:
            sys.exit(
                "An EEVEE scene takes --samples 1, 9, 25 or the square of another odd number, or "
                f"4 times that, and --renders 1; not {self.samples} and {self.seeds}."
            )
        return side

    @property
    def total(self) -> int:
        """Samples of a frame."""
        return self.samples

    @property
    def denoiser(self) -> str:
        """Name of the denoiser; there is none."""
        return ""

    @property
    def sampling(self) -> str:
        """What a frame consists of."""
        own = f" of {self.own}" if self.own > 1 else ""
        grid = f"grid of {self.grid} x {self.grid} samples{own}"
        return f"{grid}, raster shadows, screen-space reflections"


HURRIED = Quality(samples=16, seeds=1, accurate=False, light_tree=False)
"""As a hurried artist delivers."""

TRAINING = Quality(samples=16, seeds=1, clamp=2.0)
"""Of one render of a training shot's frame; as many are averaged as its noise needs. The bound is
worth 0.5 to 1.1 dB on three shots, and accurate guides 0.6 to 1.4 dB on five, for a fifth of the
time."""

HURRIED_RASTER = Raster(samples=36)
"""As a game delivers; also the setting of training shots. Without samples of EEVEE's own nothing
that was lit is reflected: 9 are 24 dB from 100 in a room with a metal crate."""

MOST_SEEDS = 48
"""So many renders of a frame have noise that no other render of the scene has."""
