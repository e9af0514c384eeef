"""Errors of a picture beside another one: FLIP, what a viewer sees of both, and Wang's SSIM.

Andersson, Nilsson, Akenine-Möller, Oskarsson, Åström, Fairchild, "FLIP: A Difference Evaluator for
Alternating Images", Proceedings of the ACM on Computer Graphics and Interactive Techniques 3(2),
2020; sections in the text are its. Opponent colours are the paper's YCxCz without scales and
offset, which filters leave as they are: float32 sums keep more digits of dark colours that way.
Filters are passes down and along rows, with the image's edge repeated outside.

Wang, Bovik, Sheikh, Simoncelli, "Image Quality Assessment: From Error Visibility to Structural
Similarity", IEEE Transactions on Image Processing 13 (2004), equation 13 of each channel, with the
11-tap Gaussian of section III.C.
"""

from __future__ import annotations

import numpy as np

from exwarp_cli.kernels._compile import ParallelKernel, device_function, inline
from exwarp_cli.kernels._row_bands import Band, band_range
from exwarp_cli.kernels.array_types import F32, F64

_MANTISSA = np.int32(23)  # bits of a float32's mantissa

# Bits of the least mantissa: those from sqrt(1/2) to sqrt(2) lie closest around 1.
_ROOT_HALF_BITS = np.int32(np.float32(np.sqrt(0.5)).view(np.int32))

_BIAS = np.int32(127)

_ZERO, _HALF, _ONE = np.float32(0), np.float32(0.5), np.float32(1)

MIN_BASE = np.float32(1e-30)

# log2((1 + s) / (1 - s)) = 2 / ln 2 * (s + s^3 / 3 + ...); the next term is below 4e-9 of the sum.
_LOG1, _LOG3, _LOG5, _LOG7, _LOG9 = (np.float32(2 / np.log(2) / n) for n in (1, 3, 5, 7, 9))

# 2^x = 1 + x ln 2 + (x ln 2)^2 / 2! + ...; the next term is below 6e-9.
_EXP1, _EXP2, _EXP3, _EXP4, _EXP5, _EXP6, _EXP7 = (
    np.float32(np.log(2) ** n / f) for n, f in enumerate((1, 2, 6, 24, 120, 720, 5040), 1)
)


@inline
def power(base: np.float32, exponent: np.float32) -> np.float32:
    """Return base ** exponent within 2e-6; both 0 or more, the result 2^-126 to 2^126.

    A base below MIN_BASE counts as 0, with the result 0 whatever the exponent. All operations are
    single float32 ones, so that builds agree in every bit.
    """
    # Without Intel's SVML numba calls the C library's `pow` for each number: two thirds of FLIP's
    # time. The casts tell numba the type; they change nothing.
    bits = np.float32(base).view(np.int32)
    shift = np.int32(np.int32(bits - _ROOT_HALF_BITS) >> _MANTISSA)
    mantissa = np.int32(bits - np.int32(shift << _MANTISSA)).view(np.float32)
    s = (mantissa - _ONE) / (mantissa + _ONE)
    q = s * s
    log = np.float32(shift) + s * (_LOG1 + q * (_LOG3 + q * (_LOG5 + q * (_LOG7 + q * _LOG9))))
    scaled = exponent * log
    integer = np.floor(scaled + _HALF)
    r = scaled - integer
    fraction = _ONE + r * (
        _EXP1 + r * (_EXP2 + r * (_EXP3 + r * (_EXP4 + r * (_EXP5 + r * (_EXP6 + r * _EXP7)))))
    )
    scale = np.int32(np.int32(np.int32(integer) + _BIAS) << _MANTISSA).view(np.float32)
    return fraction * scale if base >= MIN_BASE else _ZERO


# Opponent colours of an image: y, x - y and y - z, each of x, y, z 0 to 1 (white).
OPPONENT_PLANES = 3

# Linear sRGB to CIE XYZ, as the paper's code has it, in relation to white: rows sum to 1.
TO_XYZ = np.array(
    [
        [10135552 / 24577794, 8788810 / 24577794, 4435075 / 24577794],
        [2613072 / 12288897, 8788810 / 12288897, 887015 / 12288897],
        [1425312 / 73733382, 8788810 / 73733382, 70074185 / 73733382],
    ]
)
TO_XYZ /= TO_XYZ.sum(axis=1, keepdims=True)
_XR, _XG, _XB, _YR, _YG, _YB, _ZR, _ZG, _ZB = TO_XYZ.astype(np.float32).ravel()
_RX, _RY, _RZ, _GX, _GY, _GZ, _BX, _BY, _BZ = np.linalg.inv(TO_XYZ).astype(np.float32).ravel()

