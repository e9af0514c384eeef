"""Settling what a shot's motion vectors mean: by hand, or by measuring them in some frames."""

from __future__ import annotations

from collections.abc import Callable, Collection
from collections.abc import Sequence as Listed
from contextlib import suppress
from functools import cache

import numpy as np

from exwarp_cli.domain.frame import place
from exwarp_cli.domain.motion import MotionFinding
from exwarp_cli.errors import InputError, MotionError
from exwarp_cli.io.channels import Role
from exwarp_cli.io.frames import RawFrame, Shot, read_raw
from exwarp_cli.pipeline.early_frames import EarlyFrames, serves
from exwarp_cli.pipeline.motion_option import motion_names, parse_motion
from exwarp_cli.pipeline.shots import pairs_within
from exwarp_cli.synthesis.calibration import calibrate
from exwarp_cli.synthesis.cuts import is_cut
from exwarp_cli.synthesis.sampling import Instant, Sampled, sampled


def find_motion(
    shot: Shot,
    given: str | None,
    detect: bool = True,
    starts: Collection[int] = (),
    early: EarlyFrames | None = None,
) -> MotionFinding | None:
    """Settle the motion convention of a shot, by hand or by measuring; None without motion.

    Parameters
    ----------
    shot
        Whose vectors.
    given
        A convention by hand.
    detect
        Whether to look for cuts, where vectors explain nothing: what crosses one is no motion.
    starts
        Numbers of frames before which cuts are known.
    early
        Where frames are kept that a run reads first.

    Raises
    ------
    MotionError
        When the convention cannot be settled.
    """
    if Role.MOTION not in shot.layout:
        return None
    names, size = motion_names(shot), (shot.display.width, shot.display.height)
    if given is not None:
        convention = parse_motion(given, names, size)
        return MotionFinding(convention, "given", f"{convention.describe(names)} given by --motion")
    numbers = shot.sequence.numbers
    guess = None if shot.layout.guess is None else shot.layout.guess.sized(*size)

    @cache
    def frame(number: int) -> Sampled:
        return _sampled(shot, early or EarlyFrames(), number)

    def by(firsts: list[int]) -> MotionFinding:
        # One after the other: each is decoded on all threads, and two at once took a sixth more.
        pairs = [(frame(numbers[i]), frame(numbers[i + 1])) for i in firsts]
        return calibrate(pairs, guess, names)

    def lacks(i: int) -> bool:
        return shot.keep_going and not all(_is_sound(frame, n) for n in numbers[i - 1 : i + 1])

    firsts = pairs_within(len(numbers), lambda i: numbers[i] in starts or lacks(i))
    try:
        return _measured(by, firsts)
    except MotionError:
        if not detect or Role.COLOUR not in shot.layout:
            raise
        others = pairs_within(
            len(numbers),
            lambda i: numbers[i] in starts or lacks(i) or _cut_by_colour(shot, numbers, i),
        )
        if others == firsts:
            raise
        return _measured(by, others)


def _measured(by: Callable[[list[int]], MotionFinding], firsts: list[int]) -> MotionFinding:
    """Measure by the first pair alone, which most runs read first anyway, where it tells all."""
    if len(firsts) > 1:
        with suppress(MotionError):
            finding = by(firsts[:1])
            if finding.clear:
                return finding
    return by(firsts)


def _cut_by_colour(shot: Shot, numbers: Listed[int], index: int) -> bool:
    """Whether a cut lies before a frame, as far as colour tells without motion."""
    pair = numbers[index - 1], numbers[index]
    before, after = (read_raw(shot, number, (Role.COLOUR,)).key(None) for number in pair)
    return is_cut(before, after).found


def _is_sound(frame: Callable[[int], Sampled], number: int) -> bool:
    """Whether a frame can be measured in."""
    try:
        frame(number)
    except InputError:
        return False
    return True


def _sampled(shot: Shot, early: EarlyFrames, number: int) -> Sampled:
    """Read a frame on the display window: data windows differ, and normalised vectors go by it."""
    raw = _read(shot, early, number)
    assert raw.motion is not None
    motion = place(raw.motion, raw.gbuffer.window, shot.display, np.nan)
    colour = None if raw.image is None else raw.image.on(shot.display).pixels
    return sampled(Instant(number, raw.gbuffer.on(shot.display), motion, colour))


def _read(shot: Shot, early: EarlyFrames, number: int) -> RawFrame:
    """Read of a frame what vectors are measured by, or as a run does where that has it in it."""
    # World positions tell points apart best, and alone; reading the rest takes most of the time.
    seen = (Role.POSITION,) if Role.POSITION in shot.layout else (Role.COLOUR,)
    roles = (Role.MOTION, Role.DEPTH, Role.STENCIL, *seen)
    if number in early.numbers:
        try:
            raw = read_raw(shot, number, early.roles, objects=True)
        except InputError:  # what is wrong with the rest of it is said when it is wanted
            return read_raw(shot, number, roles)
        if serves(raw, shot, roles):
            early.keep(raw)
            return raw
    return read_raw(shot, number, roles)
