"""Which files in the way of a resumed run are its own, so that it may replace them.

Own are: frames that ExWarp wrote by the run's method, whole or damaged, whatever has changed since;
and copies of key frames, of the source as it is, or as it was when the frames around it were made.
Everything else may be a person's work, and is never replaced without --overwrite.
"""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

from exwarp_cli.domain import cores
from exwarp_cli.domain.results import FrameKind
from exwarp_cli.domain.timeline import Slot
from exwarp_cli.domain.wording import pluralise
from exwarp_cli.errors import OutputExistsError
from exwarp_cli.io.atomic import is_there
from exwarp_cli.io.key_file import written_forms
from exwarp_cli.io.output import (
    KEY_FRAMES,
    REQUESTED_METHOD,
    Authorship,
    State,
    authorship_of,
    file_digest,
)
from exwarp_cli.io.sequence import Sequence
from exwarp_cli.io.video import video_note
from exwarp_cli.pipeline.frame_writer import OutputPlan, key_is_there
from exwarp_cli.pipeline.source import Source
from exwarp_cli.pipeline.without_vectors import BY_EXWARP
from exwarp_cli.synthesis.methods import Method

NAMED = 4
"""Files that a refusal names, at most."""

FALLBACKS = ("s6", "hold")
"""Methods of the frames after the last key frame, where the run's method needs a next one."""

SLACK_S = 60.0
"""Seconds by which a key frame may be newer than the frames around it, as files are written side by
side. It counts only where none of these names the key frame, see `_Examination._is_as_old`."""

READERS = 4
"""Files that are read side by side, at most: each is in memory whole."""

HEADER_GROWTH = 4096
"""Bytes by which a frame rate in the headers of all parts may change a key frame's size."""

Reason = str
"""Why a file is not the run's own, in words that stand in parentheses after its name."""


def require_own(
    targets: OutputPlan,
    source: Source,
    method: Method,
    slots: list[Slot],
    rendered: Sequence | None = None,
) -> None:
    """Refuse to replace what the run's earlier parts did not write.

    Parameters
    ----------
    targets
        The files that the run writes.
    source
        Its input.
    method
        Makes its frames.
    slots
        The output instants that it writes. No other frame is looked at, but for those next to a key
        frame that was rendered again.
    rendered
        Frames that were rendered after all, by output number; None without.

    Raises
    ------
    OutputExistsError
        When files are in the way that are not the run's own.
    UnreadableError
        When the system does not let one of them through.
    """
    examination = _Examination(targets, source, method, rendered)
    with ThreadPoolExecutor(min(cores.count(), READERS), "exwarp-own") as pool:
        found = list(pool.map(examination.others, slots))
    others = [other for some in found for other in some]
    if targets.video is not None and _is_foreign_video(targets.video):
        others.append((targets.video, "not written by ExWarp"))
    if not others:
        return
    listed = ", ".join(f"{path.name} ({reason})" for path, reason in others[:NAMED])
    more = f" and {len(others) - NAMED} more" if len(others) > NAMED else ""
    raise OutputExistsError(
        f"{others[0][0].parent} has {pluralise(len(others), 'file')} that this run did not write: "
        f"{listed}{more}; move what you want to keep, or give --overwrite to replace it"
    )


