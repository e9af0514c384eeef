"""Looking at the truth: how good every choice in a key interval would be."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
import numpy.typing as npt

from exwarp_cli.domain.decision import CHOICES, EXTRAPOLATE, NODES, PATHS, SLOTS, WARP
from exwarp_cli.domain.frame import Float32, Window, place
from exwarp_cli.metrics.display import encode
from exwarp_cli.metrics.registry import METRICS
from exwarp_cli.policy.outcomes import METRICS as JUDGED
from exwarp_cli.synthesis.interval import Interval
from exwarp_cli.synthesis.methods import take

SAME = {("d4", WARP): ("d3", WARP), ("d5", EXTRAPOLATE): ("d4", EXTRAPOLATE)}
"""Choices that show the same frame as one of an earlier node: W(P2) after E(F), and E(P1)."""


def outcomes_of(
    interval: Interval,
    truth: Mapping[int, Float32],
    display: Window | None = None,
    as_written: Callable[[Float32], Float32] | None = None,
) -> npt.NDArray[np.float64]:
    """Make the frames of all choices of a key interval and measure them.

    Parameters
    ----------
    interval
        With its network.
    truth
        Ground truth of slots 1 to 3, float32 [H, W, 3] or more, scene-linear.
    display
        The window of the truth; None for the interval's own.
    as_written
        Rounds pixels to what a file keeps of them; None to measure them as they are made.

    Returns
    -------
    float64 [5, 2, 2]
        As `exwarp_cli.policy.outcomes` has it.
    """
    canvas = interval.key.image.data_window
    encoded = {slot: encode(pixels) for slot, pixels in truth.items()}
    found: dict[tuple[str, str], list[float]] = {}
    for node in NODES:
        for choice in CHOICES:
            if (node, choice) in SAME:
                found[node, choice] = found[SAME[node, choice]]
                continue
            slot = SLOTS[node]
            pixels = take(_path_through(node, choice), interval, slot).pixels
            if as_written is not None:
                pixels = as_written(pixels)
            made = encode(place(pixels, canvas, display or canvas))
            found[node, choice] = [METRICS[name](encoded[slot], made).overall() for name in JUDGED]
    return np.array([[found[node, choice] for choice in CHOICES] for node in NODES])


def _path_through(node: str, choice: str) -> str:
    """Return a path that takes this choice at this node."""
    return next(name for name, path in PATHS.items() if path.choices.get(node) == choice)
