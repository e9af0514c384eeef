"""Least and greatest of the values that a buffer shows, by bands of rows and channel."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from exwarp_cli.compiled.shares import WHOLE, Share, turns
from exwarp_cli.kernels.blocks import all_of
from exwarp_cli.kernels.jit import parallel, part, serial

F32 = npt.NDArray[np.float32]
B8 = npt.NDArray[np.bool_]

ROWS_PER_BAND = 32
"""Rows whose ends, and whose histogram, are found together; also the grain of the parallel loop."""


@part
def widen(values: F32, low: F32, high: F32) -> None:
    """Lower and raise ends by values, all [N]; NaN does not count, infinities do."""
    for k in range(values.size):
        low[k] = values[k] if values[k] < low[k] else low[k]
        high[k] = values[k] if values[k] > high[k] else high[k]


@part
def widen_by_row(values: F32, shown: B8, low: F32, high: F32) -> None:
    """Lower and raise the ends of each column, [W C], by what counts of a row.

    By runs of pixels that count, whatever the channels: asking at each took twice as long.
    """
    width = shown.size
    channels = values.size // width
    begin = 0
    while begin < width:
        if not shown[begin]:
            begin += 1
            continue
        end = begin
        while end < width and shown[end]:
            end += 1
        part = slice(begin * channels, end * channels)
        widen(values[part], low[part], high[part])
        begin = end


@part
def widen_by_rows(values: F32, low: F32, high: F32) -> None:
    """Do as `widen` by four rows [4, N] at once: the ends are fetched and put back once."""
    one, two, three, four = values[0], values[1], values[2], values[3]
    for k in range(low.size):
        least, most = low[k], high[k]
        for value in (one[k], two[k], three[k], four[k]):
            least = value if value < least else least
            most = value if value > most else most
        low[k], high[k] = least, most


@part
def widen_by_band(values: F32, shown: B8, low: F32, high: F32) -> None:
    """Lower and raise the ends of each column, [W C], by what counts of some rows [R, W, C]."""
    i = 0
    while i < shown.shape[0]:
        four = i + 4 <= shown.shape[0]
        if four and all_of(shown[i : i + 4].reshape(-1)):
            widen_by_rows(values[i : i + 4].reshape(4, -1), low, high)
            i += 4
        else:
            widen_by_row(values[i].reshape(-1), shown[i], low, high)
            i += 1


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
    share
        Which turns are taken: those of :func:`~exwarp_cli.compiled.shares.turns`.
    """
    height, width, channels = values.shape
    for band in turns(out.shape[0], share):
        begin = band * ROWS_PER_BAND
        low = np.full(width * channels, np.inf, np.float32)
        high = np.full(width * channels, -np.inf, np.float32)
        end = min(begin + ROWS_PER_BAND, height)
        widen_by_band(values[begin:end], shown[begin:end], low, high)
        for c in range(channels):
            least, most = np.float32(np.inf), np.float32(-np.inf)
            for j in range(c, low.size, channels):
                least, most = min(least, low[j]), max(most, high[j])
            if least == -np.inf or most == np.inf:  # infinities, which are rare, or nothing at all
                least, most = finite_ends(values[begin:end], shown[begin:end], c)
            out[band, c, 0], out[band, c, 1] = least, most


extents = parallel(extents_text)
extents_serial = serial(extents_text)
