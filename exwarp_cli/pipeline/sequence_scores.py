"""Scoring one sequence against another, frame after frame, by this tool's metrics or ExtraNet's."""

from __future__ import annotations

from collections.abc import Sequence as Listed
from contextlib import ExitStack
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

from exwarp_cli.domain.decision import infer_maker
from exwarp_cli.domain.frame import Bool, Float32, GBuffer
from exwarp_cli.domain.metric import GENERATED, METRICS
from exwarp_cli.domain.motion import MotionConvention
from exwarp_cli.domain.results import FrameKind, Score
from exwarp_cli.domain.settings import PRESETS, MeasureSettings
from exwarp_cli.errors import InputError, MotionError, UsageError
from exwarp_cli.io.display_colour import to_display
from exwarp_cli.io.ffmpeg_filters import EncodedVmafStream, VmafStream
from exwarp_cli.io.files import ResourceOwner
from exwarp_cli.io.frames import GEOMETRY, read_raw
from exwarp_cli.io.generated_frames import read_facts
from exwarp_cli.io.sequences import Sequence
from exwarp_cli.io.shot import Shot, open_shot
from exwarp_cli.io.video_reader import is_clip
from exwarp_cli.metrics.display import round_display
from exwarp_cli.metrics.registry import score_frame, score_like_extranet
from exwarp_cli.metrics.temporal import compare_with_previous, display_error, frame_flicker
from exwarp_cli.pipeline.motion_convention import find_motion
from exwarp_cli.synthesis.motion_fields import field_between, reproject, settle_motion

Scores = tuple[Score, Score | None]  # over all pixels, and in holes

ENDS_LEFT_OUT = 4  # frames at either end that ExtraNet's videos lack
SHORTEST_CUT = 12  # videos of no more frames keep their ends


class SequenceMotion:
    """Reads where the pixels of a frame come from; asked frame by frame, ascending."""

    def __init__(self, shot: Shot, convention: MotionConvention) -> None:
        self._shot = shot
        self._convention = convention
        numbers = shot.sequence.numbers
        self._step = min((b - a for a, b in pairwise(numbers)), default=1)
        self._previous: tuple[int, GBuffer] | None = None

    def into(self, number: int) -> tuple[Float32, Bool] | None:
        """Return the motion from a frame to the one before it.

        Returns
        -------
        tuple or None
            On the display window, float32 [H, W, 2] in pixels, x right, y down, NaN where unknown;
            and bool [H, W]: the frame before does not show the surface point. None where the frame
            of the last call is not its neighbour.
        """
        raw = read_raw(self._shot, number, GEOMETRY)
        current = settle_motion(raw.settle(self._convention).on(self._shot.display))
        previous, self._previous = self._previous, (number, current)
        if previous is None or previous[0] != number - self._step:
            return None
        if current.to_previous is None:
            motion = reproject(previous[1], 1.0)
        else:
            motion = field_between(current, previous[1], current.to_previous, 1)
        return motion.field, motion.hole


def open_motion(spec: str, sequence: Sequence, view: str = "") -> SequenceMotion | str:
    """Return the motion of a sequence, which the user named `spec`, or why it has none."""
    try:
        shot = open_shot(spec, view or None)
        finding = find_motion(shot, None)
    except (InputError, MotionError) as error:
        return str(error)
    if finding is None:
        return f"{sequence.pattern} has no motion vectors"
    if not set(sequence.files) <= set(shot.sequence.files):
        return f"the vectors beside {sequence.pattern} are of other frames"
    return SequenceMotion(shot, finding.convention)


@dataclass(frozen=True)
class Pair:
    """Two frames of one instant, on the display window."""

    reference: int  # the number of the true one
    # truth, test: float32 [H, W, 3] or more, scene-linear
    truth: Float32
    test: Float32
    mask: Bool | None  # bool [H, W], the holes; None without


class SequenceScorer(ResourceOwner):
    """Scores pairs one by one, and the whole sequence at the end; a context manager.

    Attributes
    ----------
    notes
        What a reader of the numbers should know at the end, a sentence each.
    """

    _vmaf: VmafStream | EncodedVmafStream | None = None

    def _open(self, stack: ExitStack) -> None:
        if self._vmaf is not None:
            stack.enter_context(self._vmaf)

    def add(self, pair: Pair) -> None:
        """Take the next pair."""
        raise NotImplementedError

    def finish(self) -> list[Scores]:
        """Return the scores of all frames."""
        raise NotImplementedError

    @property
    def notes(self) -> tuple[str, ...]:
        """See above."""
        return ()


