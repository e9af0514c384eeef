"""The median of what counts in a buffer, without sorting out the rest."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from exwarp_cli.kernels._compile import parallel, part
from exwarp_cli.kernels._row_bands import Share, turns

F32 = npt.NDArray[np.float32]
B8 = npt.NDArray[np.bool_]
I64 = npt.NDArray[np.int64]

SAMPLES = 1 << 14
"""Values that tell about where the median lies."""

BESIDE = 0.016
"""Share of all values, on each side of the samples' median, among which that of all is looked for:
four times the standard error of so many samples. Of twice the share the whole took a fifth longer
at 1920x1080; where the median lies beyond, which is rare, all values are looked through."""


SPAN = 256
"""Values that are looked at together: most spans have none that is picked."""

BANDS = 16
"""Into how many parts values are divided: the grain of the parallel loop."""


@part
def tally(values: F32, shown: B8, low: float, high: float) -> tuple[int, int, int]:
    """Return how many of a span count, lie below `low`, and from there to `high`."""
    total, below, until = np.int32(0), np.int32(0), np.int32(0)
    for n in range(values.size):
        counts = shown[n] & (values[n] > np.float32(0))
        total += np.int32(counts)
        below += np.int32(counts & (values[n] < low))
        until += np.int32(counts & (values[n] <= high))
    return int(total), int(below), int(until - below)


@part
def copy_between(values: F32, shown: B8, low: float, high: float, out: F32) -> None:
    """Copy what of a span lies between; `out` has room for one value more."""
    count = 0
    for n in range(values.size):
        value = values[n]
        out[count] = value  # kept where the next one goes to another place
        count += shown[n] & (value > np.float32(0)) & (value >= low) & (value <= high)


@part
def pick_some(values: F32, shown: B8, low: float, high: float, out: F32, counts: I64) -> None:
    """Do as `pick_between` with a band's values [N]; `out` has N + 1, `counts` 3."""
    total, below, count = 0, 0, 0
    for begin in range(0, values.size, SPAN):
        some, mask = values[begin : begin + SPAN], shown[begin : begin + SPAN]
        counting, lower, between = tally(some, mask, low, high)
        if between > 0:
            copy_between(some, mask, low, high, out[count:])
        total, below, count = total + counting, below + lower, count + between
    counts[0], counts[1], counts[2] = total, below, count


@parallel
def pick_between(
    values: F32,
    shown: B8,
    low: np.float32,
    high: np.float32,
    out: F32,
    counts: I64,
    share: Share,
) -> None:
    """Copy values above 0 that lie from `low` to `high`, by bands.

    Parameters
    ----------
    values
        float32 [N].
    shown
        bool [N]: those that count, where they are above 0.
    low, high
        Ends; both count.
    out
        float32 [B, M + 1] for bands of M values, of which the last may have fewer; the beginning of
        each is written.
    counts
        int64 [B, 3], written: how many of a band count in all, how many of them lie below `low`,
        and how many were copied.
    """
    step = out.shape[1] - 1
    for band in turns(out.shape[0], share):
        some = slice(min(band * step, values.size), min((band + 1) * step, values.size))
        pick_some(values[some], shown[some], low, high, out[band], counts[band])


def positive(values: F32, shown: B8) -> np.float32:
    """Return the median of values above 0, as numpy does; NaN where there are none.

    Parameters
    ----------
    values
        float32 [H, W].
    shown
        bool [H, W]: those that count, where they are above 0.
    """
    flat, mask = np.ascontiguousarray(values).ravel(), np.ascontiguousarray(shown).ravel()
    step = max(1, flat.size // SAMPLES)
    some = flat[::step][mask[::step]]
    some = np.sort(some[some > 0])
    low, high = np.float32(0), np.float32(np.inf)
    if step > 1 and some.size:
        near = max(1, round(BESIDE * some.size))
        low, high = (
            some[max(0, some.size // 2 - near)],
            some[min(some.size // 2 + near, len(some) - 1)],
        )
    out = np.empty((BANDS, -(-flat.size // BANDS) + 1), np.float32)
    counts = np.empty((BANDS, 3), np.int64)
    pick_between(flat, mask, low, high, out, counts)
    total, below, count = counts.sum(axis=0).tolist()
    # An even number has two in the middle, whose mean is the median.
    first, last = (total - 1) // 2 - below, total // 2 - below
    if first < 0 or last >= count:
        return np.float32(np.median(flat[mask & (flat > 0)])) if total else np.float32(np.nan)
    picked = np.concatenate([some[:many] for some, many in zip(out, counts[:, 2], strict=True)])
    return np.float32(np.partition(picked, (first, last))[first : last + 1].mean())
