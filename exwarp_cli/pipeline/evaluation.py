"""Score a whole sequence against another one."""

from __future__ import annotations

from collections.abc import Sequence as Listed
from contextlib import nullcontext
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from exwarp_cli.domain.decision import infer_maker
from exwarp_cli.domain.frame import place_on_canvas
from exwarp_cli.domain.metric import GENERATED, METRICS
from exwarp_cli.domain.results import FrameKind, Score
from exwarp_cli.domain.settings import PRESETS, MeasureSettings
from exwarp_cli.domain.timeline import parse_frames, parse_rate, ranges
from exwarp_cli.domain.wording import pluralise
from exwarp_cli.errors import InputError, LayoutError, MissingFrameError, MotionError, UsageError
from exwarp_cli.io import footage
from exwarp_cli.io.exr.reader import read_headers
from exwarp_cli.io.frames import read_plane
from exwarp_cli.io.generated_frames import read_facts
from exwarp_cli.io.sequences import Sequence, find_sequence
from exwarp_cli.io.shot import open_shot
from exwarp_cli.io.video_reader import is_clip
from exwarp_cli.io.view_transform import DisplayLook, find_display_look, find_view_transform
from exwarp_cli.io.views import expand_view
from exwarp_cli.pipeline import scoring
from exwarp_cli.pipeline.ground_truth import read_display, truth_rate
from exwarp_cli.pipeline.motion_convention import find_motion
from exwarp_cli.pipeline.progress import FrameListener, Progress
from exwarp_cli.runtime.stop import check_stop

KEY = FrameKind.KEY.value

MASK_CHANNEL = "holes"  # of a mask file; above 0.5 is a hole


@dataclass(frozen=True)
class Origin:
    """Where a frame came from, by its header; all None for a frame that ExWarp did not make."""

    kind: str | None = None  # a value of `FrameKind`; "dropped" repeats the frame before
    # "warp", "extrapolate", "softsplat", "blend", "interpolate" or "hold"
    made_by: str | None = None
    # Decision path of its key interval, S1 to S6; None outside the paper's paths
    path: str | None = None

    @property
    def generated(self) -> bool:
        """Whether it is a new frame: not a rendered one and no repeat."""
        return self.kind == FrameKind.GENERATED.value


@dataclass(frozen=True)
class ComparedFrame:
    """One pair of frames."""

    # reference, test: frame numbers in the two sequences
    reference: int
    test: int
    file: str  # name of the test frame's file
    # score, hole_score: over all pixels of the display window, and over the mask; None without a
    # mask or with an empty one
    score: Score
    hole_score: Score | None = None
    # Share of the pixels that the mask marks, 0 to 1; None without a mask
    hole_fraction: float | None = None
    origin: Origin = field(default_factory=Origin)  # where the test frame came from, by its header


@dataclass(frozen=True)
class Comparison:
    """Two sequences and the scores of their frames."""

    # reference, test, holes: the sequences; no masks, no `holes`
    reference: Sequence
    test: Sequence
    holes: Sequence | None
    matched_by: str  # how frames were paired: "number" or "order"
    # width, height: display window of the first pair, pixels
    width: int
    height: int
    frames: tuple[ComparedFrame, ...]  # at least one, in the reference's order
    measuring: MeasureSettings = field(default_factory=MeasureSettings)  # what was measured
    notes: tuple[str, ...] = ()  # what a reader of the numbers should know, a sentence each
    fps: float | None = None  # frame rate of the test; None if no file states it

    @property
    def worst(self) -> ComparedFrame:
        """The frame that is worst by the first metric that was measured; the first of them."""
        for metric in METRICS:
            scored = [f for f in self.frames if getattr(f.score, metric.field) is not None]
            if scored:
                return max(scored, key=lambda f: metric.badness(getattr(f.score, metric.field)))
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
    """Score every frame of `test` against the frame of `reference` of the same instant.

    Sequences are each a folder, a pattern or any one frame. `holes` holds masks, numbered as `test`
    (what ``upsample --write-holes`` writes) or as `reference`; a frame without a mask has no score
    in holes. `frames` is a range in the reference's numbers, None for all. `measuring` says what is
    measured, and how; None for the defaults. `progress` receives every frame, and `watcher` is
    shown those that it wants.

    Raises InputError when a sequence is not found, frames cannot be paired, a file is missing or
    damaged, or sizes differ; when nothing can be measured. Raises UsageError when the frame range
    does not parse, or options contradict each other; InstallationError when the view transform is
    not installed.
    """
    measuring = measuring or MeasureSettings()
    require_consistent(measuring, holes)
    matched_by, files, masks, notes = _pair_files(reference, test, frames, holes, measuring)
    truth, judged = files[0].reference, files[0].test
    origins = origins_of([judged.files[file.b] for file in files])
    scorer, more_notes = make_scorer(measuring, reference, truth, judged, origins)
    compared, shape = _score(files, origins, scorer, progress or Progress(), watcher)
    rate = footage.clip_rate(judged)
    if rate is None and not footage.is_plain(judged):
        header = read_headers(judged.files[min(judged.files)])[0]
        rate = parse_rate(header.get("framesPerSecond"))
    result = Comparison(
        *(truth, judged, masks, matched_by, shape[1], shape[0], compared),
        measuring=measuring,
        notes=(*notes, *more_notes, *scorer.notes),
        fps=None if rate is None else float(rate),
    )
    if all(frame.score == Score() for frame in compared):
        why = "; ".join(result.notes) or "nothing was chosen"
        raise InputError(
            f"nothing can be measured of {judged.pattern}: {why}; choose other --metrics"
        )
    if watcher is not None:  # the worst frame is known only now
        worst = next(file for file in files if file.b == result.worst.test)
        worst.show(watcher, worst.read(), result.worst.score)
    return result


