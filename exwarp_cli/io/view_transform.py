"""View transforms: how a display shows scene-linear colour to people."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import OpenImageIO as oiio

from exwarp_cli.domain.colour import SRGB
from exwarp_cli.domain.frame import Float32
from exwarp_cli.domain.settings import SRGB_VIEW
from exwarp_cli.errors import InstallationError, UsageError
from exwarp_cli.io.display_colour import HALF_MAX, Primaries, primaries_of
from exwarp_cli.io.exr.reader import read_headers
from exwarp_cli.io.footage import is_plain
from exwarp_cli.io.sequences import Sequence

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
class ViewTransform:
    """A view of an OpenColorIO configuration."""

    name: str  # as the user gives it
    config: str  # absolute path, or the ``ocio://`` name of a configuration of OpenColorIO's own
    display: str
    view: str

    def apply(self, linear: Float32) -> Float32:
        """Return what a display shows of scene-linear colour.

        Parameters
        ----------
        linear
            float32 [H, W, 3 or more], Rec. 709 primaries. NaN count as 0 and infinities as the
            largest half float.

        Returns
        -------
        float32 [H, W, 3]
            Light of an sRGB display, 0 to 1: the sRGB curve makes the view's codes of it.

        Raises
        ------
        UsageError, InstallationError
            When OpenColorIO cannot do it; the latter for views in `BUILT_IN`.
        """
        finite = np.nan_to_num(linear[..., :3], nan=0.0, posinf=HALF_MAX, neginf=-HALF_MAX)
        source = oiio.ImageBuf(np.ascontiguousarray(finite.clip(-HALF_MAX, HALF_MAX)))
        shown = oiio.ImageBufAlgo.ociodisplay(
            source, self.display, self.view, SOURCE_SPACE, colorconfig=self.config
        )
        if shown.has_error:
            (first, *_) = shown.geterror().splitlines() or ["nothing"]
            why = f"--view-transform {self.name} cannot be used, as OpenImageIO says {first!r}"
            if self.name in BUILT_IN:
                raise InstallationError(f"{why}; install a newer OpenImageIO, or use srgb")
            raise UsageError(f"{why}; correct the configuration, the display or the view")
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
        to 1. `exposure_stops` brighten before the view transform, beyond float32 to infinity.
        """
        if self.primaries is not None:
            linear = self.primaries.converted(linear)
        if exposure_stops:
            with np.errstate(over="ignore"):
                linear = linear * np.float32(2.0**exposure_stops)
        return linear if self.transform is None else self.transform.apply(linear)


def find_display_look(sequence: Sequence, transform: ViewTransform | None) -> DisplayLook:
    """Return how a display shows a sequence: the header of its first EXR has the primaries."""
    if is_plain(sequence):
        return DisplayLook(None, transform)
    header = read_headers(sequence.files[min(sequence.files)])[0]
    return DisplayLook(primaries_of(header), transform)


def find_view_transform(name: str, *shown: Sequence) -> ViewTransform | None:
    """Return the view transform of a name, for these sequences; None for the sRGB curve alone.

    Raises
    ------
    UsageError
        For a name that is neither ``srgb``, nor in `BUILT_IN`, nor ``CONFIG:DISPLAY:VIEW``, for
        a configuration without that view, and for a sequence that is not of scene-linear colour.
    InstallationError
        When OpenImageIO has no OpenColorIO, or an older one than a view in `BUILT_IN` needs.
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
        if is_plain(sequence):
            raise UsageError(
                f"--view-transform is for EXR, and {sequence.pattern} is shown as it is; leave it "
                "out"
            )
    return view