_SRGB_TOE, _SRGB_EXPONENT = np.float32(0.04045), np.float32(2.4)
_SRGB_SLOPE, _SRGB_SCALE = np.float32(1 / 12.92), np.float32(1 / 1.055)
_SRGB_OFFSET = np.float32(0.055 / 1.055)
_PEAK, _UNIT = np.float32(255), np.float32(1 / 255)

# ACES as Narkowicz fits it, with the exposure of 0.6 that goes with the fit: a quotient of two
# quadratic polynomials.
_N2, _N1 = np.float32(0.6**2 * 2.51), np.float32(0.6 * 0.03)
_D2, _D1, _D0 = np.float32(0.6**2 * 2.43), np.float32(0.6 * 0.59), np.float32(0.14)


# The brightest value that HDR-FLIP wants to show, of which the tone mapper makes 0.85. With float32
# coefficients, as the authors' package: where luminances lie whole stops apart, the last digit
# decides on the number of exposures.
_TONE = np.float32(0.85)
_A, _B, _C = (float(v) for v in (_N2 - _TONE * _D2, _N1 - _TONE * _D1, -_TONE * _D0))
SATURATED = np.float32((-_B + np.sqrt(_B * _B - 4 * _A * _C)) / (2 * _A))


@inline
def _to_xyz(r: np.float32, g: np.float32, b: np.float32) -> tuple[np.float32, ...]:
    """Return CIE XYZ relative to white, 0 to 1, of linear colour, 0 to 1."""
    x = _XR * r + _XG * g + _XB * b
    y = _YR * r + _YG * g + _YB * b
    z = _ZR * r + _ZG * g + _ZB * b
    return x, y, z


@ParallelKernel
def write_opponent(
    image: F32,  # [H, W, 3 or more], sRGB primaries
    # gain: factor before the tone mapper, up to 2^25, of a scene-linear image, 0 to 65504; 0 for an
    # image that is display-encoded, 0 to 255, and clipped to that
    gain: np.float32,
    planes: F32,  # [OPPONENT_PLANES, H, W], written
    band: Band,
) -> None:
    """Write the opponent colours of an image as displayed."""
    # LLVM vectorises these loops only where the values of a channel lie together.
    lines = np.empty((3, image.shape[1]), np.float32)
    r, g, b = lines[0], lines[1], lines[2]
    for row in band_range(image.shape[0], band):
        for c in range(3):
            line = lines[c]
            for i in range(line.size):
                line[i] = image[row, i, c]
            if gain > 0:
                for i in range(line.size):
                    v = line[i] * gain
                    line[i] = min(v * (v * _N2 + _N1) / (v * (v * _D2 + _D1) + _D0), _ONE)
            else:
                for i in range(line.size):
                    v = min(max(line[i], _ZERO), _PEAK) * _UNIT
                    curve = power(v * _SRGB_SCALE + _SRGB_OFFSET, _SRGB_EXPONENT)
                    line[i] = v * _SRGB_SLOPE if v <= _SRGB_TOE else curve
        achromatic, red_green, blue_yellow = planes[0, row], planes[1, row], planes[2, row]
        for i in range(r.size):
            x, y, z = _to_xyz(r[i], g[i], b[i])
            achromatic[i] = y
            red_green[i] = x - y
            blue_yellow[i] = y - z


# A 4K display, 0.7 m wide, seen from 0.7 m: 67.02.
PIXELS_PER_DEGREE = 0.7 * (3840 / 0.7) * np.pi / 180

_NEGLIGIBLE = 1e-9  # Weights below this share of the largest change no float32 sum

# Spreads b of the Gaussians sqrt(pi / b) exp(-pi^2 x^2 / b), x in degrees; the blue-yellow channel
# has two, of different heights.
_ACHROMATIC, _RED_GREEN = 0.0047, 0.0053
_BLUE_YELLOW = (34.1, 0.04), (13.5, 0.025)

_FEATURE_WIDTH = 0.082  # Of edges and points, in degrees


def _total(weights: F64) -> float:
    """Sum weights over both sides and the centre."""
    return float(2 * weights.sum() - weights[0])