@dataclass(frozen=True)
class _Files:
    """One pair of frames by their numbers, the reference's first, and its mask."""

    a: int
    b: int
    reference: Sequence
    test: Sequence
    mask: Path | None
    view: str
    looks: tuple[DisplayLook, DisplayLook]  # of both sequences

    def read(self) -> scoring.Pair:
        reference = self.reference.files[self.a]
        truth = read_display(self.reference, self.a, self.view)
        test = read_display(self.test, self.b, self.view)
        shape = truth.shape[:2]
        _require_shape(test.shape[:2], self.test.files[self.b], shape, reference)
        mask = None
        if self.mask is not None:
            plane, data, display = read_plane(self.mask, MASK_CHANNEL)
            _require_shape(display.shape, self.mask, shape, reference)
            mask = np.asarray(place_on_canvas(plane, data, display) > 0.5)
        return scoring.Pair(self.a, truth, test, mask)

    def show(
        self, watcher: FrameListener | None, pair: scoring.Pair, score: Score | None = None
    ) -> None:
        """Show the pair that was read to the watcher, if it wants that."""
        if watcher is not None and watcher.wants(self.b, score):
            pixels = zip(self.looks, (pair.truth, pair.test), strict=True)
            truth, test = (look.apply(linear) for look, linear in pixels)
            watcher.frame(self.b, test, truth, pair.mask, is_key=False)


def _require_shape(
    shape: tuple[int, ...], path: Path, wanted: tuple[int, ...], reference: Path
) -> None:
    if shape != wanted:
        raise LayoutError(
            f"{path} is {shape[1]}x{shape[0]} but {reference} is {wanted[1]}x{wanted[0]}; "
            "compare sequences of one resolution"
        )


def _score(
    files: list[_Files],
    origins: list[Origin],
    scorer: scoring.MetricScorer | scoring.ExtranetScorer,
    progress: Progress,
    watcher: FrameListener | None,
) -> tuple[tuple[ComparedFrame, ...], tuple[int, ...]]:
    """Score all pairs, one in memory at a time, and close their sequences.

    Also return the first pair's rows and columns.
    """
    hole_fractions: list[float | None] = []
    shape: tuple[int, ...] = (0, 0)
    try:
        progress.start(len(files))
        if watcher is not None:
            watcher.plan([[file.b] for file in files])
        with scorer.vmaf or nullcontext():
            for file in files:
                pair = file.read()
                shape = shape if hole_fractions else pair.truth.shape[:2]
                scorer.add(pair)
                hole_fractions.append(None if pair.mask is None else float(np.mean(pair.mask)))
                file.show(watcher, pair)
                progress.advance(file.b)
                check_stop()
            scores = scorer.finish()
    finally:
        progress.finish()
        footage.close_sequences(files[0].reference, files[0].test)
    compared = tuple(
        ComparedFrame(f.a, f.b, f.test.files[f.b].name, overall, inside, fraction, origin)
        for f, (overall, inside), fraction, origin in zip(
            files, scores, hole_fractions, origins, strict=True
        )
    )
    return compared, shape


def _pair_files(
    reference: str, test: str, frames: str | None, holes: str | None, measuring: MeasureSettings
) -> tuple[str, list[_Files], Sequence | None, tuple[str, ...]]:
    """Find the frames that are compared, and their masks.

    Also return how frames were paired, the sequence of masks and what `pair` notes.
    """
    truth, judged = (
        footage.find_frames(expand_view(spec, measuring.view or None)[0], scan=measuring.scan)
        for spec in (reference, test)
    )
    transform = find_view_transform(measuring.view_transform, truth, judged)
    looks = find_display_look(truth, transform), find_display_look(judged, transform)
    masks = None if holes is None else find_sequence(holes)
    matched_by, paired, notes = pair(truth, judged, measuring.view)
    wanted = list(paired) if frames is None else parse_frames(frames)
    if absent := [number for number in wanted if number not in paired]:
        raise MissingFrameError(
            f"frame {ranges(absent)} of --frames {frames} is not in both sequences, "
            f"which share {ranges(list(paired))}"
        )
    mask_files: dict[int, Path] = {}  # by the test's frame number
    if masks is not None:
        by_test = {b: masks.files[b] for b in paired.values() if b in masks.files}
        by_reference = {b: masks.files[a] for a, b in paired.items() if a in masks.files}
        mask_files = by_test or by_reference
        if not mask_files:
            raise MissingFrameError(
                f"no mask of {masks.pattern} ({ranges(list(masks.files))}) has the number of a "
                f"compared frame ({ranges(list(paired.values()))} of {judged.pattern}); "
                "give the masks that were written with these frames"
            )
    files = [
        _Files(a, paired[a], truth, judged, mask_files.get(paired[a]), measuring.view, looks)
        for a in wanted
    ]
    return matched_by, files, masks, notes


