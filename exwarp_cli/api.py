"""ExWarp from Python: what the commands `upsample`, `inspect` and `compare` do.

Example
-------
>>> from exwarp_cli import api
>>> settings = api.UpsampleSettings(api.SourceSettings("shot/"), "out/", method="softsplat")
>>> result = api.upsample(settings, report="report/")  # doctest: +SKIP
>>> result.document["frames"]["generated"]  # doctest: +SKIP

Settings are those of the command line, with its defaults. Documents are those of ``--json``.
Whatever a user can cause is an `ExwarpError`, whose message is one sentence.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from exwarp_cli.domain.settings import (
    ClusterSettings,
    MeasureSettings,
    SourceSettings,
    UpsampleSettings,
)
from exwarp_cli.errors import ExwarpError, UsageError

if TYPE_CHECKING:
    from exwarp_cli.domain.results import RunSummary
    from exwarp_cli.pipeline.evaluation import Comparison
    from exwarp_cli.pipeline.inspect import Inspection
    from exwarp_cli.pipeline.progress import Progress

__all__ = [
    "ClusterSettings",
    "ComparisonResult",
    "ExwarpError",
    "MeasureSettings",
    "SourceSettings",
    "UpsampleResult",
    "UpsampleSettings",
    "compare",
    "inspect",
    "upsample",
]


@dataclass(frozen=True)
class UpsampleResult:
    """What a run wrote."""

    summary: RunSummary
    report_folder: Path | None  # a chunk's is one of its own

    @property
    def document(self) -> dict[str, Any]:
        """The document of schema ``exwarp.report/1``, as in ``report.json``."""
        from exwarp_cli.report.schema import run_document

        return run_document(self.summary)

    @property
    def is_complete(self) -> bool:
        """False if `keep_going` left key intervals out."""
        return not self.summary.left_out


def upsample(
    settings: UpsampleSettings,
    *,
    report: str | Path | None = None,
    is_chunk: bool = False,
    distribution: ClusterSettings | None = None,
    progress: Progress | None = None,
    has_document: bool = True,
) -> UpsampleResult:
    """Write a sequence at a higher frame rate.

    Parameters
    ----------
    settings
        The input, the output and how new frames are made.
    report
        Folder for report.html, report.json and frames.csv; None for no report.
    is_chunk
        True if this is one of several runs whose reports are joined later: the report then goes to
        a folder of its own below `report`.
    distribution
        Where chunks of the work are done; None for this process.
    progress
        What shows how far the run is; None for silence.
    has_document
        False spares measuring what only documents hold.

    Raises
    ------
    ExwarpError
        With one sentence, and the exit code of the command. What is written is whole.
    """
    from exwarp_cli.pipeline.job import open_job
    from exwarp_cli.pipeline.progress import Silence

    reporter = Silence() if progress is None else progress
    job = replace(open_job(settings), reported=has_document or report is not None)
    folder, gallery = find_report_folder(report, is_chunk, job.key_numbers), None
    if folder is not None:
        from exwarp_cli.report.folder import prepare_report, write_report
        from exwarp_cli.report.gallery import Gallery

        prepare_report(folder, replace=settings.overwrite or settings.skip_existing)
        gallery = Gallery(settings.ground_truth is not None)
    if distribution is not None and distribution.spread:
        from exwarp_cli.farm.dask_cluster import run_on_cluster

        summary = run_on_cluster(job, distribution, reporter, gallery)
    else:
        from exwarp_cli.pipeline.run import run_job

        summary = run_job(job, reporter, gallery)
    if folder is not None and gallery is not None:
        write_report(folder, summary, gallery.album)
    return UpsampleResult(summary, folder)


def find_report_folder(
    report: str | Path | None, is_chunk: bool, key_numbers: tuple[int, ...]
) -> Path | None:
    """Return the folder that a run's report goes to; raises UsageError for a chunk without one."""
    if report is None and is_chunk:
        raise UsageError(
            "--as-chunk says where the report goes; give --report too, or leave it out"
        )
    if report is None or not is_chunk:
        return None if report is None else Path(report)
    from exwarp_cli.report.folder import chunk_folder

    return chunk_folder(Path(report), key_numbers)


def inspect(source: SourceSettings) -> Inspection:
    """Find out what a sequence holds and what its motion vectors mean.

    The result's ``as_dict()`` is the document of ``exwarp inspect --json``. Raises `ExwarpError` if
    the sequence cannot be read.
    """
    from exwarp_cli.pipeline.inspect import inspect as inspect_sequence

    return inspect_sequence(source)


@dataclass(frozen=True)
class ComparisonResult:
    """Scores of a sequence against another."""

    comparison: Comparison
    baseline: Comparison | None = None  # of A against the ground truth, if that is a third sequence

    @property
    def document(self) -> dict[str, Any]:
        """The document of ``exwarp compare --json``."""
        from exwarp_cli.report.comparison import comparison_document

        return comparison_document(self.comparison, self.baseline)


def compare(
    reference: str | Path,
    test: str | Path,
    *,
    ground_truth: str | Path | None = None,
    frames: str | None = None,
    holes: str | None = None,
    report: str | Path | None = None,
    measuring: MeasureSettings | None = None,
    progress: Progress | None = None,
) -> ComparisonResult:
    """Score a sequence against ground truth: the display window, sRGB-encoded, clipped to [0, 1].

    Parameters
    ----------
    reference, test
        Folders, patterns or any one frame; `reference` is the ground truth.
    ground_truth
        A third sequence that is the ground truth instead: `reference` is then the baseline, which
        `test` is compared with.
    frames
        Range of the ground truth's frame numbers; None for all.
    holes
        Masks of `write_holes`; None for no scores in holes.
    report
        Folder for the comparison's page, JSON and CSV; None for no report.
    measuring
        Metrics and limits; None for the default metrics. Limits are not enforced here.
    progress
        What shows how far it is; None for silence.

    Raises
    ------
    ExwarpError
        If the sequences cannot be read or do not fit together.
    """
    from exwarp_cli.pipeline.evaluation import evaluate
    from exwarp_cli.pipeline.progress import Silence
    from exwarp_cli.report.comparison import REFERENCE, TEST, add_baseline
    from exwarp_cli.report.folder import prepare_comparison, write_comparison
    from exwarp_cli.report.gallery import Gallery

    reporter = Silence() if progress is None else progress
    gallery = None
    if report is not None:
        prepare_comparison(Path(report))
        gallery = Gallery(True, TEST, REFERENCE, 2 if ground_truth is None else 3)
    measured = MeasureSettings() if measuring is None else measuring
    truth = str(reference if ground_truth is None else ground_truth)
    result = evaluate(truth, str(test), frames, holes, reporter, measured, gallery)
    baseline = None
    if ground_truth is not None:  # limits are on the test alone
        same = replace(measured, metrics=measured.measured, thresholds=())
        baseline = evaluate(truth, str(reference), frames, None, reporter, same)
    if report is not None and gallery is not None:
        if baseline is not None:
            add_baseline(gallery.album, result, baseline)
        write_comparison(Path(report), result, gallery.album, baseline)
    return ComparisonResult(result, baseline)
