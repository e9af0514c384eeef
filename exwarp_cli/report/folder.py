"""The folder of a report: which files it holds, each written whole or not at all.

Chunks of one run have their reports in folders of their own below it, until they are merged::

    REPORT/chunks/1001-1010/report.json …     named by the key frames
    REPORT/chunks/1011-1020/report.json …
    REPORT/report.json …                      by `exwarp merge-reports REPORT`
"""

from __future__ import annotations

from collections.abc import Sequence
from hashlib import sha256
from pathlib import Path

from exwarp_cli.domain.results import RunSummary
from exwarp_cli.domain.timeline import ranges
from exwarp_cli.errors import OutputExistsError
from exwarp_cli.io.files import atomic_write_text, make_folder, path_exists, remove_leftovers
from exwarp_cli.pipeline.evaluate import Comparison
from exwarp_cli.report.compare_page import compare_page
from exwarp_cli.report.comparison import SCHEMA, comparison, comparison_csv
from exwarp_cli.report.frames_csv import frames_csv
from exwarp_cli.report.gallery import Album
from exwarp_cli.report.page import Page, render
from exwarp_cli.report.review import worth_a_look
from exwarp_cli.report.review_lists import review_csv, review_txt
from exwarp_cli.report.summary import report, to_json
from exwarp_cli.report.upsample_page import upsample_page

REPORT_FILE = "report.json"
FRAMES_FILE = "frames.csv"
PLACES_FILE = "review.csv"
RENDER_FILE = "review.txt"
PAGE_FILE = "report.html"
CHUNKS = "chunks"

LONGEST_NAME = 100
"""Characters of a chunk's key frames in the name of its folder."""


def chunk_folder(report: Path, keys: Sequence[int]) -> Path:
    """Return where the report of a chunk lies.

    Chunks of other key frames have another name, so that none gets in another's way.

    Parameters
    ----------
    report
        The folder of the whole run's report.
    keys
        Input numbers of the chunk's key frames, at least one.

    Returns
    -------
    Path
        ``chunks/1001-1010`` in it, ``chunks/1001`` for a single key frame, ``chunks/10-90x4`` or
        ``chunks/1,5,9-12`` for others. Names that would be too long are cut, and end in a checksum.
    """
    name = ranges(keys)
    if len(name) > LONGEST_NAME:
        name = f"{name[:LONGEST_NAME]}~{sha256(name.encode()).hexdigest()[:12]}"
    return report / CHUNKS / name


def chunk_reports(report: Path) -> list[Path]:
    """Return the folders of the chunks' reports that are there, whole ones alone."""
    return sorted(path.parent for path in (report / CHUNKS).glob(f"*/{REPORT_FILE}"))


def prepare_report(folder: Path, replace: bool, option: str = "--report") -> None:
    """Make the folder before the work, and refuse to replace a report unless asked.

    Parameters
    ----------
    folder
        Of the report, or of a chunk's: see `chunk_folder`.
    replace
        Whether a report that is there may go.
    option
        What names the folder on the command line.

    Raises
    ------
    OutputExistsError
        When a report is there and `replace` is False.
    OutputError
        When the folder cannot be made.
    """
    refuse_report(folder, replace, option)
    make_folder(folder)
    remove_leftovers(folder)


def refuse_report(folder: Path, replace: bool, option: str = "--report") -> None:
    """Refuse to replace a report unless asked, and touch nothing; see `prepare_report`."""
    if path_exists(folder / REPORT_FILE) and not replace:
        raise OutputExistsError(
            f"{folder} holds a report already; give --overwrite to replace it, or another {option}"
        )


def prepare_comparison(folder: Path) -> None:
    """Make the folder before the work; a comparison replaces the one before it and nothing else.

    Raises
    ------
    OutputExistsError
        When a report of another kind is there.
    OutputError
        When the folder cannot be made.
    """
    if path_exists(folder / REPORT_FILE) and not _is_comparison(folder / REPORT_FILE):
        raise OutputExistsError(
            f"{folder} holds a report that is no comparison's; give another --report"
        )
    make_folder(folder)
    remove_leftovers(folder)


def _is_comparison(report: Path) -> bool:
    """Whether a report says at its beginning that it is one; what cannot be read does not."""
    try:
        with report.open("rb") as file:
            return SCHEMA.encode() in file.read(200)
    except OSError:
        return False


def write_report(folder: Path, run: RunSummary, album: Album | None = None) -> None:
    """Write report.json, frames.csv, the lists of a review and report.html of an upsampling run.

    Parameters
    ----------
    folder
        Made, with its parents, if it does not exist. Files of these names in it are replaced.
    run
        What was done.
    album
        Frames that the page shows; None for a page without pictures.

    Raises
    ------
    OutputError
        When the folder cannot be made or a file cannot be written.
    """
    document = report(run)
    page = upsample_page(run, document, album)
    tables = {
        FRAMES_FILE: frames_csv(run.frames),
        PLACES_FILE: review_csv(worth_a_look(run)),
        RENDER_FILE: review_txt(run.frames),
    }
    write_files(folder, to_json(document), tables, page)


def write_comparison(folder: Path, result: Comparison, album: Album | None = None) -> None:
    """Write the same of a comparison; as `write_report` does."""
    document = comparison(result)
    page = compare_page(result, document, album)
    write_files(folder, to_json(document), {FRAMES_FILE: comparison_csv(result)}, page)


def write_files(folder: Path, document: str, tables: dict[str, str], page: Page) -> None:
    """Write a report's files: `tables` by name, then the page, then `document` as report.json."""
    html = render(page)
    make_folder(folder)
    # The document last: who sees a report.json then finds what belongs to it.
    for name, text in tables.items():
        atomic_write_text(folder / name, text)
    atomic_write_text(folder / PAGE_FILE, html)
    atomic_write_text(folder / REPORT_FILE, document)
