"""Score a whole sequence against another one."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from exwarp_cli.domain.frame import Bool, Image, place
from exwarp_cli.domain.results import Score
from exwarp_cli.domain.timeline import parse_frames, ranges
from exwarp_cli.errors import LayoutError, MissingFrameError
from exwarp_cli.io.frames import read_image, read_plane
from exwarp_cli.io.sequence import Sequence, find_sequence
from exwarp_cli.metrics.registry import score
from exwarp_cli.pipeline.progress import NoProgress, Progress

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
    """

    reference: int
    test: int
    file: str
    score: Score
    hole_score: Score | None = None
    hole_fraction: float | None = None


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
    """

    reference: Sequence
    test: Sequence
    holes: Sequence | None
    matched_by: str
    width: int
    height: int
    frames: tuple[ComparedFrame, ...]

    @property
    def worst(self) -> ComparedFrame:
        """The frame with the lowest PSNR; the first of them."""
        return min(self.frames, key=lambda frame: frame.score.psnr_db)


def evaluate(
    reference: str,
    test: str,
    frames: str | None = None,
    holes: str | None = None,
    progress: Progress | None = None,
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
        Told of every frame.

    Raises
    ------
    InputError
        When a sequence is not found, frames cannot be paired, a file is missing or damaged, or
        sizes differ.
    UsageError
        When the frame range does not parse.
    """
    truth, judged = find_sequence(reference), find_sequence(test)
    masks = None if holes is None else find_sequence(holes)
    matched_by, paired = pair(truth, judged)
    pairs = _select(paired, frames)
    mask_files = {} if masks is None else _mask_files(masks, judged, paired)
    told = progress or NoProgress()
    told.start(len(pairs))
    compared = []
    height, width = 0, 0
    try:
        for a, b in pairs.items():
            one, shape = _compare(a, truth.files[a], b, judged.files[b], mask_files.get(b))
            compared.append(one)
            height, width = (height, width) if height else shape
            told.advance(b)
    finally:
        told.finish()
    return Comparison(truth, judged, masks, matched_by, width, height, tuple(compared))


def pair(reference: Sequence, test: Sequence) -> tuple[str, dict[int, int]]:
    """Find the frame of `test` that belongs to each frame of `reference`.

    By number where the numbers of one sequence are all among the other's (frames that only the
    longer one has are left out); otherwise by order, if both have equally many.

    Returns
    -------
    str, dict of int to int
        "number" or "order", and the test's number by the reference's, ascending.

    Raises
    ------
    MissingFrameError
        When neither is possible.
    """
    a, b = sorted(reference.files), sorted(test.files)
    if set(a) <= set(b) or set(b) <= set(a):
        return "number", {n: n for n in a if n in test.files}
    if len(a) != len(b):
        raise MissingFrameError(
            f"the frames {ranges(a)} of {reference.pattern} and {ranges(b)} of {test.pattern} "
            f"match neither by number nor by order ({len(a)} against {len(b)}); "
            "renumber one sequence, or move the frames that the other lacks elsewhere"
        )
    return "order", dict(zip(a, b, strict=True))


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


def _compare(
    a: int, reference: Path, b: int, test: Path, mask: Path | None
) -> tuple[ComparedFrame, tuple[int, int]]:
    """Score one pair; also return the display window's rows and columns."""
    truth, judged = _shown(reference), _shown(test)
    shape = truth.display_window.shape
    _require_shape(judged.display_window.shape, test, shape, reference)
    holes = None if mask is None else _read_mask(mask, shape, reference)
    overall, inside = score(truth.pixels, judged.pixels, holes)
    fraction = None if holes is None else float(np.mean(holes))
    return ComparedFrame(a, b, test.name, overall, inside, fraction), shape


def _shown(path: Path) -> Image:
    """Read what is meant to be seen of a frame."""
    image = read_image(path)
    return image.on(image.display_window)


def _read_mask(path: Path, shape: tuple[int, int], reference: Path) -> Bool:
    plane, data, display = read_plane(path, MASK_CHANNEL)
    _require_shape(display.shape, path, shape, reference)
    return np.asarray(place(plane, data, display) > 0.5)


def _require_shape(
    shape: tuple[int, int], path: Path, wanted: tuple[int, int], reference: Path
) -> None:
    if shape != wanted:
        raise LayoutError(
            f"{path} is {shape[1]}x{shape[0]} but {reference} is {wanted[1]}x{wanted[0]}; "
            "compare sequences of one resolution"
        )
