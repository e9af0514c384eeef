"""Colour between scene-linear light and displays: primaries, view transforms, the sRGB curve."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import OpenImageIO as oiio

from exwarp_cli.domain.colour import SRGB
from exwarp_cli.domain.frame import Float32, UInt8
from exwarp_cli.domain.settings import SRGB_VIEW
from exwarp_cli.errors import InstallationError, UsageError
from exwarp_cli.io.exr.reader import read_headers
from exwarp_cli.io.sequences import EXR, Sequence

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

HALF_MAX = 65504.0  # replaces infinity before channels are mixed
MAX_PIXEL_ASPECT = 255  # that a video is labelled with; its inverse is the smallest

# Matrices of Y'CbCr as files are labelled, with the names that the filter ``scale`` has.
MATRICES = {
    "bt709": "bt709",
    "smpte170m": "smpte170m",
    "bt470bg": "bt470",
    "fcc": "fcc",
    "smpte240m": "smpte240m",
    "bt2020nc": "bt2020",
}


# Views by name: configuration, display and view. The configurations come with OpenColorIO; their
# versions are fixed, so that another OpenColorIO shows the same picture.
BUILT_IN = {
    "aces1": (
        "ocio://cg-config-v1.0.0_aces-v1.3_ocio-v2.1",
        "sRGB - Display",
        "ACES 1.0 - SDR Video",
    ),
    "aces2": (
        "ocio://cg-config-v4.0.0_aces-v2.0_ocio-v2.5",
        "sRGB - Display",
        "ACES 2.0 - SDR 100 nits (Rec.709)",
    ),
}

# OpenImageIO's name of scene-linear Rec. 709, in every configuration.
SOURCE_SPACE = "lin_rec709"


@dataclass(frozen=True)
class VideoColour:
    """How a video's numbers mean colour: ffmpeg's names, as the encoder is to label them."""

    matrix: str = "bt709"  # of Y'CbCr, one of `MATRICES`
    # By ffmpeg's names, "unknown" among them
    primaries: str = "bt709"
    transfer: str = "iec61966-2-1"
    full_range: bool = False  # whether 0 to 255 are used, else 16 to 235

    @property
    def range(self) -> str:
        """The range by the name that filters take."""
        return "pc" if self.full_range else "tv"


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
    chromaticities = _finite_numbers(header.get("chromaticities"), 8)
    if chromaticities is None:
        return None
    neutral = _finite_numbers(header.get("adoptedNeutral"), 2)
    if neutral is None or not neutral[1] > 0:
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


def _finite_numbers(value: object, count: int) -> Float64 | None:
    """Return an attribute's numbers; None unless they are finite and so many."""
    try:
        numbers = np.array(value, np.float64).ravel()
    except (TypeError, ValueError):
        return None
    return numbers if numbers.shape == (count,) and np.isfinite(numbers).all() else None


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


def parse_pixel_aspect(ratio: object) -> Fraction:
    """Read a header's width of a pixel by its height; 1 for what no pixel can have."""
    limit = MAX_PIXEL_ASPECT
    if not isinstance(ratio, (int, float)) or not 1 / limit <= ratio <= limit:
        return Fraction(1)
    # A float32 of 16/15 is no exact fraction; videos hold one of small numbers.
    return Fraction(ratio).limit_denominator(limit)


def brighten(pixels: Float32, stops: float) -> Float32:
    """Multiply scene-linear colour by two to the power of `stops`; beyond float32 is infinity."""
    with np.errstate(over="ignore"):
        brighter: Float32 = pixels * np.float32(2.0**stops)
    return brighter


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
    linear: Float32 = _linear_table(codes.dtype.itemsize)[codes]
    return linear


@cache
def _linear_table(size: int) -> Float32:
    return SRGB.to_linear(np.linspace(0, 1, 256**size, dtype=np.float32))


