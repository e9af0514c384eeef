"""Reports of chunks that tell of the same key frames: of each key frame the newest tells.

Jobs that are submitted again with chunks of another size, and engines that change the size on the
way, leave such reports. None is deleted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path

from exwarp_cli.domain.joining import part_of
from exwarp_cli.domain.results import RunSummary
from exwarp_cli.errors import InputError
from exwarp_cli.report.folder import REPORT_FILE
from exwarp_cli.report.reading import read_report, reported_keys


@dataclass(frozen=True)
class Asked:
    """A report that is joined with others.

    Attributes
    ----------
    folder
        Where it lies.
    keys
        Input numbers of the key frames that it is asked for; None for all.
    """

    folder: Path
    keys: frozenset[int] | None = None

    def read(self) -> RunSummary:
        """Read what it tells of these; see `read_report`."""
        run = read_report(self.folder)
        return run if self.keys is None else part_of(run, self.keys)


def newest(folders: Sequence[Path]) -> tuple[list[Asked], list[Path]]:
    """Deal key frames to the reports of chunks: each to the newest that tells of it.

    Reports of the very same moment are all asked, so that the code that joins them sees which key
    frames are in two of them.

    Parameters
    ----------
    folders
        Of the reports, each once.

    Returns
    -------
    asked : list of Asked
        Those that are the newest for a key frame at least, in the order of `folders`.
    superseded : list of Path
        Those of which newer ones tell some key frames or all, in the same order.

    Raises
    ------
    InputError
        When a report cannot be read.
    """
    reported: frozenset[int] = frozenset()
    keys: dict[Path, frozenset[int]] = {}
    left: dict[Path, frozenset[int]] = {}
    for _, moment in groupby(sorted(folders, key=_written, reverse=True), key=_written):
        for folder in (together := list(moment)):
            keys[folder] = reported_keys(folder)
            left[folder] = keys[folder] - reported
        reported = reported.union(*(keys[folder] for folder in together))
    asked = [
        Asked(folder, None if left[folder] == keys[folder] else left[folder])
        for folder in folders
        if left[folder] or not keys[folder]
    ]
    return asked, [folder for folder in folders if left[folder] != keys[folder]]


def _written(folder: Path) -> int:
    """Return when a report was finished, in nanoseconds."""
    path = folder / REPORT_FILE
    try:
        return path.stat().st_mtime_ns
    except OSError as error:
        raise InputError(
            f"cannot read {path}: {error.strerror or error}; do its key frames again with "
            "--report, or leave it out"
        ) from error
