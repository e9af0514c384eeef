"""How large a frame may say that it is: a few bytes of a header can ask for any memory."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from exwarp_cli.errors import LayoutError

if TYPE_CHECKING:
    from exwarp_cli.domain.frame import Window

MOST_PIXELS = 2**28
"""Pixels of a frame that are read unless more is allowed: 16384x16384."""

_most = MOST_PIXELS


def allow(pixels: int) -> None:
    """Set how many pixels a frame may have."""
    global _most
    _most = pixels


def require_size(path: Path, height: int, width: int) -> None:
    """Refuse a frame that says it is larger than allowed.

    Raises
    ------
    LayoutError
        When it does.
    """
    if height * width > _most:
        raise LayoutError(
            f"{path} says that it is {width}x{height} pixels, more than --max-pixels {_most}; "
            "render or copy it again if it is not, or allow more"
        )


def require_canvas(what: object, canvas: Window) -> None:
    """Refuse windows that lie so far apart that no frame may be as large as what holds them all.

    Raises
    ------
    LayoutError
        When they do.
    """
    if canvas.pixels > _most:
        raise LayoutError(
            f"the data and display windows of {what} lie in {canvas.width}x{canvas.height} pixels, "
            f"more than --max-pixels {_most}; correct them, or allow more"
        )
