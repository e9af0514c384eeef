"""How good policies are on a table, beside a linear regression, and their scores as Markdown."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

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
from exwarp_cli.domain.settings import DEFAULT_FPS
from exwarp_cli.policy.outcomes import (
    best_psnr,
    best_return,
    choice_rewards,
    path_returns,
    slot_quality,
)
from exwarp_cli.research.training.outcome_tables import PolicyTable

F64 = npt.NDArray[np.float64]
Bool = npt.NDArray[np.bool_]
Paths = npt.NDArray[np.intp]

NAMES = tuple(PATHS)

# Weight of the squared coefficients beside the mean squared error, in units of the inputs.
RIDGE = 1e-2

# Of the Markdown tables, and how some policies are called there.
COLUMNS = ("exwarp", *PATHS, "oracle", "oracle-return", "regressor", "random")
TITLES = {
    "exwarp": "policy",
    "oracle": "best PSNR",
    "oracle-return": "best return",
    "regressor": "regression",
}


@dataclass(frozen=True)
class PolicyScore:
    """Means over the key intervals of a table, or of a part of it."""

    intervals: int  # How many
    reward: float  # Undiscounted sum of the rewards of an interval.
    # Of what is shown at slots 1 to 3
    psnr_db: float
    ssim: float
    new_frames: float  # Of an interval; effective FPS is base FPS times one more than this.
    warp_share: float  # Share of the decisions that are warps, 0 to 1.
    paths: tuple[int, ...]  # Intervals by path, S1 to S6


def score_paths(table: PolicyTable, paths: Paths, rows: Bool) -> PolicyScore:
    """Score the paths, an index each, that some rows of a table took."""
    chosen = paths[rows]
    shares = np.eye(len(NAMES))[chosen]
    means = _weighted_means(table, shares, rows)
    return PolicyScore(len(chosen), *means, tuple(int(n) for n in shares.sum(axis=0)))


def score_random(table: PolicyTable, rows: Bool) -> PolicyScore:
    """Score what tossing a coin at every node comes to on average, exactly."""
    odds = np.array([0.5 ** len(path.choices) for path in PATHS.values()])
    count = int(rows.sum())
    return PolicyScore(count, *_weighted_means(table, np.tile(odds, (count, 1)), rows), ())


def _weighted_means(
    table: PolicyTable, shares: F64, rows: Bool
) -> tuple[float, float, float, float, float]:
    """Return reward, PSNR, SSIM, new frames and warp share for shares [N, 6] of the paths."""
    outcomes = table.outcomes[rows]
    quality = slot_quality(outcomes).mean(axis=-2)
    generated = np.array([path.generated for path in PATHS.values()])
    counts = np.array(
        [[list(PATHS[name].choices.values()).count(c) for c in CHOICES] for name in NAMES]
    )
    warps, decisions = counts[:, CHOICES.index(WARP)], counts.sum(axis=1)
    per_path = shares.mean(axis=0)
    return (
        float((shares * path_returns(outcomes)).sum(axis=1).mean()),
        float((shares * quality[..., 0]).sum(axis=1).mean()),
        float((shares * quality[..., 1]).sum(axis=1).mean()),
        float(per_path @ generated),
        float(per_path @ warps / (per_path @ decisions)),
    )


def greedy_paths(values: F64) -> Paths:
    """Return the path of each interval by values [N, 5, 2]: the larger wins, ties go to warping."""
    paths = []
    for row in np.where(values[..., 1] > values[..., 0], EXTRAPOLATE, WARP).tolist():
        choices = dict(zip(NODES, row, strict=True))
        paths.append(NAMES.index(find_path(dict(walk_tree(choices.__getitem__)))))
    return np.array(paths, np.intp)


def fixed_path(table: PolicyTable, name: str) -> Paths:
    """Return one path throughout."""
    return np.full(len(table), NAMES.index(name), np.intp)


def oracle_paths(table: PolicyTable) -> dict[str, Paths]:
    """Return the best paths: by mean PSNR, and by return."""
    return {"oracle": best_psnr(table.outcomes), "oracle-return": best_return(table.outcomes)}


def fit_regression(tables: Sequence[PolicyTable]) -> F64:
    """Fit the reward of both choices at each node to the states of some scenes.

    Returns coefficients float64 [5, 45, 2] of the 44 inputs and of a constant, by node and choice.
    """
    states = np.concatenate([table.states for table in tables])
    gains = np.concatenate([choice_rewards(table.outcomes) for table in tables])
    weights = np.concatenate([np.full(len(table), 1 / len(table)) for table in tables])
    coefficients = []
    for node in range(len(NODES)):
        x = np.concatenate([states[:, node], np.ones((len(states), 1))], axis=1)
        scaled = x * weights[:, None] / weights.sum()
        coefficients.append(
            np.linalg.solve(scaled.T @ x + RIDGE * np.eye(x.shape[1]), scaled.T @ gains[:, node])
        )
    return np.array(coefficients)


def predict_rewards(coefficients: F64, table: PolicyTable) -> F64:
    """Return the expected reward of both choices at every node, float64 [N, 5, 2]."""
    states = table.states
    x = np.concatenate([states, np.ones((*states.shape[:2], 1))], axis=2)
    return np.asarray(np.einsum("nki,kic->nkc", x, coefficients))


def policy_card(report: dict[str, Any]) -> str:
    """Return the tables of what ``policy.json`` holds: every scene when it was left out.

    One table for PSNR and SSIM, one for return, one for what was chosen.
    """
    rows = [
        (scene, part, scores)
        for scene, parts in report["left_out"].items()
        for part, scores in parts.items()
        if part != "all"
    ]
    titles = [TITLES.get(name, name) for name in COLUMNS]
    quality = [_table_row("scene", "frames", *titles), _rule(2 + len(COLUMNS))]
    gains = [_table_row("return", "frames", *titles), _rule(2 + len(COLUMNS))]
    names = ("scene", "frames", "intervals", *PATHS, "warps", "effective fps", "int8 = float")
    choices = [_table_row(*names), _rule(len(names))]
    for scene, part, entry in rows:
        scores = [entry["scores"][name] for name in COLUMNS]
        best = max(score["psnr_db"] for score in scores[1 : 1 + len(PATHS)])
        cells = [f"{score['psnr_db']:.2f} / {score['ssim']:.3f}" for score in scores]
        marked = (
            f"**{cell}**" if score["psnr_db"] == best and name in PATHS else cell
            for name, score, cell in zip(COLUMNS, scores, cells, strict=True)
        )
        quality.append(_table_row(scene, part, *marked))
        gains.append(_table_row(scene, part, *(f"{score['reward']:.2f}" for score in scores)))
        own = entry["scores"]["exwarp"]
        fps = float(DEFAULT_FPS) * (1 + own["new_frames"])
        counts = (str(count) for count in (own["intervals"], *own["paths"]))
        shares = (f"{own['warp_share']:.1%}", f"{fps:.1f}", f"{entry['agreement']:.2%}")
        choices.append(_table_row(scene, part, *counts, *shares))
    means = (
        sum(entry["scores"][name]["reward"] for _, _, entry in rows) / len(rows) for name in COLUMNS
    )
    gains.append(_table_row("**mean**", "", *(f"{mean:.3f}" for mean in means)))
    return "\n\n".join("\n".join(lines) for lines in (quality, gains, choices))


def tile_policy_card(report: dict[str, Any]) -> str:
    """Return what ``tile-policy.json`` holds: what choices gain at some shares of the area.

    In per cent of what E gains everywhere, in dB over all scenes.
    """
    curves = report["gain_percent"]
    shares = list(next(iter(curves.values())))
    lines = [_table_row("choice", *(f"{float(share):.0%} of the area" for share in shares))]
    lines.append(_rule(1 + len(shares)))
    for name, gains in curves.items():
        lines.append(_table_row(name, *(f"{gains[share]:.0f} %" for share in shares)))
    everywhere = ", ".join(
        f"{scene} {gain:+.2f}" for scene, gain in report["extrapolator_gain_db"].items()
    )
    s4 = f"Always S4, at half of the area, gains {report['always_s4_percent']:.0f} %."
    return "\n".join([*lines, "", f"E everywhere gains, in dB: {everywhere}. {s4}"])


def _table_row(*cells: str) -> str:
    return "| " + " | ".join(cells) + " |"


def _rule(count: int) -> str:
    return "|" + "---|" * count