def _filters() -> list[F64]:
    """Return the Gaussians of the channels, the shares of the last two, and the detectors' three.

    The last two Gaussians are those of one channel down, and their shares those along. Features are
    found by a Gaussian and its first and second derivative.
    """
    widest = max(b for _, b in _BLUE_YELLOW)
    radius = int(np.ceil(3 * np.sqrt(widest / (2 * np.pi**2)) * PIXELS_PER_DEGREE))
    x = np.arange(radius + 1) / PIXELS_PER_DEGREE
    achromatic, red_green = (np.exp(-((np.pi * x) ** 2) / b) for b in (_ACHROMATIC, _RED_GREEN))
    blue_yellow = [np.exp(-((np.pi * x) ** 2) / b) for _, b in _BLUE_YELLOW]
    heights = [a * np.sqrt(np.pi / b) for a, b in _BLUE_YELLOW]
    volume = sum(a * _total(bell) ** 2 for a, bell in zip(heights, blue_yellow, strict=True))
    shares = [a * bell / volume for a, bell in zip(heights, blue_yellow, strict=True)]
    channels = [achromatic / _total(achromatic), red_green / _total(red_green), *blue_yellow]
    # Positive weights of the detectors sum to 1 and negative ones to -1.
    sigma = 0.5 * _FEATURE_WIDTH * PIXELS_PER_DEGREE
    steps = np.arange(int(np.ceil(3 * sigma)) + 1)
    bell = np.exp(-(steps**2) / (2 * sigma**2))
    slope = steps * bell
    bend = (steps**2 / sigma**2 - 1) * bell
    outside, inside = np.where(bend > 0, bend, 0), np.where(bend < 0, bend, 0)
    bend = outside / _total(outside) - inside / _total(inside)
    return [*channels, *shares, bell / _total(bell), slope / slope.sum(), bend]


_ALL = _filters()
# The filters' numbers.
BRIGHT, RED_GREEN, WIDE, NARROW, WIDE_SHARE, NARROW_SHARE, BELL, SLOPE, BEND = range(len(_ALL))

HALO = max(map(len, _ALL)) - 1  # Samples that a line has on either side of the image

_WEIGHTS = np.array([np.pad(w, (0, HALO + 1 - len(w))) for w in _ALL], np.float32)
_COUNTS = np.array([np.flatnonzero(w > _NEGLIGIBLE * w.max()).max() + 1 for w in _ALL])
# Of the samples above and to the left.
_SIGNS = np.array([-1 if n == SLOPE else 1 for n in range(len(_ALL))], np.float32)


# One array written and two read, as LLVM vectorises only loops that need few checks for overlap.
@device_function
def _scale_line(weight: np.float32, a: F32, out: F32) -> None:
    for i in range(out.size):
        out[i] = weight * a[i]


@device_function
def _add_pair(total: F32, weight: np.float32, a: F32, sign: np.float32, b: F32) -> None:
    for i in range(total.size):
        total[i] += weight * (b[i] + sign * a[i])


# Planes of what is seen: lightness, red-green, blue-yellow, strength of edges and of points.
PERCEIVED_PLANES = 5

# CIELAB; all of it scaled so that lightness is 0 to 100.
_LAB_TOE, _LAB_SLOPE = np.float32((6 / 29) ** 3), np.float32(29**2 / (3 * 6**2))
_LAB_OFFSET, _THIRD = np.float32(4 / 29), np.float32(1 / 3)
_L1, _L0, _HUNT = np.float32(116), np.float32(16), np.float32(0.01)
_A1, _B1 = np.float32(500), np.float32(200)


@inline
def _lab_curve(value: np.float32) -> np.float32:
    """Return CIELAB's cube root with its straight toe, of 0 to 1."""
    toe = value * _LAB_SLOPE + _LAB_OFFSET
    return power(value, _THIRD) if value > _LAB_TOE else toe


# The plane, the filter down and the filter along. A table, as each call compiles for 0.1 s.
_PASSES = np.array(
    [
        (0, BRIGHT, BRIGHT),
        (1, RED_GREEN, RED_GREEN),
        (2, WIDE, WIDE_SHARE),
        (2, NARROW, NARROW_SHARE),
        (0, BELL, SLOPE),
        (0, SLOPE, BELL),
        (0, BELL, BEND),
        (0, BEND, BELL),
    ]
)


