"""Random ranks of a Cryptomatte; as a module, what is made of them, for interpreted code too."""

from __future__ import annotations

import sys

import numpy as np

from exwarp_cli.io.cryptomatte import refine_ids_by_depth, surface_ids


def case(seed: int, height: int = 24, width: int = 31) -> np.ndarray:
    """Ranks of few surfaces, with shares of all kinds: unsorted, NaN, negative, above 1."""
    rng = np.random.default_rng(seed)
    hashes = np.array(
        [0, 1 << 31, *rng.integers(0x00800000, 0x7F800000, 5), *rng.integers(2**31, 2**32, 2)],
        np.uint32,
    )
    out = np.empty((height, width, 4), np.float32)
    bits = out.view(np.uint32)
    bits[..., ::2] = rng.choice(hashes, (height, width, 2))
    shares = rng.choice(
        np.array([0, 0.1, 0.25, 0.5, 0.6, 0.9, 1, 1.25, -0.1, np.nan]), (height, width, 2)
    )
    out[..., 1::2] = shares + rng.choice([0, 0.01], (height, width, 2))
    return out


def everything() -> dict[str, np.ndarray]:
    """What both builds are asked, for the comparison with interpreted code."""
    found = {}
    for rounded in (False, True):
        ranks = case(5)
        shown = surface_ids(ranks, rounded)
        some = [int(i) for i in np.unique(shown) if i > 0][::2]
        found[f"surfaces {rounded}"] = shown
        found[f"moving {rounded}"] = surface_ids(ranks, rounded, some)
        depth = np.random.default_rng(6).choice(np.array([1, 1.03, 2, np.inf]), shown.shape)
        found[f"by depth {rounded}"] = refine_ids_by_depth(shown, depth.astype(np.float32))
    return found


if __name__ == "__main__":
    np.savez(sys.argv[1], **everything())
