"""How large a frame may say that it is: a few bytes of a header can ask for any memory."""

from __future__ import annotations

from pathlib import Path

from exwarp_cli.errors import LayoutError

MOST_PIXELS = 2**28
"""Pixels of a frame that are read unless more is allowed: 16384x16384."""

_most = MOST_PIXELS


def allow(pixels: int) -> None:
    """Set how many pixels a frame may have."""
    global _most
    _most = pixels


def require_size(path: Path, width: int, height: int) -> None:
    """Refuse a frame that says it is larger than allowed.

    Raises
    ------
    LayoutError
        When it does.
    """
    if width * height > _most:
        raise LayoutError(
            f"{path} says that it is {width}x{height} pixels, more than --max-pixels {_most}; "
            "render or copy it again if it is not, or allow more"
        )


def require_canvas(what: object, width: int, height: int) -> None:
    """Refuse windows that lie so far apart that no frame may be as large as what holds them all.

    Raises
    ------
    LayoutError
        When they do.
    """
    if width * height > _most:
        raise LayoutError(
            f"the data and display windows of {what} lie in {width}x{height} pixels, more than "
            f"--max-pixels {_most}; correct them, or allow more"
        )