@ParallelKernel
def write_perceived(
    planes: F32,  # [OPPONENT_PLANES, H, W], opponent colours
    # perceived: [PERCEIVED_PLANES, H, W], written: CIELAB with Hunt's effect; edges and points, 0
    # to sqrt(2)
    perceived: F32,
    band: Band,
) -> None:
    """Write what a viewer sees of an image (sections 4.1.1, 4.1.2 and 4.2.1)."""
    last, width = planes.shape[1] - 1, planes.shape[2]
    line = np.empty(width + 2 * HALO, np.float32)
    inner = line[HALO : HALO + width]
    filtered = np.empty((_PASSES.shape[0], width), np.float32)
    for row in band_range(planes.shape[1], band):
        for n in range(_PASSES.shape[0]):
            plane, down, along = planes[_PASSES[n, 0]], _PASSES[n, 1], _PASSES[n, 2]
            _scale_line(_WEIGHTS[down, 0], plane[row], inner)
            for k in range(1, _COUNTS[down]):
                above, below = plane[max(row - k, 0)], plane[min(row + k, last)]
                _add_pair(inner, _WEIGHTS[down, k], above, _SIGNS[down], below)
            line[:HALO] = inner[0]
            line[HALO + width :] = inner[width - 1]
            out = filtered[n]
            _scale_line(_WEIGHTS[along, 0], line[HALO:], out)
            for k in range(1, _COUNTS[along]):
                _add_pair(
                    out, _WEIGHTS[along, k], line[HALO - k :], _SIGNS[along], line[HALO + k :]
                )
        # CIELAB with Hunt's effect (section 4.1.2). What no display can show is clipped first;
        # chroma is scaled by lightness.
        achromatic, red_green, wide, narrow = filtered[0], filtered[1], filtered[2], filtered[3]
        lightness, a, b = perceived[0, row], perceived[1, row], perceived[2, row]
        for i in range(width):
            y = achromatic[i]
            x, z = y + red_green[i], y - (wide[i] + narrow[i])
            red = min(max(_RX * x + _RY * y + _RZ * z, _ZERO), _ONE)
            green = min(max(_GX * x + _GY * y + _GZ * z, _ZERO), _ONE)
            blue = min(max(_BX * x + _BY * y + _BZ * z, _ZERO), _ONE)
            x, y, z = _to_xyz(red, green, blue)
            fx, fy, fz = _lab_curve(x), _lab_curve(y), _lab_curve(z)
            light = _L1 * fy - _L0
            lightness[i] = light
            a[i] = _HUNT * light * (_A1 * (fx - fy))
            b[i] = _HUNT * light * (_B1 * (fy - fz))
        for n in range(2):  # strengths of edges, and of points
            right, down, length = filtered[4 + 2 * n], filtered[5 + 2 * n], perceived[3 + n, row]
            for i in range(width):
                length[i] = np.sqrt(right[i] * right[i] + down[i] * down[i])


# Distances to the power of 0.7; those below 0.4 of the largest take 0.95 of the range. Green and
# blue are farthest apart (section 4.1.3).
_DISTANCE_EXPONENT = np.float32(0.7)
_X, _Y, _Z = np.cbrt(TO_XYZ[:, 1:])
_LIGHTNESS, _CHROMA = 116 * _Y - 16, 0.01 * (116 * _Y - 16)
_GREEN_TO_BLUE = np.diff([_LIGHTNESS, _CHROMA * 500 * (_X - _Y), _CHROMA * 200 * (_Y - _Z)])[:, 0]
_LARGEST = float((abs(_GREEN_TO_BLUE[0]) + np.hypot(*_GREEN_TO_BLUE[1:])) ** 0.7)
_BEND, _AT_BEND = np.float32(0.4 * _LARGEST), np.float32(0.95)
_BELOW, _ABOVE = np.float32(0.95 / (0.4 * _LARGEST)), np.float32((1 - 0.95) / (0.6 * _LARGEST))

_ROOT_HALF = np.float32(np.sqrt(0.5))


@ParallelKernel
def raise_flip_error(
    reference: F32,  # [PERCEIVED_PLANES, H, W], as `test`; from `write_perceived`
    test: F32,
    error: F32,  # [H, W], 0 to 1: becomes the larger of itself and the pair's FLIP error
    band: Band,
) -> None:
    """Raise an error map to the error of a pair of images (sections 4.1.3, 4.2.2 and 4.3)."""
    colour = np.empty(error.shape[1], np.float32)
    for row in band_range(error.shape[0], band):
        l0, a0, b0 = reference[0, row], reference[1, row], reference[2, row]
        l1, a1, b1 = test[0, row], test[1, row], test[2, row]
        e0, p0, e1, p1 = reference[3, row], reference[4, row], test[3, row], test[4, row]
        for i in range(colour.size):
            da, db = a0[i] - a1[i], b0[i] - b1[i]
            distance = abs(l0[i] - l1[i]) + np.sqrt(da * da + db * db)
            curved = power(distance, _DISTANCE_EXPONENT)
            colour[i] = _BELOW * curved if curved < _BEND else _AT_BEND + _ABOVE * (curved - _BEND)
        out = error[row]
        for i in range(out.size):
            feature = np.sqrt(_ROOT_HALF * max(abs(e0[i] - e1[i]), abs(p0[i] - p1[i])))
            value = power(colour[i], _ONE - min(feature, _ONE))
            out[i] = max(out[i], min(value, _ONE))


