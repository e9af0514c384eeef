"""Sizes of all frames of an input, from their headers alone, before any frame is made."""

from __future__ import annotations

from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING

from exwarp_cli.domain.frame import Window
from exwarp_cli.domain.timeline import Slot
from exwarp_cli.errors import InputError, LayoutError
from exwarp_cli.io.footage import is_plain, picture_size
from exwarp_cli.pipeline.ground_truth import truth_of_another_size

if TYPE_CHECKING:
    from exwarp_cli.io.sequence import Sequence
    from exwarp_cli.io.shot import Shot
    from exwarp_cli.pipeline.source import FrameOf, Source

READERS = 16
"""Headers that are read at a time: on a network share each waits for the server."""


def require_one_size(shot: Shot, numbers: Iterable[int]) -> None:
    """Refuse a shot of which some frames have another size, unless such frames are left out.

    Headers that cannot be read are passed over: the reading of that frame says what is wrong.
    500 headers take 0.1 s on a local disk.

    Raises
    ------
    LayoutError
        Where a frame's display window is not that of the shot.
    """
    if shot.keep_going:
        return
    wanted = list(numbers)
    files = {
        member.files[number]: (member, number)
        for member in (shot.sequence, *shot.aovs.values())
        for number in wanted
        if number in member.files
    }
    others = [
        (path, window)
        for path, window in zip(files, _displays(files.values()), strict=True)
        if window is not None and window != shot.display
    ]
    if others:
        path, window = others[0]
        plain = is_plain(shot.sequence)
        sizes = [f"{w.width}x{w.height}" if plain else str(w) for w in (window, shot.display)]
        more = f" (and {len(others) - 1} more)" if len(others) > 1 else ""
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
    """Refuse ground truth of which some frames have another size than the input.

    Raises
    ------
    LayoutError
        Where that is so for a slot of some key intervals (indices).
    """
    sequence, frame_of = truth
    timeline, display = source.timeline, source.keys.display
    slots = [slot for key in keys for slot in timeline.made_of(key)]
    wanted = {slot: n for slot in slots if (n := frame_of(slot)) is not None}
    windows = _displays((sequence, number) for number in wanted.values())
    for slot, window in zip(wanted, windows, strict=True):
        if window is not None and window.shape != display.shape:
            raise truth_of_another_size(timeline.number(slot), window, display)


def _displays(frames: Iterable[tuple[Sequence, int]]) -> list[Window | None]:
    """Return the display window of each frame; None where its header cannot be read."""

    def display(frame: tuple[Sequence, int]) -> Window | None:
        try:
            return picture_size(*frame)
        except (InputError, OSError, KeyError):
            return None

    with ThreadPoolExecutor(READERS, "exwarp-header") as pool:
        return list(pool.map(display, frames))
