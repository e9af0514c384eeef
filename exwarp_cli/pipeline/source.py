"""Opening an input: its frames, numbering, rate, ids, and what its vectors and depth mean."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from fractions import Fraction
from pathlib import Path
from typing import TypeVar

from exwarp_cli.domain.frame import Window, set_max_pixels
from exwarp_cli.domain.motion import MotionConvention, MotionFinding
from exwarp_cli.domain.settings import DEFAULT_FPS, SourceSettings
from exwarp_cli.domain.timeline import (
    FACTOR,
    MAX_FACTOR,
    NTSC_RATIO,
    CutOption,
    Slot,
    Timeline,
    number_step,
    parse_cuts,
    parse_rate,
    ranges,
    standard_rate,
)
from exwarp_cli.errors import InputError, LayoutError, MissingFrameError, MotionError, UsageError
from exwarp_cli.io import sequences
from exwarp_cli.io.channel_map import parse_aovs, read_channel_map
from exwarp_cli.io.channels import Role
from exwarp_cli.io.footage import clip_rate, find_footage, is_plain, make_shot, read_display_window
from exwarp_cli.io.frames import require_visible
from exwarp_cli.io.layers import is_colour_alone, no_vectors_message
from exwarp_cli.io.shot import Shot, open_shot
from exwarp_cli.io.video_reader import is_clip
from exwarp_cli.io.views import ALL
from exwarp_cli.pipeline import depth_and_ids
from exwarp_cli.pipeline.motion_convention import find_motion, motion_names, parse_motion
from exwarp_cli.runtime.frame_pool import IN_MEMORY, ScratchFrames

T = TypeVar("T")

# Returns the number of a slot's frame in a sequence at the output rate; None where it has none.
FrameOf = Callable[[Slot], int | None]

# Headers that are read at a time: on a network share each waits for the server.
READERS = 16


@dataclass(frozen=True)
class Source:
    """An opened input."""

    keys: Shot
    slots: Shot | None  # G-buffers at the output rate; None in the key setting
    slot_number: FrameOf  # in `slots`
    timeline: Timeline
    finding: MotionFinding | None  # convention of the vectors in use: of `slots`, else of the keys
    fps: Fraction  # base rate
    fps_source: str  # "option", "header", "file" (a video's) or "assumed"
    cuts: CutOption  # those that are given lie at key frames
    estimated: bool = False  # True if motion is needed and estimated from colour
    unusable: str = ""  # why vectors that exist are not used, and motion is estimated instead
    # Where large key frames lie when a network may extrapolate.
    scratch: ScratchFrames = field(default=IN_MEMORY, compare=False, repr=False)

    @property
    def geometry(self) -> Shot:
        """The shot whose G-buffers are in use: `slots`, else the key frames."""
        return self.slots or self.keys

    @property
    def output_fps(self) -> Fraction:
        """Frames per second of the output."""
        return self.fps * self.timeline.factor

    @property
    def written_fps(self) -> Fraction | None:
        """The rate that written frames say they have; None where it is assumed."""
        return None if self.fps_source == "assumed" else self.output_fps

    @property
    def convention(self) -> MotionConvention | None:
        """Convention of the motion vectors in use; None without motion."""
        return None if self.finding is None else self.finding.convention

    @property
    def motion_origin(self) -> tuple[str, str] | None:
        """Where motion is from, in a word and in a sentence; None without motion."""
        if self.estimated:
            evidence = (
                "from colour by OpenCV's DIS optical flow between neighbouring key frames, far "
                "less exact than a renderer's vectors"
            )
            if self.unusable:
                evidence += f"; vectors are not used: {self.unusable}"
            return "estimated", evidence
        return None if self.finding is None else (self.finding.source, self.finding.evidence)

    @property
    def allows_decisions(self) -> bool:
        """True at the paper's factor, and along a renderer's motion."""
        return self.timeline.factor == FACTOR and not self.estimated

    @property
    def setting(self) -> str:
        """Name of the setting, "key" or "slot"."""
        return "key" if self.slots is None else "slot"


def open_source(
    settings: SourceSettings, motion_needed: bool = True, pictures: bool = False
) -> Source:
    """Find and recognise an input.

    Without `motion_needed` a convention that cannot be settled is no error, and G-buffers at the
    output rate without vectors to the previous slot are left out. With `pictures` videos, stills
    and EXR with colour alone are taken, and their motion estimated; and EXR with other passes and
    without usable vectors, where `settings` allow it.

    Raises InputError when a sequence is missing, has gaps, or lacks what is needed; MotionError
    when the convention of the motion vectors cannot be settled.
    """
    cuts = parse_cuts(settings.cuts)
    plain = open_plain(settings) if pictures else None
    if plain is not None:
        timeline, fps, fps_source = _timeline(plain, settings)
        cuts.starts_in(timeline.numbers)
        return Source(plain, None, _no_number, timeline, None, fps, fps_source, cuts, motion_needed)
    keys, settings = open_keys(settings)
    if Role.COLOUR not in keys.layout:
        listed = ", ".join(ref.label for ref in keys.every) or "none that can be read"
        raise LayoutError(
            f"{keys.sequence.pattern} has no colour channels that are recognised, only "
            f"{listed}; name them in a channel map, or render the beauty pass"
        )
    timeline, fps, fps_source = _timeline(keys, settings)
    if settings.gbuffers is not None and timeline.steps is None:
        raise UsageError(
            f"--gbuffers lead from slot to slot between key frames, and from {float(fps):g} to "
            f"{float(fps * timeline.factor):g} fps most key frames are no output instants; leave "
            "--gbuffers out, or give a whole --factor"
        )
    first_keys = cuts.starts_in(timeline.numbers)
    keys, slots = depth_and_ids.read_ids(settings.dynamic, keys, open_slots(settings, keys))
    slot_number: FrameOf = _no_number
    starts: set[int | None] = {timeline.numbers[key] for key in first_keys}
    if slots is not None:
        slot_number = align(timeline, slots.sequence, "--gbuffers")
        last = Slot(len(timeline.numbers) - 1, 0)
        if slot_number(last) is None:
            raise InputError(
                f"--gbuffers {slots.sequence.pattern} has frames {ranges(slots.sequence.numbers)}, "
                f"fewer than the {timeline.order(last) + 1} slots up to the last key frame; render "
                "the others"
            )
        starts = {slot_number(Slot(key, 0)) for key in first_keys}
    source = Source(keys, slots, slot_number, timeline, None, fps, fps_source, cuts)
    cut_numbers = {number for number in starts if number is not None}
    return _with_motion(source, settings, cut_numbers, motion_needed, pictures)


def _with_motion(
    source: Source,
    settings: SourceSettings,
    starts: Collection[int],  # numbers of frames before which cuts are known
    motion_needed: bool,
    pictures: bool,
) -> Source:
    """Return a source with what its vectors mean, and depth as they say it grows."""
    keys, slots, slot_number = source.keys, source.slots, source.slot_number
    shot, colours = source.geometry, None
    comparable = {Role.COLOUR, Role.POSITION} & set(shot.layout.roles)
    if slots is not None and not comparable and keys.display.shape == slots.display.shape:
        # Key frames to measure slots' vectors by, as these have no colour.
        instants = (Slot(key, 0) for key in range(len(source.timeline.numbers)))
        colours = keys, tuple(map(slot_number, instants))
    names_vectors = settings.gbuffers is not None or settings.motion is not None
    may_estimate = pictures and settings.estimate_motion and not names_vectors
    try:
        finding = find_motion(shot, settings.motion, source.cuts.detect, starts, colours)
        unusable = ""
    except MotionError as error:
        if motion_needed and not may_estimate:
            raise
        finding, unusable = None, str(error)
    ordered = shot
    if finding is not None:
        ordered = depth_and_ids.with_depth_ordered(shot, finding.convention, starts)
    if slots is None:
        keys = ordered
    elif ordered is not shot:
        # Depth of the same name in both is read alike.
        names, slot_names = (
            {ref.name for ref in each.layout.roles.get(Role.DEPTH, ())} for each in (keys, slots)
        )
        if names == slot_names and keys.depth == slots.depth:
            keys = depth_and_ids.read_alike(keys, ordered)
        slots = ordered
    # A render with passes is meant to have vectors: a farm would not notice that they are missing.
    is_footage = (
        not names_vectors and Role.MOTION not in ordered.layout and is_colour_alone(ordered)
    )
    estimated = finding is None and motion_needed and (may_estimate or (pictures and is_footage))
    if finding is None and motion_needed and not estimated:
        raise LayoutError(no_vectors_message(ordered, pictures and slots is None))
    if slots is not None and (finding is None or finding.convention.to_previous is None):
        if motion_needed and not estimated:
            raise LayoutError(
                f"--gbuffers {slots.sequence.pattern} has no readable vectors to the previous "
                "slot, along which colour is moved; render them, or leave --gbuffers out"
            )
        slots, slot_number, finding = None, _no_number, None
    return replace(
        source,
        keys=keys,
        slots=slots,
        slot_number=slot_number,
        finding=finding,
        estimated=estimated,
        unusable=unusable,
    )


def open_sources(settings: SourceSettings, motion_needed: bool) -> tuple[Source, ...]:
    """Open the view that is asked for; of all views every one, the hero first; see `open_source`.

    Pictures are taken, too. Raises UsageError when all views are asked for, and each has files of
    its own.
    """
    sources = tuple(open_source(view, motion_needed, pictures=True) for view in each_view(settings))
    leader = sources[0].keys.sequence
    if any(source.keys.sequence.files != leader.files for source in sources):
        views = ", ".join(f"--view {source.keys.view}" for source in sources)
        raise UsageError(
            f"--view all writes all views into one file, and here each has its own "
            f"({leader.pattern}); run once for each: {views}"
        )
    return sources


def each_view(settings: SourceSettings) -> tuple[SourceSettings, ...]:
    """Return the settings of every view of a shot for ``--view all``, the hero's first.

    Other settings are returned as they are.
    """
    if settings.view != ALL or is_clip(settings.sequence):
        return (settings,)
    aovs, channel_map = parse_aovs(settings.aovs), None
    if settings.channel_map is not None:  # whose view does not count, as all are asked for
        channel_map = replace(read_channel_map(Path(settings.channel_map)), view=None)
    shot = open_shot(settings.sequence, None, aovs, channel_map, settings.keep_going)
    if not shot.views:
        raise LayoutError(f"{shot.sequence.pattern} has no views; leave --view {ALL} out")
    return tuple(replace(settings, view=view) for view in shot.views)


def open_plain(settings: SourceSettings) -> Shot | None:
    """Open a video or a sequence of stills, which have colour alone; None where EXR is meant.

    Raises InputError when it cannot be read; UsageError when options are given that say how EXR is
    read.
    """
    set_max_pixels(settings.max_pixels)
    sequence = find_footage(settings.sequence, settings.keep_going, settings.scan)
    if sequence is None:
        return None
    options = {
        "--gbuffers": settings.gbuffers,
        "--motion": settings.motion,
        "--view": settings.view,
        "--aov": settings.aovs,
        "--channel-map": settings.channel_map,
        "--dynamic": settings.dynamic,
    }
    for option, value in options.items():
        if value:
            raise UsageError(
                f"{option} is for rendered EXR frames, and {sequence.pattern} has nothing but "
                "colour; leave it out"
            )
    return make_shot(sequence, settings.keep_going)


def open_keys(settings: SourceSettings) -> tuple[Shot, SourceSettings]:
    """Open the key frames; the settings get the motion of their channel map.

    That motion counts where `settings.motion` is not given, and vectors are those of the key
    frames. Raises InputError as :func:`exwarp_cli.io.shot.open_shot` does; UsageError when the
    map's motion is not understood.
    """
    set_max_pixels(settings.max_pixels)
    aovs, path = parse_aovs(settings.aovs), settings.channel_map
    channel_map = None if path is None else read_channel_map(Path(path))
    shot = open_shot(settings.sequence, settings.view, aovs, channel_map, settings.keep_going)
    require_visible(shot)
    shot = depth_and_ids.with_world_positions(depth_and_ids.with_depth_measured(shot))
    if channel_map is None or channel_map.motion is None or settings.motion or settings.gbuffers:
        return shot, settings
    if Role.MOTION not in shot.layout:
        raise LayoutError(
            f"motion in the channel map {channel_map.path} is of no use, as no motion channels are "
            f"recognised in {shot.sequence.pattern}; name them in channels.motion"
        )
    try:
        size = (shot.display.width, shot.display.height)
        parse_motion(channel_map.motion, motion_names(shot), size)
    except UsageError as error:
        raise UsageError(
            f"motion in the channel map {channel_map.path} is wrong: {error}"
        ) from error
    return shot, replace(settings, motion=channel_map.motion)


def open_slots(settings: SourceSettings, keys: Shot) -> Shot | None:
    """Open the G-buffers at the output rate, in the view of the key frames; None without.

    Options and maps that name channels are of the key frames; here they are recognised.
    """
    if settings.gbuffers is None:
        return None
    channel_map = keys.channel_map
    view = settings.view or (None if channel_map is None else channel_map.view)
    slots = open_shot(settings.gbuffers, view, keep_going=settings.keep_going)
    if slots.view != keys.view and keys.view in slots.views:
        # Another view is first there.
        slots = open_shot(settings.gbuffers, keys.view, keep_going=settings.keep_going)
    return depth_and_ids.with_world_positions(depth_and_ids.with_depth_measured(slots))


def rate_of(keys: Shot, option: Fraction | None) -> tuple[Fraction, str]:
    """Return the base rate, and whether it is from the option, the header, a video or assumed.

    A header has the scene's rate, and so has what is assumed. Of a scene at 24 fps that is rendered
    in steps of 4 (1, 5, 9 …) the key frames come at 6.
    """
    if option is not None:
        return standard_rate(option), "option"
    own = clip_rate(keys.sequence)
    if own is not None:
        return own, "file"
    step = number_step(keys.sequence.numbers)
    rate = None
    if not is_plain(keys.sequence):
        header = keys.headers.read(keys.sequence.files[keys.first])
        values = (part.get("framesPerSecond") for part in header.attributes)
        rate = next(filter(None, map(parse_rate, values)), None)
    return (DEFAULT_FPS / step, "assumed") if rate is None else (rate / step, "header")


def step_note(numbers: Sequence[int], fps: Fraction, fps_source: str) -> str | None:
    """Say how the rate of frames that are numbered in steps is read, and how else it could be."""
    step = number_step(numbers)
    if step == 1 or fps_source not in ("header", "assumed"):
        return None
    scene = f"{float(fps * step):g}"
    what = f"the header's {scene} fps are" if fps_source == "header" else f"{scene} fps are assumed"
    return (
        f"frames are numbered in steps of {step}: {what} taken for the rate of the scene, of which "
        f"one frame in {step} is rendered, so the key frames come at {float(fps):g} fps; if the "
        f"key frames themselves come at {scene} fps, give --fps {scene}"
    )


def _timeline(keys: Shot, settings: SourceSettings) -> tuple[Timeline, Fraction, str]:
    """Number the output frames; also return what `rate_of` does.

    Raises UsageError when --factor and --to-fps are both given, or the rate is not above the
    input's, or too far.
    """
    fps, fps_source = rate_of(keys, settings.fps)
    factor = Fraction(FACTOR if settings.factor is None else settings.factor)
    if settings.to_fps is not None:
        if settings.factor is not None:
            raise UsageError("--factor and --to-fps say the same in two ways; give one of them")
        # The rate within 0.1 % at which most key frames are output instants. From 24000/1001 to 60
        # fps only one key frame in a thousand is one; to 60000/1001 every other one is. The rate is
        # kept where nothing is gained.
        factor = standard_rate(settings.to_fps) / fps
        ratios = (factor, factor * NTSC_RATIO, factor / NTSC_RATIO)
        factor = min(ratios, key=lambda ratio: ratio.denominator)
        if not 1 < factor <= MAX_FACTOR:
            raise UsageError(
                f"--to-fps {float(settings.to_fps):g} is {float(factor):g} times the input's "
                f"{float(fps):g} fps; give more than that and at most {MAX_FACTOR} times it, or "
                "correct the input's rate with --fps"
            )
    timeline = Timeline.of(keys.sequence.numbers, settings.start_frame, settings.tail, factor)
    return timeline, fps, fps_source


def align(timeline: Timeline, sequence: sequences.Sequence, option: str) -> FrameOf:
    """Match a sequence at the output rate to slots: by number where its numbers are those.

    Else by order: its first frame belongs to the first key frame. Raises InputError when the
    sequence has gaps, also where only the key frames' instants are missing.
    """
    try:
        numbers = Timeline.of(sequence.numbers).numbers
    except MissingFrameError as error:
        message = f"{option} needs every frame, those at the key frames' instants too: {error}"
        raise MissingFrameError(message) from error
    available = set(numbers)
    count = math.floor((len(timeline.numbers) - 1) * timeline.factor) + 1
    expected = range(timeline.start, timeline.start + count)
    by_number = available.issuperset(expected)

    def frame_of(slot: Slot) -> int | None:
        if by_number:
            number = timeline.number(slot)
            return number if number in available else None
        order = timeline.order(slot)
        return numbers[order] if order < len(numbers) else None

    if len(numbers) == len(timeline.numbers) < count:
        raise InputError(
            f"{option} has {len(numbers)} frames like the key frames, but has to be at "
            f"{float(timeline.factor):g} times their rate; check the path"
        )
    if len(numbers) > 1 and numbers[1] - numbers[0] > 1 and available.issubset(expected):
        # By order, each would be taken for a frame of another instant.
        raise InputError(
            f"{option} has only the frames {ranges(list(numbers))} of "
            f"{expected[0]}-{expected[-1]}, and needs every frame from the first key frame on; "
            "give the whole sequence"
        )
    return frame_of


def _no_number(_slot: Slot) -> int | None:
    return None


def require_one_size(shot: Shot, numbers: Collection[int]) -> None:
    """Refuse a shot of which some frames have another size, unless such frames are skipped.

    Headers that cannot be read are passed over: the reading of that frame says what is wrong.
    Raises LayoutError where a frame's display window is not that of the shot.
    """
    # 500 headers take 0.1 s on a local disk.
    if shot.keep_going:
        return
    files = {
        member.files[number]: (member, number)
        for member in (shot.sequence, *shot.aovs.values())
        for number in numbers
        if number in member.files
    }
    different = find_other_windows(files, shot.display)
    if different:
        path, window = next(iter(different.items()))
        plain = is_plain(shot.sequence)
        sizes = [f"{w.width}x{w.height}" if plain else str(w) for w in (window, shot.display)]
        more = f" (and {len(different) - 1} more)" if len(different) > 1 else ""
        raise LayoutError(
            f"{path}{more} is {sizes[0]} where the sequence's first frame is {sizes[1]}; "
            f"{'write' if plain else 'render'} all frames at one resolution"
        )


def find_other_windows(
    frames: Mapping[T, tuple[sequences.Sequence, int]], display: Window
) -> dict[T, Window]:
    """Return the display windows that are not `display`; frames with no readable header pass."""

    def window_of(frame: tuple[sequences.Sequence, int]) -> Window:
        try:
            return read_display_window(*frame)
        except (InputError, OSError, KeyError):
            return display

    with ThreadPoolExecutor(READERS, "exwarp-header") as pool:
        windows = zip(frames, pool.map(window_of, frames.values()), strict=True)
        return {frame: window for frame, window in windows if window != display}