class MetricScorer(SequenceScorer):
    """Scores by the metrics of this tool; memory holds one frame.

    Parameters
    ----------
    names
        What is measured, as in `Score`.
    motion
        For flicker; None where it is not measured.
    """

    def __init__(self, names: tuple[str, ...], motion: SequenceMotion | None) -> None:
        self._names = names
        self._motion = motion
        self._vmaf = VmafStream() if "vmaf" in names else None
        self._scores: list[Scores] = []
        self._error: Float32 | None = None
        self._transitions: list[float | None] = []

    def add(self, pair: Pair) -> None:
        """Score the next pair by what needs no later one."""
        overall, inside = score_frame(pair.truth, pair.test, pair.mask, self._names)
        if self._vmaf is not None:
            self._vmaf.write(to_display(pair.truth), to_display(pair.test))
        if self._motion is not None:
            value, masked = self._transition(self._motion, pair)
            self._transitions.append(value)
            inside = None if inside is None else replace(inside, flicker=masked)
        self._scores.append((overall, inside))

    def finish(self) -> list[Scores]:
        """Return all scores, with VMAF and flicker."""
        scores = self._scores
        if self._vmaf is not None:
            values = self._vmaf.close()
            scores = [(replace(s, vmaf=v), h) for (s, h), v in zip(scores, values, strict=True)]
        if self._motion is not None:
            flickers = frame_flicker([*self._transitions, None])
            pairs = zip(scores, flickers, strict=True)
            scores = [(replace(s, flicker=v), h) for (s, h), v in pairs]
        return scores

    def _transition(self, motion: SequenceMotion, pair: Pair) -> tuple[float | None, float | None]:
        """Return how the error changes into a frame, over all pixels and in holes."""
        into = motion.into(pair.reference)
        before, self._error = self._error, display_error(pair.truth, pair.test)
        if into is None or before is None:
            return None, None
        change = compare_with_previous(self._error, before, *into)
        return change.mean(), None if pair.mask is None else change.within(pair.mask)


class ExtranetScorer(SequenceScorer):
    """Scores as ExtraNet's release takes them: see `exwarp_cli.metrics.registry`.

    VMAF is of H.264 videos of both sequences, rendered frames included.

    Parameters
    ----------
    names
        Out of psnr_db, ssim and vmaf.
    count
        How many frames come.
    generated
        For each, whether it counts in PSNR and SSIM; None where that is not known, and a frame
        counts unless its pixels are those of the truth.
    """

    def __init__(self, names: tuple[str, ...], count: int, generated: list[bool] | None) -> None:
        self._names = names
        cut = ENDS_LEFT_OUT if count > SHORTEST_CUT else 0
        self._video = range(cut, count - cut)
        self._generated = generated
        self._vmaf = EncodedVmafStream() if "vmaf" in names else None
        self._scores: list[Score] = []
        self._counted = 0

    @property
    def notes(self) -> tuple[str, ...]:
        """Which frames counted."""
        by = "by their headers" if self._generated else "as their pixels are not those of the truth"
        note = f"{self._counted} of {len(self._scores)} frames count as generated, {by}"
        if self._vmaf is None:
            return (note,)
        return (note, f"VMAF is of {len(self._video)} frames in H.264, rendered ones included")

    def add(self, pair: Pair) -> None:
        """Score the next pair if it counts, and append it to the videos."""
        index = len(self._scores)
        truth, test = round_display(pair.truth), round_display(pair.test)
        is_different = bool((truth != test).any())
        counts = is_different if self._generated is None else self._generated[index]
        self._counted += counts
        values = score_like_extranet(pair.truth, pair.test) if counts else Score()
        self._scores.append(
            Score(
                psnr_db=values.psnr_db if "psnr_db" in self._names else None,
                ssim=values.ssim if "ssim" in self._names else None,
            )
        )
        if self._vmaf is not None and index in self._video:
            self._vmaf.write(truth, test)

    def finish(self) -> list[Scores]:
        """Return all scores, with VMAF."""
        if self._vmaf is not None:
            for index, value in zip(self._video, self._vmaf.close(), strict=True):
                self._scores[index] = replace(self._scores[index], vmaf=value)
        return [(score, None) for score in self._scores]


