"""Shots within a sequence: nothing is taken across the cuts between them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field

import numpy as np

from exwarp_cli.domain.frame import GBuffer, KeyFrame
from exwarp_cli.domain.timeline import Cut, CutOption, Slot
from exwarp_cli.errors import InputError
from exwarp_cli.synthesis.cut_detection import Thumbnail, compare_thumbnails, make_thumbnail
from exwarp_cli.synthesis.holds import (
    NOISE,
    NOISE_AFTER_MOTION,
    RECENT_PAIRS,
    PictureChange,
    change_between,
    is_same_picture,
)

# Share of the frame's longer side from which a change of speed may come of a cut: 19 pixels of
# 1920. Cameras that change so much within a key interval are rare, and what leads across a cut
# leads to another camera, mostly by a good part of the frame.
LEAP = 0.01

# Distances at which another pair is sought in place of one that shows the same picture twice.
AROUND_HOLD = (1, -1, 2, -2, 3, -3, 5, -5, 8, -8, 16, -16, 32, -32)


class _RecordedError(Exception):
    """The cause of an error of a frame that is recorded as unreadable."""


@dataclass
class UnreadableFrames:
    """Frames of the input that cannot be read, by their slot, whose index is 0 for key frames.

    An unreadable key frame is like a hole between two shots: nothing is taken across it. The same
    frames have to be unreadable for every chunk of a sequence, whatever else that chunk reads. So
    a key frame is always read in the same way, and a question where shots begin reads the key
    frames on both sides. Unless `tolerant`, errors pass, and nothing is recorded.
    """

    tolerant: bool = False
    _reasons: dict[Slot, str] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self._reasons)

    @contextmanager
    def recorded(self, slot: Slot) -> Iterator[None]:
        """Record the slot's frame as unreadable when the block raises InputError.

        The error is raised again, and raised at once for a frame that is recorded.
        """
        if slot in self._reasons:
            raise InputError(self._reasons[slot]) from _RecordedError()
        try:
            yield
        except InputError as error:
            # A recorded error is that of another frame, read for this one.
            if not self.tolerant or isinstance(error.__cause__, _RecordedError):
                raise
            self._reasons[slot] = str(error)  # without what its traceback holds
            raise InputError(self._reasons[slot]) from _RecordedError()

    def has(self, *slots: Slot) -> bool:
        """Return True if the frame of any of these slots is recorded."""
        return any(slot in self._reasons for slot in slots)


@dataclass(eq=False)
class Shots:
    """Where shots begin and pictures repeat, of every pair of key frames from those two alone.

    So any part of the sequence finds the same, and so does every method: all code that reads key
    frames shows them with the same channels. Key frames are named by their index. Raises
    MissingFrameError when a cut is given at a frame that the sequence lacks.
    """

    wish: CutOption
    numbers: Sequence[int]  # of the input's key frames
    # Reads a key frame that was not seen, or released; shows it by `see`, and returns it.
    read: Callable[[int], KeyFrame]
    # Key frames that cannot be read: shots end before them, and begin after them.
    unreadable: UnreadableFrames = field(default_factory=UnreadableFrames)
    lossy: bool = False  # True if a lossy codec may have changed pictures that are repeated
    # Of the view that tells where shots begin: all views are cut and held alike.
    leader: Shots | None = None
    _followers: list[Shots] = field(default_factory=list)
    _glances: dict[int, Thumbnail] = field(default_factory=dict)
    _starts: dict[int, bool] = field(default_factory=dict)
    _repeats: dict[int, bool] = field(default_factory=dict)
    _changes: dict[int, PictureChange] = field(default_factory=dict)
    _leaps: dict[int, tuple[float, float, float] | None] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self._given = self.wish.starts_in(self.numbers)
        self._beside_given = {key - i for key in self._given for i in (0, 1)}
        if self.leader is not None:
            self.leader._followers.append(self)

    @property
    def cuts(self) -> tuple[Cut, ...] | None:
        """The cuts that were met so far; None where there are none by the user's will."""
        if not self.wish.detect and not self.wish.numbers:
            return None
        starts = (key for key, is_start in sorted(self._starts.items()) if is_start)
        return tuple(
            Cut(self.numbers[k], "given" if k in self._given else "detected") for k in starts
        )

    def see(self, key: int, frame: KeyFrame) -> None:
        """Take a glance at a key frame as it was read, with vectors over a key interval."""
        if self.wish.detect or key in self._beside_given:
            self._glances[key] = make_thumbnail(frame)

    def starts_at(self, key: int) -> bool:
        """Return True if a cut lies before a key frame; none does before the first."""
        if self.leader is not None:
            return self.leader.starts_at(key)
        inside = 0 < key < len(self.numbers)
        is_beside_hole = self.unreadable.has(Slot(key - 1, 0), Slot(key, 0))
        if is_beside_hole and key not in self._given:
            return inside
        if key not in self._starts:
            is_start = inside and key in self._given
            if inside and not is_start and self.wish.detect:
                is_start = compare_thumbnails(self._glance(key - 1), self._glance(key)).found
            elif inside and not is_start and self.unreadable.tolerant:
                # Whether they can be read shows as they are read.
                self.read(key - 1)
                self.read(key)
            self._starts[key] = is_start
        return self._starts[key]

    def repeats(self, key: int) -> bool:
        """Return True if a key frame shows the same picture as the one before it, in all views.

        The first of a shot repeats nothing.
        """
        if self.leader is not None:
            return self.leader.repeats(key)
        if key not in self._repeats:
            inside = 0 < key < len(self.numbers) and not self.starts_at(key)
            self._repeats[key] = inside and all(
                shots._shows_same_picture(key) for shots in (self, *self._followers)
            )
        return self._repeats[key]

    def _shows_same_picture(self, key: int) -> bool:
        if not self.lossy:
            before, after = (self.read(index).image for index in (key - 1, key))
            return is_same_picture(before, after)
        change = self._change(key)
        # A codec explains little noise whatever was before, and more only after motion.
        if change.local <= NOISE or change.local > NOISE_AFTER_MOTION:
            return change.local <= NOISE
        for earlier in range(key - 1, max(key - 1 - RECENT_PAIRS, 0), -1):
            if self.starts_at(earlier):
                return False
            if self._change(earlier).local > NOISE_AFTER_MOTION:
                return change.is_calm_after(self._change(earlier))
        return False

    def _change(self, key: int) -> PictureChange:
        if key not in self._changes:
            before, after = (self.read(index).image for index in (key - 1, key))
            self._changes[key] = change_between(before, after)
        return self._changes[key]

    def begin(self, key: int, back: int) -> int:
        """Return the first key frame of a shot, or the one so many before: the later of them."""
        oldest = max(key - back, 0)
        return next((i for i in range(key, oldest, -1) if self.starts_at(i)), oldest)

    def within(self, key: int, gbuffer: GBuffer) -> GBuffer:
        """Return a key frame's geometry without vectors that lead to another shot."""
        # A shot that was rendered by itself has good vectors beyond its ends, so they go only where
        # those the other way are there too, and the two do not continue each other.
        if gbuffer.to_next is None or gbuffer.to_previous is None:
            return gbuffer
        crossing = self._vectors_across_cut(key)
        return gbuffer.without(crossing) if crossing else gbuffer

    def cut_facts(self, key: int, back: int, used: Iterable[int]) -> list[str]:
        """Say what frames after a key frame depend on; nothing where no cut is near.

        `back` is how many key frames before it may be used, `used` are the key frames whose vectors
        are.
        """
        begin = self.begin(key, back)
        facts = [f"begin {begin - key}"] if self.starts_at(begin) else []
        facts += ["end"] if self.starts_at(key + 1) else []
        crossing = {i - key: self._vectors_across_cut(i) for i in sorted(set(used))}
        return facts + [f"{name} {offset}" for offset, name in crossing.items() if name]

    def release_before(self, oldest: int) -> None:
        """Drop glances at key frames before one; what they showed stays known."""
        self._glances = {key: glance for key, glance in self._glances.items() if key >= oldest}

    def _glance(self, key: int) -> Thumbnail:
        if key not in self._glances:
            self.read(key)
        return self._glances[key]

    def _vectors_across_cut(self, key: int) -> str:
        """Return which vectors of a key frame lead to another shot; "" for none."""
        if not self.wish.detect and key not in self._beside_given:
            return ""
        if key not in self._leaps:
            self._leaps[key] = measure_leap(self._glance(key))
        leap = self._leaps[key]
        if leap is None:
            return ""
        apart, to_next, to_previous = leap
        cut_before, cut_after = self.starts_at(key), self.starts_at(key + 1)
        # Vectors that are not as the others foretell cross the cut. Between the two, the change has
        # to be larger than what goes on inside the shot: a camera that brakes or reverses changes
        # by as much as it moves. Of a shot of one frame there is nothing inside; the shorter ones
        # stay there.
        if cut_before and cut_after:
            longer = "to_next" if to_next > to_previous else "to_previous"
            return longer if apart > min(to_next, to_previous) else ""
        if cut_after and apart > to_previous:
            return "to_next"
        return "to_previous" if cut_before and apart > to_next else ""


