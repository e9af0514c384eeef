"""Score a whole sequence against another one."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from fractions import Fraction
from pathlib import Path

import numpy as np

from exwarp_cli.domain.frame import Bool, Image, place_on_canvas
from exwarp_cli.domain.metric import METRICS
from exwarp_cli.domain.results import FrameKind, Score
from exwarp_cli.domain.settings import MeasureSettings
from exwarp_cli.domain.timeline import parse_frames, ranges
from exwarp_cli.domain.wording import pluralise
from exwarp_cli.errors import InputError, LayoutError, MissingFrameError
from exwarp_cli.io.footage import close, find_frames, picture
from exwarp_cli.io.frames import read_plane
from exwarp_cli.io.sequence import Sequence, find_sequence
from exwarp_cli.io.views import expand
from exwarp_cli.pipeline.comparing import (
    Origin,
    Pair,
    Scorer,
    origins_of,
    rendered_note,
    require_consistent,
    require_generated,
    scorer,
)
from exwarp_cli.pipeline.finding import truth_rate
from exwarp_cli.pipeline.progress import FrameListener, NoProgress, Progress
from exwarp_cli.runtime.stop import check_stop

KEY = FrameKind.KEY.value

MASK_CHANNEL = "holes"
"""Channel of a mask file; above 0.5 is a hole."""


@dataclass(frozen=True)
class ComparedFrame:
    """One pair of frames.

    Attributes
    ----------
    reference, test
        Frame numbers in the two sequences.
    file
        Name of the test frame's file.
    score, hole_score
        Over all pixels of the display window, and over the mask; None without a mask or with an
        empty one.
    hole_fraction
        Share of the pixels that the mask marks, 0 to 1; None without a mask.
    origin
        What the test frame's header tells of where it came from.
    """

    reference: int
    test: int
    file: str
    score: Score
    hole_score: Score | None = None
    hole_fraction: float | None = None
    origin: Origin = field(default_factory=Origin)


@dataclass(frozen=True)
class Comparison:
    """Two sequences and the scores of their frames.

    Attributes
    ----------
    reference, test, holes
        The sequences; no masks, no `holes`.
    matched_by
        "number" or "order": how frames were paired.
    width, height
        Display window of the first pair, pixels.
    frames
        At least one, in the reference's order.
    measuring
        What was asked for.
    notes
        What a reader of the numbers should know, a sentence each.
    """

    reference: Sequence
    test: Sequence
    holes: Sequence | None
    matched_by: str
    width: int
    height: int
    frames: tuple[ComparedFrame, ...]
    measuring: MeasureSettings = field(default_factory=MeasureSettings)
    notes: tuple[str, ...] = ()

    @property
    def worst(self) -> ComparedFrame:
        """The frame that is worst by the first metric that was measured; the first of them."""
        for metric in METRICS:
            known = [f for f in self.frames if getattr(f.score, metric.field) is not None]
            if known:
                return max(known, key=lambda f: metric.badness(getattr(f.score, metric.field)))
        return self.frames[0]


def evaluate(
    reference: str,
    test: str,
    frames: str | None = None,
    holes: str | None = None,
    progress: Progress | None = None,
    measuring: MeasureSettings | None = None,
    watcher: FrameListener | None = None,
) -> Comparison:
    """Score every frame of `test` against the frame of `reference` that belongs to it.

    Parameters
    ----------
    reference, test, holes
        Sequences, each as a folder, a pattern or any one frame. `holes` holds masks, numbered as
        `test` (what ``upsample --write-holes`` writes) or as `reference`; a frame without a mask
        has no score in holes.
    frames
        Frame range in the reference's numbers; None for all.
    progress
        Receives every frame.
    measuring
        What is measured, and how; None for the defaults.
    watcher
        Shown frames that it wants to see; None where no frame is shown.

    Raises
    ------
    InputError
        When a sequence is not found, frames cannot be paired, a file is missing or damaged, or
        sizes differ; when nothing of what was asked for can be measured.
    UsageError
        When the frame range does not parse, or options contradict each other.
    """
    measuring = measuring or MeasureSettings()
    require_consistent(measuring, holes)
    truth, judged = (
        find_frames(expand(spec, measuring.view or None)[0], scan=measuring.scan)
        for spec in (reference, test)
    )
    masks = None if holes is None else find_sequence(holes)
    matched_by, paired, pairing_notes = pair(truth, judged, measuring.view)
    pairs = _select(paired, frames)
    mask_files = {} if masks is None else _mask_files(masks, judged, paired)
    files = [
        _Files(a, b, truth, judged, mask_files.get(b), measuring.view) for a, b in pairs.items()
    ]
    origins = origins_of([judged.files[one.b] for one in files])
    require_generated(measuring, origins, judged)
    scoring, notes = scorer(measuring, reference, truth, origins)
    try:
        compared, shape = _score(files, scoring, progress or NoProgress(), watcher)
    finally:
        close(truth, judged)
    if measuring.preset is None:  # which has its own rule for rendered frames
        notes = (*rendered_note(origins), *notes)
    notes = (*pairing_notes, *notes)
    compared = tuple(replace(f, origin=o) for f, o in zip(compared, origins, strict=True))
    found = Comparison(
        *(truth, judged, masks, matched_by, shape[1], shape[0], compared),
        measuring=measuring,
        notes=(*notes, *scoring.notes),
    )
    _require_scores(found)
    if watcher is not None:  # scores are known only now, and the worst frame may not be chosen
        worst = next(one for one in files if one.b == found.worst.test)
        _show(watcher, worst.b, worst.read(), found.worst.score)
    return found


@dataclass(frozen=True)
class _Files:
    """One pair of frames, the reference's first, and its mask."""

    a: int
    b: int
    reference: Sequence
    test: Sequence
    mask: Path | None
    view: str

    @property
    def name(self) -> str:
        """Name of the test's file."""
        return self.test.files[self.b].name

    def read(self) -> Pair:
        """Read the pair and its mask, all of one size."""
        reference = self.reference.files[self.a]
        truth = _shown(self.reference, self.a, self.view)
        judged = _shown(self.test, self.b, self.view)
        shape = truth.display_window.shape
        _require_shape(judged.display_window.shape, self.test.files[self.b], shape, reference)
        mask = None if self.mask is None else _read_mask(self.mask, shape, reference)
        return Pair(self.a, truth.pixels, judged.pixels, mask)


