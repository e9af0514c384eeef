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
from exwarp_cli.report.newest import Asked, newest
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
    superseded
        Folders of chunks' reports of which newer ones tell some key frames or all.
    """

    run: RunSummary
    reports: int
    missing: str | None
    unseen: tuple[Path, ...]
    superseded: tuple[Path, ...] = ()

    @property
    def document(self) -> dict[str, Any]:
        """What report.json holds, and as ``merged`` facts about the merging."""
        merged = {
            "reports": self.reports,
            "missing": self.missing,
            "without_pictures": [str(folder) for folder in self.unseen],
            "superseded": [str(folder) for folder in self.superseded],
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
        those in its ``chunks``, of which the newest tell; see `newest`.
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
    asked, superseded, target = _resolved(folders, output)
    runs = [one.read() for one in asked]
    run = join(runs, [str(one.folder) for one in asked])
    prepare_report(target, replace, "-o")
    shown = [{frame.number for frame in one.frames} for one in runs]
    pages = PageAlbums.of([one.folder / PAGE_FILE for one in asked], shown)
    write_report(target, run, pages.album(run))
    unseen = tuple(page.parent for page in pages.unreadable)
    missing = ranges(missing_keys(run)) or None
    return Merged(run, len(asked), missing, unseen, tuple(superseded))


def _resolved(folders: Sequence[Path], output: Path | None) -> tuple[list[Asked], list[Path], Path]:
    """Return the reports that are joined, each once, those left aside, and where to write."""
    if output is None:
        if len(folders) > 1:
            raise UsageError("several reports are named; say with -o where the joined one goes")
        return *newest(_chunks_in(folders[0])), folders[0]
    each = [_reports_in(folder) for folder in folders]
    by_path = {one.folder.resolve(): one for asked, _ in each for one in asked}
    superseded = {folder.resolve(): folder for _, older in each for folder in older}
    if output.resolve() in by_path:
        raise UsageError(f"-o {output} is one of the reports that are joined; name another folder")
    return list(by_path.values()), list(superseded.values()), output


def _reports_in(folder: Path) -> tuple[list[Asked], list[Path]]:
    """Return the reports that a folder stands for: its own, else those of chunks in it."""
    if (folder / REPORT_FILE).exists():
        return [Asked(folder)], []
    found = chunk_reports(folder)
    if not found:
        raise InputError(
            f"{folder} holds no {REPORT_FILE}; name folders that upsample --report wrote"
        )
    return newest(found)


def _chunks_in(folder: Path) -> list[Path]:
    """Return the reports of the chunks in a folder."""
    found = chunk_reports(folder)
    if not found:
        raise InputError(
            f"{folder} holds no {CHUNKS}/*/{REPORT_FILE}, as upsample --report {folder} --as-chunk "
            "writes it; name the folders of the reports themselves, and with -o where to write"
        )
    return found
