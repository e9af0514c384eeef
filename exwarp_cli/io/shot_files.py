"""The files of a shot: its sequences, the headers of a frame, and what is damaged in them."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

import numpy as np

from exwarp_cli.domain.frame import Bool, is_surely_finite, nonfinite_pixels
from exwarp_cli.errors import InputError, LayoutError
from exwarp_cli.io.channels import Role, detect_layout
from exwarp_cli.io.cryptomatte import Headers
from exwarp_cli.io.exr.header import Channel, Part
from exwarp_cli.io.exr.reader import ExrFile, FileHeader, HeaderCache, deep_image_error
from exwarp_cli.io.frame_names import pass_role
from exwarp_cli.io.producers import vector_direction
from exwarp_cli.io.sequences import AovSet, Sequence, find_aov_set, find_sequence
from exwarp_cli.io.views import list_views, view_channels

T = TypeVar("T")

# Channels that are decoded together: a part may have dozens, of 33 MB each at 3840x2160.
CHANNEL_BATCH = 8


@dataclass(frozen=True)
class FrameHeaders:
    """What is in the headers of one frame's files by AOV, the leader's first, and their cache."""

    number: int
    parts: Mapping[str, tuple[Part, ...]]
    texts: Headers  # the attributes that are text
    cache: HeaderCache


@dataclass
class ShotFiles:
    """The sequences of a shot: the leader, which stands for all, and the others by AOV.

    Without colour the leader is one of `aovs`, and keeps its AOV's name.
    """

    leader: Sequence
    aovs: Mapping[str, Sequence]
    _last: FrameHeaders | None = None

    def read_headers(self, number: int) -> FrameHeaders:
        """Read the headers of one frame; those of the last frame are kept."""
        if self._last is None or self._last.number != number:
            members = {} if self.leader in self.aovs.values() else {"": self.leader}
            members |= self.aovs
            cache = HeaderCache()
            headers = {
                aov: read_flat_header(member.files[number], cache)
                for aov, member in members.items()
            }
            parts = {aov: header.parts for aov, header in headers.items()}
            texts = {aov: header.texts for aov, header in headers.items()}
            self._last = FrameHeaders(number, parts, texts, cache)
        return self._last


def find_files(spec: str, gaps: bool, decided: Collection[Role] = ()) -> ShotFiles:
    """Find the sequences that a name without view stands for; with `gaps`, list missing frames.

    `decided` are the roles whose channels the user names.

    Raises LayoutError if two passes are of one role, and nothing tells which one is meant.
    """
    aov_set = find_aov_set(spec, gaps=gaps, needed=lambda members: _needed_aovs(members, decided))
    if aov_set is None:
        return ShotFiles(find_sequence(spec, gaps=gaps), {})
    return ShotFiles(aov_set.leader, aov_set.aovs)


def _needed_aovs(aov_set: AovSet, decided: Collection[Role]) -> list[str]:
    """Return the AOVs of a set that its colour's own files do not hold."""
    own = set() if aov_set.colour is None else _roles_in(aov_set.colour)
    roles = {name: pass_role(name) for name in aov_set.aovs}
    names = [
        name
        for name, role in roles.items()
        # Files that hold vectors are a render by themselves.
        if role not in own and not (role is None and Role.MOTION in own)
    ]
    for role in (Role.MOTION, Role.DEPTH):
        rivals = [name for name in names if roles[name] is role and role not in decided]
        directions = {vector_direction(name) for name in rivals}
        if len(rivals) > 1 and directions != {"forward", "backward"}:
            listed = " and ".join(aov_set.aovs[name].pattern for name in rivals)
            raise LayoutError(
                f"{listed} both go by a name of {role.value}; say which one holds it with "
                f"--aov {role.value}={aov_set.aovs[rivals[0]].pattern}"
            )
    return names


def _roles_in(sequence: Sequence) -> set[Role]:
    """Return the roles that a sequence's files hold, by the first one that can be read."""
    for path in sequence.files.values():
        try:
            parts = read_flat_header(path, HeaderCache()).parts
        except InputError:  # reported when that frame is read
            continue
        views = list_views(parts)
        channels = view_channels(parts, views[0] if views else "")
        return set(detect_layout({"": rename_channels(channels)}).roles)
    return set()


def read_flat_header(path: Path, headers: HeaderCache) -> FileHeader:
    """Read the header of a file, and refuse one of which all parts are deep."""
    header = headers.read(path)
    if all(part.deep for part in header.parts):
        raise deep_image_error(path)
    return header


def rename_channels(channels: Mapping[str, Channel]) -> tuple[Channel, ...]:
    """Return channels with the names, without view, that they are known by, for detection."""
    return tuple(replace(channel, name=name) for name, channel in channels.items())


def first_usable(numbers: Iterable[int], read: Callable[[int], T]) -> T:
    """Return what `read` gives for the first frame for which it raises no InputError.

    Raises the InputError of the very first frame, of at least one, if all fail.
    """
    first_error: InputError | None = None
    for number in numbers:
        try:
            return read(number)
        except InputError as error:
            first_error = first_error or error
    assert first_error is not None
    raise first_error


def require_sound(paths: Iterable[Path]) -> None:
    """Decode all flat pixels of EXR files, as damage shows there alone; InputError if damaged."""
    for path in paths:
        with ExrFile(path) as file:
            for part in file.parts:
                for i in range(0, 0 if part.deep else len(part.channels), CHANNEL_BATCH):
                    file.read(part.channels[i : i + CHANNEL_BATCH])


class NonFinite:
    """Counts of NaN and infinite pixels in a sequence's frames. Several threads may note them."""

    def __init__(self) -> None:
        self._counts: dict[int, dict[str, int]] = {}

    def note(self, number: int, pixels: Mapping[str, int]) -> None:
        """Note counts by the channels' role or layer; a frame may be read several times."""
        for channels, count in pixels.items():
            if count:
                counts = self._counts.setdefault(number, {})
                counts[channels] = max(count, counts.get(channels, 0))

    def of(self, number: int) -> Iterator[tuple[str, int]]:
        """Yield the channels and counts of a frame, sorted."""
        yield from sorted(self._counts.get(number, {}).items())


def count_nonfinite(planes: Iterable[np.ndarray], role: Role | None = None) -> int:
    """Count the pixels that are not finite in any of these channels.

    `planes` are [H, W] or [H, W, C] of any types; those of other windows than the first are left
    out. In a depth NaN alone counts: infinity is how renderers write the background.
    """
    nonfinite: Bool | None = None
    shape: tuple[int, ...] | None = None
    for plane in planes:
        if plane.dtype.kind != "f":
            continue
        shape = shape or plane.shape[:2]
        values = plane.reshape(*plane.shape[:2], -1)
        if role is Role.DEPTH:
            pixels = np.asarray(np.isnan(values).any(axis=-1))
        elif is_surely_finite(values):
            continue
        else:
            pixels = nonfinite_pixels(values)
        if pixels.shape == shape:
            nonfinite = pixels if nonfinite is None else nonfinite | pixels
    return 0 if nonfinite is None else int(np.count_nonzero(nonfinite))
