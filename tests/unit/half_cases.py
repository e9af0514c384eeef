"""Floats that are hard to round to halfs, and what `round_to_half` makes of them.

``python -m tests.unit.half_cases OUT.npz`` does so in whatever build the environment asks for.
"""

from __future__ import annotations

import sys

import numpy as np

from exwarp_cli.kernels.exr_filters import round_to_half

HALF_MAX = 65504.0
EDGES = np.array(
    [
        *(0x00000000, 0x80000000, 0x00000001, 0x807FFFFF),  # zeros, and what is far below halfs
        *(0x32FFFFFF, 0x33000000, 0x33000001, 0x33800000, 0x33C00000),  # about their smallest
        *(0x387FDFFF, 0x387FE000, 0x387FF000, 0x387FFFFF, 0x38800000),  # about their first full one
        *(0x3F801000, 0x3F803000, 0x3F801001, 0x3F802FFF),  # halfway between two, and beside
        *(0x477FE000, 0x477FEFFF, 0x477FF000, 0x47800000, 0x7F7FFFFF),  # about their largest
        *(0x7F800000, 0xFF800000),  # infinity
        *(0x7F800001, 0x7F802000, 0x7FC00000, 0xFFFFFFFF),  # NaN, loud and quiet
    ],
    np.uint32,
)


def some_bits(each: int = 4) -> np.ndarray:
    """Return bits [N]: the edges, and so many in every 65,536 of all floats."""
    rng = np.random.default_rng(0)
    every = (np.arange(2**16, dtype=np.uint32)[:, None] << 16) + rng.integers(
        0, 2**16, each, np.uint32
    )
    return np.concatenate([EDGES, every.reshape(-1)])


def rounded(bits: np.ndarray, bounded: bool) -> np.ndarray:
    """Return halfs [H, W], as bits, of floats' bits."""
    out = np.full(bits.shape, 7, np.uint16)
    round_to_half(bits, bounded, out)
    return out


def by_numpy(bits: np.ndarray, bounded: bool) -> np.ndarray:
    """Return the same, [H, W], for one channel."""
    floats = bits.view(np.float32)
    with np.errstate(all="ignore"):
        bound = np.clip(floats, -HALF_MAX, HALF_MAX) if bounded else floats
        return bound.astype(np.float16).view(np.uint16)


def edges_rounded() -> dict[str, np.ndarray]:
    """Return what becomes of the edges and some others, with rows that hold no NaN."""
    bits = np.concatenate([EDGES, some_bits(1)[:: 2**6]])
    rows = np.stack([bits, np.where(bits & 0x7FFFFFFF > 0x7F800000, np.uint32(1), bits)])
    return {str(bounded): rounded(rows, bounded) for bounded in (False, True)}


if __name__ == "__main__":
    np.savez(sys.argv[1], **edges_rounded())
