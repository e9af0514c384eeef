"""Powers of float32 numbers that LLVM can take eight at a time.

Without Intel's SVML numba calls the C library's ``pow`` once for each number: 14 of them for a pair
of pixels were two thirds of FLIP's time.
"""

from __future__ import annotations

import numpy as np

from exwarp_cli.kernels._compile import inlined

_MANTISSA = np.int32(23)
"""Bits of a float32's mantissa."""

_ROOT_HALF = np.int32(np.float32(np.sqrt(0.5)).view(np.int32))
"""Bits of the least mantissa: those from sqrt(1/2) to sqrt(2) lie closest around 1."""

_BIAS = np.int32(127)

_ONE, _TWO, _HALF, _ZERO = np.float32(1), np.float32(2), np.float32(0.5), np.float32(0)

LEAST = np.float32(1e-30)
"""What is smaller counts as 0."""

# log2((1 + s) / (1 - s)) = 2 / ln 2 * (s + s^3 / 3 + ...); the next term is below 4e-9 of the sum.
_L1, _L3, _L5, _L7, _L9 = (np.float32(2 / np.log(2) / n) for n in (1, 3, 5, 7, 9))

# 2^x = 1 + x ln 2 + (x ln 2)^2 / 2! + ...; the next term is below 6e-9.
_E1, _E2, _E3, _E4, _E5, _E6, _E7 = (
    np.float32(np.log(2) ** n / f) for n, f in enumerate((1, 2, 6, 24, 120, 720, 5040), 1)
)


@inlined
def power(base: np.float32, exponent: np.float32) -> np.float32:
    """Return base ** exponent; both 0 or more, the result 2^-126 to 2^126.

    Within 2e-6 of the value; below `LEAST` the base counts as 0, and the result is 0 whatever the
    exponent. All operations are single float32 ones, so that builds agree in every bit.
    """
    # The casts tell numba the type; they change nothing.
    bits = np.float32(base).view(np.int32)
    shift = np.int32(np.int32(bits - _ROOT_HALF) >> _MANTISSA)
    mantissa = np.int32(bits - np.int32(shift << _MANTISSA)).view(np.float32)
    s = (mantissa - _ONE) / (mantissa + _ONE)
    q = s * s
    log = np.float32(shift) + s * (_L1 + q * (_L3 + q * (_L5 + q * (_L7 + q * _L9))))
    place = exponent * log
    whole = np.floor(place + _HALF)
    r = place - whole
    part = _ONE + r * (_E1 + r * (_E2 + r * (_E3 + r * (_E4 + r * (_E5 + r * (_E6 + r * _E7))))))
    scale = np.int32(np.int32(np.int32(whole) + _BIAS) << _MANTISSA).view(np.float32)
    return part * scale if base >= LEAST else _ZERO
