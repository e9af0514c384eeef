"""Opening an input: its frames, numbering, rate and what its motion vectors mean."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from exwarp_cli.domain.frame import place
from exwarp_cli.domain.motion import AxisMap, MotionConvention, MotionFinding
from exwarp_cli.domain.settings import DEFAULT_FPS, SourceSettings
from exwarp_cli.domain.timeline import FACTOR, Slot, Timeline, ranges
from exwarp_cli.errors import InputError, LayoutError, MissingFrameError, MotionError, UsageError
from exwarp_cli.io.channels import PRESETS, Role
from exwarp_cli.io.frames import Shot, open_shot, read_raw
from exwarp_cli.io.output import frame_rate, read_headers
from exwarp_cli.io.sequence import Sequence
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
    keys = open_shot(settings.sequence)
    if Role.COLOUR not in keys.layout:
        raise LayoutError(
            f"{keys.sequence.pattern} has no colour channels that are recognised; list its "
            "channels with 'exwarp inspect'"
        )
    timeline = Timeline.of(keys.sequence.numbers, settings.start_frame, settings.tail)
    slots = None if settings.gbuffers is None else open_shot(settings.gbuffers)
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
        raise LayoutError(
            f"{shot.sequence.pattern} has no motion vectors that are recognised; render the motion "
            "pass, or use --method hold or blend"
        )
    if slots is not None and (finding is None or finding.convention.to_previous is None):
        if motion_needed:
            raise LayoutError(
                f"--gbuffers {slots.sequence.pattern} has no readable vectors to the previous "
                "slot, along which colour is moved; render them, or leave --gbuffers out"
            )
        slots, slot_number, finding = None, _no_number, None
    fps, fps_source = rate_of(keys, settings.fps)
    return Source(keys, slots, slot_number, timeline, finding, fps, fps_source)


def find_motion(shot: Shot, given: str | None) -> MotionFinding | None:
    """Settle the motion convention of a shot, by hand or by measuring; None without motion."""
    if Role.MOTION not in shot.layout:
        return None
    names = motion_names(shot)
    if given is not None:
        convention = parse_motion(given, names)
        return MotionFinding(convention, "given", f"{convention.describe(names)} given by --motion")
    numbers = shot.sequence.numbers
    firsts = sorted({0, (len(numbers) - 1) // 2, len(numbers) - 2} - {-1})
    pairs = [
        (_instant(shot, numbers[i]), _instant(shot, numbers[i + 1]))
        for i in firsts
        if i + 1 < len(numbers)
    ]
    return calibrate(pairs, shot.layout.guess, names)


def motion_names(shot: Shot) -> tuple[str, ...]:
    """Names of the motion channels as --motion takes them, with their layer where needed."""
    refs = shot.layout.roles[Role.MOTION]
    short = [ref.component for ref in refs]
    if len(set(short)) == len(short):
        return tuple(short)
    return tuple(".".join(ref.name.split(".")[-2:]) for ref in refs)


def parse_motion(text: str, names: tuple[str, ...]) -> MotionConvention:
    """Read the ``--motion`` option.

    A preset's name (blender, unreal, forward …), or the channels that hold the displacement to the
    previous and next frame in pixels, x right and y down, with signs and factors:
    ``previous=X,-Y next=-Z,W``, ``next=0.5*u,-0.5*v``.

    Raises
    ------
    UsageError
        When the text is neither.
    """
    preset = PRESETS.get(text.strip().lower())
    if preset is not None:
        highest = max(
            max(m.x_channel, m.y_channel) for m in (preset.to_previous, preset.to_next) if m
        )
        if highest >= len(names):
            raise UsageError(
                f"--motion {text} needs {highest + 1} motion channels and there are "
                f"{len(names)}: {', '.join(names)}"
            )
        return preset
    maps: dict[str, AxisMap] = {}
    for clause in text.split():
        direction, _, terms = clause.partition("=")
        axes = [_axis(term, names) for term in terms.split(",")]
        known = direction in ("previous", "next") and direction not in maps
        if not known or len(axes) != 2 or None in axes:
            raise UsageError(
                f"--motion {text!r} is not understood; write a preset ({', '.join(PRESETS)}) or "
                f"for example 'previous={names[0]},-{names[1]}', with channels out of "
                f"{', '.join(names)}"
            )
        (x, x_scale), (y, y_scale) = (axis for axis in axes if axis is not None)
        maps[direction] = AxisMap(x, y, x_scale, y_scale)
    if not maps:
        raise UsageError("--motion is empty; write a preset or a convention, or leave it out")
    return MotionConvention(maps.get("previous"), maps.get("next"))


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
    count = FACTOR * (len(timeline.numbers) - 1) + 1
    expected = range(timeline.start, timeline.start + count)
    by_number = known.issuperset(expected)

    def frame_of(slot: Slot) -> int | None:
        if by_number:
            number = timeline.number(slot)
            return number if number in known else None
        return numbers[slot.order] if slot.order < len(numbers) else None

    if len(numbers) == len(timeline.numbers) and len(numbers) > 1:
        raise InputError(
            f"{what} has {len(numbers)} frames like the key frames, but has to be at {FACTOR} "
            "times their rate; check the path"
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
            f"fewer than the {last.order + 1} slots up to the last key frame; render the others"
        )


def _axis(term: str, names: tuple[str, ...]) -> tuple[int, float] | None:
    """Read one signed, scaled channel of a convention; None when it is not one."""
    match = re.fullmatch(r"(?P<sign>[+-]?)(?:(?P<factor>[0-9.]+)\*)?(?P<name>[^*]+)", term.strip())
    if match is None or match["name"] not in names:
        return None
    try:
        factor = float(match["factor"] or 1.0)
    except ValueError:
        return None
    return names.index(match["name"]), -factor if match["sign"] == "-" else factor


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
