"""What a user wants measured of two sequences, and who measures it frame after frame."""

from __future__ import annotations

from collections.abc import Sequence as Listed
from contextlib import ExitStack
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from types import TracebackType
from typing import Any, Protocol

from exwarp_cli.domain.decision import infer_maker
from exwarp_cli.domain.frame import Bool, Float32, GBuffer
from exwarp_cli.domain.metric import GENERATED, METRICS
from exwarp_cli.domain.motion import MotionConvention
from exwarp_cli.domain.results import FrameKind, Score
from exwarp_cli.domain.settings import PRESETS, MeasureSettings
from exwarp_cli.errors import InputError, MotionError, UsageError
from exwarp_cli.io.atomic import Held
from exwarp_cli.io.clip import is_clip
from exwarp_cli.io.frames import GEOMETRY, Shot, open_shot, read_raw
from exwarp_cli.io.output import facts_in
from exwarp_cli.io.sequence import Sequence
from exwarp_cli.io.video import to_display
from exwarp_cli.io.vmaf import EncodedVmaf, Vmaf
from exwarp_cli.metrics import extranet_scores
from exwarp_cli.metrics.display import round_display
from exwarp_cli.metrics.registry import score_frame
from exwarp_cli.metrics.temporal import compare_with_previous, display_error, frame_flicker
from exwarp_cli.pipeline.motion_finding import find_motion
from exwarp_cli.synthesis.geometry import matched, reproject, settle_motion


class Flow:
    """Reads where the pixels of a frame come from; asked frame by frame, ascending."""

    def __init__(self, shot: Shot, convention: MotionConvention) -> None:
        self._shot = shot
        self._convention = convention
        numbers = shot.sequence.numbers
        self._step = min((b - a for a, b in pairwise(numbers)), default=1)
        self._before: tuple[int, GBuffer] | None = None

    def into(self, number: int) -> tuple[Float32, Bool] | None:
        """Return the motion from a frame to the one before it.

        Returns
        -------
        tuple or None
            On the display window, float32 [H, W, 2] in pixels, x right, y down, NaN where nothing
            is known; and bool [H, W]: the frame before does not show the surface point. None where
            the frame that was asked for last is not its neighbour.
        """
        raw = read_raw(self._shot, number, GEOMETRY)
        now = settle_motion(raw.settle(self._convention).on(self._shot.display))
        before, self._before = self._before, (number, now)
        if before is None or before[0] != number - self._step:
            return None
        found = (
            reproject(before[1], 1.0)
            if now.to_previous is None
            else matched(now, before[1], now.to_previous, 1)
        )
        return found.field, found.hole


def open_flow(spec: str, sequence: Sequence, view: str = "") -> Flow | str:
    """Return the flow of a sequence, or in a few words why it has none.

    Parameters
    ----------
    spec
        What the user named it by.
    sequence
        What was found there.
    view
        Whose vectors; "" for the hero's.
    """
    try:
        shot = open_shot(spec, view or None)
        finding = find_motion(shot, None)
    except (InputError, MotionError) as error:
        return str(error)
    if finding is None:
        return f"{sequence.pattern} has no motion vectors"
    if not set(sequence.files) <= set(shot.sequence.files):
        return f"the vectors beside {sequence.pattern} are of other frames"
    return Flow(shot, finding.convention)


Scores = tuple[Score, Score | None]
"""Over all pixels, and in holes."""

ENDS_LEFT_OUT = 4
"""Frames at either end that ExtraNet's videos lack."""

SHORTEST_CUT = 12
"""Videos of no more frames keep their ends."""


@dataclass(frozen=True)
class Pair:
    """Two frames that belong together, on the display window.

    Attributes
    ----------
    reference
        The number of the true one.
    truth, test
        float32 [H, W, 3] or more, scene-linear.
    mask
        bool [H, W]; None without.
    """

    reference: int
    truth: Float32
    test: Float32
    mask: Bool | None


