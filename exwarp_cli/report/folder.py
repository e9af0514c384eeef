"""The folder of a report: which files it holds, each written whole or not at all.

Chunks of one run have their reports in folders of their own below it, until they are merged::

    REPORT/chunks/1001-1010/report.json …     named by the key frames
    REPORT/chunks/1011-1020/report.json …
    REPORT/report.json …                      by `exwarp merge-reports REPORT`

run.json holds all that a run found out, without loss, so that reports can be merged. Its fields are
those of `exwarp_cli.domain.results.RunSummary` and the dataclasses in it.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import is_dataclass
from functools import cache
from hashlib import sha256
from itertools import repeat
from pathlib import Path
from types import UnionType
from typing import Any, get_args, get_origin, get_type_hints

from exwarp_cli.domain.results import RunSummary
from exwarp_cli.domain.timeline import ranges
from exwarp_cli.errors import OutputExistsError
from exwarp_cli.io.files import atomic_write_text, make_folder, path_exists, remove_leftovers
from exwarp_cli.pipeline.evaluation import Comparison
from exwarp_cli.report import comparison, schema
from exwarp_cli.report.gallery import Album
from exwarp_cli.report.html import render
from exwarp_cli.report.review import places_worth_a_look
from exwarp_cli.report.upsample_page import upsample_page

REPORT_FILE = "report.json"
FRAMES_FILE = "frames.csv"
PLACES_FILE = "review.csv"
RENDER_FILE = "review.txt"  # frames most worth rendering, as farms take them: 12,15-18; or nothing
PAGE_FILE = "report.html"
# What `exwarp merge-reports` reads: the run without loss, and its pictures.
RUN_FILE = "run.json"
RUN_SCHEMA = "exwarp.run/1"
ALBUM_FILE = "album.json"

CHUNKS = "chunks"

# Characters of a chunk's key frames in the name of its folder.
MAX_NAME = 100


def chunk_folder(report: Path, keys: Sequence[int]) -> Path:
    """Return where the report of a chunk lies in the folder of the whole run's report.

    `keys` are input numbers of the chunk's key frames, at least one: ``chunks/1001-1010``,
    ``chunks/1001``, ``chunks/10-90x4`` or ``chunks/1,5,9-12``. Other key frames have another name.
    Names that would be too long are cut, and end in a checksum.
    """
    name = ranges(keys)
    if len(name) > MAX_NAME:
        name = f"{name[:MAX_NAME]}~{sha256(name.encode()).hexdigest()[:12]}"
    return report / CHUNKS / name


def chunk_reports(report: Path) -> list[Path]:
    """Return the folders of the chunks' reports that are complete."""
    return sorted(path.parent for path in (report / CHUNKS).glob(f"*/{REPORT_FILE}"))


def prepare_report(folder: Path, replace: bool, option: str = "--report") -> None:
    """Make the folder of a report before the work, and refuse to replace one unless asked.

    `option` names the folder on the command line. OutputExistsError: it holds a report and
    `replace` is False. OutputError: it cannot be made.
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

    OutputExistsError: it holds a report of another kind. OutputError: it cannot be made.
    """
    report, head = folder / REPORT_FILE, b""
    with suppress(OSError), report.open("rb") as file:
        head = file.read(200)
    if comparison.SCHEMA.encode() not in head and path_exists(report):
        raise OutputExistsError(
            f"{folder} holds a report that is no comparison's; give another --report"
        )
    make_folder(folder)
    remove_leftovers(folder)


def write_report(folder: Path, run: RunSummary, album: Album) -> None:
    """Write, or replace, all files of the report of a run; `album` has the page's pictures.

    OutputError: the folder cannot be made or a file cannot be written.
    """
    document = schema.run_document(run)
    page = render(upsample_page(run, document, album))
    report = schema.to_json(document)
    render_list = document["review"]["render"] if document["review"] else ""
    texts = {
        FRAMES_FILE: schema.format_frames_csv(run.frames),
        PLACES_FILE: schema.format_review_csv(places_worth_a_look(run)),
        RENDER_FILE: f"{render_list}\n" if render_list else "",
        RUN_FILE: format_run(run, report),
        ALBUM_FILE: schema.to_json(album.to_plain(), compact=True),
        PAGE_FILE: page,
        REPORT_FILE: report,  # last, as it marks a complete report
    }
    make_folder(folder)
    for name, text in texts.items():
        atomic_write_text(folder / name, text)


def write_comparison(
    folder: Path, result: Comparison, album: Album, baseline: Comparison | None = None
) -> None:
    """Write the files of a comparison; as `write_report` does."""
    document = comparison.comparison_document(result, baseline)
    page = render(comparison.compare_page(result, document, album, baseline))
    make_folder(folder)
    atomic_write_text(folder / FRAMES_FILE, comparison.format_comparison_csv(result))
    atomic_write_text(folder / PAGE_FILE, page)
    atomic_write_text(folder / REPORT_FILE, schema.to_json(document))


def format_run(run: RunSummary, report: str) -> str:
    """Write run.json; `report` is the text of the report.json beside it."""
    digest = sha256(report.encode()).hexdigest()
    document = {"schema": RUN_SCHEMA, "report_sha256": digest, "run": run}
    return schema.to_json(document, compact=True, lossless=True)


def parse_run(text: str, report: str) -> RunSummary:
    """Read run.json back.

    One of `schema.UNREADABLE`: it holds something else, or belongs to another report.json.
    """
    document = json.loads(text)
    digest = sha256(report.encode()).hexdigest()
    if document["schema"] != RUN_SCHEMA or document["report_sha256"] != digest:
        raise ValueError("run.json is of another report")
    run: RunSummary = _decode(RunSummary, document["run"])
    return run


_type_hints = cache(get_type_hints)


def _decode(kind: Any, value: Any) -> Any:
    """Return a value of an annotated type from what `to_plain` returned; refuse other types."""
    if kind in (int, str, bool):
        if type(value) is not kind:
            raise TypeError(f"{value!r} is no {kind.__name__}")
        return value
    if kind is float:
        # Integers stay integers, so that tables have the same text again.
        if type(value) in (int, float):
            return value
        return float(value) if isinstance(value, str) else _decode(int, value)
    arguments = get_args(kind)
    if isinstance(kind, UnionType):
        return None if value is None else _decode(arguments[0], value)
    if get_origin(kind) is tuple:
        kinds = repeat(arguments[0], len(value)) if arguments[-1] is Ellipsis else arguments
        return tuple(_decode(*pair) for pair in zip(kinds, value, strict=True))
    if get_origin(kind) is dict:
        return {key: _decode(arguments[1], item) for key, item in value.items()}
    if isinstance(kind, type) and is_dataclass(kind):
        hints = _type_hints(kind)
        return kind(**{name: _decode(hints[name], item) for name, item in value.items()})
    return kind(value)  # an Enum or a Fraction
