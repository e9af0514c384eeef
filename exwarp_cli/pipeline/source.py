"""Opening an input: its frames, numbering, rate and what its motion vectors mean."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from exwarp_cli.domain.frame import place
from exwarp_cli.domain.motion import MotionFinding
from exwarp_cli.domain.settings import DEFAULT_FPS, SourceSettings
from exwarp_cli.domain.timeline import FACTOR, MOST, Slot, Timeline, ranges
from exwarp_cli.errors import InputError, LayoutError, MissingFrameError, MotionError, UsageError
from exwarp_cli.io.channels import Role
from exwarp_cli.io.frames import Shot, read_raw
from exwarp_cli.io.output import frame_rate, read_headers
from exwarp_cli.io.sequence import Sequence
from exwarp_cli.pipeline.motion_option import motion_names, parse_motion
from exwarp_cli.pipeline.opening import open_keys, open_slots
from exwarp_cli.synthesis.calibration import calibrate
from exwarp_cli.synthesis.probing import Instant

FrameOf = Callable[[Slot], int | None]


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
        Base rate, and where it came from: "option", "header" or "assumed".
    """

    keys: Shot
    slots: Shot | None
    slot_number: FrameOf
    timeline: Timeline
    finding: MotionFinding | None
    fps: Fraction
    fps_source: str

    @property
    def output_fps(self) -> Fraction:
        """Frames per second of the output."""
        return self.fps * self.timeline.factor

    @property
    def setting(self) -> str:
        """Name of the setting, "key" or "slot"."""
        return "key" if self.slots is None else "slot"


def open_source(settings: SourceSettings, motion_needed: bool = True) -> Source:
    """Find and recognise an input.

    Parameters
    ----------
    settings
        What the user said.
    motion_needed
        Whether the method uses motion vectors. Without, a convention that cannot be settled is no
        error, and G-buffers at the output rate without vectors to the previous slot are left out.

    Raises
    ------
    InputError
        When a sequence is missing, has gaps, or lacks what is needed.
    MotionError
        When the convention of the motion vectors cannot be settled.
    """
    keys, settings = open_keys(settings)
    if Role.COLOUR not in keys.layout:
        raise LayoutError(
            f"{keys.sequence.pattern} has no colour channels that are recognised; list its "
            "channels with 'exwarp inspect'"
        )
    fps, fps_source = rate_of(keys, settings.fps)
    factor = factor_of(settings, fps)
    timeline = Timeline.of(keys.sequence.numbers, settings.start_frame, settings.tail, factor)
    if settings.gbuffers is not None and timeline.steps is None:
        raise UsageError(
            f"--gbuffers lead from slot to slot between key frames, and from {float(fps):g} to "
            f"{float(fps * factor):g} fps most key frames are no output instants; leave --gbuffers "
            "out, or give a whole --factor"
        )
    slots = open_slots(settings, keys)
    slot_number: FrameOf = _no_number
    if slots is not None:
        slot_number = align(timeline, slots.sequence, "--gbuffers")
        _enough(timeline, slots, slot_number)
    shot = slots or keys
    try:
        finding = find_motion(shot, settings.motion)
    except MotionError:
        if motion_needed:
            raise
        finding = None
    if motion_needed and finding is None:
        half = shot.layout.incomplete.get(Role.MOTION)
        told = "" if half is None else f" ({half})"
        raise LayoutError(
            f"{shot.sequence.pattern} has no motion vectors that are recognised{told}; render the "
            "motion pass, or use --method hold or blend"
        )
    if slots is not None and (finding is None or finding.convention.to_previous is None):
        if motion_needed:
            raise LayoutError(
                f"--gbuffers {slots.sequence.pattern} has no readable vectors to the previous "
                "slot, along which colour is moved; render them, or leave --gbuffers out"
            )
        slots, slot_number, finding = None, _no_number, None
    return Source(keys, slots, slot_number, timeline, finding, fps, fps_source)


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
    factor = settings.to_fps / fps
    if not 1 < factor <= MOST:
        raise UsageError(
            f"--to-fps {float(settings.to_fps):g} is {float(factor):g} times the input's "
            f"{float(fps):g} fps; give more than that and at most {MOST} times it, or correct the "
            "input's rate with --fps"
        )
    return factor


def find_motion(shot: Shot, given: str | None) -> MotionFinding | None:
    """Settle the motion convention of a shot, by hand or by measuring; None without motion."""
    if Role.MOTION not in shot.layout:
        return None
    names, size = motion_names(shot), (shot.display.width, shot.display.height)
    if given is not None:
        convention = parse_motion(given, names, size)
        return MotionFinding(convention, "given", f"{convention.describe(names)} given by --motion")
    numbers = shot.sequence.numbers
    firsts = sorted({0, (len(numbers) - 1) // 2, len(numbers) - 2} - {-1})
    pairs = [
        (_instant(shot, numbers[i]), _instant(shot, numbers[i + 1]))
        for i in firsts
        if i + 1 < len(numbers)
    ]
    guess = None if shot.layout.guess is None else shot.layout.guess.sized(*size)
    return calibrate(pairs, guess, names)


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
        told = f"{what} needs every frame, those at the key frames' instants too: {error}"
        raise MissingFrameError(told) from error
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


def _instant(shot: Shot, number: int) -> Instant:
    """Read a frame on the display window: data windows differ, and normalised vectors go by it."""
    # World positions tell points apart best, and alone; reading the rest takes most of the time.
    seen = (Role.POSITION,) if Role.POSITION in shot.layout else (Role.COLOUR,)
    raw = read_raw(shot, number, (Role.MOTION, Role.DEPTH, Role.STENCIL, *seen))
    assert raw.motion is not None
    motion = place(raw.motion, raw.gbuffer.window, shot.display, np.nan)
    colour = None if raw.image is None else raw.image.on(shot.display).pixels
    return Instant(number, raw.gbuffer.on(shot.display), motion, colour)


def rate_of(keys: Shot, given: Fraction | None) -> tuple[Fraction, str]:
    """Return the base rate, and whether it is from the option, the header or assumed."""
    if given is not None:
        return given, "option"
    first = keys.sequence.files[keys.sequence.numbers[0]]
    for header in read_headers(first):
        found = frame_rate(header)
        if found is not None:
            return found, "header"
    return DEFAULT_FPS, "assumed"
