"""Settling what a shot's motion vectors mean: by hand, or by measuring them in some frames."""

from __future__ import annotations

from collections.abc import Callable, Collection
from collections.abc import Sequence as Listed
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from exwarp_cli.domain.frame import Float32, place_on_canvas
from exwarp_cli.domain.motion import AxisMap, MotionConvention, MotionFinding
from exwarp_cli.domain.timeline import number_step
from exwarp_cli.errors import InputError, MotionError
from exwarp_cli.io.channels import Role
from exwarp_cli.io.frames import Shot, is_seen, read_raw
from exwarp_cli.io.producers import PRESETS
from exwarp_cli.pipeline.motion_option import motion_names, parse_motion
from exwarp_cli.pipeline.shots import pair_beside_hold, pairs_within
from exwarp_cli.synthesis.calibration import calibrate, looks_like
from exwarp_cli.synthesis.cuts import is_cut
from exwarp_cli.synthesis.picture_motion import colour_moves, geometry_moves
from exwarp_cli.synthesis.sampling import LEAST, Instant, Interval, Sampled, interval, sampled

SPREAD, MOST_MOVING = 16, 3
"""Pairs that are looked through for motion where the first ones hold none, and those measured."""


@dataclass(frozen=True)
class KeyColours:
    """Key frames whose colour tells what the vectors of frames between them mean.

    Attributes
    ----------
    keys
        The key frames.
    numbers
        For each key frame, the number of the frame at its instant; None where there is none.
    """

    keys: Shot
    numbers: tuple[int | None, ...]


