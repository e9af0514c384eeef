"""Outcomes of each choice: quality, rewards, returns, and the best path, exactly.

An outcome is the quality of the frame that a node shows under either choice, float64 [5, 2, 2]:
by node, choice (warp, extrapolate) and metric (PSNR in dB, SSIM). As a node's frames do not depend
on how it was reached, these twenty numbers describe a key interval completely. Under a clock a late
frame repeats the one before, which depends on the whole path so far: see `clocked_returns`.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from exwarp_cli.domain.decision import (
    CHOICES,
    EXTRAPOLATE,
    NODE_SLOTS,
    NODES,
    PATHS,
    REPEATING_CHOICES,
)

F64 = npt.NDArray[np.float64]

METRICS = ("psnr_db", "ssim")  # The last axis of an outcome

DROP_PENALTY = -0.1  # Alpha of the paper's reward, once for each repeated frame

# float64 [5, 2]: what each choice is docked for the frame that it drops.
PENALTIES = np.array(
    [[DROP_PENALTY * ((node, choice) in REPEATING_CHOICES) for choice in CHOICES] for node in NODES]
)


def choice_rewards(outcomes: F64) -> F64:
    """Return the reward of every choice at every node, [..., 5, 2] (paper, section IV-C1).

    It is the gain in PSNR and SSIM of the frame over that of the other choice, plus alpha where the
    choice repeats a frame. Outcomes are [..., 5, 2, 2].
    """
    gain = outcomes - outcomes[..., ::-1, :]
    return np.asarray(gain.sum(axis=-1) + PENALTIES)


def path_returns(outcomes: F64) -> F64:
    """Return the undiscounted sum of rewards along each path, float64 [..., 6]."""
    rewards = choice_rewards(outcomes)
    sums = [
        sum(rewards[..., NODES.index(node), CHOICES.index(choice)] for node, choice in steps)
        for steps in (path.choices.items() for path in PATHS.values())
    ]
    return np.stack(sums, axis=-1)


def slot_quality(outcomes: F64) -> F64:
    """Return the quality of slots 1 to 3 along each path, float64 [..., 6, 3, 2]."""
    # Where d1 extrapolates, slot 2 shows E(F) without a node of its own: what d2 would show.
    paths = []
    for path in PATHS.values():
        steps = dict(path.choices)
        steps.setdefault("d2", EXTRAPOLATE)
        order = sorted(steps)
        slots = [outcomes[..., NODES.index(node), CHOICES.index(steps[node]), :] for node in order]
        paths.append(np.stack(slots, axis=-2))
    return np.stack(paths, axis=-3)


def best_return(outcomes: F64) -> npt.NDArray[np.intp]:
    """Return the index of the path with the largest return of an interval; ties to warping."""
    # Paths are ordered from most to least extrapolation.
    return np.asarray(len(PATHS) - 1 - np.argmax(path_returns(outcomes)[..., ::-1], axis=-1))


def best_psnr(outcomes: F64) -> npt.NDArray[np.intp]:
    """Return the index of the path with the best mean PSNR of slots 1 to 3; ties to warping."""
    means = slot_quality(outcomes)[..., 0].mean(axis=-1)
    return np.asarray(len(PATHS) - 1 - np.argmax(means[..., ::-1], axis=-1))


def clocked_returns(
    quality: F64,  # [6, 3, 2], PSNR (dB) and SSIM of slots 1 to 3 of each path
    # dropped: by path, how many slots repeat the frame before: alpha counts once for each
    dropped: Sequence[int],
) -> F64:
    """Return the undiscounted sum of rewards along each path, float64 [6] (section IV-C1)."""
    sums = DROP_PENALTY * np.asarray(dropped, np.float64)
    for i, path in enumerate(PATHS.values()):
        for node, choice in path.choices.items():
            slot = NODE_SLOTS[node] - 1
            # Exactly one way leads to a node, so any path with its other choice is equal up to it.
            rivals = [other.choices.get(node, choice) != choice for other in PATHS.values()]
            sums[i] += (quality[i, slot] - quality[rivals.index(True), slot]).sum()
    return np.asarray(sums)
