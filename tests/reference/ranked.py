"""Which surface prevails in a pixel: straight from the definition, in exact fractions."""

from __future__ import annotations

from collections.abc import Collection
from fractions import Fraction
from math import isnan

import numpy as np

HIDDEN_RANKS = 4


def identity(bits: int, rounded: bool = False) -> int:
    """The bits without the sign; rounded to the nearest multiple of 256 that is finite."""
    kept = bits % 2**31
    if rounded:
        nearest = (kept + 128) // 256 * 256
        kept = nearest if nearest < 0x7F800000 else kept // 256 * 256
    return kept


def surface(ranks: list[tuple[int, float]], lead: float, rounded: bool = False) -> int:
    """The surface of one pixel: of two (bits, share); 0 background, -1 none that leads."""
    known = sorted(
        (
            (Fraction(min(float(share), 1.0)), identity(bits, rounded))
            for bits, share in ranks
            if identity(bits, rounded) and not isnan(share) and share > 0
        ),
        key=lambda one: -one[0],
    )
    shares = [share for share, _ in known] + [Fraction(0)] * (2 - len(known))
    left = max(1 - sum(shares), Fraction(0))
    limit = Fraction(float(lead))
    if shares[0] - max(shares[1], left) > limit:
        return known[0][1]
    return 0 if left - HIDDEN_RANKS * shares[1] - shares[0] > limit else -1


def moving(
    ranks: list[tuple[int, float]], dynamic: Collection[int], lead: float, rounded: bool = False
) -> int:
    """The moving surface of one pixel, 0 if it shows none, -1 if it might."""
    present = {identity(bits, rounded) for bits, share in ranks if not isnan(share) and share > 0}
    if not present & set(dynamic):
        return 0
    shown = surface(ranks, lead, rounded)
    return shown if shown in dynamic or shown < 0 else 0


def image(of: object, ranks: np.ndarray, *args: object) -> np.ndarray:
    """Apply one of the above to every pixel of float32 [H, W, 4]."""
    bits = np.ascontiguousarray(ranks).view(np.uint32)
    out = np.empty(ranks.shape[:2], np.int32)
    for i, j in np.ndindex(out.shape):
        pixel = [(int(bits[i, j, c]), float(ranks[i, j, c + 1])) for c in (0, 2)]
        out[i, j] = of(pixel, *args)
    return out


def by_depth(ids: np.ndarray, depth: np.ndarray, tolerance: float) -> np.ndarray:
    """The id of the neighbour nearest in depth, unless one shares the id at about that depth."""
    out = ids.copy()
    for i, j in np.ndindex(ids.shape):
        near = []
        for y, x in np.ndindex(ids.shape):
            if max(abs(y - i), abs(x - j)) != 1 or ids[y, x] < 0:
                continue
            one, other = float(depth[i, j]), float(depth[y, x])
            away = 0.0 if one == other else abs(one - other) / max(one, other)
            if away <= tolerance:  # not NaN: infinite beside finite
                near.append((away, len(near), ids[y, x]))
        if near and all(ident != ids[i, j] for _, _, ident in near):
            out[i, j] = min(near)[2]
    return out
