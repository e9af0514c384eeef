"""The reports of chunks, joined into the one that a single run would have written."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from exwarp_cli.domain.joining import join, missing_keys
from exwarp_cli.domain.results import RunSummary
from exwarp_cli.domain.timeline import ranges
from exwarp_cli.errors import InputError, UsageError
from exwarp_cli.report.album_reading import PageAlbums
from exwarp_cli.report.folder import (
    CHUNKS,
    PAGE_FILE,
    REPORT_FILE,
    chunk_reports,
    prepare_report,
    write_report,
)
from exwarp_cli.report.reading import read_report
from exwarp_cli.report.summary import report


@dataclass(frozen=True)
class Merged:
    """What came of merging.

    Attributes
    ----------
    run
        The joined run.
    reports
        How many it was joined from.
    missing
        Range of the sequence's key frames that are in none of them; None where all are.
    unseen
        Folders of reports whose pictures are not in the page, as their own pages are not there,
        are damaged, or are of another version.
    """

    run: RunSummary
    reports: int
    missing: str | None
    unseen: tuple[Path, ...]

    @property
    def document(self) -> dict[str, Any]:
        """What report.json holds, and as ``merged`` what is told of the merging."""
        merged = {
            "reports": self.reports,
            "missing": self.missing,
            "without_pictures": [str(folder) for folder in self.unseen],
        }
        return report(self.run) | {"merged": merged}


def merge_reports(
    folders: Sequence[Path], output: Path | None = None, replace: bool = False
) -> Merged:
    """Join reports into one, and write it.

    Parameters
    ----------
    folders
        Of reports, or of what chunks reported to: a folder without a report of its own stands for
        those in its ``chunks``.
    output
        The folder to write to; None for the only one of `folders`, whose ``chunks`` are joined.
    replace
        Whether a report that is there may go.

    Raises
    ------
    UsageError
        When nothing says where to write.
    InputError
        When a report cannot be read, or they do not belong together.
    OutputError
        When the report cannot be written; OutputExistsError when one is there.
    """
    reports, target = _resolved(folders, output)
    run = join([read_report(folder) for folder in reports], [str(folder) for folder in reports])
    prepare_report(target, replace, "-o")
    pages = PageAlbums.of([folder / PAGE_FILE for folder in reports])
    write_report(target, run, pages.album(run))
    missing = ranges(missing_keys(run)) or None
    return Merged(run, len(reports), missing, tuple(page.parent for page in pages.unreadable))


def _resolved(folders: Sequence[Path], output: Path | None) -> tuple[list[Path], Path]:
    """Return the folders of the reports that are joined, each once, and the one to write to."""
    if output is None:
        if len(folders) > 1:
            raise UsageError("several reports are named; say with -o where the joined one goes")
        return _chunks_in(folders[0]), folders[0]
    found = [report for folder in folders for report in _reports_in(folder)]
    by_path = {report.resolve(): report for report in found}
    if output.resolve() in by_path:
        raise UsageError(f"-o {output} is one of the reports that are joined; name another folder")
    return list(by_path.values()), output


def _reports_in(folder: Path) -> list[Path]:
    """Return the reports that a folder stands for: its own, else those of chunks in it."""
    found = [folder] if (folder / REPORT_FILE).exists() else chunk_reports(folder)
    if not found:
        raise InputError(
            f"{folder} holds no {REPORT_FILE}; name folders that upsample --report wrote"
        )
    return found


def _chunks_in(folder: Path) -> list[Path]:
    """Return the reports of the chunks in a folder."""
    found = chunk_reports(folder)
    if not found:
        raise InputError(
            f"{folder} holds no {CHUNKS}/*/{REPORT_FILE}, as upsample --report {folder} --as-chunk "
            "writes it; name the folders of the reports themselves, and with -o where to write"
        )
    return found
