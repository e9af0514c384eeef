"""Key frames of one view: read on demand by role, remembered, and dropped once per interval."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace

from exwarp_cli.domain.frame import SURFACE_PARTS, GBuffer, Image, KeyFrame, Window
from exwarp_cli.domain.network_api import HISTORY_FRAMES
from exwarp_cli.domain.timeline import FACTOR, Slot
from exwarp_cli.errors import InputError, LayoutError
from exwarp_cli.io.channels import Role
from exwarp_cli.io.footage import ClipSequence, is_plain, key_picture, picture
from exwarp_cli.io.frames import GEOMETRY, SURFACE, Shot, colour_window, read_raw
from exwarp_cli.io.sequence import Sequence
from exwarp_cli.io.soundness import NonFinite, count_broken
from exwarp_cli.pipeline.shots import Shots, UnreadableFrames
from exwarp_cli.pipeline.source import FrameOf, Source
from exwarp_cli.pipeline.without_vectors import Estimates
from exwarp_cli.synthesis.methods import Method


@dataclass(frozen=True)
class HistoryFrame:
    """A key frame before the interval's own.

    Attributes
    ----------
    frame
        As read.
    instants
        With slots' G-buffers those on the way to it, without surface: the key frame after it, the
        slots between from the last to the first, and this key frame; motion reaches over one slot.
        Empty in the key setting.
    held
        True if the key frame after this one shows the same picture: nothing moves between them.
    """

    frame: KeyFrame
    instants: tuple[GBuffer, ...]
    held: bool = False


class KeyFrameStore:
    """Reads key frames, and slots' G-buffers, of one view.

    One thread reads interval by interval. Another may ask for the surface of frames of an interval
    before (`get_complete`) meanwhile.

    Parameters
    ----------
    source
        The view.
    method
        Decides which roles are read.
    unreadable
        Where frames are recorded that cannot be read; all views share it.
    digest
        Called with a slot before its frame is read, where frames may be unreadable: digests the
        slot's files, and raises InputError for a file that cannot be read.
    reads_late
        Whether older key frames and surfaces are read only for intervals that are extrapolated.
    keeps_shapes
        Whether features are computed, which need the geometry of instants with normals.
    leader
        The store of the view that decides where shots begin; None for that view itself.
    """

    def __init__(
        self,
        source: Source,
        method: Method,
        unreadable: UnreadableFrames,
        digest: Callable[[Slot], None],
        reads_late: bool = False,
        keeps_shapes: bool = False,
        leader: KeyFrameStore | None = None,
    ) -> None:
        self.source = source
        self.unreadable = unreadable
        self._digest = digest
        self._has_surface = method.extrapolates and not reads_late
        self._slot_roles = (*GEOMETRY, *SURFACE) if method.extrapolates else GEOMETRY
        self._keeps_slots = method.older_keys(method.lookahead) > 0
        self._keeps_shapes = keeps_shapes
        self._lookahead = method.lookahead
        self._companions: list[Callable[[int], object]] = []
        # The raw geometry is kept, too: without it a key frame had to be decoded again where the
        # window of the next interval differs.
        self._frames: dict[int, KeyFrame] = {}
        self._complete: dict[int, KeyFrame] = {}
        self._slots: dict[Slot, GBuffer] = {}
        self._shapes: dict[Slot, GBuffer] = {}
        numbers, lossy = source.timeline.numbers, isinstance(source.keys.sequence, ClipSequence)
        self.shots = Shots(source.cuts, numbers, self.get, unreadable, lossy)
        if leader is not None:
            self.shots.follow(leader.shots)
            leader.read_with(self.get)
        self._estimates = None
        if source.estimated:
            self._estimates = Estimates(self._read_colour, len(numbers), unreadable.has)
        self._normals_tell = cuts_need_normals(source.keys, source.cuts.detect)
        self._needs_normals = frames_need_normals(source.keys, method.extrapolates)

    def read_with(self, read: Callable[[int], object]) -> None:
        """Read more with each key frame, by its index, where frames may be unreadable.

        A key frame counts as unreadable if its layers or its other views are.
        """
        self._companions.append(read)

    def get(self, key: int) -> KeyFrame:
        """Return a key frame as it was read, by its index; it is shown to the search for cuts.

        Raises
        ------
        InputError
            When a file cannot be read.
        """
        if key not in self._frames:
            with self.reading(Slot(key, 0)):
                frame = self._read(key)
                if self.unreadable.tolerant:
                    for read in self._companions:
                        read(key)
            self._frames[key] = self.source.scratch.store(frame)
        return self._frames[key]

    def get_in_shot(self, key: int, before: bool = False) -> KeyFrame:
        """Return a key frame without vectors that lead to another shot.

        Parameters
        ----------
        key
            Its index.
        before
            True for the interval before the key frame, False for the one after it.
        """
        if self._estimates is not None:
            # A repeated picture tells nothing of the motion that leads on from it.
            back = key > 0 and not self.shots.starts_at(key) and not self.shots.repeats(key)
            ahead = self._lookahead and self.is_followed(key)
            ahead = ahead and not (before and self.shots.repeats(key + 1))
            return self._estimates.moving(key, back, ahead, before)
        return self._within_shot(key, self.get(key))

    def get_complete(self, key: int, frame: KeyFrame | None = None) -> KeyFrame:
        """Return a key frame with its surface, without vectors that lead to another shot.

        Parameters
        ----------
        key
            Its index.
        frame
            The key frame without its surface, where that is in memory: only the surface is read.

        Raises
        ------
        InputError
            When a file cannot be read.
        """
        if key not in self._complete:
            complete = self._read_complete(key) if frame is None else self._add(frame)
            self._complete[key] = self.source.scratch.store(complete)
        return self._complete[key]

    def get_slot(self, slot: Slot) -> GBuffer:
        """Read the G-buffer of a slot; raises InputError where that fails."""
        source = self.source
        number = source.slot_number(slot)
        assert source.slots is not None and number is not None
        with self.reading(slot):
            raw = read_raw(source.slots, number, self._slot_roles, objects=True)
        gbuffer = source.scratch.store(raw.settle(source.convention))
        if self._keeps_slots:
            self._slots[slot] = without_surface(gbuffer)
        if self._keeps_shapes and slot.index in (0, FACTOR - 1):
            self._shapes[slot] = gbuffer.without(*SURFACE_PARTS)
        return gbuffer

    def get_way_back(self, key: int) -> tuple[GBuffer, ...]:
        """Return the slots' G-buffers, without surface, from the key frame after one back to it."""
        if self.source.slots is None:
            return ()
        steps = self.source.timeline.steps
        assert steps is not None  # slots have G-buffers where the factor is an integer
        found = []
        for slot in slots_back_to(key, steps):
            known = self._slots.get(slot)
            found.append(without_surface(self.get_slot(slot)) if known is None else known)
        return tuple(found)

    def get_shape(self, slot: Slot) -> GBuffer:
        """Return the geometry of an instant with normals, which features are computed from."""
        source = self.source
        if slot not in self._shapes and source.slots is not None:
            self.get_slot(slot)
        elif slot not in self._shapes:
            frame = self._frames.get(slot.key)
            if frame is not None and frame.gbuffer is not None:
                return frame.gbuffer
            number = source.timeline.numbers[slot.key]
            # With colour, whose window may be smaller, as in the key frames that are in memory.
            roles = (Role.COLOUR, *GEOMETRY)
            with self.reading(slot):
                raw = read_raw(source.keys, number, roles, objects=True)
            self._shapes[slot] = raw.settle(source.convention)
        return self._shapes[slot]

    def get_window(self, key: int) -> Window | None:
        """Return the data window of a key frame's colour; None where none can be read."""
        numbers, keys = self.source.timeline.numbers, self.source.keys
        if is_plain(keys.sequence) or not 0 <= key < len(numbers):
            return None
        if key in self._frames:
            return self._frames[key].image.data_window
        with suppress(InputError):
            return colour_window(keys, numbers[key])
        return None

    def is_followed(self, key: int) -> bool:
        """Return True if a key frame of the same shot comes after one."""
        last = key + 1 == len(self.source.timeline.numbers)
        return not last and not self.shots.starts_at(key + 1)

    def slots_after(self, key: int) -> tuple[Slot, ...]:
        """Return the slots after a key frame that have G-buffers: all of them, or none."""
        slots = self.source.timeline.between(key)
        known = all(self.source.slot_number(slot) is not None for slot in slots)
        return slots if known else ()

    def keep_shape(self, key: int) -> None:
        """Remember of a key frame what the features of the next one are found by."""
        frame = self._frames.get(key)
        if frame is not None and frame.gbuffer is not None:
            g = frame.gbuffer
            self._shapes[Slot(key, 0)] = GBuffer(g.window, g.depth, g.normal, g.position)

    def release_before(self, oldest: int, key: int) -> None:
        """Drop what no interval after one needs, or not yet, as it was read to find cuts.

        Parameters
        ----------
        oldest
            Index of the first key frame that the next interval needs.
        key
            Index of the interval that was read last.
        """
        self._frames = {i: f for i, f in self._frames.items() if oldest <= i <= key + 1}
        self._slots = {slot: g for slot, g in self._slots.items() if slot.key >= oldest}
        self._shapes = {slot: shape for slot, shape in self._shapes.items() if slot.key >= key}
        # The interval before the one that was read may ask for its frames meanwhile.
        for index in list(self._complete):
            if index < key - HISTORY_FRAMES:
                self._complete.pop(index, None)
        self.shots.forget(min(oldest, key))
        if self._estimates is not None:
            self._estimates.forget(oldest)

    @contextmanager
    def reading(self, slot: Slot) -> Iterator[None]:
        """Read a slot's frame in the block; it is recorded as unreadable where that fails."""
        with self.unreadable.recorded(slot):
            if self.unreadable.tolerant:
                self._digest(slot)
            yield

    def _read(self, key: int) -> KeyFrame:
        source = self.source
        number = source.timeline.numbers[key]
        if self._estimates is not None:
            frame = self._estimates.frame(key)
            if source.cuts.detect:
                self.shots.see(key, self._estimates.flowing(key))
            return frame
        if is_plain(source.keys.sequence):
            frame = self._read_colour(key)
            self.shots.see(key, frame)
            return frame
        if source.slots is None:
            raw = read_raw(source.keys, number, self._roles, objects=True)
            frame = raw.key(source.convention)
            # Cuts are found by the same channels whatever the method.
            self.shots.see(key, frame if self._normals_tell else frame.without("normal"))
            return frame if self._needs_normals else frame.without("normal")
        frame = read_raw(source.keys, number, (Role.COLOUR,)).key(None)
        steps = source.timeline.steps
        assert steps is not None  # slots have G-buffers where the factor is an integer
        gbuffer = self.get_slot(Slot(key, 0)).on(frame.image.data_window)
        frame = replace(frame, gbuffer=over_interval(gbuffer, steps))
        self.shots.see(key, frame)
        return frame

    def _read_colour(self, key: int) -> KeyFrame:
        keys, number = self.source.keys, self.source.timeline.numbers[key]
        with self.reading(Slot(key, 0)):
            if is_plain(keys.sequence):
                return KeyFrame(number, key_picture(keys, number), None)
            return read_raw(keys, number, (Role.COLOUR,)).key(None)

    @property
    def _roles(self) -> tuple[Role, ...]:
        """What is read of key frames without slots' G-buffers.

        Methods without motion report holes by the geometry. Networks need the surface, too.
        """
        if self.source.finding is None:
            return (Role.COLOUR,)
        if self._has_surface:
            return (Role.COLOUR, *GEOMETRY, *SURFACE)
        if self._needs_normals or self._normals_tell:
            return (Role.COLOUR, *GEOMETRY)
        return (Role.COLOUR, *(role for role in GEOMETRY if role is not Role.NORMAL))

    def _read_complete(self, key: int) -> KeyFrame:
        number, roles = self.source.timeline.numbers[key], (Role.COLOUR, *GEOMETRY, *SURFACE)
        raw = read_raw(self.source.keys, number, roles, objects=True)
        return self._within_shot(key, raw.key(self.source.convention))

    def _add(self, frame: KeyFrame) -> KeyFrame:
        """Add a key frame's surface, on the window of its geometry."""
        if frame.gbuffer is None:
            return frame
        # With colour everything lies on its data window.
        on_display = frame.gbuffer.window == self.source.keys.display
        roles = SURFACE if on_display else (Role.COLOUR, *SURFACE)
        surface = read_raw(self.source.keys, frame.number, roles).gbuffer
        parts = {part: getattr(surface, part) for part in SURFACE_PARTS}
        return replace(frame, gbuffer=replace(frame.gbuffer, **parts))

    def _within_shot(self, key: int, frame: KeyFrame) -> KeyFrame:
        if frame.gbuffer is None:
            return frame
        return replace(frame, gbuffer=self.shots.within(key, frame.gbuffer))