def _score(
    files: list[_Files], scoring: Scorer, progress: Progress, watcher: FrameListener | None
) -> tuple[tuple[ComparedFrame, ...], tuple[int, ...]]:
    """Score all pairs, one in memory at a time; also return the first one's rows and columns."""
    shares: list[float | None] = []
    shape: tuple[int, ...] = (0, 0)
    progress.start(len(files))
    if watcher is not None:
        watcher.plan([[one.b] for one in files])
    try:
        with scoring:
            for one in files:
                pair = one.read()
                shape = shape if shares else pair.truth.shape[:2]
                scoring.add(pair)
                shares.append(None if pair.mask is None else float(np.mean(pair.mask)))
                _show(watcher, one.b, pair, None)
                progress.advance(one.b)
                check_stop()
            scores = scoring.finish()
    finally:
        progress.finish()
    compared = tuple(
        ComparedFrame(one.a, one.b, one.name, overall, inside, share)
        for one, (overall, inside), share in zip(files, scores, shares, strict=True)
    )
    return compared, shape


def pair(
    reference: Sequence, test: Sequence, view: str = ""
) -> tuple[str, dict[int, int], tuple[str, ...]]:
    """Find the frame of `test` that belongs to each frame of `reference`.

    By number where the numbers of one sequence are all among the other's (frames that only the
    longer one has are left out). Otherwise by order, if both have equally many, or are as ExWarp
    writes them: a tail more or less. Where both begin alike and their pictures show another rate,
    by the instant.

    Returns
    -------
    str, dict of int to int, tuple of str
        "number" or "order"; the test's number by the reference's, ascending; and what a reader of
        the numbers should know.

    Raises
    ------
    MissingFrameError
        When neither is possible.
    """
    a, b = sorted(reference.files), sorted(test.files)
    by_number = set(a) <= set(b) or set(b) <= set(a)
    if len(a) != len(b) and (a[0] == b[0] or not by_number):
        kinds = [origin.kind for origin in origins_of([test.files[n] for n in b])]
        rate = _rate(reference, test, kinds, view)
        if rate != 1:
            return "order", *_by_instant(a, b, rate)
        if not by_number and abs(len(a) - len(b)) < _interval(kinds):
            left = f"the last {pluralise(abs(len(a) - len(b)), 'frame')} of the longer sequence"
            return "order", dict(zip(a, b, strict=False)), (f"{left} have no partner",)
    if by_number:
        return "number", {n: n for n in a if n in test.files}, ()
    if len(a) != len(b):
        raise MissingFrameError(
            f"the frames {ranges(a)} of {reference.pattern} and {ranges(b)} of {test.pattern} "
            f"match neither by number nor by order ({len(a)} against {len(b)}); "
            "renumber one sequence, or move the frames that the other lacks elsewhere"
        )
    return "order", dict(zip(a, b, strict=True)), ()