def pair(
    reference: Sequence, test: Sequence, view: str = ""
) -> tuple[str, dict[int, int], tuple[str, ...]]:
    """Find the frame of `test` at the instant of each frame of `reference`.

    By number where the numbers of one sequence are all among the other's; frames that only the
    longer one has are left out. Else by order, if both have equally many, or one has the tail that
    ExWarp writes. Where both begin alike and their pictures show different rates, by instant.

    Return "number" or "order"; the test's number by the reference's, ascending; and what a reader
    of the numbers should know. Raises MissingFrameError when frames cannot be paired.
    """
    a, b = sorted(reference.files), sorted(test.files)
    by_number = set(a) <= set(b) or set(b) <= set(a)
    if len(a) != len(b) and (a[0] == b[0] or not by_number):
        kinds = [origin.kind for origin in origins_of([test.files[n] for n in b])]
        # Rendered frames are the reference's own pictures; without headers, any frame will do.
        rendered = [index for index, kind in enumerate(kinds) if kind is None or kind == KEY]
        rate = truth_rate(
            rendered,
            len(b),
            len(a),
            lambda index: read_display(test, b[index], view),
            lambda index: read_display(reference, a[index], view),
        )
        if rate != 1:
            instants = ((index * rate, number) for index, number in enumerate(b))
            paired = {a[int(i)]: n for i, n in instants if i.denominator == 1 and i < len(a)}
            note = (
                f"the first sequence has {rate.numerator} frames for each {rate.denominator} of "
                "the second, as the pictures show: those of the same instant are compared"
            )
            return "order", paired, (note,)
        # Frames up to the next rendered one, at most; none where no header names its kind.
        runs = "".join("r" if kind in (None, KEY) else "n" for kind in kinds).split("r")
        interval = 0 if set(kinds) <= {None} else max(map(len, runs)) + 1
        if not by_number and abs(len(a) - len(b)) < interval:
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


def origins_of(files: Listed[Path]) -> list[Origin]:
    """Read where frames came from, of every header once.

    Raises DamagedFileError when a header cannot be read.
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
            f"{names[foreign[0]]}; leave that or the preset out"
        )
    if holes is not None:
        raise UsageError(
            f"--preset {measuring.preset} measures whole frames; leave --holes or the preset out"
        )


def make_scorer(
    measuring: MeasureSettings,
    spec: str,
    reference: Sequence,
    test: Sequence,
    origins: Listed[Origin],
) -> tuple[scoring.MetricScorer | scoring.ExtranetScorer, tuple[str, ...]]:
    """Return a scorer, and what a reader of its numbers should know.

    The true sequence is `reference`, which the user named `spec`. The origins are those of the
    frames that will be scored, in order. Raises UsageError for limits on generated frames where no
    header names any.
    """
    generated = [origin.generated for origin in origins]
    limits = [limit for limit in measuring.thresholds if limit.scope == GENERATED]
    if limits and not any(generated):
        raise UsageError(
            f"{limits[0].option} {limits[0].name} is on generated frames, and by their headers "
            f"none of the compared frames of {test.pattern} is one; write {limits[0].metric.option}"
            f"={limits[0].limit:g} for all frames"
        )
    if measuring.preset is not None:  # it has its own rule for rendered frames
        has_headers = any(origin.kind is not None for origin in origins)
        if has_headers and not any(generated):
            raise InputError(
                "by their headers none of the frames of the second sequence is generated, and "
                f"--preset {measuring.preset} scores nothing else; leave the preset out"
            )
        flags = generated if has_headers else None
        return scoring.ExtranetScorer(measuring.measured, len(origins), flags), ()
    notes = []
    not_rendered = (FrameKind.GENERATED.value, FrameKind.DROPPED.value)
    rendered = sum(origin.kind not in not_rendered for origin in origins)
    if rendered not in (0, len(origins)):
        notes.append(
            f"the means of all pixels are over all {len(origins)} frames, {rendered} of which are "
            "rendered ones by their headers"
        )
    motion: scoring.SequenceMotion | None = None
    if "flicker" in measuring.measured:
        reason = f"{reference.pattern} has no motion vectors"
        try:
            shot = open_shot(spec, measuring.view or None)
            finding = find_motion(shot, None)
        except (InputError, MotionError) as error:
            finding, reason = None, str(error)
        if finding is not None:
            reason = f"the vectors beside {reference.pattern} are of other frames"
            if set(reference.files) <= set(shot.sequence.files):
                motion = scoring.SequenceMotion(shot, finding.convention)
        if motion is None:
            notes.append(
                f"flicker is not measured, as it follows the motion of the first sequence: {reason}"
            )
    return scoring.MetricScorer(measuring.measured, motion), tuple(notes)
