"""Checksums of the files that a run wrote, and whether they are on the disk as they were made."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from exwarp_cli.domain.results import FrameKind, FrameRecord, WrittenFile
from exwarp_cli.domain.timeline import ranges
from exwarp_cli.errors import InputError, OutputError
from exwarp_cli.io.exr.writer import Buffer
from exwarp_cli.io.files import output_error
from exwarp_cli.io.generated_frames import read_fingerprint, read_picture
from exwarp_cli.io.video_reader import open_clip
from exwarp_cli.runtime import cores
from exwarp_cli.runtime.stop import check_stop

if TYPE_CHECKING:
    from exwarp_cli.pipeline.frame_writer import OutputPlan

FRAME, HOLES, VIDEO = "frame", "holes", "video"
"""Kinds of written files."""

Sums = dict[tuple[str, int], str]
"""SHA-256 of files as they were made, by kind and number of the frame."""


def sum_of(pieces: Iterable[Buffer]) -> str:
    """Return the SHA-256 of a file that is given piece by piece, hexadecimal."""
    digest = hashlib.sha256()
    for piece in pieces:
        digest.update(piece)
    return digest.hexdigest()


def sum_in(path: Path) -> str:
    """Return the SHA-256 of a file, hexadecimal; raises OSError."""
    check_stop()
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def files_of(
    targets: OutputPlan, frames: Iterable[FrameRecord], sums: Sums
) -> tuple[WrittenFile, ...]:
    """List the files of a run with their checksums.

    Parameters
    ----------
    targets
        Where they are.
    frames
        What was written, or kept of an earlier run.
    sums
        What is known of them; others are read for it.

    Raises
    ------
    OutputError
        When one cannot be read.
    """
    return tuple(
        WrittenFile(kind, number, path.name, _sum(sums, kind, number, path))
        for kind, number, path, _ in _listed(targets, frames)
    )


def verify(
    targets: OutputPlan,
    frames: Iterable[FrameRecord],
    files: Iterable[WrittenFile],
    view: str,
    shown: int,
) -> int:
    """Read all files of a run again, compare them with what was made, and return how many.

    Parameters
    ----------
    targets, frames
        As for `files_of`.
    files
        What it returned.
    view
        Of frames of an earlier run, which is decoded; "" for the hero, and without views.
    shown
        How many frames a video has.

    Raises
    ------
    OutputError
        When some are not as they were made; these are removed.
    """
    known = {(file.kind, file.frame): file.sha256 for file in files}
    checks = [
        _Check(kind, number, path, known[kind, number], kept, view, shown)
        for kind, number, path, kept in _listed(targets, frames)
    ]
    _require_sound(checks)
    return len(checks)


def verify_video(path: Path, shown: int) -> None:
    """Read a video again that goes with frames; it has `shown` of them. Raises OutputError."""
    try:
        whole = sum_in(path)
    except OSError as error:
        raise output_error(path, error) from error
    _require_sound([_Check(VIDEO, None, path, whole, False, "", shown)])


def _require_sound(checks: list[_Check]) -> None:
    with ThreadPoolExecutor(cores.count(), "exwarp-verify") as pool:
        sound = list(pool.map(_Check.is_sound, checks))
    bad = [check for check, is_sound in zip(checks, sound, strict=True) if not is_sound]
    if not bad:
        return
    for check in bad:
        with suppress(OSError):
            check.path.unlink()
    names = " and ".join(filter(None, (_named(bad, kind) for kind in (FRAME, HOLES, VIDEO))))
    raise OutputError(
        f"{names} in {bad[0].path.parent} {'is' if len(bad) == 1 else 'are'} not on the disk as "
        "written, and removed; check the disk or the network share, and run again with "
        "--skip-existing"
    )


@dataclass(frozen=True)
class _Check:
    """A file that is to be as it was made; `kept` of an earlier run, which tells by its own seal.

    `shown` is how many frames a video has.
    """

    kind: str
    number: int | None
    path: Path
    sha256: str
    kept: bool
    view: str
    shown: int

    def is_sound(self) -> bool:
        """Read the file from the disk, and compare it."""
        try:
            drop_cached(self.path)
            if sum_in(self.path) != self.sha256:
                return False
            if self.kind == VIDEO:
                return open_clip(self.path).count == self.shown
            if self.kept:
                read_picture(self.path, self.view)
                return read_fingerprint(self.path) is not None
        except (OSError, InputError):
            return False
        return True


def drop_cached(path: Path) -> None:
    """Ask the system to forget what it holds of a file in memory, where it can."""
    if not hasattr(os, "posix_fadvise"):
        return
    handle = os.open(path, os.O_RDONLY)
    try:
        os.posix_fadvise(handle, 0, 0, os.POSIX_FADV_DONTNEED)
    finally:
        os.close(handle)


Listed = tuple[str, int | None, Path, bool]
"""Kind, number of the frame, path, and whether its own seal tells, as it is of an earlier run."""


def _listed(targets: OutputPlan, frames: Iterable[FrameRecord]) -> Iterator[Listed]:
    """Yield the files of a run; a video beside frames can be made of them at any time."""
    for frame in frames:
        copied = frame.kind in (FrameKind.KEY, FrameKind.RENDERED)  # maybe byte for byte
        sealed = frame.resumed and not copied
        if targets.frames is not None:
            yield FRAME, frame.number, targets.frames.path(frame.number), sealed
        if targets.holes is not None and frame.hole_fraction is not None:
            yield HOLES, frame.number, targets.holes.path(frame.number), False
    if targets.frames is None and targets.video is not None:
        yield VIDEO, None, targets.video, False


def _sum(sums: Sums, kind: str, number: int | None, path: Path) -> str:
    if number is not None and (kind, number) in sums:
        return sums[kind, number]
    try:
        return sum_in(path)
    except OSError as error:
        raise output_error(path, error) from error


def _named(bad: Iterable[_Check], kind: str) -> str:
    """Name the bad files of a kind; "" where there are none."""
    mine = [check for check in bad if check.kind == kind]
    if kind == VIDEO:
        return f"the video {mine[0].path.name}" if mine else ""
    numbers = [check.number for check in mine if check.number is not None]
    what = {FRAME: "frame", HOLES: "hole mask"}[kind]
    return f"{what}{'s' if len(numbers) > 1 else ''} {ranges(numbers)}" if numbers else ""
