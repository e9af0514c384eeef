"""Rendered scenes for training and judging, as their manifests describe them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

BENCHMARK, TRAINING = "benchmark", "training"
ROLES = (BENCHMARK, TRAINING)


@dataclass(frozen=True)
class FrameSet:
    """Numbered frames of one rate.

    Attributes
    ----------
    pattern
        Path relative to the scene's folder, with ``#`` for digits.
    first, count
        Number of the first frame, and how many there are; numbered in steps of one.
    step
        How far apart they are, in instants.
    """

    pattern: str
    first: int
    count: int
    step: int = 1

    @property
    def numbers(self) -> range:
        """All frame numbers."""
        return range(self.first, self.first + self.count)


@dataclass(frozen=True)
class SceneManifest:
    """What one folder of a data set holds.

    Attributes
    ----------
    scene
        Name, unique in a data set.
    role
        "benchmark" (judged on, and only ever trained on when another one is judged) or
        "training" (never judged on).
    about
        One sentence.
    width, height
        Pixels.
    fps, key_fps
        Rate of the instants, and of the key frames.
    instants
        Colour and G-buffers of every instant; motion vectors reach to the neighbouring instants.
    keys
        Every `keys.step`-th instant again, as a key frame: motion vectors reach over 1/`key_fps`.
    renderer
        Program, version and engine.
    samples, denoiser
        Per pixel; and the denoiser's name, or "".
    seed
        Of the scene and of the noise.
    motion
        What the motion channels mean, in the notation of ``--motion``.
    dynamic
        What the object ids stand for; 0, all that stands still, is not listed.
    """

    scene: str
    role: str
    about: str
    width: int
    height: int
    fps: int
    key_fps: int
    instants: FrameSet
    keys: FrameSet
    renderer: str
    samples: int
    denoiser: str
    seed: int
    motion: str
    dynamic: Mapping[int, str]

    @property
    def size(self) -> str:
        """Width and height as text, "427x240"."""
        return f"{self.width}x{self.height}"

    def has_key(self, index: int) -> bool:
        """Whether an instant, counted from 0, was also rendered as a key frame."""
        whole, beyond = divmod(index, self.keys.step)
        return beyond == 0 and 0 <= whole < self.keys.count
