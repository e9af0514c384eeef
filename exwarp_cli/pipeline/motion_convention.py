"""What a shot's motion vectors mean: by ``--motion``, or measured in some pairs of its frames."""

from __future__ import annotations

import re
from collections.abc import Collection
from contextlib import suppress
from dataclasses import dataclass, field

import numpy as np

from exwarp_cli.domain.frame import place_on_canvas
from exwarp_cli.domain.motion import PRESETS, AxisMap, MotionConvention, MotionFinding
from exwarp_cli.domain.timeline import number_step
from exwarp_cli.errors import InputError, MotionError, UsageError
from exwarp_cli.io.channels import Role
from exwarp_cli.io.frames import is_visible, read_raw
from exwarp_cli.io.shot import Shot
from exwarp_cli.pipeline.shots import pairs_around, pairs_within
from exwarp_cli.synthesis import calibration_samples
from exwarp_cli.synthesis.calibration import calibrate, preset_hint
from exwarp_cli.synthesis.cut_detection import compare_thumbnails, make_thumbnail
from exwarp_cli.synthesis.holds import has_colour_moved, has_geometry_moved

# Words for the frame's size in pixels, as factors of ``--motion``.
UNITS = ("width", "height")

# Factors of ``--motion`` up to which vectors stay numbers of 32 bits.
MOST = 1e30

# Pairs that are looked through for motion where the first ones hold none, and those measured.
SPREAD, MOST_MOVING = 16, 3

