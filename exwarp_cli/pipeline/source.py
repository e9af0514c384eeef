"""Opening an input: its frames, numbering, rate and what its motion vectors mean."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection
from dataclasses import dataclass, field
from fractions import Fraction

from exwarp_cli.domain.motion import MotionConvention, MotionFinding
from exwarp_cli.domain.settings import SourceSettings
from exwarp_cli.domain.timeline import (
    FACTOR,
    MAX_FACTOR,
    CutOption,
    OutputRate,
    Slot,
    Timeline,
    compatible_rate,
    parse_cuts,
    ranges,
    standard_rate,
)
from exwarp_cli.errors import (
    InputError,
    LayoutError,
    MissingFrameError,
    MotionError,
    UsageError,
)
from exwarp_cli.io.channels import Role
from exwarp_cli.io.frames import Shot
from exwarp_cli.io.sequence import Sequence
from exwarp_cli.io.unrecognised import is_colour_alone, no_vectors
from exwarp_cli.pipeline.depth_kind import read_alike, with_depth_ordered
from exwarp_cli.pipeline.motion_finding import KeyColours, find_motion
from exwarp_cli.pipeline.opening import (
    each_view,
    open_keys,
    open_plain,
    open_slots,
    rate_of,
    read_ids,
)
from exwarp_cli.runtime.frame_pool import IN_MEMORY, ScratchFrames

FrameOf = Callable[[Slot], int | None]

ESTIMATED = (
    "estimated",
    "from colour by OpenCV's DIS optical flow between neighbouring key frames, far less exact than "
    "a renderer's vectors",
)
"""What is said of motion without vectors."""


@dataclass(frozen=True)
class Source:
    """An opened input.

    Attributes
    ----------
    keys
        The key frames.
    slots
        G-buffers at the output rate; None in the key setting, and where they were left out.
    slot_number
        The number of a slot's frame in `slots`; None where it has none.
    timeline
        Numbering.
    finding
        Convention of the motion vectors in use: those of `slots` where there are some, else of the
        keys; None without motion.
    fps, fps_source
        Base rate, and where it came from: "option", "header", "file" (a video's) or
        "assumed".
    cuts
        What the user says about cuts; those given lie at key frames.
    estimated
        Whether motion is needed and there are no vectors, so that it is estimated from colour.
    unusable
        Why vectors that are there are not used, and motion is estimated instead; "" otherwise.
    scratch
        Where large key frames lie when a network may extrapolate.
    """

    keys: Shot
    slots: Shot | None
    slot_number: FrameOf
    timeline: Timeline
    finding: MotionFinding | None
    fps: Fraction
    fps_source: str
    cuts: CutOption
    estimated: bool = False
    unusable: str = ""
    scratch: ScratchFrames = field(default=IN_MEMORY, compare=False, repr=False)

    @property
    def output_fps(self) -> Fraction:
        """Frames per second of the output."""
        return self.fps * self.timeline.factor

    @property
    def output_rate(self) -> OutputRate:
        """Frames per second of the output, and what written frames say of them."""
        return OutputRate(self.output_fps, self.written_fps)

    @property
    def written_fps(self) -> Fraction | None:
        """The rate that written frames say they have; None where it is assumed."""
        return None if self.fps_source == "assumed" else self.output_fps

    @property
    def moves(self) -> bool:
        """Whether motion is known, by vectors or estimated."""
        return self.estimated or self.finding is not None

    @property
    def convention(self) -> MotionConvention | None:
        """Convention of the motion vectors in use; None without motion."""
        return None if self.finding is None else self.finding.convention

    @property
    def motion_origin(self) -> tuple[str, str] | None:
        """Where motion is from, in a word and in a sentence; None without motion."""
        if self.estimated:
            name, how = ESTIMATED
            return name, f"{how}; vectors are not used: {self.unusable}" if self.unusable else how
        return None if self.finding is None else (self.finding.source, self.finding.evidence)

    @property
    def setting(self) -> str:
        """Name of the setting, "key" or "slot"."""
        return "key" if self.slots is None else "slot"


def open_source(
    settings: SourceSettings,
    motion_needed: bool = True,
    pictures: bool = False,
) -> Source:
    """Find and recognise an input.

    Parameters
    ----------
    settings
        What the user said.
    motion_needed
        Whether the method uses motion vectors. Without, a convention that cannot be settled is no
        error, and G-buffers at the output rate without vectors to the previous slot are left out.
    pictures
        Whether videos, stills and EXR with colour alone are taken, and their motion estimated; and
        EXR with other passes and without usable vectors, where `settings` allow it.

    Raises
    ------
    InputError
        When a sequence is missing, has gaps, or lacks what is needed.
    MotionError
        When the convention of the motion vectors cannot be settled.
    """
    cuts = parse_cuts(settings.cuts)
    plain = open_plain(settings) if pictures else None
    if plain is not None:
        fps, fps_source = rate_of(plain, settings.fps)
        timeline = _timeline(plain, settings, fps)
        cuts.starts_in(timeline.numbers)
        return Source(plain, None, _no_number, timeline, None, fps, fps_source, cuts, motion_needed)
    keys, settings = open_keys(settings)
    if Role.COLOUR not in keys.layout:
        raise LayoutError(
            f"{keys.sequence.pattern} has no colour channels that are recognised, only "
            f"{keys.listed}; name them in a channel map, or render the beauty pass"
        )
    fps, fps_source = rate_of(keys, settings.fps)
    timeline = _timeline(keys, settings, fps)
    if settings.gbuffers is not None and timeline.steps is None:
        raise UsageError(
            f"--gbuffers lead from slot to slot between key frames, and from {float(fps):g} to "
            f"{float(fps * timeline.factor):g} fps most key frames are no output instants; leave "
            "--gbuffers out, or give a whole --factor"
        )
    begin = cuts.starts_in(timeline.numbers)
    keys, slots = read_ids(settings.dynamic, keys, open_slots(settings, keys))
    slot_number: FrameOf = _no_number
    if slots is not None:
        slot_number = align(timeline, slots.sequence, "--gbuffers")
        _enough(timeline, slots, slot_number)
    shot = slots or keys
    starts = _numbers_at(begin, timeline, None if slots is None else slot_number)
    unusable = ""
    try:
        colours = _key_colours(keys, slots, timeline, slot_number)
        finding = find_motion(shot, settings.motion, cuts.detect, starts, colours)
    except MotionError as error:
        if motion_needed and not (pictures and _may_estimate(settings)):
            raise
        finding, unusable = None, str(error)
    keys, slots = _with_depth(keys, slots, finding, starts)
    shot = slots or keys
    estimated = finding is None and motion_needed and pictures and _is_estimated(shot, settings)
    if motion_needed and not estimated:
        _require_vectors(shot, finding, slots, pictures)
    if slots is not None and (finding is None or finding.convention.to_previous is None):
        slots, slot_number, finding = None, _no_number, None
    return Source(
        keys, slots, slot_number, timeline, finding, fps, fps_source, cuts, estimated, unusable
    )


def open_sources(
    settings: SourceSettings, motion_needed: bool, pictures: bool = False
) -> tuple[Source, ...]:
    """Open the view that is asked for; of all views every one, the hero first; see `open_source`.

    Raises
    ------
    UsageError
        When all views are asked for, and each has files of its own.
    """
    sources = tuple(open_source(view, motion_needed, pictures) for view in each_view(settings))
    leader, *others = sources
    for other in others:
        if other.keys.sequence.files != leader.keys.sequence.files:
            raise UsageError(
                f"--view all writes all views into one file, and here each has its own "
                f"({leader.keys.sequence.pattern}); run once for each: "
                + ", ".join(f"--view {source.keys.view}" for source in sources)
            )
    return sources


def _key_colours(
    keys: Shot, slots: Shot | None, timeline: Timeline, slot_number: FrameOf
) -> KeyColours | None:
    """Return the key frames to measure slots' vectors by, where these have no colour."""
    if slots is None or {Role.COLOUR, Role.POSITION} & set(slots.layout.roles):
        return None
    if (keys.display.width, keys.display.height) != (slots.display.width, slots.display.height):
        return None
    count = len(timeline.numbers)
    return KeyColours(keys, tuple(slot_number(Slot(key, 0)) for key in range(count)))


def _with_depth(
    keys: Shot,
    slots: Shot | None,
    finding: MotionFinding | None,
    starts: Collection[int],
) -> tuple[Shot, Shot | None]:
    """Return key frames and slots with depth as their vectors say it grows.

    Depth of the same name in both is read alike. `starts` are numbers at which shots begin.
    """
    if finding is None:
        return keys, slots
    shot = slots or keys
    found = with_depth_ordered(shot, finding.convention, starts)
    if found is shot:
        return keys, slots
    if slots is None:
        return found, None
    names = [{ref.name for ref in each.layout.roles.get(Role.DEPTH, ())} for each in (keys, slots)]
    if names[0] == names[1] and keys.depth == slots.depth:
        keys = read_alike(keys, found)
    return keys, found


def _require_vectors(
    shot: Shot, finding: MotionFinding | None, slots: Shot | None, estimable: bool
) -> None:
    """Refuse a shot without vectors, and G-buffers of slots without those to the previous one."""
    if finding is None:
        raise LayoutError(no_vectors(shot, estimable and slots is None))
    if slots is not None and finding.convention.to_previous is None:
        raise LayoutError(
            f"--gbuffers {slots.sequence.pattern} has no readable vectors to the previous slot, "
            "along which colour is moved; render them, or leave --gbuffers out"
        )


def _timeline(keys: Shot, settings: SourceSettings, fps: Fraction) -> Timeline:
    factor = factor_of(settings, fps)
    return Timeline.of(keys.sequence.numbers, settings.start_frame, settings.tail, factor)


def _may_estimate(settings: SourceSettings) -> bool:
    """Whether the user allows an estimate, and means no vectors."""
    return settings.estimate_motion and settings.gbuffers is None and settings.motion is None


def _is_estimated(shot: Shot, settings: SourceSettings) -> bool:
    """Whether the motion of a shot without usable vectors is estimated from colour.

    A render with passes is meant to have vectors: a farm would not notice that they are missing.
    """
    meant = settings.gbuffers is not None or settings.motion is not None
    footage = not meant and Role.MOTION not in shot.layout and is_colour_alone(shot)
    return footage or _may_estimate(settings)


def factor_of(settings: SourceSettings, fps: Fraction) -> Fraction:
    """Return how many output frames there are per key frame.

    Raises
    ------
    UsageError
        When --factor and --to-fps are both given, or the rate is not above the input's, or too far.
    """
    if settings.to_fps is None:
        return Fraction(FACTOR if settings.factor is None else settings.factor)
    if settings.factor is not None:
        raise UsageError("--factor and --to-fps say the same in two ways; give one of them")
    factor = compatible_rate(fps, standard_rate(settings.to_fps)) / fps
    if not 1 < factor <= MAX_FACTOR:
        raise UsageError(
            f"--to-fps {float(settings.to_fps):g} is {float(factor):g} times the input's "
            f"{float(fps):g} fps; give more than that and at most {MAX_FACTOR} times it, or "
            "correct the input's rate with --fps"
        )
    return factor


def _numbers_at(keys: Collection[int], timeline: Timeline, slot_number: FrameOf | None) -> set[int]:
    """Return the numbers of key frames' instants, by index: theirs, or their slots'."""
    if slot_number is None:
        return {timeline.numbers[key] for key in keys}
    found = (slot_number(Slot(key, 0)) for key in keys)
    return {number for number in found if number is not None}


def align(timeline: Timeline, sequence: Sequence, what: str) -> FrameOf:
    """Match a sequence at the output rate to slots: by number where its numbers are those.

    Else by order: its first frame belongs to the first key frame.

    Raises
    ------
    InputError
        When the sequence has gaps, also where only the key frames' instants are missing.
    """
    try:
        numbers = Timeline.of(sequence.numbers).numbers
    except MissingFrameError as error:
        message = f"{what} needs every frame, those at the key frames' instants too: {error}"
        raise MissingFrameError(message) from error
    known = set(numbers)
    count = math.floor((len(timeline.numbers) - 1) * timeline.factor) + 1
    expected = range(timeline.start, timeline.start + count)
    by_number = known.issuperset(expected)

    def frame_of(slot: Slot) -> int | None:
        if by_number:
            number = timeline.number(slot)
            return number if number in known else None
        order = timeline.order(slot)
        return numbers[order] if order < len(numbers) else None

    if len(numbers) == len(timeline.numbers) < count:
        raise InputError(
            f"{what} has {len(numbers)} frames like the key frames, but has to be at "
            f"{float(timeline.factor):g} times their rate; check the path"
        )
    if len(numbers) > 1 and numbers[1] - numbers[0] > 1 and known.issubset(expected):
        # By order, each would be taken for a frame of another instant.
        raise InputError(
            f"{what} has only the frames {ranges(list(numbers))} of {expected[0]}-{expected[-1]}, "
            "and needs every frame from the first key frame on; give the whole sequence"
        )
    return frame_of


def _no_number(_slot: Slot) -> int | None:
    return None


def _enough(timeline: Timeline, slots: Shot, frame_of: FrameOf) -> None:
    """Refuse slot G-buffers that end before the last key frame."""
    last = Slot(len(timeline.numbers) - 1, 0)
    if frame_of(last) is None:
        raise InputError(
            f"--gbuffers {slots.sequence.pattern} has frames {ranges(slots.sequence.numbers)}, "
            f"fewer than the {timeline.order(last) + 1} slots up to the last key frame; render the "
            "others"
        )
