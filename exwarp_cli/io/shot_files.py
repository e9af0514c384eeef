"""The files of a shot: its sequences, and what stands in the headers of one of their frames."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from exwarp_cli.io.cryptomatte import Headers
from exwarp_cli.io.exr import ExrReader, Part, deep_only
from exwarp_cli.io.sequence import Sequence, find_aov_set, find_sequence


@dataclass(frozen=True)
class Looks:
    """What one frame's files hold.

    Attributes
    ----------
    leader, aovs
        The sequences, as in `ShotFiles`.
    number
        Of the frame.
    parts, headers
        By AOV, the leader's first.
    """

    leader: Sequence
    aovs: Mapping[str, Sequence]
    number: int
    parts: Mapping[str, tuple[Part, ...]]
    headers: Headers


@dataclass
class ShotFiles:
    """The sequences of a shot, and what was seen last in one of their frames.

    Attributes
    ----------
    leader
        The sequence that stands for all.
    aovs
        The others, by AOV. Without colour one of them leads; it keeps its AOV's name.
    """

    leader: Sequence
    aovs: Mapping[str, Sequence]
    _last: Looks | None = None

    def by(self, number: int) -> Looks:
        """Look into a frame."""
        if self._last is None or self._last.number != number:
            members = {} if self.leader in self.aovs.values() else {"": self.leader}
            members |= self.aovs
            looks = {aov: look(member.files[number]) for aov, member in members.items()}
            parts = {aov: look[0] for aov, look in looks.items()}
            headers = {aov: look[1] for aov, look in looks.items()}
            self._last = Looks(self.leader, self.aovs, number, parts, headers)
        return self._last


def find_files(spec: str, gaps: bool) -> ShotFiles:
    """Find the sequences that a name without view stands for.

    With `gaps` frames that are missing in between are listed, too.
    """
    aov_set = find_aov_set(spec, gaps=gaps)
    if aov_set is None:
        return ShotFiles(find_sequence(spec, gaps=gaps), {})
    return ShotFiles(aov_set.leader, aov_set.aovs)


def look(path: Path) -> tuple[tuple[Part, ...], list[dict[str, object]]]:
    """Return the parts of a file of which one at least is flat, and their attributes."""
    with ExrReader(path) as file:
        parts, headers = file.parts, file.headers
    if all(part.deep for part in parts):
        raise deep_only(path)
    return parts, headers
