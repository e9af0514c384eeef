"""A stereo shot with known truth: the street seen by two cameras, in the layouts of writers."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tests.cli.shots import blender_passes
from tests.cli.street import Street
from tests.stereo_layouts import LAYOUTS, Planes

APART = 0.6
"""How far to the right the right eye is, in the street's units: some pixels at the box."""


@dataclass(frozen=True)
class Eye(Street):
    """The street seen from a little to the right of the camera."""

    shift: float = 0.0

    def _camera(self, time: float) -> tuple[np.ndarray, np.ndarray]:
        centre, turn = super()._camera(time)
        return centre + turn @ [self.shift, 0, 0], turn


EYES = {"left": Eye(), "right": Eye(shift=APART)}


def eyes_at(time: float) -> dict[str, Planes]:
    """Return Blender's passes of both eyes, by view and name."""
    return {
        view: {name: plane for group in blender_passes(eye, time) for name, plane in group.items()}
        for view, eye in EYES.items()
    }


def write_stereo(folder: Path, layout: str, numbers: Iterable[int] = (1, 2, 3)) -> Path:
    """Write frames of a layout, at times 0, 1, 2 …"""
    folder.mkdir(parents=True)
    for time, number in enumerate(numbers):
        LAYOUTS[layout](folder / f"shot.{number:04d}.exr", eyes_at(time), number)
    return folder


def arguments(folder: Path, layout: str) -> tuple[str, tuple[str, ...]]:
    """Return the sequence and the texts of --aov by which a layout is read."""
    if layout == "folders":
        return str(folder / "%V" / "shot_%v.####.exr"), ()
    if layout == "aovs":
        more = [f"{role}={folder / 'more'}" for role in ("normal", "position", "stencil")]
        vectors = f"motion={folder / 'mv' / 'mv.####.exr'}:X,Y,Z,W"
        return str(folder / "colour"), (vectors, f"depth={folder / 'z'}", *more)
    return str(folder), ()
