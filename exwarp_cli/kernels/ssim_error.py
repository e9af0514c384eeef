"""Structural similarity: the map of Wang's SSIM, per channel.

Wang, Bovik, Sheikh, Simoncelli, "Image Quality Assessment: From Error Visibility to Structural
Similarity", IEEE Transactions on Image Processing 13 (2004), equation 13, with the 11-tap Gaussian
of section III.C.
"""

from __future__ import annotations

import numpy as np

from exwarp_cli.kernels._compile import device_function, kernel
from exwarp_cli.kernels._row_bands import Band, band_range
from exwarp_cli.kernels.array_types import F32, F64

RADIUS = 5  # Taps on either side of the centre: 3.5 sigma, rounded

SIGMA = 1.5
DATA_RANGE = 255.0
C1 = (0.01 * DATA_RANGE) ** 2
C2 = (0.03 * DATA_RANGE) ** 2

_ROWS_PER_STRIP = 16  # rows that share one scratch line; also the grain of the parallel loop


def _gaussian() -> tuple[float, ...]:
    taps = np.exp(-0.5 * (np.arange(-RADIUS, RADIUS + 1) / SIGMA) ** 2)
    return tuple(float(w) for w in (taps / taps.sum())[RADIUS:])


W0, W1, W2, W3, W4, W5 = _gaussian()


def ssim_map(
    reference: F32,  # as `test`: [H, W, C], display-encoded, 0 to 255, finite
    test: F32,
) -> F32:
    """Return the structural similarity of every pixel and channel, float32 [H, W, C], -1 to 1.

    Equal to scikit-image's ``structural_similarity`` with ``gaussian_weights=True, sigma=1.5,
    use_sample_covariance=False, data_range=255, full=True`` on float64 pixels. An image smaller
    than the 11 taps is reflected again. Equal neighbourhoods give exactly 1.
    """
    height, width, channels = reference.shape
    lines = (height, width * channels)
    out = np.empty(lines, dtype=np.float32)
    x = np.ascontiguousarray(reference).reshape(lines)
    y = np.ascontiguousarray(test).reshape(lines)
    _write_map(x, y, channels, out)
    return out.reshape(height, width, channels)


@device_function
def _mirror_index(i: int, n: int) -> int:
    """Return index i of a line of n samples that is reflected about its outer edges."""
    i = i % (2 * n)
    return i if i < n else 2 * n - 1 - i


# The loops below are apart, with one array written in each, because LLVM vectorises only loops that
# need few checks for overlap. As one loop over all four sums they took 132 ms instead of 44.
@device_function
def _add_values(total: F64, weight: float, a: F32, b: F32) -> None:
    for i in range(total.size):
        total[i] += weight * (np.float64(a[i]) + np.float64(b[i]))


@device_function
def _add_squares(total: F64, weight: float, a: F32, b: F32, c: F32, d: F32) -> None:
    for i in range(total.size):
        e, f, g, h = np.float64(a[i]), np.float64(b[i]), np.float64(c[i]), np.float64(d[i])
        total[i] += weight * ((e * e + f * f) + (g * g + h * h))


@device_function
def _add_products(total: F64, weight: float, a: F32, b: F32, c: F32, d: F32) -> None:
    for i in range(total.size):
        total[i] += weight * (
            np.float64(a[i]) * np.float64(b[i]) + np.float64(c[i]) * np.float64(d[i])
        )


@device_function
def _blur_columns(x: F32, y: F32, row: int, halo: int, sums: F64) -> None:
    """Blur x, y, x*x + y*y and x*y downwards, for one row, into the four lines of `sums`."""
    sums[:] = 0.0
    # Each line is sliced by itself: numba takes a line of a sliced block for strided and does not
    # vectorise its loops (1080p, one thread: 126 ms instead of 44).
    stop = halo + x.shape[1]
    sx, sy, ss, sp = sums[0][halo:stop], sums[1][halo:stop], sums[2][halo:stop], sums[3][halo:stop]
    # Half the centre's weight, twice: what serves for a pair of rows serves for the single row.
    for k, weight in enumerate((0.5 * W0, W1, W2, W3, W4, W5)):
        above, below = _mirror_index(row - k, x.shape[0]), _mirror_index(row + k, x.shape[0])
        a, b, c, d = x[above], y[above], x[below], y[below]
        _add_values(sx, weight, a, c)
        _add_values(sy, weight, b, d)
        _add_squares(ss, weight, a, b, c, d)
        _add_products(sp, weight, a, b, c, d)


@device_function
def _reflect_ends(line: F64, width: int, channels: int) -> None:
    for p in range(RADIUS):
        left = (_mirror_index(p - RADIUS, width) + RADIUS) * channels
        right = (_mirror_index(p + width, width) + RADIUS) * channels
        for c in range(channels):
            line[p * channels + c] = line[left + c]
            line[(p + width + RADIUS) * channels + c] = line[right + c]


@device_function
def _blur_row(line: F64, s: int, out: F64) -> None:
    """Blur a line whose samples of one channel are s apart."""
    a, b, c, d, e = line, line[s:], line[2 * s :], line[3 * s :], line[4 * s :]
    f, g, h = line[5 * s :], line[6 * s :], line[7 * s :]
    p, q, r = line[8 * s :], line[9 * s :], line[10 * s :]
    for i in range(out.size):
        out[i] = W0 * f[i] + W1 * (e[i] + g[i]) + W2 * (d[i] + h[i])
    for i in range(out.size):
        out[i] += W3 * (c[i] + p[i]) + W4 * (b[i] + q[i]) + W5 * (a[i] + r[i])


@device_function
def _write_similarity(mean_x: F64, mean_y: F64, squares: F64, products: F64, out: F32) -> None:
    for i in range(out.size):
        means = mean_x[i] * mean_y[i]
        powers = mean_x[i] * mean_x[i] + mean_y[i] * mean_y[i]
        top = (2.0 * means + C1) * (2.0 * (products[i] - means) + C2)
        out[i] = np.float32(top / ((powers + C1) * (squares[i] - powers + C2)))


@device_function
def _write_strip(x: F32, y: F32, channels: int, out: F32, first: int) -> None:
    height, span = x.shape
    halo = RADIUS * channels
    sums = np.empty((4, span + 2 * halo))
    means = np.empty((4, span))
    for row in range(first, min(first + _ROWS_PER_STRIP, height)):
        _blur_columns(x, y, row, halo, sums)
        for j in range(4):
            _reflect_ends(sums[j], span // channels, channels)
            _blur_row(sums[j], channels, means[j])
        _write_similarity(means[0], means[1], means[2], means[3], out[row])


@kernel(parallel=True)
def _write_map(x: F32, y: F32, channels: int, out: F32, band: Band) -> None:
    for strip in band_range((x.shape[0] + _ROWS_PER_STRIP - 1) // _ROWS_PER_STRIP, band):
        _write_strip(x, y, channels, out, strip * _ROWS_PER_STRIP)
