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
        for node in path.choices:
            slot = SLOTS[node] - 1
            sums[i] += (shown[i, slot] - shown[names.index(_rival(path.choices, node)), slot]).sum()
    return np.asarray(sums)


def _rival(choices: dict[str, str], node: str) -> str:
    """Name a path that comes to the same node and takes the other choice there."""
    before = {key: choice for key, choice in choices.items() if SLOTS[key] < SLOTS[node]}
    return next(
        name
        for name, path in PATHS.items()
        if before.items() <= path.choices.items()
        and path.choices.get(node, choices[node]) != choices[node]
    )
