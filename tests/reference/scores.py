"""Naive twin of a policy's scores: interval by interval, straight from the paper's table of paths.

Outcomes are [N, 5, 2, 2] by node d1 … d5, choice (0 warp, 1 extrapolate) and metric (PSNR, SSIM).
"""

from __future__ import annotations

import numpy as np

D1, D2, D3, D4, D5 = range(5)
W, E = 0, 1

TREE = {
    "S1": [(D1, E), (D3, E)],
    "S2": [(D1, E), (D3, W)],
    "S3": [(D1, W), (D2, E), (D4, E)],
    "S4": [(D1, W), (D2, E), (D4, W)],
    "S5": [(D1, W), (D2, W), (D5, E)],
    "S6": [(D1, W), (D2, W), (D5, W)],
}
"""The nodes that each path passes, and what it does there."""

FRAMES = {
    "S1": [(D1, E), (D2, E), (D3, E)],
    "S2": [(D1, E), (D2, E), (D3, W)],
    "S3": [(D1, W), (D2, E), (D4, E)],
    "S4": [(D1, W), (D2, E), (D4, W)],
    "S5": [(D1, W), (D2, W), (D5, E)],
    "S6": [(D1, W), (D2, W), (D5, W)],
}
"""The frames of slots 1 to 3: E(F) is shown at slot 2 of S1 and S2 too, as d2 would show it."""

DROPS = {(D1, E), (D3, E)}


def reward(outcomes: np.ndarray, node: int, choice: int) -> float:
    gain = outcomes[node, choice, 0] - outcomes[node, 1 - choice, 0]
    gain += outcomes[node, choice, 1] - outcomes[node, 1 - choice, 1]
    return float(gain) - 0.1 * ((node, choice) in DROPS)


def chosen_path(values: np.ndarray) -> str:
    """Go down the tree by the values [5, 2] of one interval; a tie is to warp."""
    steps, node = [], D1
    while True:
        choice = E if values[node, E] > values[node, W] else W
        steps.append((node, choice))
        if steps in TREE.values():
            return next(name for name, path in TREE.items() if path == steps)
        node = {(D1, W): D2, (D1, E): D3, (D2, W): D5, (D2, E): D4}[node, choice]


def score(outcomes: np.ndarray, shares: list[dict[str, float]]) -> dict[str, float]:
    """Return means over intervals that take each path to a share."""
    total = dict.fromkeys(("reward", "psnr_db", "ssim", "new_frames"), 0.0)
    warps = decisions = 0.0
    for row, odds in zip(outcomes, shares, strict=True):
        for name, share in odds.items():
            total["reward"] += share * sum(reward(row, *step) for step in TREE[name])
            for frame in FRAMES[name]:
                total["psnr_db"] += share * row[frame][0] / 3
                total["ssim"] += share * row[frame][1] / 3
            total["new_frames"] += share * (3 - sum(frame in DROPS for frame in TREE[name]))
            warps += share * sum(choice == W for _, choice in TREE[name])
            decisions += share * len(TREE[name])
    found = {name: value / len(outcomes) for name, value in total.items()}
    return found | {"warp_share": warps / decisions}


def coin() -> dict[str, float]:
    """Return how often each path is taken when a coin is tossed at every node: all outcomes."""
    odds = dict.fromkeys(TREE, 0.0)
    for toss in range(8):
        bits = [toss >> k & 1 for k in range(3)]
        values = np.zeros((5, 2))
        values[D1, E], values[D2, E] = bits[0], bits[1]
        values[[D3, D4, D5], E] = bits[2]
        # The second toss decides d3 where d1 = E: nothing else is left to be decided then.
        if bits[0]:
            values[D3, E] = bits[1]
        odds[chosen_path(values * 2 - np.array([0, 1]))] += 1 / 8
    return odds
