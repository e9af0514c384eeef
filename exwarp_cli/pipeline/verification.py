"""Checksums of the files that a run wrote, and the check that the disk holds them."""

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
    from exwarp_cli.pipeline.output_plan import OutputPlan

FRAME, HOLES, VIDEO = "frame", "holes", "video"  # kinds of written files

Sums = dict[tuple[str, int], str]  # SHA-256 of written files, by kind and number of the frame


def sum_of(pieces: Iterable[Buffer]) -> str:
    """Return the SHA-256 of a file in pieces, hexadecimal."""
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
    """List the files of a run with their checksums; those without a known one are read.

    Raises
    ------
    OutputError
        When a file cannot be read.
    """
    files = []
    for kind, number, path, _ in _list_files(targets, frames):
        digest = None if number is None else sums.get((kind, number))
        try:
            files.append(WrittenFile(kind, number, path.name, digest or sum_in(path)))
        except OSError as error:
            raise output_error(path, error) from error
    return tuple(files)


def verify(
    targets: OutputPlan,
    frames: Iterable[FrameRecord],
    files: Iterable[WrittenFile],
    view: str,
    shown: int,
) -> int:
    """Read all files of a run again, compare them with what was written, and return how many.

    Parameters
    ----------
    files
        As `files_of` returned them.
    view
        Of frames of an earlier run, which is decoded; "" for the hero, and without views.
    shown
        How many frames a video has.

    Raises
    ------
    OutputError
        When some differ; these are removed.
    """
    sums = {(file.kind, file.frame): file.sha256 for file in files}
    checks = [
        _Check(kind, number, path, sums[kind, number], is_sealed, view, shown)
        for kind, number, path, is_sealed in _list_files(targets, frames)
    ]
    _require_sound(checks)
    return len(checks)


def verify_video(path: Path, shown: int) -> None:
    """Read a video of `shown` frames again that was written with frames. Raises OutputError."""
    try:
        digest = sum_in(path)
    except OSError as error:
        raise output_error(path, error) from error
    _require_sound([_Check(VIDEO, None, path, digest, False, "", shown)])


@dataclass(frozen=True)
class _Check:
    """A file, and what it must be.

    `is_sealed` is True for a frame of an earlier run, which has its own checksum.
    """

    kind: str
    number: int | None
    path: Path
    sha256: str
    is_sealed: bool
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
            if self.is_sealed:
                read_picture(self.path, self.view)
                return read_fingerprint(self.path) is not None
        except (OSError, InputError):
            return False
        return True


def drop_cached(path: Path) -> None:
    """Have the system drop its copy of a file in memory, if it can."""
    if not hasattr(os, "posix_fadvise"):
        return
    handle = os.open(path, os.O_RDONLY)
    try:
        os.posix_fadvise(handle, 0, 0, os.POSIX_FADV_DONTNEED)
    finally:
        os.close(handle)


def _require_sound(checks: list[_Check]) -> None:
    with ThreadPoolExecutor(cores.count(), "exwarp-verify") as pool:
        sound = list(pool.map(_Check.is_sound, checks))
    bad = [check for check, is_sound in zip(checks, sound, strict=True) if not is_sound]
    if not bad:
        return
    for check in bad:
        with suppress(OSError):
            check.path.unlink()
    names = []
    for kind, word in ((FRAME, "frame"), (HOLES, "hole mask")):
        numbers = [c.number for c in bad if c.kind == kind and c.number is not None]
        if numbers:
            names.append(f"{word}{'s' if len(numbers) > 1 else ''} {ranges(numbers)}")
    names += [f"the video {check.path.name}" for check in bad if check.kind == VIDEO]
    raise OutputError(
        f"{' and '.join(names)} in {bad[0].path.parent} {'is' if len(bad) == 1 else 'are'} not on "
        "the disk as written, and removed; check the disk or the network share, and run again with "
        "--skip-existing"
    )


def _list_files(
    targets: OutputPlan, frames: Iterable[FrameRecord]
) -> Iterator[tuple[str, int | None, Path, bool]]:
    """Yield kind, frame number and path of a run's files, and whether they have their own checksum.

    A video with frames is not among them: it can be made from the frames at any time.
    """
    for frame in frames:
        is_copy = frame.kind in (FrameKind.KEY, FrameKind.RENDERED)  # maybe byte for byte
        if targets.frames is not None:
            is_sealed = frame.resumed and not is_copy
            yield FRAME, frame.number, targets.frames.path(frame.number), is_sealed
        if targets.holes is not None and frame.hole_fraction is not None:
            yield HOLES, frame.number, targets.holes.path(frame.number), False
    if targets.frames is None and targets.video is not None:
        yield VIDEO, None, targets.video, False
