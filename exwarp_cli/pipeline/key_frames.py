"""Key frames of one view: read on demand by role, remembered, and dropped once per interval."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace

from exwarp_cli.domain.frame import (
    SURFACE_PARTS,
    GBuffer,
    Image,
    KeyFrame,
    Window,
    place_on_canvas,
    require_canvas,
)
from exwarp_cli.domain.network_api import HISTORY_FRAMES
from exwarp_cli.domain.timeline import FACTOR, Slot
from exwarp_cli.errors import InputError
from exwarp_cli.io.channels import Role
from exwarp_cli.io.footage import ClipSequence, is_plain, read_key_picture
from exwarp_cli.io.frames import GEOMETRY, SURFACE, colour_window, read_raw
from exwarp_cli.io.shot import Shot
from exwarp_cli.pipeline.shots import Shots, UnreadableFrames
from exwarp_cli.pipeline.source import Source
from exwarp_cli.synthesis.holds import is_still_one_way
from exwarp_cli.synthesis.methods import Method
from exwarp_cli.synthesis.optical_flow import Flow, estimate_flow, with_estimated_motion

GEOMETRY_WITHOUT_NORMAL = tuple(role for role in GEOMETRY if role is not Role.NORMAL)

# Alpha from which on a pixel is opaque: denoisers and half floats take a little off.
OPAQUE = 0.99


@dataclass(frozen=True)
class HistoryFrame:
    """A key frame before the interval's own."""

    frame: KeyFrame  # as read
    # With slots' G-buffers those on the way to it, without surface: the key frame after it, the
    # slots between from the last to the first, and this key frame; motion reaches over one slot.
    # Empty in the key setting.
    instants: tuple[GBuffer, ...]
    held: bool = False  # True if the key frame after shows the same picture: nothing moves between