@dataclass(frozen=True)
class ViewTransform:
    """A view of an OpenColorIO configuration."""

    name: str  # as the user gives it
    config: str  # absolute path, or the ``ocio://`` name of a configuration of OpenColorIO's own
    display: str
    view: str

    def apply(self, linear: Float32) -> Float32:
        """Return what a display shows of scene-linear colour.

        `linear` is float32 [H, W, 3 or more], Rec. 709 primaries. NaN count as 0 and infinities as
        the largest half float. Returns float32 [H, W, 3], light of an sRGB display, 0 to 1: the
        sRGB curve makes the view's codes of it.

        Raises UsageError, for views in `BUILT_IN` InstallationError, if OpenColorIO cannot do it.
        """
        finite = np.nan_to_num(linear[..., :3], nan=0.0, posinf=HALF_MAX, neginf=-HALF_MAX)
        source = oiio.ImageBuf(np.ascontiguousarray(finite.clip(-HALF_MAX, HALF_MAX)))
        shown = oiio.ImageBufAlgo.ociodisplay(
            source, self.display, self.view, SOURCE_SPACE, colorconfig=self.config
        )
        if shown.has_error:
            (first, *_) = shown.geterror().splitlines() or ["nothing"]
            refused = f"--view-transform {self.name} cannot be used, as OpenImageIO says {first!r}"
            if self.name in BUILT_IN:
                raise InstallationError(f"{refused}; install a newer OpenImageIO, or use srgb")
            raise UsageError(f"{refused}; correct the configuration, the display or the view")
        codes = np.asarray(shown.get_pixels(oiio.FLOAT), np.float32)
        return SRGB.to_linear(codes.clip(0, 1))


@dataclass(frozen=True)
class DisplayLook:
    """How a display shows the frames of a sequence."""

    primaries: Primaries | None = None  # of the frames; None for Rec. 709
    transform: ViewTransform | None = None  # None for the sRGB curve alone

    def apply(self, linear: Float32, exposure_stops: float = 0.0) -> Float32:
        """Return the light of a display, Rec. 709, that shows scene-linear colour.

        `linear` and the result are float32 [H, W, 3 or more]; a display clips what is not from 0
        to 1. `exposure_stops` brighten before the view transform.
        """
        if self.primaries is not None:
            linear = self.primaries.converted(linear)
        if exposure_stops:
            linear = brighten(linear, exposure_stops)
        return linear if self.transform is None else self.transform.apply(linear)


def find_display_look(sequence: Sequence, transform: ViewTransform | None) -> DisplayLook:
    """Return how a display shows a sequence: the header of its first EXR has the primaries."""
    if sequence.type not in EXR:
        return DisplayLook(None, transform)
    header = read_headers(sequence.files[min(sequence.files)])[0]
    return DisplayLook(primaries_of(header), transform)


def find_view_transform(name: str, *shown: Sequence) -> ViewTransform | None:
    """Return the view transform of a name, for these sequences; None for the sRGB curve alone.

    Raises UsageError for a name that is neither ``srgb``, nor in `BUILT_IN`, nor
    ``CONFIG:DISPLAY:VIEW``, for a configuration without that view, and for a sequence that is not
    of scene-linear colour. Raises InstallationError when OpenImageIO has no OpenColorIO, or an
    older one than a view in `BUILT_IN` needs.
    """
    if name == SRGB_VIEW:
        return None
    parts = BUILT_IN.get(name) or tuple(name.rsplit(":", 2))
    if len(parts) != 3 or not (parts[0].startswith("ocio://") or Path(parts[0]).is_absolute()):
        raise UsageError(
            f"--view-transform {name} is not one of {', '.join((SRGB_VIEW, *BUILT_IN))}, and not "
            "CONFIG:DISPLAY:VIEW with the full path of an OpenColorIO configuration"
        )
    view = ViewTransform(name, *parts)
    view.apply(np.zeros((1, 1, 3), np.float32))
    for sequence in shown:
        if sequence.type not in EXR:
            raise UsageError(
                f"--view-transform is for EXR, and {sequence.pattern} is shown as it is; leave it "
                "out"
            )
    return view
