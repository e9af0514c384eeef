"""The files of a shot: its sequences, and what stands in the headers of one of their frames."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from exwarp_cli.errors import InputError, LayoutError
from exwarp_cli.io.channels import Role, detect
from exwarp_cli.io.cryptomatte import Headers
from exwarp_cli.io.exr.header import Part
from exwarp_cli.io.exr.reader import FileHeader, HeaderCache, deep_image_error
from exwarp_cli.io.pass_sets import pass_role
from exwarp_cli.io.producers import direction_named
from exwarp_cli.io.sequence import AovSet, Sequence, find_aov_set, find_sequence
from exwarp_cli.io.views import channels_of, views_of


@dataclass(frozen=True)
class Looks:
    """What one frame's files hold.

    Attributes
    ----------
    leader, aovs
        The sequences, as in `ShotFiles`.
    number
        Of the frame.
    headers
        By AOV, the leader's first.
    cache
        Where they are kept.
    """

    leader: Sequence
    aovs: Mapping[str, Sequence]
    number: int
    headers: Mapping[str, FileHeader]
    cache: HeaderCache

    @property
    def parts(self) -> dict[str, tuple[Part, ...]]:
        """The parts of each file by AOV."""
        return {aov: header.parts for aov, header in self.headers.items()}

    @property
    def texts(self) -> Headers:
        """The attributes of each file that are text, by AOV."""
        return {aov: header.texts for aov, header in self.headers.items()}


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
            cache = HeaderCache()
            headers = {aov: look(member.files[number], cache) for aov, member in members.items()}
            self._last = Looks(self.leader, self.aovs, number, headers, cache)
        return self._last


def find_files(spec: str, gaps: bool, decided: Collection[Role] = ()) -> ShotFiles:
    """Find the sequences that a name without view stands for.

    Parameters
    ----------
    spec
        The name.
    gaps
        Whether frames that are missing in between are listed, too.
    decided
        Roles whose channels the user names.

    Raises
    ------
    LayoutError
        When two passes are of one role, and nothing tells which one is meant.
    """
    aov_set = find_aov_set(spec, gaps=gaps, needed=lambda found: _needed(found, decided))
    if aov_set is None:
        return ShotFiles(find_sequence(spec, gaps=gaps), {})
    return ShotFiles(aov_set.leader, aov_set.aovs)


def _needed(found: AovSet, decided: Collection[Role]) -> list[str]:
    """Return the AOVs of a set that its colour's own files do not hold."""
    own = set() if found.colour is None else _own_roles(found.colour)
    roles = {name: pass_role(name) for name in found.aovs}
    names = [
        name
        for name, role in roles.items()
        # Files that hold vectors are a render by themselves.
        if role not in own and not (role is None and Role.MOTION in own)
    ]
    for wanted in (Role.MOTION, Role.DEPTH):
        rivals = [name for name in names if roles[name] is wanted and wanted not in decided]
        directions = {direction_named(name) for name in rivals}
        if len(rivals) > 1 and directions != {"forward", "backward"}:
            listed = " and ".join(found.aovs[name].pattern for name in rivals)
            raise LayoutError(
                f"{listed} both go by a name of {wanted.value}; say which one holds it with "
                f"--aov {wanted.value}={found.aovs[rivals[0]].pattern}"
            )
    return names


def _own_roles(colour: Sequence) -> set[Role]:
    """Return the roles that the colour's files hold, by the first one that can be read."""
    for path in colour.files.values():
        try:
            parts = look(path, HeaderCache()).parts
        except InputError:  # reported when that frame is read
            continue
        views = views_of(parts)
        channels = channels_of(parts, views[0] if views else "")
        named = (replace(channel, name=name) for name, channel in channels.items())
        return set(detect({"": tuple(named)}).roles)
    return set()


def look(path: Path, headers: HeaderCache) -> FileHeader:
    """Return the header of a file of which one part at least is flat."""
    header = headers.read(path)
    if all(part.deep for part in header.parts):
        raise deep_image_error(path)
    return header
