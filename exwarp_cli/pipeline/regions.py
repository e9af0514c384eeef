"""Data windows whose edge is a picture's edge: render regions, letterboxes, crops.

A data window smaller than the display window means one of two things. Of an object that was cropped
to what it covers, nothing is around: it may move out of the window, and new frames cover more. Of a
picture of which only a region was rendered, something is around that no file holds: what moves in
over the edge is unknown, and new frames have the window of their key frame.

A window is a region if its picture is opaque everywhere and a neighbouring key frame has the same
window. Objects have transparent pixels around them, or windows that go with them. So an opaque
window that moves with every key frame counts as an object's: a crop that follows something cannot
be told from a card that fills its window. Only key frames next to the interval's own decide, so any
part of a sequence decides alike.
"""

from __future__ import annotations

from collections.abc import Callable

from exwarp_cli.domain.frame import Image, Window

OPAQUE = 0.99
"""Alpha from which on a pixel is opaque: denoisers and half floats take a little off."""


class Regions:
    """Tells which key frames show a region of a picture.

    Parameters
    ----------
    display
        The display window of all frames.
    window_of
        Returns the data window of the colour of a key frame, by index; None where there is no such
        frame, or it cannot be read.
    """

    def __init__(self, display: Window, window_of: Callable[[int], Window | None]) -> None:
        self._display = display
        self._window_of = window_of
        self._windows: dict[int, Window | None] = {}

    def is_steady(self, key: int) -> bool:
        """Whether a key frame's window does not cover the display, and a neighbour's is the same.

        A single key frame has no neighbours that could contradict.
        """
        window = self._window(key)
        if window is None or window.covers(self._display):
            return False
        around = [self._window(key - 1), self._window(key + 1)]
        known = [other for other in around if other is not None]
        return window in known or not known

    def is_region(self, key: int, image: Image, following: Image | None) -> bool:
        """Whether the slots after a key frame show a region.

        Parameters
        ----------
        key
            Its index.
        image, following
            Its colour, and that of the next key frame where slots are made of it, too.
        """
        images = [image] if following is None else [image, following]
        return self.is_steady(key) and all(map(is_opaque, images))

    def forget(self, key: int) -> None:
        """Drop the windows that no key frame after one goes by."""
        self._windows = {index: w for index, w in self._windows.items() if index >= key}

    def _window(self, key: int) -> Window | None:
        if key not in self._windows:
            self._windows[key] = self._window_of(key)
        return self._windows[key]


def is_opaque(image: Image) -> bool:
    """Whether a picture has no alpha, or is opaque in every pixel of its data window."""
    alpha = image.pixels[..., 3:]
    return not bool((alpha < OPAQUE).any())


def remark(image: Image, region: bool) -> str | None:
    """Return how a key frame's window is read, in a sentence; None where it speaks for itself.

    Parameters
    ----------
    image
        Its colour.
    region
        Whether slots after it keep the window.
    """
    window, display = image.data_window, image.display_window
    if window.covers(display):
        return None
    if region:
        return f"the data window {window} is a region of the picture {display}: new frames keep it"
    if not is_opaque(image):
        return None
    return (
        f"the data window {window} is opaque and differs from those of the key frames around: "
        f"taken for a cropped object with nothing around it; if it is a region of the picture "
        f"{display}, render all key frames with the same one"
    )
