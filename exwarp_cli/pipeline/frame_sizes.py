"""Sizes of all frames, from their headers alone, and data windows whose edge is a picture's edge.

A data window smaller than the display window means one of two things. Of an object that was cropped
to what it covers, nothing is around: it may move out of the window, and new frames cover more. Of a
picture of which only a region was rendered, something is around that no file holds: what moves in
over the edge is unknown, and new frames have the window of their key frame.

A window is a region if its picture is opaque everywhere and a neighbouring key frame has the same
window. Objects have transparent pixels around them, or windows that go with them. So an opaque
window that moves with every key frame counts as an object's: a crop that follows something looks
the same as a card that fills its window. Only key frames next to the interval's own decide, so any
part of a sequence decides alike.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING

from exwarp_cli.domain.frame import Image, Window
from exwarp_cli.domain.timeline import Slot
from exwarp_cli.errors import InputError, LayoutError
from exwarp_cli.io.footage import is_plain, read_display_window
from exwarp_cli.pipeline.ground_truth import truth_of_another_size

if TYPE_CHECKING:
    from exwarp_cli.io.sequences import Sequence
    from exwarp_cli.io.shot import Shot
    from exwarp_cli.pipeline.source import FrameOf, Source

# Headers that are read at a time: on a network share each waits for the server.
READERS = 16

# Alpha from which on a pixel is opaque: denoisers and half floats take a little off.
OPAQUE = 0.99


def require_one_size(shot: Shot, numbers: Iterable[int]) -> None:
    """Refuse a shot of which some frames have another size, unless such frames are skipped.

    Headers that cannot be read are passed over: the reading of that frame says what is wrong.

    Raises
    ------
    LayoutError
        Where a frame's display window is not that of the shot.
    """
    # 500 headers take 0.1 s on a local disk.
    if shot.keep_going:
        return
    wanted = list(numbers)
    files = {
        member.files[number]: (member, number)
        for member in (shot.sequence, *shot.aovs.values())
        for number in wanted
        if number in member.files
    }
    different = [
        (path, window)
        for path, window in zip(files, _displays(files.values()), strict=True)
        if window is not None and window != shot.display
    ]
    if different:
        path, window = different[0]
        plain = is_plain(shot.sequence)
        sizes = [f"{w.width}x{w.height}" if plain else str(w) for w in (window, shot.display)]
        more = f" (and {len(different) - 1} more)" if len(different) > 1 else ""
        raise LayoutError(
            f"{path}{more} is {sizes[0]} where the sequence's first frame is {sizes[1]}; "
            f"{'write' if plain else 'render'} all frames at one resolution"
        )


def require_one_size_of(source: Source, keys: tuple[int, ...], lookahead: bool) -> None:
    """Do as `require_one_size` for the frames that some key intervals (indices) are made of."""
    timeline = source.timeline
    last = len(timeline.numbers) - 1
    # A cut before the next key frame is looked for in both, whatever the method.
    reads_next = lookahead or source.cuts.detect
    ends = {min(key + 1, last) for key in keys} if reads_next else set()
    require_one_size(source.keys, (timeline.numbers[key] for key in sorted(ends.union(keys))))
    if source.slots is not None:
        slots = [slot for key in keys for slot in (Slot(key, 0), *timeline.between(key))]
        numbers = (source.slot_number(slot) for slot in slots)
        require_one_size(source.slots, (number for number in numbers if number is not None))


def require_truth_size(
    truth: tuple[Sequence, FrameOf], source: Source, keys: tuple[int, ...]
) -> None:
    """Refuse ground truth of another size than the input, for slots of some key intervals.

    `keys` are indices of key frames; raises LayoutError.
    """
    sequence, frame_of = truth
    timeline, display = source.timeline, source.keys.display
    slots = [slot for key in keys for slot in timeline.made_of(key)]
    wanted = {slot: n for slot in slots if (n := frame_of(slot)) is not None}
    windows = _displays((sequence, number) for number in wanted.values())
    for slot, window in zip(wanted, windows, strict=True):
        if window is not None and window.shape != display.shape:
            raise truth_of_another_size(timeline.number(slot), window, display)


def require_rendered_size(sequence: Sequence, source: Source, keys: tuple[int, ...]) -> None:
    """Refuse rendered frames, by output number, of another size than the key frames.

    `keys` are indices of key frames; raises LayoutError, unless such frames are skipped.
    """
    if source.keys.keep_going:
        return
    timeline, display = source.timeline, source.keys.display
    slot_numbers = (timeline.number(slot) for key in keys for slot in timeline.made_of(key))
    numbers = [number for number in slot_numbers if number in sequence.files]
    windows = _displays((sequence, number) for number in numbers)
    for number, window in zip(numbers, windows, strict=True):
        if window is not None and window != display:
            raise LayoutError(
                f"frame {number} of --rendered is {window} and the input is {display}; render it "
                "at the resolution and with the windows of the key frames"
            )


def _displays(frames: Iterable[tuple[Sequence, int]]) -> list[Window | None]:
    """Return the display window of each frame; None where its header cannot be read."""

    def display(frame: tuple[Sequence, int]) -> Window | None:
        try:
            return read_display_window(*frame)
        except (InputError, OSError, KeyError):
            return None

    with ThreadPoolExecutor(READERS, "exwarp-header") as pool:
        return list(pool.map(display, frames))


class Regions:
    """Which key frames, by index, show a region of a picture.

    `window_of` returns the data window of a key frame's colour; None where there is no such frame,
    or it cannot be read.
    """

    def __init__(self, display: Window, window_of: Callable[[int], Window | None]) -> None:
        self._display = display
        self._window_of = window_of
        self._windows: dict[int, Window | None] = {}

    def is_steady(self, key: int) -> bool:
        """Return True if a window does not cover the display, and a neighbour's is the same.

        A single key frame has no neighbours that could contradict.
        """
        window = self._window(key)
        if window is None or window.covers(self._display):
            return False
        neighbours = [self._window(key - 1), self._window(key + 1)]
        readable = [neighbour for neighbour in neighbours if neighbour is not None]
        return window in readable or not readable

    def is_region(self, key: int, image: Image, following: Image | None) -> bool:
        """Return True if the slots after a key frame show a region.

        `image` is its colour, `following` that of the next key frame where slots are made of it.
        """
        images = [image] if following is None else [image, following]
        return self.is_steady(key) and all(map(is_opaque, images))

    def release_before(self, key: int) -> None:
        """Drop the windows that no key frame from one on goes by."""
        self._windows = {index: w for index, w in self._windows.items() if index >= key}

    def _window(self, key: int) -> Window | None:
        if key not in self._windows:
            self._windows[key] = self._window_of(key)
        return self._windows[key]


def is_opaque(image: Image) -> bool:
    """Return True if a picture has no alpha, or is opaque in every pixel of its data window."""
    alpha = image.pixels[..., 3:]
    return not bool((alpha < OPAQUE).any())


def window_note(image: Image, region: bool) -> str | None:
    """Say how a key frame's window is read; None where it speaks for itself."""
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
