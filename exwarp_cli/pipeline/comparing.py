"""Scores of whole sequences, frame after frame: also what takes several frames."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import dataclass, replace
from itertools import pairwise
from types import TracebackType
from typing import Protocol

from exwarp_cli.domain.frame import Bool, Float32, GBuffer
from exwarp_cli.domain.motion import MotionConvention
from exwarp_cli.domain.results import Score
from exwarp_cli.errors import InputError, MotionError
from exwarp_cli.io.atomic import Held
from exwarp_cli.io.frames import GEOMETRY, Shot, open_shot, read_raw
from exwarp_cli.io.sequence import Sequence
from exwarp_cli.io.video import to_display
from exwarp_cli.io.vmaf import EncodedVmaf, Vmaf
from exwarp_cli.metrics import extranet
from exwarp_cli.metrics.display import rounded
from exwarp_cli.metrics.flicker import error, of_frames, transition
from exwarp_cli.metrics.registry import score
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
        overall, inside = score(pair.truth, pair.test, pair.mask, self._names)
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
            flickers = of_frames([*self._into, None])
            found = [(replace(s, flicker=v), h) for (s, h), v in zip(found, flickers, strict=True)]
        return found

    @property
    def notes(self) -> tuple[str, ...]:
        """Nothing."""
        return ()

    def _transition(self, flow: Flow, pair: Pair) -> tuple[float | None, float | None]:
        """Return what changes into a frame, over all pixels and in holes."""
        motion = flow.into(pair.reference)
        before, self._error = self._error, error(pair.truth, pair.test)
        if motion is None or before is None:
            return None, None
        found = transition(self._error, before, *motion)
        return found.mean(), None if pair.mask is None else found.within(pair.mask)


class ExtranetScores(Held):
    """Scores as ExtraNet's release takes them: see `exwarp_cli.metrics.extranet`.

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
        told = f"{self._counted} of {len(self._scores)} frames count as generated, {by}"
        if self._vmaf is None:
            return (told,)
        return (told, f"VMAF is of {len(self._video)} frames in H.264, rendered ones included")

    def add(self, pair: Pair) -> Scores:
        """Score the next frame, if it counts, and append it to the videos."""
        index = len(self._scores)
        shown, judged = rounded(pair.truth), rounded(pair.test)
        same = bool((shown == judged).all())
        counts = not same if self._generated is None else self._generated[index]
        self._counted += counts
        found = extranet.score(pair.truth, pair.test) if counts else Score()
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
