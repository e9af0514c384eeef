"""The shot on data windows that differ: from frame to frame, or from part to part."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import OpenEXR

from tests.blender_layers import Planes
from tests.cli import shots
from tests.cli.decisions.conftest import STREET, write_shots
from tests.cli.street import Street


def moving_shots(root: Path) -> dict[str, tuple[object, ...]]:
    """Write the shot on windows that change; the slots' are others than the key frames'."""
    key, colour = _moving(_key_planes, 0), _moving(shots.colour_planes, 0)
    return write_shots(root, key, colour, _moving(shots.slot_planes, 1))


def parted(path: Path, street: Street, time: float) -> None:
    """Colour in the middle of the frame, geometry all over it."""
    colour, *geometry = shots.blender_passes(street, time)
    whole = shots.window(0, 0, STREET.width, STREET.height)
    path.parent.mkdir(parents=True, exist_ok=True)
    cut = {name: plane[4:14, 6:26].copy() for name, plane in colour.items()}
    small = shots.header(dataWindow=shots.window(6, 4, 20, 10), displayWindow=whole)
    full = shots.header(dataWindow=whole, displayWindow=whole)
    made = [OpenEXR.Part(small, cut, "colour")]
    made += [OpenEXR.Part(dict(full), dict(p), next(iter(p)).split(".")[0]) for p in geometry]
    OpenEXR.File(made).write(str(path))


def _key_planes(street: Street, time: float) -> Planes:
    """All passes of a key frame in one part."""
    return {k: v for group in shots.blender_passes(street, time) for k, v in group.items()}


def _moving(planes_of: Callable[[Street, float], Planes], turn: int) -> shots.FrameWriter:
    """A writer of frames of which some reach beyond the display window, and some leave it empty."""

    def frame(path: Path, street: Street, time: float) -> None:
        x, y = (int(3 * time) + turn) % 5, (int(time) + turn) % 3
        planes = {
            name: (_filtered(v) if "Vector" in name else v)[y:17, x:31].copy()
            for name, v in planes_of(street, time).items()
        }
        place = shots.window(x - 3, y - 1, 31 - x, 17 - y)
        head = shots.header(dataWindow=place, displayWindow=shots.window(0, 0, 26, 15))
        shots.write(path, {"": planes}, head)

    return frame


def _filtered(plane: np.ndarray) -> np.ndarray:
    """Average neighbours, as renderers filter vectors; their own motion has to be settled."""
    around = np.pad(plane, 1, mode="edge")
    return (around[:-2, 1:-1] + around[2:, 1:-1] + around[1:-1, :-2] + around[1:-1, 2:]) / 4
