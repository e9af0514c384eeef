"""Fixed-point numbers, and how they are rounded.

A state is 32-bit fixed point with 16 fractional bits (Q16.16): the int32 `x` stands for
`x / 65536`. Every rounding is to the nearest, and of two equally near to the larger ("half up"),
which in hardware is one addition and one arithmetic shift.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from exwarp_cli.kernels.array_types import F64, I32, I64

FRACTION_BITS = 16

ONE = 1 << FRACTION_BITS  # 1.0 in Q16.16

# Largest shift of a requantisation. An int32 times a multiplier below 2^31 lies within +-2^62, and
# the rounding term is 2^61 at most, so that no sum leaves int64.
MAX_SHIFT = 62

MAX_MULTIPLIER = 2**31 - 1  # largest multiplier of a requantisation; the least is 1

MAX_ACTIVATION = 127  # activations are int8 in 0 … 127: ReLU and saturation are one clamp

_INT32 = np.iinfo(np.int32)


def to_fixed(values: npt.ArrayLike) -> I32:
    """Convert float64 numbers of any shape to Q16.16, rounding half up.

    Values beyond +-32768 saturate, infinities included. NaN gives 0; callers that must reject it
    check before.
    """
    scaled = np.asarray(values, np.float64) * ONE
    scaled = np.clip(np.where(np.isnan(scaled), 0.0, scaled), _INT32.min, _INT32.max)
    # Adding a half first would itself round: the double just below 0.5 would become 1.
    whole = np.floor(scaled)
    rounded = whole + (scaled - whole >= 0.5)
    return np.asarray(rounded).astype(np.int32)


def from_fixed(values: I32) -> F64:
    """Return what Q16.16 numbers stand for, exactly; float64 of the same shape."""
    return np.asarray(values, np.float64) / ONE


def requantise_half_up(
    value: npt.ArrayLike,  # int32
    multiplier: npt.ArrayLike,  # 1 … MAX_MULTIPLIER
    shift: npt.ArrayLike,  # 0 … MAX_SHIFT
) -> I64:
    """Multiply by ``multiplier / 2**shift``, rounding half up; int64, not saturated.

    The result is ``floor((value * multiplier + 2**(shift - 1)) / 2**shift)``, without the rounding
    term for shift 0: a 32x32 bit multiplication, an addition and an arithmetic right shift.
    """
    product = np.asarray(value, np.int64) * np.asarray(multiplier, np.int64)
    places = np.asarray(shift, np.int64)
    half = (np.int64(1) << places) >> np.int64(1)
    return np.asarray((product + half) >> places)


def saturate(values: npt.ArrayLike, low: int, high: int) -> I64:
    """Clamp to `low` … `high`; int64 of the same shape."""
    return np.asarray(np.clip(np.asarray(values, np.int64), np.int64(low), np.int64(high)))