def find_motion(
    shot: Shot,
    given: str | None,
    detect: bool = True,
    starts: Collection[int] = (),
    colours: KeyColours | None = None,
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
    colours
        Key frames with colour, where the shot itself has none.

    Raises
    ------
    MotionError
        When the convention cannot be settled.
    """
    if Role.MOTION not in shot.layout:
        return None
    names, size = motion_names(shot), (shot.display.width, shot.display.height)
    measuring = _Measuring(shot, starts, colours, names)
    if given is None:
        guess = None if shot.layout.guess is None else shot.layout.guess.sized(*size)
        return measuring.finding(guess, detect)
    convention = parse_motion(given, names, size)
    evidence = f"{convention.describe(names)} given by --motion"
    with suppress(InputError, MotionError):
        evidence += _contradiction(measuring.finding(convention, detect))
    return MotionFinding(convention, "given", evidence)


def _contradiction(finding: MotionFinding) -> str:
    """Say what was measured where it contradicts --motion; "" where it does not."""
    if finding.source != "corrected":
        return ""
    measured = finding.evidence.partition(";")[0]
    return f", but the frames contradict it: {measured}{looks_like(finding.preset)}"


class _Measuring:
    """Measures the vectors of a shot in some pairs of its frames; see `find_motion`."""

    def __init__(
        self,
        shot: Shot,
        starts: Collection[int],
        colours: KeyColours | None,
        names: tuple[str, ...],
    ) -> None:
        self._shot = shot
        self._starts = starts
        self._colours = colours
        self._names = names
        self._numbers = shot.sequence.numbers
        self._frames: dict[tuple[int, bool], Sampled] = {}

    def finding(self, guess: MotionConvention | None, detect: bool) -> MotionFinding:
        """Measure by world positions if there are any, else by depth and colour.

        World positions of what moves by itself are not found again. Before a resting camera,
        nothing else moves, so there colour tells.
        """
        layout = self._shot.layout
        firsts = pairs_within(len(self._numbers), self._parted)
        if self._hold_zeros(firsts):
            return self._at_rest(firsts, guess, detect)
        try:
            found = self._beside_cuts(guess, detect, by_colour=False)
        except MotionError:
            if not (Role.POSITION in layout and Role.COLOUR in layout):
                raise
            return self._beside_cuts(guess, detect, by_colour=True)
        if found.source == "untested" and Role.POSITION in layout and Role.COLOUR in layout:
            return self._beside_cuts(guess, detect, by_colour=True)
        return found

    def _hold_zeros(self, firsts: list[int]) -> bool:
        """Return True if the vectors of all these pairs are 0; the first pair nearly always tells.

        The last of an odd number of channels is a length or an alpha.
        """
        used = 2 * (len(self._names) // 2)
        ends = (self._frame(self._numbers[i + j], False) for i in firsts for j in (0, 1))
        return bool(firsts) and not any(
            np.any(one.motion[:, :used]) or np.any(one.moving) for one in ends
        )

    def _at_rest(
        self, firsts: list[int], guess: MotionConvention | None, detect: bool
    ) -> MotionFinding:
        """Return what is read of vectors that are 0; raises MotionError if the picture moves."""
        numbers, layout = self._numbers, self._shot.layout
        frames = ", ".join(f"{numbers[i]}-{numbers[i + 1]}" for i in firsts)
        if any(self._moves(first, detect) for first in firsts):
            raise zero_vectors_error(self._names, frames, layout.producer)
        if moving := self._moving_pairs(firsts, by_colour=False):
            return self._by(moving, guess, by_colour=False)
        evidence = f"the vectors of frames {frames} are 0, and nothing moves there"
        convention = MotionConvention(AxisMap(0, 1, 1.0, -1.0)) if guess is None else guess
        return MotionFinding(convention, "untested", evidence, resting=True)

    def _moves(self, first: int, detect: bool) -> bool:
        """Return True if the picture of a pair moves; what changes at a cut is no motion."""
        numbers, layout = self._numbers, self._shot.layout
        pair = numbers[first], numbers[first + 1]
        found = geometry_moves(*(self._frame(number, False) for number in pair))
        if Role.COLOUR not in layout:
            return found is True
        if found is None:
            before, after = (self._frame(number, True).perceived for number in pair)
            found = before is not None and after is not None and colour_moves(before, after)
        return found and not (detect and _cut_by_colour(self._shot, numbers, first + 1))

    def _beside_holds(self, firsts: list[int], by_colour: bool) -> list[int]:
        """Return the pairs, in place of those that show one picture twice others nearby."""
        return sorted({self._beside_hold(first, by_colour) for first in firsts})

    def _beside_hold(self, first: int, by_colour: bool) -> int:
        def is_hold(index: int) -> bool:
            if abs(index - first) > 1:
                self._frames.clear()  # so that few are in memory
            return self._shows_one_picture(index, by_colour)

        return pair_beside_hold(first, len(self._numbers), self._parted, is_hold)

    def _shows_one_picture(self, first: int, by_colour: bool) -> bool:
        """Return True if both frames of a pair are the same, though their vectors are not at rest.

        Of a pair at rest, others are looked for where all of them are.
        """
        before, after = (self._frame(self._numbers[i], by_colour) for i in (first, first + 1))
        if not (before.moving.any() or after.moving.any()):
            return False
        parts = ("position", "depth", "perceived")
        known = [(getattr(before, part), getattr(after, part)) for part in parts]
        there = [(a, b) for a, b in known if a is not None and b is not None]
        return bool(there) and all(np.array_equal(a, b, equal_nan=True) for a, b in there)

    def _beside_cuts(
        self, guess: MotionConvention | None, detect: bool, by_colour: bool
    ) -> MotionFinding:
        """Measure in pairs that cross no known cut, and where that fails, none that is seen."""
        count = len(self._numbers)
        firsts = pairs_within(count, self._unseen) or pairs_within(count, self._parted)
        try:
            return self._in_pairs(firsts, guess, by_colour)
        except MotionError:
            if not detect or Role.COLOUR not in self._shot.layout:
                raise
            others = pairs_within(
                count,
                lambda i: self._unseen(i) or _cut_by_colour(self._shot, self._numbers, i),
            )
            if others == firsts:
                raise
            return self._in_pairs(others, guess, by_colour)

    def _in_pairs(
        self, firsts: list[int], guess: MotionConvention | None, by_colour: bool
    ) -> MotionFinding:
        """Measure by the first pair alone, which most runs read first anyway, if it tells all.

        If nothing moves in all of them, look for pairs in which something does.
        """
        if len(firsts) > 1:
            with suppress(MotionError):
                found = self._by(self._beside_holds(firsts[:1], by_colour), guess, by_colour)
                if found.clear:
                    return found
        firsts = self._beside_holds(firsts, by_colour)
        found = self._by(firsts, guess, by_colour)
        moving = self._moving_pairs(firsts, by_colour) if found.resting else []
        return self._by(moving, guess, by_colour) if moving else found

    def _by(
        self, firsts: list[int], guess: MotionConvention | None, by_colour: bool
    ) -> MotionFinding:
        """Measure in these pairs."""
        numbers = self._numbers
        # One after the other: each is decoded on all threads, and two at once took a sixth more.
        pairs = [tuple(self._frame(numbers[j], by_colour) for j in (i, i + 1)) for i in firsts]
        width, height = self._shot.display.width, self._shot.display.height
        return calibrate(
            [(before, after) for before, after in pairs],
            guess,
            self._names,
            self._intervals(len(firsts)),
            {name: preset.sized(width, height) for name, preset in PRESETS.items()},
            number_step(numbers),
        )

    def _moving_pairs(self, firsts: list[int], by_colour: bool) -> list[int]:
        """Return pairs in which something moves, of some that are evenly spread; few at most."""
        count = len(self._numbers) - 1
        others = sorted({count * i // SPREAD for i in range(SPREAD)} - set(firsts))
        moving: list[int] = []
        for first in others:
            if self._parted(first + 1) or len(moving) == MOST_MOVING:
                continue
            ends = [self._frame(self._numbers[i], by_colour) for i in (first, first + 1)]
            if any(np.count_nonzero(one.moving & one.usable) >= LEAST for one in ends):
                moving.append(first)
            else:
                self._frames.clear()
        return moving

    def _frame(self, number: int, by_colour: bool) -> Sampled:
        """Read and reduce a frame; what was reduced before is kept."""
        key = number, by_colour
        if key not in self._frames:
            # On the display window: data windows differ, and normalised vectors go by it. World
            # positions tell points apart best, and alone; reading the rest takes most of the time.
            by_position = Role.POSITION in self._shot.layout and not by_colour
            seen = Role.POSITION if by_position else Role.COLOUR
            raw = read_raw(self._shot, number, (Role.MOTION, Role.DEPTH, Role.STENCIL, seen))
            assert raw.motion is not None
            motion = place_on_canvas(raw.motion, raw.gbuffer.window, self._shot.display, np.nan)
            colour = None if raw.image is None else raw.image.on(self._shot.display).pixels
            self._frames[key] = sampled(
                Instant(number, raw.gbuffer.on(self._shot.display), motion, colour)
            )
        return self._frames[key]

    def _parted(self, index: int) -> bool:
        """Whether a frame and the one before it do not belong together, or cannot be read."""
        numbers = self._numbers
        if numbers[index] in self._starts:
            return True
        return self._shot.keep_going and not all(
            _is_sound(lambda n: self._frame(n, False), n) for n in numbers[index - 1 : index + 1]
        )

    def _unseen(self, index: int) -> bool:
        """Whether a frame and the one before it tell nothing, as one lies beyond the display."""
        pair = self._numbers[index - 1 : index + 1]
        return self._parted(index) or not all(is_seen(self._shot, number) for number in pair)

    def _intervals(self, count: int) -> list[Interval]:
        """Read so many intervals between key frames whose colours tell; [] without colours."""
        colours = self._colours
        if colours is None:
            return []
        ends = colours.numbers

        def parted(index: int) -> bool:
            return ends[index] in self._starts or None in ends[index - 1 : index + 1]

        found = (self._interval(i) for i in pairs_within(len(ends), parted)[:count])
        return [one for one in found if one is not None]

    def _interval(self, index: int) -> Interval | None:
        """Read two key frames' colours and the vectors between; None where one cannot be read."""
        assert self._colours is not None
        shot, ends = self._colours.keys, self._colours.numbers
        numbers = shot.sequence.numbers[index], shot.sequence.numbers[index + 1]
        first, last = ends[index], ends[index + 1]
        assert first is not None and last is not None
        try:
            before, after = (
                read_raw(shot, number, (Role.COLOUR,)).key(None).image.on(shot.display).pixels
                for number in numbers
            )
            between = [number for number in self._numbers if first <= number <= last]
            vectors = [_vectors(self._shot, number) for number in between]
        except InputError:
            if not self._shot.keep_going:
                raise
            return None
        return interval(numbers, before, after, vectors)


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


def _vectors(shot: Shot, number: int) -> Float32:
    """Read a frame's motion channels on the display window."""
    raw = read_raw(shot, number, (Role.MOTION,))
    assert raw.motion is not None
    return place_on_canvas(raw.motion, raw.gbuffer.window, shot.display, np.nan)


SETTINGS = {
    "Blender": "switch it off in Render Properties > Motion Blur, as Cycles writes no vectors with "
    "it",
    "Arnold": "Arnold writes vectors only with Motion Blur on: switch it on together with "
    "Instantaneous Shutter",
    "Redshift": "Redshift writes vectors only with Motion Blur on, and keeps the beauty sharp "
    "meanwhile: switch it on",
    "V-Ray": "switch it off in Render Settings > Motion Blur, and check that the Velocity element "
    "is on",
    "Karma": "switch it off in the Karma render settings > Rendering > Motion Blur",
    "RenderMan": "switch it off in Render Settings > Motion Blur",
}
"""What to do by producer, as `io.producers` names them."""

ANY = "switch it off in the renderer's settings"


def zero_vectors_error(names: tuple[str, ...], frames: str, producer: str) -> MotionError:
    """Return the error for vectors that are 0 while the picture moves.

    Parameters
    ----------
    names
        Of the motion channels.
    frames
        Numbers of the frames that were looked at.
    producer
        What wrote the files, as far as they tell.
    """
    advice = next((text for name, text in SETTINGS.items() if producer.startswith(name)), ANY)
    return MotionError(
        f"the motion channels {', '.join(names)} are 0 throughout in frames {frames}, while the "
        f"picture moves: motion blur was on, or the pass is empty; {advice}, and render the motion "
        "pass again; if nothing is meant to move, give --motion"
    )