@dataclass(frozen=True)
class _Examination:
    """Looks at the files in the way of one run."""

    targets: OutputPlan
    source: Source
    method: Method
    rendered: Sequence | None = None
    _known: dict[Path, Authorship | None] = field(default_factory=dict)

    def others(self, slot: Slot) -> list[tuple[Path, Reason]]:
        """Return the files of a slot that are not the run's own, each with the reason."""
        number = self.source.timeline.number(slot)
        found: list[tuple[Path, Reason | None]] = []
        if self.targets.frames is not None:
            path = self.targets.frames.path(number)
            found.append((path, self._frame(path, slot)))
        if self.targets.holes is not None and slot.index:
            path = self.targets.holes.path(number)
            authorship = self._authorship(path)
            found.append((path, None if authorship is None else self._reason(authorship)))
        return [(path, reason) for path, reason in found if reason is not None]

    def _frame(self, path: Path, slot: Slot) -> Reason | None:
        """Return why a frame is not the run's own; None if it is, or there is none."""
        copied_from = self._rendered_file(slot)
        if copied_from is not None and _is_copy(path, copied_from):
            return None
        authorship = self._authorship(path)
        if authorship is None:
            return None
        reason = self._reason(authorship)
        if reason is None:
            return None
        try:
            copied = self._is_of_the_source(path) or (not slot.index and self._was_key(path, slot))
        except FileNotFoundError:  # another chunk has just replaced it
            return None
        return None if copied else reason

    def _authorship(self, path: Path) -> Authorship | None:
        if path not in self._known:
            self._known[path] = authorship_of(path)
        return self._known[path]

    def _reason(self, authorship: Authorship) -> Reason | None:
        """Return why a file is not the run's own, by what it says of itself; None if it is."""
        if authorship.state is State.FOREIGN:
            return "not written by ExWarp"
        if authorship.state is State.EDITED:
            return "changed since ExWarp wrote it"
        by = _other_method(authorship, self.method)
        return None if by is None else f"made by {by} and not by {self.method.name}"

    def _rendered_file(self, slot: Slot) -> Path | None:
        """Return the file that a slot's frame is a copy of, if it is one."""
        if not slot.index:
            return self._key_file(slot.key)
        files = {} if self.rendered is None else self.rendered.files
        return files.get(self.source.timeline.number(slot))

    def _key_file(self, key: int) -> Path:
        return self.source.keys.sequence.files[self.source.timeline.numbers[key]]

    def _is_of_the_source(self, path: Path) -> bool:
        """Whether a file is a copy of any key frame as it is now."""
        size = path.stat().st_size
        near = (
            key for key, length in self._key_sizes.items() if abs(size - length) <= HEADER_GROWTH
        )
        return any(_is_copy(path, key) for key in near)

    @cached_property
    def _key_sizes(self) -> dict[Path, int]:
        sizes: dict[Path, int] = {}
        for path in dict.fromkeys(self.source.keys.sequence.files.values()):
            try:
                sizes[path] = path.stat().st_size
            except OSError:  # missing, as --keep-going has it
                continue
        return sizes

    def _was_key(self, path: Path, slot: Slot) -> bool:
        """Whether a file is the key frame as it was when the frames around it were made.

        Or the beginning of what the key frame is now.
        """
        source = self._key_file(slot.key)
        if source.suffix.lower() != path.suffix.lower():
            return False  # key frames are decoded there, and carry a checksum
        if _begins(path, source):
            return True
        number = self.source.timeline.numbers[slot.key]
        around = list(self._made_around(slot.key))
        named = [_key_frames(authorship) for _, authorship in around]
        digest = file_digest(path)
        if any(digest in keys.values() for keys in named):
            return True
        if any(number in keys for keys in named):
            return False
        return self._is_as_old(path, [other for other, _ in around])

    def _is_as_old(self, path: Path, around: list[Path]) -> bool:
        """Whether a key frame that no header names is as old as the frames around it.

        Earlier builds name none. Without a tail no frame is made of the last key frame, unless the
        method looks ahead.
        """
        times = [other.stat().st_mtime for other in around]
        return bool(times) and path.stat().st_mtime <= max(times) + SLACK_S

    def _made_around(self, key: int) -> Iterator[tuple[Path, Authorship]]:
        """Yield the generated frames before and after a key frame that are as they were written."""
        timeline, frames = self.source.timeline, self.targets.frames
        assert frames is not None
        for index in (key, key - 1):
            for slot in timeline.made_of(index) if index >= 0 else ():
                path = frames.path(timeline.number(slot))
                authorship = self._authorship(path)
                if authorship is not None and authorship.state is State.INTACT:
                    yield path, authorship


def _is_foreign_video(path: Path) -> bool:
    """Whether something is where a video goes that does not name ExWarp in its comment."""
    if not is_there(path) or not path.stat().st_size:
        return False
    return not (video_note(path) or "").startswith(BY_EXWARP)


def _other_method(authorship: Authorship, method: Method) -> str | None:
    """Return the method that made a frame, if it is another than the run's.

    Frames of earlier builds name only their own method; after the last key frame it may be a
    fallback of the run's.
    """
    facts = authorship.facts
    if facts.get("kind") in (FrameKind.KEY.value, FrameKind.RENDERED.value):
        return None
    requested = facts.get(REQUESTED_METHOD)
    if requested is not None:
        return None if requested == method.name else str(requested)
    own = facts.get("method")
    fell_back = method.lookahead and own in FALLBACKS
    return None if own in (None, method.name) or fell_back else str(own)


def _key_frames(authorship: Authorship) -> dict[int, str]:
    """Read the digests of key frames by number that a generated frame names."""
    words = str(authorship.facts.get(KEY_FRAMES, "")).split(",")
    pairs = (word.partition(":") for word in words)
    return {int(number): digest for number, _, digest in pairs if number.lstrip("-").isdecimal()}


def _is_copy(path: Path, source: Path) -> bool:
    """Whether a file holds a key frame, as it is or with another frame rate in its header."""
    return any(key_is_there(path, form) for form in written_forms(source, path))


def _begins(path: Path, source: Path) -> bool:
    """Whether a file is a copy of another that was broken off, with or without zeros at its end."""
    try:
        copied = path.read_bytes().rstrip(b"\0")
    except OSError:
        return False
    return any(form.begins_with(copied) for form in written_forms(source, path))
