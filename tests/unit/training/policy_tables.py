"""Tables of states and outcomes whose best choices are known, without a render."""

from __future__ import annotations

import numpy as np

from exwarp_cli.domain.decision import NODES
from exwarp_cli.research.training.outcome_tables import PolicyTable

OBJECTS, NORMAL, POSITION, VAR_X, VAR_Y, WIDTH, HEIGHT, DISTANCE = range(8)
"""Columns of a table's features."""

NETWORK = "5eed" * 16


def table(
    features: np.ndarray,
    outcomes: np.ndarray,
    scene: str = "made",
    groups: tuple[str, ...] = ("key-phase0-speed1 64x36",),
) -> PolicyTable:
    """A table of rows that are dealt to groups of equal size, the last one taking the rest."""
    share = max(1, len(features) // len(groups))
    group = np.minimum(np.arange(len(features)) // share, len(groups) - 1).astype(np.int16)
    return PolicyTable(scene, groups, group, features, outcomes, NETWORK)


def random_table(
    count: int, seed: int = 0, scene: str = "made", groups: tuple[str, ...] = ("slot a", "key a")
) -> PolicyTable:
    """Features and outcomes without any sense."""
    rng = np.random.default_rng(seed)
    outcomes = rng.uniform((20.0, 0.5), (45.0, 1.0), (count, 5, 2, 2))
    return table(random_features(rng, count), outcomes, scene, groups)


def random_features(rng: np.random.Generator, count: int) -> np.ndarray:
    """Features over most of their range, float64 [count, 3, 8], whole where they are counts."""
    scale = 10.0 ** rng.uniform(-3, 0, (count, 3, 8))
    found = scale * [600.0, 0.2, 2.0, 50.0, 50.0, 0, 0, 0]
    found[..., OBJECTS] = np.floor(found[..., OBJECTS])
    found[..., WIDTH], found[..., HEIGHT] = 427, 240
    found[..., DISTANCE] = rng.uniform(1, 20, (count, 1))
    return found


def tempting(count: int, seed: int, scene: str = "made") -> PolicyTable:
    """A table where what looks worse at first may lead to more.

    At d1 warping always loses 1 dB. Half of the rows, known by large normals' distances, then have
    3 dB to gain at d2 and at the node after it; by a coin that the variance in x tells, by
    extrapolation or by warping. The other rows gain a tenth there, and no row gains after d1 = E.
    So at best half of the returns are 5 dB, and of the others 0.9 dB, as the repeat costs 0.1.
    """
    rng = np.random.default_rng(seed)
    leads, coin = rng.random(count) < 0.5, rng.random(count) < 0.5
    features = random_features(rng, count)
    features[..., NORMAL] = np.where(leads[:, None], 0.1, 0.001) * rng.uniform(0.7, 1.4, (count, 3))
    features[..., VAR_X] = np.where(coin[:, None], 100.0, 0.01) * rng.uniform(0.7, 1.4, (count, 3))
    outcomes = np.full((count, 5, 2, 2), 30.0)
    outcomes[..., 1] = 0.9
    gain = np.where(leads, 3.0, 0.1) * np.where(coin, 1.0, -1.0)
    outcomes[:, NODES.index("d1"), 1, 0] += 1.0
    for node in ("d2", "d4", "d5"):
        outcomes[:, NODES.index(node), 1, 0] += gain
    return table(features, outcomes, scene)