SSIM_RADIUS = 5  # Taps on either side of the centre: 3.5 sigma, rounded

SSIM_SIGMA = 1.5
SSIM_RANGE = 255.0
SSIM_C1 = (0.01 * SSIM_RANGE) ** 2
SSIM_C2 = (0.03 * SSIM_RANGE) ** 2

_SSIM_TAPS = np.exp(-0.5 * (np.arange(-SSIM_RADIUS, SSIM_RADIUS + 1) / SSIM_SIGMA) ** 2)
W0, W1, W2, W3, W4, W5 = (float(w) for w in (_SSIM_TAPS / _SSIM_TAPS.sum())[SSIM_RADIUS:])


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
    _write_ssim(x, y, channels, out)
    return out.reshape(height, width, channels)


@device_function
def _mirror_index(i: int, n: int) -> int:
    """Return index i of a line of n samples that is reflected about its outer edges."""
    i = i % (2 * n)
    return i if i < n else 2 * n - 1 - i


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
        # Loops apart, with one array written in each, because LLVM vectorises only loops that need
        # few checks for overlap. As one loop they took 132 ms instead of 44.
        for i in range(sx.size):
            sx[i] += weight * (np.float64(a[i]) + np.float64(c[i]))
        for i in range(sy.size):
            sy[i] += weight * (np.float64(b[i]) + np.float64(d[i]))
        for i in range(ss.size):
            e, f, g, h = np.float64(a[i]), np.float64(b[i]), np.float64(c[i]), np.float64(d[i])
            ss[i] += weight * ((e * e + f * f) + (g * g + h * h))
        for i in range(sp.size):
            e, f, g, h = np.float64(a[i]), np.float64(b[i]), np.float64(c[i]), np.float64(d[i])
            sp[i] += weight * (e * f + g * h)


@ParallelKernel
def _write_ssim(x: F32, y: F32, channels: int, out: F32, band: Band) -> None:
    height, span = x.shape
    width, halo = span // channels, SSIM_RADIUS * channels
    sums, means = np.empty((4, span + 2 * halo)), np.empty((4, span))
    for row in band_range(height, band):
        _blur_columns(x, y, row, halo, sums)
        for j in range(4):
            line = sums[j]
            for p in range(SSIM_RADIUS):
                left = (_mirror_index(p - SSIM_RADIUS, width) + SSIM_RADIUS) * channels
                right = (_mirror_index(p + width, width) + SSIM_RADIUS) * channels
                for c in range(channels):
                    line[p * channels + c] = line[left + c]
                    line[(p + width + SSIM_RADIUS) * channels + c] = line[right + c]
            # Blurred along, where the samples of one channel are so far apart.
            mean, s = means[j], channels
            a, b, c, d, e = line, line[s:], line[2 * s :], line[3 * s :], line[4 * s :]
            f, g, h = line[5 * s :], line[6 * s :], line[7 * s :]
            t, u, v = line[8 * s :], line[9 * s :], line[10 * s :]
            for i in range(span):
                mean[i] = W0 * f[i] + W1 * (e[i] + g[i]) + W2 * (d[i] + h[i])
            for i in range(span):
                mean[i] += W3 * (c[i] + t[i]) + W4 * (b[i] + u[i]) + W5 * (a[i] + v[i])
        mean_x, mean_y, squares, products = means[0], means[1], means[2], means[3]
        similarity = out[row]
        for i in range(similarity.size):
            product = mean_x[i] * mean_y[i]
            powers = mean_x[i] * mean_x[i] + mean_y[i] * mean_y[i]
            top = (2.0 * product + SSIM_C1) * (2.0 * (products[i] - product) + SSIM_C2)
            similarity[i] = np.float32(top / ((powers + SSIM_C1) * (squares[i] - powers + SSIM_C2)))