def frames_need_normals(shot: Shot, extrapolates: bool) -> bool:
    """Return True if frames are made by key frames' normals.

    Warps use them for Unreal's background alone, in sets of one file per AOV.
    """
    return extrapolates or bool(shot.aovs)


def cuts_need_normals(shot: Shot, detects: bool) -> bool:
    """Return True if cuts are found by key frames' normals: the same for every method."""
    return bool(shot.aovs) or (detects and Role.POSITION not in shot.layout)


def reads_late(shot: Shot, method: Method) -> bool:
    """Return True if older key frames and surfaces can be read after the path is decided.

    A policy decides without them. Not where ids of whatever is shown are all there is: moving
    objects are found by all frames of an interval.
    """
    # Of a run that only warps they took a seventh of the CPU time, two fifths of the memory.
    decides = method.judge is not None and not method.needs_truth and not method.lookahead
    return decides and (shot.ids is None or shot.ids.dynamic is not None)


def without_surface(gbuffer: GBuffer) -> GBuffer:
    """Return what motion is found by: a third of the memory, where frames are kept for later."""
    return gbuffer.without("normal", *SURFACE_PARTS)


def slots_back_to(key: int, steps: int) -> tuple[Slot, ...]:
    """Return the instants from the key frame after one back to it, of so many steps."""
    return (Slot(key + 1, 0), *(Slot(key, i) for i in range(steps - 1, -1, -1)))


