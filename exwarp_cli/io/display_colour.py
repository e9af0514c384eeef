"""Colour between scene-linear light and displays: primaries, the sRGB curve, and video's labels."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from exwarp_cli.domain.colour import SRGB
from exwarp_cli.domain.frame import Float32, UInt8

UInt16 = npt.NDArray[np.uint16]
Codes = npt.NDArray[np.uint8 | np.uint16]  # of a display
Float64 = npt.NDArray[np.float64]

# x and y of red, green, blue and white, as OpenEXR's attribute ``chromaticities`` has them.
REC709 = (0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.3290)

# Chromaticities of colour spaces by their names.
COLOUR_SPACES = {
    "ACEScg": (0.713, 0.293, 0.165, 0.830, 0.128, 0.044, 0.32168, 0.33767),
    "ACES2065-1": (0.7347, 0.2653, 0.0, 1.0, 0.0001, -0.077, 0.32168, 0.33767),
    "Rec. 2020": (0.708, 0.292, 0.170, 0.797, 0.131, 0.046, 0.3127, 0.3290),
    "P3-D65": (0.680, 0.320, 0.265, 0.690, 0.150, 0.060, 0.3127, 0.3290),
}

TOLERANCE = 5e-4  # between equal chromaticities: headers hold rounded ones

# From XYZ to cone responses (Lam 1985; as in ICC.1:2010, annex E).
BRADFORD: Float64 = np.array(
    [[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]]
)

HALF_MAX = 65504.0  # largest half float; replaces infinity before channels are mixed

# Matrices of Y'CbCr as files are labelled, with the names that the filter ``scale`` has.
MATRICES = {
    "bt709": "bt709",
    "smpte170m": "smpte170m",
    "bt470bg": "bt470",
    "fcc": "fcc",
    "smpte240m": "smpte240m",
    "bt2020nc": "bt2020",
}


@dataclass(frozen=True)
class VideoColour:
    """How a video's numbers mean colour: ffmpeg's names, as the encoder is to label them."""

    matrix: str = "bt709"  # of Y'CbCr, one of `MATRICES`
    # By ffmpeg's names, "unknown" among them
    primaries: str = "bt709"
    transfer: str = "iec61966-2-1"
    full_range: bool = False  # whether 0 to 255 are used, else 16 to 235


@dataclass(frozen=True)
class Primaries:
    """The colours of a file's red, green and blue."""

    name: str  # of the colour space, for a message
    # Matrix by rows, from the file's R, G, B to those of Rec. 709.
    to_rec709: tuple[tuple[float, ...], ...]

    def converted(self, pixels: Float32) -> Float32:
        """Return float32 [H, W, 3] with Rec. 709 primaries, scene-linear as `pixels` [H, W, 3+].

        Unlike the input's, no value is NaN or infinite: NaN becomes 0.
        """
        finite = np.nan_to_num(pixels[..., :3], nan=0.0, posinf=HALF_MAX, neginf=-HALF_MAX)
        mixed: Float32 = finite @ np.array(self.to_rec709, np.float32).T
        return mixed


def primaries_of(header: Mapping[str, Any]) -> Primaries | None:
    """Read the primaries of an EXR header; None for Rec. 709.

    Neutral is what ``adoptedNeutral`` says, else the white of the chromaticities; by Bradford's
    adaptation it becomes neutral in Rec. 709. None also for a header without chromaticities, where
    OpenEXR assumes Rec. 709, and for chromaticities that no colours can have.
    """
    finite: dict[str, Float64] = {}
    for attribute, count in (("chromaticities", 8), ("adoptedNeutral", 2)):
        with suppress(TypeError, ValueError):
            values = np.array(header.get(attribute), np.float64).ravel()
            if values.shape == (count,) and np.isfinite(values).all():
                finite[attribute] = values
    if "chromaticities" not in finite:
        return None
    chromaticities = finite["chromaticities"]
    neutral = finite.get("adoptedNeutral", chromaticities[6:])
    if not neutral[1] > 0:
        neutral = chromaticities[6:]
    if np.allclose([*chromaticities[:6], *neutral], REC709, rtol=0, atol=TOLERANCE):
        return None
    try:
        to_xyz, from_xyz = _rgb_to_xyz(chromaticities), np.linalg.inv(_rgb_to_xyz(np.array(REC709)))
        before, after = BRADFORD @ _xyz(*neutral), BRADFORD @ _xyz(*REC709[6:])
        adaptation = np.asarray(np.linalg.inv(BRADFORD) @ np.diag(after / before) @ BRADFORD)
        matrix = from_xyz @ adaptation @ to_xyz
    except np.linalg.LinAlgError:
        return None
    if not np.isfinite(matrix).all():
        return None
    listed = " ".join(f"{value:.4g}" for value in chromaticities)
    name = f"the chromaticities {listed}"
    for space, numbers in COLOUR_SPACES.items():
        if np.allclose(chromaticities, numbers, rtol=0, atol=TOLERANCE):
            name = space
            break
    return Primaries(name, tuple(tuple(map(float, row)) for row in matrix))


def _rgb_to_xyz(chromaticities: Float64) -> Float64:
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


def to_display(pixels: Float32) -> UInt8:
    """Turn scene-linear colour into 8-bit sRGB [H, W, 3], rounded half up (IEC 61966-2-1).

    `pixels` are float32 [H, W, 3 or more] with Rec. 709 primaries; channels past the third are
    dropped. NaN and negative infinity become 0, positive infinity 255.
    """
    return _round_codes(pixels, 255.0).astype(np.uint8)


def to_display_16(pixels: Float32) -> UInt16:
    """Turn scene-linear colour into 16-bit sRGB as `to_display` does; white is 65535."""
    return _round_codes(pixels, 65535.0).astype(np.uint16)


def _round_codes(pixels: Float32, white: float) -> Float32:
    linear = np.nan_to_num(pixels[..., :3], nan=0.0, posinf=1.0, neginf=0.0).clip(0.0, 1.0)
    codes: Float32 = np.floor(SRGB.to_code(linear) * np.float32(white) + np.float32(0.5))
    return codes


def from_display(codes: Codes) -> Float32:
    """Turn sRGB codes, uint8 or uint16, into scene-linear float32, 0 to 1 (IEC 61966-2-1).

    For 8 bits it is the inverse of `to_display`. The type's largest value is white.
    """
    table = SRGB.to_linear(np.linspace(0, 1, 256**codes.dtype.itemsize, dtype=np.float32))
    return np.take(table, codes)