class KeyFrameStore:
    """Reads key frames, and slots' G-buffers, of one view. Key frames are named by their index.

    One thread reads interval by interval. Another may ask for the surface of frames of an interval
    before (`get_complete`) meanwhile.
    """

    def __init__(
        self,
        source: Source,
        method: Method,  # decides which roles are read
        unreadable: UnreadableFrames,  # all views share it
        # Called with a slot before its frame is read, where frames may be unreadable: digests the
        # slot's files, and raises InputError for a file that cannot be read.
        digest: Callable[[Slot], None],
        reads_late: bool = False,  # older key frames and surfaces only if slots are extrapolated
        keeps_shapes: bool = False,  # what features need: the geometry of instants with normals
        leader: KeyFrameStore | None = None,  # of the view that decides where shots begin
    ) -> None:
        self.source = source
        self.unreadable = unreadable
        self._digest = digest
        self._slot_roles = (*GEOMETRY, *SURFACE) if method.extrapolates else GEOMETRY
        self._keeps_slots = method.older_keys(method.lookahead) > 0
        self._keeps_shapes = keeps_shapes
        self._lookahead = method.lookahead
        # Output frames of a key interval; without an integer factor slots have no G-buffers.
        self._steps = source.timeline.steps or 0
        # What reads more with each key frame, where frames may be unreadable: a key frame counts
        # as unreadable if its layers or its other views are.
        self.companions: list[Callable[[int], object]] = []
        # The raw geometry is kept, too: without it a key frame had to be decoded again where the
        # window of the next interval differs.
        self._frames: dict[int, KeyFrame] = {}
        self._complete: dict[int, KeyFrame] = {}
        self._slots: dict[Slot, GBuffer] = {}
        self._shapes: dict[Slot, GBuffer] = {}
        numbers, lossy = source.timeline.numbers, isinstance(source.keys.sequence, ClipSequence)
        shots = None if leader is None else leader.shots
        self.shots: Shots = Shots(source.cuts, numbers, self.get, unreadable, lossy, shots)
        if leader is not None:
            leader.companions.append(self.get)
        self._estimates = None
        if source.estimated:
            self._estimates = MotionEstimates(
                self._read_colour, len(numbers), lambda key: unreadable.has(Slot(key, 0))
            )
        keys = source.keys
        # Cuts are found by the same channels whatever the method.
        self._normals_tell = bool(keys.aovs) or (
            source.cuts.detect and Role.POSITION not in keys.layout
        )
        # Warps use them for Unreal's background alone, in sets of one file per AOV.
        self._needs_normals = method.extrapolates or bool(keys.aovs)
        # What is read of key frames with vectors and without slots' G-buffers. Methods without
        # motion report holes by the geometry. Networks need the surface, too.
        reads_normals = self._needs_normals or self._normals_tell
        geometry = GEOMETRY if reads_normals else GEOMETRY_WITHOUT_NORMAL
        surface = SURFACE if method.extrapolates and not reads_late else ()
        self._roles: tuple[Role, ...] = (Role.COLOUR, *geometry, *surface)

    def get(self, key: int) -> KeyFrame:
        """Return a key frame as it was read; it is shown to the search for cuts.

        Raises InputError when a file cannot be read.
        """
        if key not in self._frames:
            with self.reading(Slot(key, 0)):
                frame = self._read(key)
                if self.unreadable.tolerant:
                    for read in self.companions:
                        read(key)
            self._frames[key] = self.source.scratch.store(frame)
        return self._frames[key]

    def get_in_shot(self, key: int, before: bool = False) -> KeyFrame:
        """Return a key frame without vectors that lead to another shot.

        `before` is True for the interval before the key frame, False for the one after it.
        """
        if self._estimates is not None:
            # A repeated picture tells nothing of the motion that leads on from it.
            back = key > 0 and not self.shots.starts_at(key) and not self.shots.repeats(key)
            ahead = self._lookahead and self.is_followed(key)
            ahead = ahead and not (before and self.shots.repeats(key + 1))
            return self._estimates.moving(key, back, ahead, before)
        frame = self.get(key)
        if frame.gbuffer is None:
            return frame
        return replace(frame, gbuffer=self.shots.within(key, frame.gbuffer))

    def get_complete(self, key: int, frame: KeyFrame | None = None) -> KeyFrame:
        """Return a key frame with its surface, without vectors that lead to another shot.

        Of a `frame` without its surface that is in memory, only the surface is read. Raises
        InputError when a file cannot be read.
        """
        if key not in self._complete:
            keys = self.source.keys
            if frame is None:
                number, everything = self.source.timeline.numbers[key], (*GEOMETRY, *SURFACE)
                raw = read_raw(keys, number, (Role.COLOUR, *everything), objects=True)
                frame = raw.key(self.source.convention)
                if frame.gbuffer is not None:
                    frame = replace(frame, gbuffer=self.shots.within(key, frame.gbuffer))
            elif frame.gbuffer is not None:
                # With colour everything lies on its data window.
                on_display = frame.gbuffer.window == keys.display
                roles = SURFACE if on_display else (Role.COLOUR, *SURFACE)
                surface = read_raw(keys, frame.number, roles).gbuffer
                parts = {part: getattr(surface, part) for part in SURFACE_PARTS}
                frame = replace(frame, gbuffer=replace(frame.gbuffer, **parts))
            self._complete[key] = self.source.scratch.store(frame)
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

    def get_history(self, keys: Iterable[int], complete: bool = False) -> tuple[HistoryFrame, ...]:
        """Return key frames before an interval's own; with their surface if `complete`.

        Raises InputError when a file cannot be read.
        """
        history, get = [], self.get_complete if complete else self.get_in_shot
        for key in keys:
            frame, way_back = get(key), []
            if self.source.slots is not None:
                for slot in slots_back_to(key, self._steps):
                    kept = self._slots.get(slot)
                    way_back.append(without_surface(self.get_slot(slot)) if kept is None else kept)
            history.append(HistoryFrame(frame, tuple(way_back), self.shots.repeats(key + 1)))
        return tuple(history)

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

    def is_steady(self, key: int) -> bool:
        """Return True if a key frame may show a region of a picture, by its data window.

        A data window smaller than the display window means one of two things. Of an object that was
        cropped to what it covers, nothing is around: it may move out of the window, and new frames
        cover more. Of a picture of which only a region was rendered, something is around that no
        file holds: what moves in over the edge is unknown, and new frames have the window of their
        key frame.

        A window is a region if its picture is opaque everywhere and a neighbouring key frame has
        the same window; a single key frame has no neighbours that could contradict. Objects have
        transparent pixels around them, or windows that go with them. So an opaque window that moves
        with every key frame counts as an object's: a crop that follows something looks the same as
        a card that fills its window. Only key frames next to the interval's own decide, so any part
        of a sequence decides alike.
        """
        window = self._window(key)
        if window is None or window.covers(self.source.keys.display):
            return False
        neighbours = [self._window(key - 1), self._window(key + 1)]
        readable = [neighbour for neighbour in neighbours if neighbour is not None]
        return window in readable or not readable

    def _window(self, key: int) -> Window | None:
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
        return slots if all(self.source.slot_number(slot) is not None for slot in slots) else ()

    def release_before(self, oldest: int, key: int) -> None:
        """Drop what no interval after one needs, or not yet, as it was read to find cuts.

        `oldest` is the first key frame that the next interval needs, `key` the interval that was
        read last.
        """
        self._frames = {i: f for i, f in self._frames.items() if oldest <= i <= key + 1}
        self._slots = {slot: g for slot, g in self._slots.items() if slot.key >= oldest}
        self._shapes = {slot: shape for slot, shape in self._shapes.items() if slot.key >= key}
        # The interval before the one that was read may ask for its frames meanwhile.
        for index in list(self._complete):
            if index < key - HISTORY_FRAMES:
                self._complete.pop(index, None)
        self.shots.release_before(min(oldest, key))
        if self._estimates is not None:
            self._estimates.release_before(oldest)

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
            if source.cuts.detect:
                self.shots.see(key, self._estimates.flowing(key))
            return self._estimates.frame(key)
        if source.finding is None:
            frame = self._read_colour(key)
            self.shots.see(key, frame)
            return frame
        if source.slots is None:
            raw = read_raw(source.keys, number, self._roles, objects=True)
            frame = raw.key(source.convention)
            self.shots.see(key, frame if self._normals_tell else frame.without("normal"))
            return frame if self._needs_normals else frame.without("normal")
        frame = read_raw(source.keys, number, (Role.COLOUR,)).key(None)
        gbuffer = self.get_slot(Slot(key, 0)).on(frame.image.data_window)
        frame = replace(frame, gbuffer=over_interval(gbuffer, self._steps))
        self.shots.see(key, frame)
        return frame

    def _read_colour(self, key: int) -> KeyFrame:
        keys, number = self.source.keys, self.source.timeline.numbers[key]
        with self.reading(Slot(key, 0)):
            if is_plain(keys.sequence):
                return KeyFrame(number, read_key_picture(keys, number), None)
            return read_raw(keys, number, (Role.COLOUR,)).key(None)


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