def over_interval(gbuffer: GBuffer, steps: int) -> GBuffer:
    """Turn motion per slot into motion per key interval, of `steps` slots, at constant velocity.

    With slots' G-buffers a key frame's own vectors are used only where theirs do not lead: after
    the last key frame, and to the next one where the renderer writes none that way.
    """
    after, before = gbuffer.to_next, gbuffer.to_previous
    return replace(
        gbuffer,
        to_next=None if after is None else steps * after,
        to_previous=None if before is None else steps * before,
    )


CHANNELS = "ground truth"
"""What the report calls the channels of its frames."""


@dataclass(frozen=True)
class IntervalTruth:
    """Ground truth of one interval, as far as there is some.

    Attributes
    ----------
    frames
        By slot, of the slots that are made.
    ends
        The rendered instants around, at slot 0 and, counted on as a slot, at the next key frame's
        instant; only for VMAF.
    unscored
        Why frames cannot be used, by slot, where the run goes on without them.
    """

    frames: dict[int, Image] = field(default_factory=dict)
    ends: dict[int, Image] = field(default_factory=dict)
    unscored: dict[int, str] = field(default_factory=dict)


@dataclass(frozen=True)
class TruthReader:
    """Reads ground truth, as far as there is some.

    Attributes
    ----------
    source
        The view that is scored.
    truth
        The sequence, and its frame for a slot; None without.
    measured
        What is measured, as in `Score`.
    tolerant
        Whether to go on without frames that cannot be used.
    nonfinite
        What was counted in its frames, by the number of the output frame.
    """

    source: Source
    truth: tuple[Sequence, FrameOf] | None
    measured: tuple[str, ...]
    tolerant: bool = False
    nonfinite: NonFinite = field(default_factory=NonFinite)

    def read(self, key: int) -> IntervalTruth:
        """Read what an interval is scored by.

        Raises
        ------
        InputError
            When a frame is damaged, holds no colour or is of another size, unless tolerant.
        """
        result = IntervalTruth()
        if self.truth is None:
            return result
        timeline = self.source.timeline
        self._read_into(result.frames, timeline.made_of(key), result.unscored)
        if "vmaf" in self.measured:
            self._read_into(result.ends, self._ends(key), result.unscored)
        return result

    def _read_into(
        self, frames: dict[int, Image], slots: Iterable[Slot], unscored: dict[int, str]
    ) -> None:
        for slot in slots:
            try:
                image = self._frame(slot)
            except InputError as error:
                if not self.tolerant:
                    raise
                unscored[slot.index] = str(error)
                continue
            if image is not None:
                frames[slot.index] = image

    def _frame(self, slot: Slot) -> Image | None:
        """Read a frame; None where the sequence has none for the slot."""
        assert self.truth is not None
        sequence, frame_of = self.truth
        number = frame_of(slot)
        if number is None:
            return None
        image, display = picture(sequence, number, self.source.keys.view), self.source.keys.display
        output = self.source.timeline.number(slot)
        if image.display_window.shape != display.shape:
            raise truth_of_another_size(output, image.display_window, display)
        self.nonfinite.note(output, {CHANNELS: count_broken((image.pixels,))})
        return image

    def _ends(self, key: int) -> tuple[Slot, ...]:
        timeline = self.source.timeline
        after = Slot(key, len(timeline.between(key)) + 1)
        last = key + 1 == len(timeline.numbers)
        return (Slot(key, 0),) if last else (Slot(key, 0), after)


def truth_of_another_size(output: int, size: Window, display: Window) -> LayoutError:
    """Build the error for the truth of an output frame that has another size than the input."""
    return LayoutError(
        f"--ground-truth for frame {output} is {size} and the input is {display}; give a sequence "
        "of the same resolution"
    )