class Scorer(Protocol):
    """Who scores a sequence; a context manager."""

    def __enter__(self) -> Scorer:
        """Begin."""

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Give up, or end."""

    def add(self, pair: Pair) -> Scores:
        """Take the next frame, and return its score as far as it is known."""

    def finish(self) -> list[Scores]:
        """Return the scores of all frames."""

    @property
    def notes(self) -> tuple[str, ...]:
        """What is known at the end that a reader of the numbers should know, a sentence each."""


class SequenceScores(Held):
    """Scores by the metrics of this tool; memory holds one frame.

    Parameters
    ----------
    names
        What is measured, as in `Score`.
    flow
        Motion for flicker; None where it is not measured.
    """

    def __init__(self, names: tuple[str, ...], flow: Flow | None) -> None:
        self._names = names
        self._flow = flow
        self._vmaf = Vmaf() if "vmaf" in names else None
        self._scores: list[Scores] = []
        self._error: Float32 | None = None
        self._into: list[float | None] = []

    def _open(self, stack: ExitStack) -> None:
        if self._vmaf is not None:
            stack.enter_context(self._vmaf)

    def add(self, pair: Pair) -> Scores:
        """Score the next frame by what needs no later one."""
        overall, inside = score_frame(pair.truth, pair.test, pair.mask, self._names)
        if self._vmaf is not None:
            self._vmaf.write(to_display(pair.truth), to_display(pair.test))
        if self._flow is not None:
            value, masked = self._transition(self._flow, pair)
            self._into.append(value)
            inside = None if inside is None else replace(inside, flicker=masked)
        self._scores.append((overall, inside))
        return overall, inside

    def finish(self) -> list[Scores]:
        """Return all scores, with VMAF and flicker."""
        found = self._scores
        if self._vmaf is not None:
            values = self._vmaf.close()
            found = [(replace(s, vmaf=v), h) for (s, h), v in zip(found, values, strict=True)]
        if self._flow is not None:
            flickers = frame_flicker([*self._into, None])
            found = [(replace(s, flicker=v), h) for (s, h), v in zip(found, flickers, strict=True)]
        return found

    @property
    def notes(self) -> tuple[str, ...]:
        """Nothing."""
        return ()

    def _transition(self, flow: Flow, pair: Pair) -> tuple[float | None, float | None]:
        """Return what changes into a frame, over all pixels and in holes."""
        motion = flow.into(pair.reference)
        before, self._error = self._error, display_error(pair.truth, pair.test)
        if motion is None or before is None:
            return None, None
        found = compare_with_previous(self._error, before, *motion)
        return found.mean(), None if pair.mask is None else found.within(pair.mask)


class ExtranetScores(Held):
    """Scores as ExtraNet's release takes them: see `exwarp_cli.metrics.extranet_scores`.

    VMAF is of H.264 videos of both sequences, rendered frames and all.

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
        self._vmaf = EncodedVmaf() if "vmaf" in names else None
        self._scores: list[Score] = []
        self._counted = 0

    def _open(self, stack: ExitStack) -> None:
        if self._vmaf is not None:
            stack.enter_context(self._vmaf)

    @property
    def notes(self) -> tuple[str, ...]:
        """Which frames counted."""
        by = "by their headers" if self._generated else "as their pixels are not those of the truth"
        note = f"{self._counted} of {len(self._scores)} frames count as generated, {by}"
        if self._vmaf is None:
            return (note,)
        return (note, f"VMAF is of {len(self._video)} frames in H.264, rendered ones included")

    def add(self, pair: Pair) -> Scores:
        """Score the next frame, if it counts, and append it to the videos."""
        index = len(self._scores)
        shown, judged = round_display(pair.truth), round_display(pair.test)
        same = bool((shown == judged).all())
        counts = not same if self._generated is None else self._generated[index]
        self._counted += counts
        found = extranet_scores.score_like_extranet(pair.truth, pair.test) if counts else Score()
        found = Score(
            psnr_db=found.psnr_db if "psnr_db" in self._names else None,
            ssim=found.ssim if "ssim" in self._names else None,
        )
        self._scores.append(found)
        if self._vmaf is not None and index in self._video:
            self._vmaf.write(shown, judged)
        return found, None

    def finish(self) -> list[Scores]:
        """Return all scores, with VMAF."""
        if self._vmaf is not None:
            for index, value in zip(self._video, self._vmaf.close(), strict=True):
                self._scores[index] = replace(self._scores[index], vmaf=value)
        return [(score, None) for score in self._scores]