@dataclass
class MotionEstimates:
    """Key frames without vectors, by index, and the flows between neighbouring ones.

    Each is read and estimated once. A flow depends on its two frames alone, so any part of a
    sequence finds the same.
    """

    read: Callable[[int], KeyFrame]  # reads the colour of a key frame
    count: int  # of key frames
    is_unreadable: Callable[[int], bool] = lambda key: False  # none moves towards such a one
    _frames: dict[int, KeyFrame] = field(default_factory=dict)
    _flows: dict[int, tuple[Flow, Flow]] = field(default_factory=dict)

    def frame(self, key: int) -> KeyFrame:
        """Return a key frame, colour alone."""
        if key not in self._frames:
            self._frames[key] = replace(self.read(key), gbuffer=None)
        return self._frames[key]

    def flowing(self, key: int) -> KeyFrame:
        """Return a key frame with all that was estimated, as cuts are found by it."""
        frame = self.frame(key)
        flows = self._flow(key, key - 1), self._flow(key, key + 1)
        back, ahead = (None if flow is None else flow.motion for flow in flows)
        window = frame.image.data_window
        return replace(frame, gbuffer=GBuffer(window, to_previous=back, to_next=ahead))

    def moving(self, key: int, back: bool, ahead: bool, before: bool = False) -> KeyFrame:
        """Return a key frame, by its index, for synthesis.

        `back` and `ahead` say whether the key frames before and after it may tell how it moves.
        `before` is True for the interval before the key frame, False for the one after it.
        """
        to_previous = self._flow(key, key - 1) if back else None
        to_next = self._flow(key, key + 1) if ahead else None
        # Where the picture stands towards one neighbour and moves towards the other, the motion
        # between them is no parabola, and what fits the repeated picture best is no motion. Then
        # the flow across the interval counts alone.
        if (
            to_previous is not None
            and to_next is not None
            and is_still_one_way(to_previous.motion, to_next.motion)
        ):
            to_previous, to_next = (to_previous, None) if before else (None, to_next)
        return with_estimated_motion(self.frame(key), to_previous, to_next)

    def release_before(self, oldest: int) -> None:
        """Drop what no key frame from one on needs."""
        self._frames = {i: frame for i, frame in self._frames.items() if i >= oldest}
        self._flows = {i: pair for i, pair in self._flows.items() if i >= oldest - 1}

    def _flow(self, key: int, neighbour: int) -> Flow | None:
        """Return the flow from a key frame to one beside it, on its window; None without one."""
        if not 0 <= neighbour < self.count or self.is_unreadable(neighbour):
            return None
        first = min(key, neighbour)
        if first not in self._flows:
            frames = self.frame(first), self.frame(first + 1)
            windows = [frame.image.data_window for frame in frames]
            canvas = windows[0].union(windows[1])
            require_canvas(f"frame {frames[0].number} and the next one", canvas)
            flows = estimate_flow(*(frame.image.on(canvas).pixels for frame in frames))
            to_next, to_previous = (
                Flow(
                    place_on_canvas(flow.motion, canvas, window),
                    place_on_canvas(flow.mismatch, canvas, window),
                )
                for flow, window in zip(flows, windows, strict=True)
            )
            self._flows[first] = to_next, to_previous
        return self._flows[first][0 if first == key else 1]


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
