"""How clean a scene is rendered; this module does without Blender."""

from __future__ import annotations

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
    careful : bool
        Whether all lights are sampled by their share (Cycles' light tree), and the denoiser
        cleans its guides, albedo and normals, at full quality first.
    """

    samples: int
    seeds: int
    careful: bool

    @property
    def total(self) -> int:
        """Samples of all renders of a frame."""
        return self.samples * self.seeds

    @property
    def denoiser(self) -> str:
        """Name of the denoiser, and how it is set up where that is not the quick way."""
        return "OpenImageDenoise" + (", accurate albedo and normal guides" if self.careful else "")


HURRIED = Quality(samples=16, seeds=1, careful=False)
"""As a hurried artist delivers; also the setting of training shots."""

MOST_SEEDS = 48
"""So many renders of a frame have noise that no other render of the scene has."""
