"""How good policies are on a table: return, quality, frame rate, and what they chose."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from exwarp_cli.domain.decision import (
    CHOICES,
    EXTRAPOLATE,
    NODES,
    PATHS,
    WARP,
    find_path,
    walk_tree,
)
from exwarp_cli.policy.outcomes import best_psnr, best_return, path_returns, slot_quality
from exwarp_cli.training.policy_table import PolicyTable

F64 = npt.NDArray[np.float64]
Paths = npt.NDArray[np.intp]

NAMES = tuple(PATHS)


@dataclass(frozen=True)
class PolicyScore:
    """Means over the key intervals of a table, or of a part of it.

    Attributes
    ----------
    intervals
        How many.
    reward
        Undiscounted sum of the rewards of an interval.
    psnr_db, ssim
        Of what is shown at slots 1 to 3.
    new_frames
        Of an interval; effective FPS is base FPS times one more than this.
    warp_share
        Share of the decisions that are warps, 0 to 1.
    paths
        Intervals by path, S1 to S6.
    """

    intervals: int
    reward: float
    psnr_db: float
    ssim: float
    new_frames: float
    warp_share: float
    paths: tuple[int, ...]


def score_paths(table: PolicyTable, paths: Paths, rows: npt.NDArray[np.bool_]) -> PolicyScore:
    """Score the paths, an index each, that some rows of a table took."""
    chosen = paths[rows]
    shares = np.eye(len(NAMES))[chosen]
    found = _weighted(table, shares, rows)
    return PolicyScore(len(chosen), *found, tuple(int(n) for n in shares.sum(axis=0)))


def score_random(table: PolicyTable, rows: npt.NDArray[np.bool_]) -> PolicyScore:
    """Score what tossing a coin at every node comes to on average, exactly."""
    odds = np.array([0.5 ** len(path.choices) for path in PATHS.values()])
    count = int(rows.sum())
    found = _weighted(table, np.tile(odds, (count, 1)), rows)
    return PolicyScore(count, *found, ())


def taken(values: F64) -> Paths:
    """Return the path of each interval by values [N, 5, 2]: the larger wins, ties go to warping."""
    extrapolates = values[..., 1] > values[..., 0]
    return np.array([_path(row) for row in extrapolates], np.intp)


def _path(extrapolates: npt.NDArray[np.bool_]) -> int:
    """Return the index of the path that these choices at the five nodes lead to."""
    choices = dict(zip(NODES, np.where(extrapolates, EXTRAPOLATE, WARP).tolist(), strict=True))
    return NAMES.index(find_path(dict(walk_tree(choices.__getitem__))))


def fixed(table: PolicyTable, name: str) -> Paths:
    """Return one path throughout."""
    return np.full(len(table), NAMES.index(name), np.intp)


def oracles(table: PolicyTable) -> dict[str, Paths]:
    """Return the best paths: by mean PSNR, and by return."""
    return {"oracle": best_psnr(table.outcomes), "oracle-return": best_return(table.outcomes)}


def _weighted(
    table: PolicyTable, shares: F64, rows: npt.NDArray[np.bool_]
) -> tuple[float, float, float, float, float]:
    """Return reward, PSNR, SSIM, new frames and warp share for shares [N, 6] of the paths."""
    outcomes = table.outcomes[rows]
    quality = slot_quality(outcomes).mean(axis=-2)
    generated = np.array([path.generated for path in PATHS.values()])
    warps = np.array([_count(name, WARP) for name in NAMES])
    decisions = np.array([sum(_count(name, choice) for choice in CHOICES) for name in NAMES])
    per_path = shares.mean(axis=0)
    return (
        float((shares * path_returns(outcomes)).sum(axis=1).mean()),
        float((shares * quality[..., 0]).sum(axis=1).mean()),
        float((shares * quality[..., 1]).sum(axis=1).mean()),
        float(per_path @ generated),
        float(per_path @ warps / (per_path @ decisions)),
    )


def _count(path: str, choice: str) -> int:
    return sum(taken == choice for taken in PATHS[path].choices.values())