# What to do about motion blur, by producer as `io.channels` names them.
BLUR_ADVICE = {
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

_NUMBER = r"[0-9.]+(?:[eE][+-]?[0-9]+)?"
# Names of channels may have spaces and commas in them, so only these words part the directions.
_CLAUSES = re.compile(r"\s+(?=(?:previous|next)=)")


def motion_names(shot: Shot) -> tuple[str, ...]:
    """Return the names of the motion channels as --motion takes them, as short as possible.

    Only so much of the layer stands before a component as tells them apart, and the AOV if it must.
    """
    refs = shot.layout.roles[Role.MOTION]
    for elements in range(1, 1 + max(ref.name.count(".") + 1 for ref in refs)):
        short = tuple(".".join(ref.name.split(".")[-elements:]) for ref in refs)
        if len(set(short)) == len(short):
            return short
    return tuple(ref.label for ref in refs)


def parse_motion(text: str, names: tuple[str, ...], size: tuple[int, int]) -> MotionConvention:
    """Read the ``--motion`` option.

    Either a preset's name (blender, unreal, forward …), or the channels that hold the displacement
    to the previous and next frame in pixels, x right and y down, with signs and factors:
    ``previous=X,-Y next=-Z,W``, ``next=0.5*u,-0.5*v``. Besides:

    - ``width`` and ``height`` are factors for vectors that are shares of the frame:
      ``next=0.5*width*R,-0.5*height*G``;
    - a value that stands for no motion is taken off in brackets:
      ``previous=-1920*(R-0.5),1080*(G-0.5)``;
    - a channel with the length, where the others are a direction, is a last factor:
      ``next=R*B,-G*B``, or ``next=2*(R-0.5)*B,-2*(G-0.5)*B`` for a direction mapped to 0 … 1;
    - premultiplied vectors are divided by alpha: ``next=R/A,-G/A``,
      ``next=9*(R/A-0.5),9*(G/A-0.5)``.

    `names` are the motion channels' names, in order; `size` is width and height of the display
    window. Raises UsageError when the text is neither.
    """
    preset = PRESETS.get(text.strip().lower())
    if preset is not None:
        if preset.count > len(names):
            raise UsageError(
                f"--motion {text} needs {preset.count} motion channels and there are "
                f"{len(names)}: {', '.join(names)}"
            )
        return preset.sized(*size)
    terms: dict[str, tuple[_Term, _Term]] = {}
    for clause in filter(None, _CLAUSES.split(text.strip())):
        direction, _, axes = clause.partition("=")
        commas = (match.start() for match in re.finditer(",", axes))
        pairs = (
            [_parse_term(part, names, size) for part in (axes[:i], axes[i + 1 :])] for i in commas
        )
        pair = next(((x, y) for x, y in pairs if x and y and x.shared == y.shared), None)
        if direction not in ("previous", "next") or direction in terms or pair is None:
            raise UsageError(
                f"--motion {text!r} is not understood; write a preset ({', '.join(PRESETS)}) or "
                f"for example 'previous={names[0]},-{names[1]}', with channels out of "
                f"{', '.join(names)}"
            )
        terms[direction] = pair
    if not terms:
        raise UsageError("--motion is empty; write a preset or a convention, or leave it out")
    if max(abs(term.scale) for pair in terms.values() for term in pair) > MOST:
        raise UsageError(f"--motion {text!r} has a factor above {MOST:g}; correct it")
    maps = {
        direction: AxisMap(x.channel, y.channel, x.scale, y.scale, *x.shared)
        for direction, (x, y) in terms.items()
    }
    return MotionConvention(maps.get("previous"), maps.get("next"))


@dataclass(frozen=True)
class _Term:
    """One axis of a displacement; see `AxisMap`."""

    channel: int
    scale: float
    shared: tuple[float, int | None, int | None]  # `still`, `length` and `alpha`: of both axes


def _parse_term(text: str, names: tuple[str, ...], size: tuple[int, int]) -> _Term | None:
    """Read one axis of a convention; None when it is not one."""
    name = "|".join(re.escape(n) for n in sorted(names, key=len, reverse=True))
    match = re.fullmatch(
        rf"(?P<sign>[+-]?)(?:(?P<factor>{_NUMBER})\*)?(?:(?P<unit>width|height)\*)?"
        rf"(?P<open>\()?(?P<name>{name})(?:/(?P<alpha>{name}))?"
        rf"(?(open)(?P<still>[+-]{_NUMBER})\))(?:\*(?P<length>{name}))?",
        text,
    )
    if match is None:
        return None
    try:
        factor, still = float(match["factor"] or 1.0), 0.0 - float(match["still"] or 0.0)
    except ValueError:
        return None
    length, alpha = (
        None if match[key] is None else names.index(match[key]) for key in ("length", "alpha")
    )
    scale = -factor if match["sign"] == "-" else factor
    if match["unit"]:
        scale *= size[UNITS.index(match["unit"])]
    return _Term(names.index(match["name"]), scale, (still, length, alpha))


# Key frames whose colour tells what the vectors of frames between them mean, and the number of the
# frame at each one's instant; None without one.
KeyColours = tuple[Shot, tuple[int | None, ...]]


def find_motion(
    shot: Shot,
    given: str | None,
    detect: bool = True,
    starts: Collection[int] = (),
    colours: KeyColours | None = None,
) -> MotionFinding | None:
    """Settle the motion convention of a shot, by hand or by measuring; None without motion.

    `given` is a convention by hand. `detect` says whether to look for cuts, where vectors explain
    nothing: what crosses one is no motion. `starts` are numbers of frames before which cuts are
    known, `colours` key frames with colour, where the shot itself has none. Raises MotionError when
    the convention cannot be settled.
    """
    if Role.MOTION not in shot.layout:
        return None
    names, size = motion_names(shot), (shot.display.width, shot.display.height)
    if given is not None:
        guess: MotionConvention | None = parse_motion(given, names, size)
    else:
        guess = None if shot.layout.guess is None else shot.layout.guess.sized(*size)
    measurement = _Measurement(shot, starts, colours, names, detect, guess)
    if given is None or guess is None:
        return measurement.finding()
    evidence = f"{guess.describe(names)} given by --motion"
    with suppress(InputError, MotionError):
        finding = measurement.finding()
        if finding.source == "corrected":
            measured = finding.evidence.partition(";")[0]
            evidence += f", but the frames contradict it: {measured}{preset_hint(finding.preset)}"
    return MotionFinding(guess, "given", evidence)


@dataclass
class _Measurement:
    """Measures the vectors of a shot in some pairs of its frames; see `find_motion`.

    A pair is named by the index of its first frame. With `by_colour`, frames are compared by colour
    although they have world positions.
    """

    shot: Shot
    starts: Collection[int]
    colours: KeyColours | None
    names: tuple[str, ...]
    detect: bool
    guess: MotionConvention | None  # by hand, or by the names of the channels
    _frames: dict[tuple[int, bool], calibration_samples.FrameSamples] = field(default_factory=dict)

    def finding(self) -> MotionFinding:
        """Measure by world positions if there are any, else by depth and colour."""
        firsts = pairs_within(len(self.shot.sequence.numbers), self._is_parted)
        # The last of an odd number of channels is a length or an alpha.
        used = 2 * (len(self.names) // 2)
        # Read one by one: the first pair nearly always tells.
        ends = (self._frame(first + i) for first in firsts for i in (0, 1))
        if firsts and not any(np.any(f.motion[:, :used]) or np.any(f.moving) for f in ends):
            return self._at_rest(firsts)
        has_both = Role.POSITION in self.shot.layout and Role.COLOUR in self.shot.layout
        # World positions of what moves by itself are not found again. Before a resting camera,
        # nothing else moves, so there colour tells.
        try:
            finding = self._measure_within_shots(by_colour=False)
        except MotionError:
            if not has_both:
                raise
        else:
            if not (finding.source == "untested" and has_both):
                return finding
        return self._measure_within_shots(by_colour=True)

    def _at_rest(self, firsts: list[int]) -> MotionFinding:
        """Return what is read of vectors that are 0; raises MotionError if the picture moves."""
        numbers = self.shot.sequence.numbers
        frames = ", ".join(f"{numbers[i]}-{numbers[i + 1]}" for i in firsts)
        if any(self._picture_moves(first) for first in firsts):
            producer = self.shot.layout.producer
            texts = (text for name, text in BLUR_ADVICE.items() if producer.startswith(name))
            advice = next(texts, "switch it off in the renderer's settings")
            raise MotionError(
                f"the motion channels {', '.join(self.names)} are 0 throughout in frames "
                f"{frames}, while the picture moves: motion blur was on, or the pass is empty; "
                f"{advice}, and render the motion pass again; if nothing is meant to move, give "
                "--motion"
            )
        if moving := self._moving_pairs(firsts, by_colour=False):
            return self._measure_pairs(moving, by_colour=False)
        evidence = f"the vectors of frames {frames} are 0, and nothing moves there"
        convention = self.guess or MotionConvention(AxisMap(0, 1, 1.0, -1.0))
        return MotionFinding(convention, "untested", evidence, resting=True)

    def _picture_moves(self, first: int) -> bool:
        """Return True if the picture of a pair moves; what changes at a cut is no motion."""
        moves = has_geometry_moved(self._frame(first), self._frame(first + 1))
        if Role.COLOUR not in self.shot.layout:
            return moves is True
        if moves is None:
            before, after = (self._frame(i, by_colour=True).perceived for i in (first, first + 1))
            moves = before is not None and after is not None and has_colour_moved(before, after)
        return moves and not (self.detect and self._is_cut_by_colour(first + 1))

    def _measure_within_shots(self, by_colour: bool) -> MotionFinding:
        """Measure in pairs that cross no known cut, and where that fails, none that is seen."""
        count = len(self.shot.sequence.numbers)
        firsts = pairs_within(count, self._is_unseen) or pairs_within(count, self._is_parted)
        try:
            return self._measure_first(firsts, by_colour)
        except MotionError:
            if not self.detect or Role.COLOUR not in self.shot.layout:
                raise
            uncut = pairs_within(count, lambda i: self._is_unseen(i) or self._is_cut_by_colour(i))
            if uncut == firsts:
                raise
            return self._measure_first(uncut, by_colour)

    def _measure_first(self, firsts: list[int], by_colour: bool) -> MotionFinding:
        """Measure by the first pair alone, which most runs read first anyway, if it tells all.

        If nothing moves in all of them, look for pairs in which something does.
        """
        if len(firsts) > 1:
            with suppress(MotionError):
                pair = self._beside_holds(firsts[:1], by_colour)
                finding = self._measure_pairs(pair, by_colour)
                if finding.clear:
                    return finding
        firsts = self._beside_holds(firsts, by_colour)
        finding = self._measure_pairs(firsts, by_colour)
        moving = self._moving_pairs(firsts, by_colour) if finding.resting else []
        return self._measure_pairs(moving, by_colour) if moving else finding

    def _measure_pairs(self, firsts: list[int], by_colour: bool) -> MotionFinding:
        # One after the other: each is decoded on all threads, and two at once took a sixth more.
        pairs = [(self._frame(i, by_colour), self._frame(i + 1, by_colour)) for i in firsts]
        width, height = self.shot.display.width, self.shot.display.height
        presets = {name: preset.sized(width, height) for name, preset in PRESETS.items()}
        intervals, step = self._intervals(len(firsts)), number_step(self.shot.sequence.numbers)
        return calibrate(pairs, self.guess, self.names, intervals, presets, step)

    def _beside_holds(self, firsts: list[int], by_colour: bool) -> list[int]:
        """Return the pairs, each that shows one picture twice replaced by a pair nearby.

        The frames of such a pair are equal, though their vectors are not at rest. A pair at rest
        stays; if all are at rest, `_moving_pairs` looks for others.
        """
        chosen, count = set(), len(self.shot.sequence.numbers)
        for wanted in firsts:
            moving = wanted
            for first in pairs_around(wanted, count, self._is_parted):
                if abs(first - wanted) > 1:
                    self._frames.clear()  # so that few are in memory
                before, after = self._frame(first, by_colour), self._frame(first + 1, by_colour)
                parts = ("position", "depth", "perceived")
                values = [(getattr(before, part), getattr(after, part)) for part in parts]
                known = [(a, b) for a, b in values if a is not None and b is not None]
                is_same = bool(known) and all(np.array_equal(*v, equal_nan=True) for v in known)
                if not is_same or not (before.moving.any() or after.moving.any()):
                    moving = first
                    break
            chosen.add(moving)
        return sorted(chosen)

    def _moving_pairs(self, firsts: list[int], by_colour: bool) -> list[int]:
        """Return pairs in which something moves, of some that are evenly spread; few at most."""
        count = len(self.shot.sequence.numbers) - 1
        candidates = sorted({count * i // SPREAD for i in range(SPREAD)} - set(firsts))
        moving: list[int] = []
        for first in candidates:
            if self._is_parted(first + 1) or len(moving) == MOST_MOVING:
                continue
            ends = [self._frame(i, by_colour) for i in (first, first + 1)]
            counts = [np.count_nonzero(frame.moving & frame.usable) for frame in ends]
            if max(counts) >= calibration_samples.MIN_SAMPLES:
                moving.append(first)
            else:
                self._frames.clear()
        return moving

    def _frame(self, index: int, by_colour: bool = False) -> calibration_samples.FrameSamples:
        """Read and reduce a frame; what was reduced before is kept."""
        number = self.shot.sequence.numbers[index]
        key = number, by_colour
        if key not in self._frames:
            # On the display window: data windows differ, and normalised vectors go by it. World
            # positions tell points apart best, and alone; reading the rest takes most of the time.
            by_position = Role.POSITION in self.shot.layout and not by_colour
            compared = Role.POSITION if by_position else Role.COLOUR
            raw = read_raw(self.shot, number, (Role.MOTION, Role.DEPTH, Role.STENCIL, compared))
            assert raw.motion is not None
            motion = place_on_canvas(raw.motion, raw.gbuffer.window, self.shot.display, np.nan)
            colour = None if raw.image is None else raw.image.on(self.shot.display).pixels
            gbuffer = raw.gbuffer.on(self.shot.display)
            frame = calibration_samples.MotionFrame(number, gbuffer, motion, colour)
            self._frames[key] = calibration_samples.sample_frame(frame)
        return self._frames[key]

    def _is_parted(self, index: int) -> bool:
        """Return True if a frame and the one before do not belong together, or are unreadable."""
        if self.shot.sequence.numbers[index] in self.starts:
            return True
        if self.shot.keep_going:
            try:
                self._frame(index - 1)
                self._frame(index)
            except InputError:
                return True
        return False

    def _is_unseen(self, index: int) -> bool:
        """Return True if a frame and the one before it tell nothing: one is beyond the display."""
        pair = self.shot.sequence.numbers[index - 1 : index + 1]
        return self._is_parted(index) or not all(is_visible(self.shot, number) for number in pair)

    def _is_cut_by_colour(self, index: int) -> bool:
        """Return True if a cut lies before a frame, as far as colour tells without motion."""
        before, after = (
            make_thumbnail(read_raw(self.shot, number, (Role.COLOUR,)).key(None))
            for number in self.shot.sequence.numbers[index - 1 : index + 1]
        )
        return compare_thumbnails(before, after).found

    def _intervals(self, count: int) -> list[calibration_samples.KeyPair]:
        """Read so many intervals between key frames whose colours tell, and the vectors between.

        [] without colours; intervals of which a frame cannot be read are left out.
        """
        if self.colours is None:
            return []
        keys, instants = self.colours
        firsts = pairs_within(
            len(instants), lambda i: instants[i] in self.starts or None in instants[i - 1 : i + 1]
        )
        intervals = []
        for index in firsts[:count]:
            first, last = instants[index], instants[index + 1]
            assert first is not None and last is not None
            numbers = keys.sequence.numbers[index], keys.sequence.numbers[index + 1]
            try:
                before, after = (
                    read_raw(keys, number, (Role.COLOUR,)).key(None).image.on(keys.display).pixels
                    for number in numbers
                )
                vectors = []
                for number in self.shot.sequence.numbers:
                    if not first <= number <= last:
                        continue
                    raw = read_raw(self.shot, number, (Role.MOTION,))
                    assert raw.motion is not None
                    vectors.append(
                        place_on_canvas(raw.motion, raw.gbuffer.window, self.shot.display, np.nan)
                    )
            except InputError:
                if not keys.keep_going:
                    raise
                continue
            intervals.append(calibration_samples.sample_key_pair(numbers, before, after, vectors))
        return intervals