def _rate(reference: Sequence, test: Sequence, kinds: list[str | None], view: str) -> Fraction:
    """Return how many frames the reference has per frame of the test, as the pictures show."""
    a, b = sorted(reference.files), sorted(test.files)
    # Rendered frames are the reference's own pictures; where no header tells, any will do.
    rendered = [place for place, kind in enumerate(kinds) if kind is None or kind == KEY]
    return truth_rate(
        rendered,
        len(b),
        len(a),
        lambda place: picture(test, b[place], view),
        lambda place: picture(reference, a[place], view),
    )


def _interval(kinds: list[str | None]) -> int:
    """Return the longest run of frames between rendered ones; 0 where no header tells."""
    runs = "".join("r" if kind in (None, KEY) else "n" for kind in kinds).split("r")
    return 0 if set(kinds) <= {None} else max(map(len, runs)) + 1


def _by_instant(
    a: list[int], b: list[int], rate: Fraction
) -> tuple[dict[int, int], tuple[str, ...]]:
    """Pair frames of sequences that begin alike, the first with `rate` times as many frames."""
    places = [(place * rate, place) for place in range(len(b))]
    paired = {a[int(at)]: b[place] for at, place in places if at.denominator == 1 and at < len(a)}
    note = (
        f"the first sequence has {rate.numerator} frames for each {rate.denominator} of the "
        f"second, as the pictures show: those of the same instant are compared"
    )
    return paired, (note,)


def _select(paired: dict[int, int], frames: str | None) -> dict[int, int]:
    if frames is None:
        return paired
    wanted = parse_frames(frames)
    absent = [number for number in wanted if number not in paired]
    if absent:
        raise MissingFrameError(
            f"frame {ranges(absent)} of --frames {frames} is not in both sequences, "
            f"which share {ranges(list(paired))}"
        )
    return {number: paired[number] for number in wanted}


def _mask_files(masks: Sequence, test: Sequence, paired: dict[int, int]) -> dict[int, Path]:
    """Mask file by the test's frame number."""
    by_test = {b: masks.files[b] for b in paired.values() if b in masks.files}
    by_reference = {b: masks.files[a] for a, b in paired.items() if a in masks.files}
    if not by_test and not by_reference:
        raise MissingFrameError(
            f"no mask of {masks.pattern} ({ranges(list(masks.files))}) has the number of a "
            f"compared frame ({ranges(list(paired.values()))} of {test.pattern}); "
            "give the masks that were written with these frames"
        )
    return by_test or by_reference


def _show(watcher: FrameListener | None, number: int, one: Pair, score: Score | None) -> None:
    """Show the test's frame to the watcher if it wants it."""
    if watcher is not None and watcher.wants(number, score):
        watcher.frame(number, one.test, one.truth, one.mask, is_key=False)


def _require_scores(found: Comparison) -> None:
    """Refuse a comparison in which nothing could be measured."""
    if all(frame.score == Score() for frame in found.frames):
        why = "; ".join(found.notes) or "nothing was chosen"
        raise InputError(
            f"nothing can be measured of {found.test.pattern}: {why}; choose other --metrics"
        )


def _shown(sequence: Sequence, number: int, view: str) -> Image:
    """Read what is meant to be seen of a frame."""
    image = picture(sequence, number, view)
    return image.on(image.display_window)


def _read_mask(path: Path, shape: tuple[int, int], reference: Path) -> Bool:
    plane, data, display = read_plane(path, MASK_CHANNEL)
    _require_shape(display.shape, path, shape, reference)
    return np.asarray(place_on_canvas(plane, data, display) > 0.5)


def _require_shape(
    shape: tuple[int, int], path: Path, wanted: tuple[int, int], reference: Path
) -> None:
    if shape != wanted:
        raise LayoutError(
            f"{path} is {shape[1]}x{shape[0]} but {reference} is {wanted[1]}x{wanted[0]}; "
            "compare sequences of one resolution"
        )