@dataclass(frozen=True)
class Origin:
    """Where a frame came from, as its header tells; all None for a frame that ExWarp did not make.

    Attributes
    ----------
    kind
        A value of `FrameKind`: "generated" or "dropped".
    made_by
        "warp", "extrapolate", "softsplat", "blend", "interpolate" or "hold".
    path
        Decision path of its key interval, S1 to S6; None outside the paper's paths.
    """

    kind: str | None = None
    made_by: str | None = None
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
    return [_origin({} if is_clip(str(path)) else facts_in(path)) for path in files]


def _origin(known: dict[str, Any]) -> Origin:
    values = (known.get(name) for name in ("kind", "madeBy", "path", "method"))
    kind, made_by, path, method = (value if isinstance(value, str) else None for value in values)
    return Origin(kind, infer_maker(made_by, method), path)


def require_consistent(measuring: MeasureSettings, holes: str | None) -> None:
    """Refuse what contradicts itself, before any work; raises UsageError."""
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
    """Refuse limits on generated frames where no header tells of any; raises UsageError."""
    limits = [limit for limit in measuring.thresholds if limit.scope == GENERATED]
    if limits and not any(origin.generated for origin in origins):
        raise UsageError(
            f"{limits[0].option} {limits[0].name} is on generated frames, and by their headers "
            f"none of the compared frames of {test.pattern} is one; write {limits[0].metric.option}"
            f"={limits[0].limit:g} for all frames"
        )


def scorer(
    measuring: MeasureSettings, spec: str, reference: Sequence, origins: Listed[Origin]
) -> tuple[Scorer, tuple[str, ...]]:
    """Return who scores, and what a reader of the numbers should know of it.

    Parameters
    ----------
    measuring
        What is wanted.
    spec, reference
        The true sequence: what the user named it by, and what was found.
    origins
        Of the frames that will be scored, in order.
    """
    if measuring.preset is not None:
        generated = _generated(origins)
        if generated is not None and not any(generated):
            raise InputError(
                "by their headers none of the frames of the second sequence is generated, and "
                f"--preset {measuring.preset} scores nothing else; leave the preset out"
            )
        return ExtranetScores(measuring.measured, len(origins), generated), ()
    if "flicker" not in measuring.measured:
        return SequenceScores(measuring.measured, None), ()
    flow = open_flow(spec, reference, measuring.view)
    if isinstance(flow, Flow):
        return SequenceScores(measuring.measured, flow), ()
    note = f"flicker is not measured, as it follows the motion of the first sequence: {flow}"
    return SequenceScores(measuring.measured, None), (note,)


def _generated(origins: Listed[Origin]) -> list[bool] | None:
    """Return which frames the headers call generated; None where no header says anything."""
    if all(origin.kind is None for origin in origins):
        return None
    return [origin.generated for origin in origins]


def rendered_note(origins: Listed[Origin]) -> tuple[str, ...]:
    """Say that frames which were rendered raise the means over an upsampled sequence, if any do."""
    rendered = sum(not (origin.generated or origin.dropped) for origin in origins)
    if rendered in (0, len(origins)):
        return ()
    return (
        f"the means of all pixels are over all {len(origins)} frames, {rendered} of which are "
        "rendered ones by their headers",
    )
