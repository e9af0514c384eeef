"""From a header's chromaticities to the primaries of Rec. 709, which displays and video have."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from exwarp_cli.domain.frame import Float32

Float64 = npt.NDArray[np.float64]

REC709 = (0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.3290)
"""x and y of red, green, blue and white, as OpenEXR's attribute ``chromaticities`` has them."""

KNOWN = {
    "ACEScg": (0.713, 0.293, 0.165, 0.830, 0.128, 0.044, 0.32168, 0.33767),
    "ACES2065-1": (0.7347, 0.2653, 0.0, 1.0, 0.0001, -0.077, 0.32168, 0.33767),
    "Rec. 2020": (0.708, 0.292, 0.170, 0.797, 0.131, 0.046, 0.3127, 0.3290),
    "P3-D65": (0.680, 0.320, 0.265, 0.690, 0.150, 0.060, 0.3127, 0.3290),
}
"""Chromaticities of colour spaces by their names."""

NEAR = 5e-4
"""Difference up to which chromaticities are the same: headers hold rounded ones."""

BRADFORD: Float64 = np.array(
    [[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]]
)
"""From XYZ to cone responses (Lam 1985; as in ICC.1:2010, annex E)."""

BRIGHTEST = 65504.0
"""What infinity becomes before channels are mixed: the largest half float."""


@dataclass(frozen=True)
class Primaries:
    """What red, green and blue of a file mean.

    Attributes
    ----------
    name
        Of the colour space, for a message.
    to_rec709
        Matrix by rows, from the file's R, G, B to those of Rec. 709.
    """

    name: str
    to_rec709: tuple[tuple[float, ...], ...]

    def converted(self, pixels: Float32) -> Float32:
        """Return float32 [H, W, 3] with Rec. 709 primaries, scene-linear as `pixels` [H, W, 3+].

        Unlike the input's, no value is NaN or infinite: NaN becomes 0.
        """
        finite = np.nan_to_num(pixels[..., :3], nan=0.0, posinf=BRIGHTEST, neginf=-BRIGHTEST)
        mixed: Float32 = finite @ np.array(self.to_rec709, np.float32).T
        return mixed


def primaries_of(header: Mapping[str, Any]) -> Primaries | None:
    """Read the primaries of an EXR header.

    Neutral is what ``adoptedNeutral`` says, else the white of the chromaticities; by Bradford's
    adaptation it becomes neutral in Rec. 709.

    Returns
    -------
    Primaries or None
        None for Rec. 709, for a header without chromaticities, where OpenEXR assumes Rec. 709, and
        for chromaticities that no colours can have.
    """
    stated = _numbers(header.get("chromaticities"), 8)
    if stated is None:
        return None
    neutral = _numbers(header.get("adoptedNeutral"), 2)
    if neutral is None or not neutral[1] > 0:
        neutral = stated[6:]
    if np.allclose([*stated[:6], *neutral], REC709, rtol=0, atol=NEAR):
        return None
    try:
        matrix = np.linalg.inv(_to_xyz(np.array(REC709))) @ _adapted(neutral) @ _to_xyz(stated)
    except np.linalg.LinAlgError:
        return None
    if not np.isfinite(matrix).all():
        return None
    known = (n for n, xy in KNOWN.items() if np.allclose(stated, xy, rtol=0, atol=NEAR))
    listed = " ".join(f"{value:.4g}" for value in stated)
    name = next(known, f"the chromaticities {listed}")
    return Primaries(name, tuple(tuple(map(float, row)) for row in matrix))


def _numbers(value: object, count: int) -> Float64 | None:
    """Return an attribute's finite numbers; None where it has others, or another count."""
    try:
        numbers = np.array(value, np.float64).ravel()
    except (TypeError, ValueError):
        return None
    return numbers if numbers.shape == (count,) and np.isfinite(numbers).all() else None


def _to_xyz(chromaticities: Float64) -> Float64:
    """Return the matrix from R, G, B to XYZ, where white has Y = 1 (SMPTE RP 177)."""
    with np.errstate(divide="ignore", invalid="ignore"):
        red, green, blue, white = (_xyz(x, y) for x, y in chromaticities.reshape(4, 2))
        columns = np.stack([red, green, blue], axis=-1)
    if not np.isfinite([*columns.ravel(), *white]).all():
        raise np.linalg.LinAlgError
    return columns * np.linalg.solve(columns, white)


def _xyz(x: float, y: float) -> Float64:
    """Return XYZ with Y = 1."""
    return np.array([x / y, 1.0, (1.0 - x - y) / y])


def _adapted(neutral: Float64) -> Float64:
    """Return the matrix in XYZ that turns a neutral's chromaticity into the white of Rec. 709."""
    before, after = BRADFORD @ _xyz(*neutral), BRADFORD @ _xyz(*REC709[6:])
    return np.asarray(np.linalg.inv(BRADFORD) @ np.diag(after / before) @ BRADFORD)
