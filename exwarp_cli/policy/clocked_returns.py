"""Returns of the decision paths, from what their slots really show.

`outcomes` knows the paths whose frames all come in time. Under a clock a late frame repeats the one
before, which depends on the whole path so far.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from exwarp_cli.domain.decision import PATHS, SLOTS
from exwarp_cli.policy.outcomes import DROP_PENALTY

F64 = npt.NDArray[np.float64]


def clocked_returns(shown: F64, dropped: Sequence[int]) -> F64:
    """Return the undiscounted sum of rewards along each path (paper, section IV-C1), float64 [6].

    Parameters
    ----------
    shown
        float64 [6, 3, 2], PSNR (dB) and SSIM of what slots 1 to 3 of each path show.
    dropped
        For each path the slots that repeat the frame before: alpha counts once for each.
    """
    names = list(PATHS)
    sums = DROP_PENALTY * np.asarray(dropped, np.float64)
    for i, path in enumerate(PATHS.values()):
        for node, choice in path.choices.items():
            slot = SLOTS[node] - 1
            rival = names.index(_rival(node, choice))
            sums[i] += (shown[i, slot] - shown[rival, slot]).sum()
    return np.asarray(sums)


def _rival(node: str, choice: str) -> str:
    """Name a path with the other choice at a node; one way leads to each, so both came alike."""
    return next(name for name, path in PATHS.items() if path.choices.get(node, choice) != choice)
