"""Least and greatest of the values that a buffer shows, by bands of rows and channel."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from exwarp_cli.kernels._compile import parallel, part, serial
from exwarp_cli.kernels._row_bands import WHOLE, Share, turns
from exwarp_cli.kernels.blocks import all_of, any_of

F32 = npt.NDArray[np.float32]
B8 = npt.NDArray[np.bool_]

ROWS_PER_BAND = 32
"""Rows whose ends, and whose histogram, are found together; also the grain of the parallel loop."""

FOUR = 4
"""Rows that are looked at together."""

SPAN = 128
"""Pixels of a row that are looked at together: 256, with more of them beside something hidden, took
1.2 times as long, 64 the same. With ends of their own for each column of the frame, which the
nearest cache does not hold, it took 1.2 to 1.4 times as long again."""


@part
def widen(values: F32, low: F32, high: F32) -> None:
    """Lower and raise ends by values, all [N]; NaN does not count, infinities do."""
    for k in range(values.size):
        low[k] = values[k] if values[k] < low[k] else low[k]
        high[k] = values[k] if values[k] > high[k] else high[k]


@part
def widen_by_four(rows: F32, some: slice, low: F32, high: F32) -> None:
    """Do as `widen` by part of four rows [4, M] at once: the ends are fetched and put back once."""
    one, two, three, four = rows[0][some], rows[1][some], rows[2][some], rows[3][some]
    for k in range(one.size):
        least, most = low[k], high[k]
        for value in (one[k], two[k], three[k], four[k]):
            least = value if value < least else least
            most = value if value > most else most
        low[k], high[k] = least, most


@part
def widen_by_runs(values: F32, shown: B8, span: slice, low: F32, high: F32) -> None:
    """Lower and raise the ends by what counts of a span of a row, [W C].

    By runs of pixels that count, whatever the channels: asking at each took twice as long.
    """
    channels = values.size // shown.size
    begin = span.start
    while begin < span.stop:
        if not shown[begin]:
            begin += 1
            continue
        end = begin
        while end < span.stop and shown[end]:
            end += 1
        widen(values[begin * channels : end * channels], low, high)
        begin = end


@part
def widen_by_rows(rows: F32, shown: B8, low: F32, high: F32) -> None:
    """Lower and raise the ends by what counts of some rows, [R, W C].

    Of spans, so that their ends, which are the same for all, stay in the nearest cache.
    """
    count, width = shown.shape
    channels = rows.shape[1] // width
    for begin in range(0, width, SPAN):
        end = min(begin + SPAN, width)
        every = True
        for i in range(count):
            every &= all_of(shown[i][begin:end])
        if every and count == FOUR:
            widen_by_four(rows, slice(begin * channels, end * channels), low, high)
            continue
        for i in range(count):
            if every or any_of(shown[i][begin:end]):
                widen_by_runs(rows[i], shown[i], slice(begin, end), low, high)


@part
def finite_ends(values: F32, shown: B8, c: int) -> tuple[np.float32, np.float32]:
    """Return the least and greatest finite value of a channel that counts, of rows [R, W, C]."""
    least, most = np.float32(np.inf), np.float32(-np.inf)
    for i in range(shown.shape[0]):
        for j in range(shown.shape[1]):
            value = values[i, j, c]
            if shown[i, j] and abs(value) < np.float32(np.inf):
                least, most = min(least, value), max(most, value)
    return least, most


def extents_text(values: F32, shown: B8, out: F32, share: Share = WHOLE) -> None:
    """Write the least and greatest value of each band of rows and channel.

    Parameters
    ----------
    values
        float32 [H, W, C].
    shown
        bool [H, W]: pixels that count.
    out
        float32 [ceil(H / ROWS_PER_BAND), C, 2], written: least and greatest of the finite values
        that count; +inf and -inf where there are none.
    """
    height, _, channels = values.shape
    low, high = np.empty(SPAN * channels, np.float32), np.empty(SPAN * channels, np.float32)
    for band in turns(out.shape[0], share):
        for k in range(low.size):
            low[k], high[k] = np.inf, -np.inf
        begin, end = band * ROWS_PER_BAND, min((band + 1) * ROWS_PER_BAND, height)
        for i in range(begin, end, FOUR):
            some = slice(i, min(i + FOUR, end))
            rows = values[some]
            widen_by_rows(rows.reshape(rows.shape[0], -1), shown[some], low, high)
        for c in range(channels):
            least, most = np.float32(np.inf), np.float32(-np.inf)
            for j in range(c, low.size, channels):
                least, most = min(least, low[j]), max(most, high[j])
            if least == -np.inf or most == np.inf:  # infinities, which are rare, or nothing at all
                least, most = finite_ends(values[begin:end], shown[begin:end], c)
            out[band, c, 0], out[band, c, 1] = least, most


extents = parallel(extents_text)
extents_serial = serial(extents_text)