@dataclass(frozen=True)
class Origin:
    """Where a frame came from, by its header; all None for a frame that ExWarp did not make."""

    kind: str | None = None  # a value of `FrameKind`: "generated" or "dropped"
    # "warp", "extrapolate", "softsplat", "blend", "interpolate" or "hold"
    made_by: str | None = None
    # Decision path of its key interval, S1 to S6; None outside the paper's paths
    path: str | None = None

    @property
    def generated(self) -> bool:
        """Whether it is a new frame: not a rendered one and no repeat."""
        return self.kind == FrameKind.GENERATED.value

    @property
    def dropped(self) -> bool:
        """Whether it repeats the frame before."""
        return self.kind == FrameKind.DROPPED.value

    @property
    def choice(self) -> str | None:
        """What was decided for a generated frame; None outside the decision tree."""
        return self.made_by if self.generated and self.path is not None else None


def origins_of(files: Listed[Path]) -> list[Origin]:
    """Read where frames came from, of every header once.

    Raises
    ------
    DamagedFileError
        When a header cannot be read.
    """
    origins = []
    for path in files:
        facts = {} if is_clip(str(path)) else read_facts(path)
        values = (facts.get(name) for name in ("kind", "madeBy", "path", "method"))
        kind, made_by, decided, method = (v if isinstance(v, str) else None for v in values)
        origins.append(Origin(kind, infer_maker(made_by, method), decided))
    return origins


def require_consistent(measuring: MeasureSettings, holes: str | None) -> None:
    """Refuse contradicting options, before any work; raises UsageError."""
    if holes is None:
        limits = [limit for limit in measuring.thresholds if limit.scope == "holes"]
        if limits:
            raise UsageError(
                f"{limits[0].option} {limits[0].name} is on holes, which are not known; give masks "
                "with --holes"
            )
    if measuring.preset is None:
        return
    offered = PRESETS[measuring.preset]
    if foreign := [name for name in measuring.measured if name not in offered]:
        names = {metric.field: metric.option for metric in METRICS}
        raise UsageError(
            f"--preset {measuring.preset} measures {', '.join(names[o] for o in offered)} and not "
            f"{names[foreign[0]]}; "
            "leave that or the preset out"
        )
    if holes is not None:
        raise UsageError(
            f"--preset {measuring.preset} measures whole frames; leave --holes or the preset out"
        )


def require_generated(measuring: MeasureSettings, origins: Listed[Origin], test: Sequence) -> None:
    """Refuse limits on generated frames where no header names any; raises UsageError."""
    limits = [limit for limit in measuring.thresholds if limit.scope == GENERATED]
    if limits and not any(origin.generated for origin in origins):
        raise UsageError(
            f"{limits[0].option} {limits[0].name} is on generated frames, and by their headers "
            f"none of the compared frames of {test.pattern} is one; write {limits[0].metric.option}"
            f"={limits[0].limit:g} for all frames"
        )


def make_scorer(
    measuring: MeasureSettings, spec: str, reference: Sequence, origins: Listed[Origin]
) -> tuple[SequenceScorer, tuple[str, ...]]:
    """Return a scorer, and what a reader of its numbers should know.

    The true sequence is `reference`, which the user named `spec`. The origins are those of the
    frames that will be scored, in order.
    """
    if measuring.preset is not None:
        generated = [origin.generated for origin in origins]
        has_headers = any(origin.kind is not None for origin in origins)
        if has_headers and not any(generated):
            raise InputError(
                "by their headers none of the frames of the second sequence is generated, and "
                f"--preset {measuring.preset} scores nothing else; leave the preset out"
            )
        flags = generated if has_headers else None
        return ExtranetScorer(measuring.measured, len(origins), flags), ()
    if "flicker" not in measuring.measured:
        return MetricScorer(measuring.measured, None), ()
    motion = open_motion(spec, reference, measuring.view)
    if isinstance(motion, SequenceMotion):
        return MetricScorer(measuring.measured, motion), ()
    note = f"flicker is not measured, as it follows the motion of the first sequence: {motion}"
    return MetricScorer(measuring.measured, None), (note,)


def rendered_note(origins: Listed[Origin]) -> tuple[str, ...]:
    """Return a note where rendered frames raise the means over an upsampled sequence."""
    rendered = sum(not (origin.generated or origin.dropped) for origin in origins)
    if rendered in (0, len(origins)):
        return ()
    return (
        f"the means of all pixels are over all {len(origins)} frames, {rendered} of which are "
        "rendered ones by their headers",
    )