def measure_leap(glance: Thumbnail) -> tuple[float, float, float] | None:
    """Compare a frame's vectors to both sides, of surfaces as rendered, in cells of its glance.

    Return the median lengths of n + p, n and p, with n to the next frame and p to the previous one;
    None where the two continue each other.
    """
    after, before = glance.to_next, glance.to_previous
    if after is None or before is None:
        return None
    valid = np.isfinite(after).all(axis=-1) & np.isfinite(before).all(axis=-1)
    if (valid & glance.surface).any():
        valid &= glance.surface  # background has often none, whatever the camera does
    if not valid.any():
        return None
    apart, to_next, to_previous = (
        float(np.median(np.linalg.norm(vectors[valid], axis=-1)))
        for vectors in (after + before, after, before)
    )
    return (apart, to_next, to_previous) if apart > LEAP * max(glance.light.shape) else None


def pairs_around(first: int, count: int, is_cut: Callable[[int], bool]) -> Iterator[int]:
    """Yield a pair of neighbouring frames, and those that may stand for it if it is a hold.

    A picture that is repeated tells nothing of its vectors, which are those of the first one. A
    pair is named by its first frame. `count` is of all frames; `is_cut` returns True if a frame, by
    its index, does not belong to the frame before it.
    """
    yield first
    candidates = (first + distance for distance in AROUND_HOLD)
    yield from (i for i in candidates if 0 <= i < count - 1 and not is_cut(i + 1))


def pairs_within(count: int, is_cut: Callable[[int], bool]) -> list[int]:
    """Choose pairs of neighbouring frames to measure by: of the start, the middle and the end.

    `count` is of all frames. `is_cut` takes a frame's index and returns True if a cut lies before
    it. A pair across one gives way to the nearest that is not. The indices of the earlier frames
    are returned, ascending.
    """
    firsts = range(count - 1)
    nearest = {
        next((i for i in sorted(firsts, key=lambda i: abs(i - wanted)) if not is_cut(i + 1)), -1)
        for wanted in (0, (count - 1) // 2, count - 2)
    }
    return sorted(nearest - {-1})
