"""What each choice would lead to: quality, rewards, returns, and the best path, exactly.

An outcome is the quality of the frame that a node shows under either choice, float64 [5, 2, 2]:
by node, choice (warp, extrapolate) and metric (PSNR in dB, SSIM). As a node's frames do not depend
on how it was reached, these twenty numbers tell everything of a key interval.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from exwarp_cli.domain.decision import CHOICES, DROPPING, EXTRAPOLATE, NODES, PATHS

F64 = npt.NDArray[np.float64]

METRICS = ("psnr_db", "ssim")
"""The last axis of an outcome."""

DROP_PENALTY = -0.1
"""Alpha of the paper's reward, once for each repeated frame."""

PENALTIES = np.array(
    [[DROP_PENALTY * ((node, choice) in DROPPING) for choice in CHOICES] for node in NODES]
)
"""float64 [5, 2]: what each choice is docked for the frame that it drops."""


def rewards(outcomes: F64) -> F64:
    """Return the reward of every choice at every node (paper, section IV-C1).

    The gain in PSNR and SSIM of the frame shown over the one that the other choice would show,
    plus alpha where the choice repeats a frame.

    Parameters
    ----------
    outcomes
        [..., 5, 2, 2].

    Returns
    -------
    float64 [..., 5, 2]
    """
    gain = outcomes - outcomes[..., ::-1, :]
    return np.asarray(gain.sum(axis=-1) + PENALTIES)


def returns(outcomes: F64) -> F64:
    """Return the undiscounted sum of rewards along each path, float64 [..., 6]."""
    found = rewards(outcomes)
    sums = [
        sum(found[..., NODES.index(node), CHOICES.index(choice)] for node, choice in steps)
        for steps in (path.choices.items() for path in PATHS.values())
    ]
    return np.stack(sums, axis=-1)


def shown(outcomes: F64) -> F64:
    """Return the quality of slots 1 to 3 along each path, float64 [..., 6, 3, 2].

    Slot 2 shows E(F) without a node of its own where d1 chose to extrapolate: what d2 would show.
    """
    paths = []
    for path in PATHS.values():
        steps = dict(path.choices)
        steps.setdefault("d2", EXTRAPOLATE)
        order = sorted(steps)
        slots = [outcomes[..., NODES.index(node), CHOICES.index(steps[node]), :] for node in order]
        paths.append(np.stack(slots, axis=-2))
    return np.stack(paths, axis=-3)


def best_return(outcomes: F64) -> npt.NDArray[np.intp]:
    """Return the index of the path with the best return of each interval; a tie goes to warping."""
    return _last_best(returns(outcomes))


def best_psnr(outcomes: F64) -> npt.NDArray[np.intp]:
    """Return the index of the path with the best mean PSNR of slots 1 to 3; ties to warping."""
    return _last_best(shown(outcomes)[..., 0].mean(axis=-1))


def _last_best(values: F64) -> npt.NDArray[np.intp]:
    """Return the index of the largest value along the last axis; of equal ones the last.

    Paths are in the order from most to least extrapolation.
    """
    return np.asarray(values.shape[-1] - 1 - np.argmax(values[..., ::-1], axis=-1))
