"""Channels of a role that lie in a sequence of their own: the option ``--aov``."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from exwarp_cli.errors import LayoutError, UsageError
from exwarp_cli.io.channels import ChannelRef, Layout, Role, detect
from exwarp_cli.io.exr.header import Channel

COUNTS: Mapping[Role, tuple[int, int]] = {
    Role.COLOUR: (3, 4),
    Role.MOTION: (2, 5),
    **dict.fromkeys((Role.NORMAL, Role.POSITION, Role.ALBEDO, Role.SPECULAR), (3, 3)),
}
"""Fewest and most channels of a role; of the others one."""

_ROLES = {role.value: role for role in Role} | {"color": Role.COLOUR}
_FILE = re.compile(r"(?P<pattern>.*?\.exr)(?::(?P<channels>.*))?", re.IGNORECASE | re.DOTALL)
# Without a suffix it is a folder; the colon of a drive belongs to it.
_FOLDER = re.compile(
    r"(?P<pattern>[A-Za-z]:[/\\][^:]*|[^:]+)(?::(?P<channels>[^/\\]*))?", re.DOTALL
)


@dataclass(frozen=True)
class AovFile:
    """Where a role's channels are.

    Attributes
    ----------
    role
        What they hold.
    pattern
        Folder, pattern or any frame of their sequence.
    channels
        Their names, components in order; () for those that are recognised.
    """

    role: Role
    pattern: str
    channels: tuple[str, ...] = ()

    @property
    def option(self) -> str:
        """Name it for a message."""
        return f"--aov {self.role.value}={self.pattern}"

    @property
    def chosen(self) -> str:
        """Its channels as they follow the pattern; "" for those that are recognised."""
        return f":{','.join(self.channels)}" if self.channels else ""


def parse_aovs(texts: Iterable[str]) -> tuple[AovFile, ...]:
    """Read ``ROLE=PATTERN[:CHANNELS]``, for example ``motion=vec/shot.####.exr:R,G``.

    Raises
    ------
    UsageError
        When one is not of this form, or a role comes twice.
    """
    found = tuple(_parse(text) for text in texts)
    for i, aov in enumerate(found):
        if aov.role in [other.role for other in found[:i]]:
            raise UsageError(f"--aov names {aov.role.value} twice; give one sequence for each role")
    return found


def recognise(aov: AovFile, channels: Mapping[str, Channel], where: object) -> Layout:
    """Find the channels of an AOV's role in a file.

    Parameters
    ----------
    aov
        What is sought.
    channels
        Of the file's view, by name.
    where
        Names the file in messages.

    Returns
    -------
    Layout
        Of this role alone, in the AOV of its name.

    Raises
    ------
    LayoutError
        When a channel is not there, or none is recognised.
    """
    role = aov.role
    if aov.channels:
        names = tuple(named(name, channels, aov.option, where) for name in aov.channels)
        return Layout({role: tuple(ChannelRef(role.value, name) for name in names)})
    # By its own names; else as if its folder's role were the layer's name; else what there is.
    own = detect({"": channels.values()})
    found = own if role in own else detect({role.value: channels.values()})
    single = _single(role, channels)
    refs = tuple(ref.name for ref in found.roles.get(role, ()))
    if role not in own and len(single) > len(refs):
        refs = single
    if not refs:
        raise LayoutError(
            f"{where} has no {role.value} channels that are recognised, only "
            f"{_listed(channels)}; name them, as in {aov.option}:{_example(role)}"
        )
    guess = found.guess if role in found and role is Role.MOTION else None
    producer = own.producer
    alphas = found.alphas if role is Role.COLOUR else ()
    return Layout(
        {role: tuple(ChannelRef(role.value, name) for name in refs)},
        guess,
        producer,
        alphas=tuple(ChannelRef(role.value, ref.name) for ref in alphas),
    )


def named(name: str, channels: Iterable[str], option: str, where: object) -> str:
    """Return the channel that a name means: the name itself, or the one that ends in it.

    Raises
    ------
    LayoutError
        When there is none, or several.
    """
    channels = tuple(channels)
    if name in channels:
        return name
    ends = [channel for channel in channels if channel.endswith(f".{name}")]
    if len(ends) == 1:
        return ends[0]
    have = f"several of that name ({_listed(ends)})" if ends else f"only {_listed(channels)}"
    raise LayoutError(f"{option} names the channel {name!r}, and {where} has {have}; correct it")


def check_count(role: Role, channels: tuple[str, ...], option: str) -> None:
    """Refuse a number of channels that a role cannot have, and the same one twice.

    Raises
    ------
    UsageError
        When it cannot.
    """
    least, most = COUNTS.get(role, (1, 1))
    if not least <= len(channels) <= most:
        wanted = str(least) if least == most else f"{least} to {most}"
        raise UsageError(
            f"{option} names {len(channels)} channel{'s' * (len(channels) != 1)} for "
            f"{role.value}, which takes {wanted}; write them as in {_example(role)}"
        )
    twice = next((name for i, name in enumerate(channels) if name in channels[:i]), None)
    if twice is not None and role is not Role.COLOUR:  # a grey beauty is one plane thrice
        raise UsageError(
            f"{option} names the channel {twice!r} of {role.value} twice; name each component's"
        )


def role_of(name: str, option: str) -> Role:
    """Return the role of a name.

    Raises
    ------
    UsageError
        When there is none.
    """
    role = _ROLES.get(name.strip().lower())
    if role is None:
        known = ", ".join(role.value for role in Role)
        raise UsageError(f"{option}: {name!r} is no role; the roles are {known}")
    return role


def _parse(text: str) -> AovFile:
    role, equals, rest = text.partition("=")
    match = _FILE.fullmatch(rest) or _FOLDER.fullmatch(rest)
    if not equals or not rest or match is None:
        raise UsageError(
            f"--aov {text!r} is not understood; write ROLE=PATTERN or ROLE=PATTERN:CHANNELS, for "
            "example motion=vec/shot.####.exr:R,G"
        )
    option = f"--aov {text}"
    found = role_of(role, option)
    if match["channels"] is None:
        return AovFile(found, match["pattern"])
    channels = tuple(name.strip() for name in match["channels"].split(","))
    if not all(channels):
        raise UsageError(f"{option}: a channel's name is empty; separate names by single commas")
    check_count(found, channels, option)
    return AovFile(found, match["pattern"], channels)


def _single(role: Role, channels: Mapping[str, Channel]) -> tuple[str, ...]:
    """Return the channels of a file's only layer in their usual order, () where they do not fit."""
    layers = {name.rpartition(".")[0] for name in channels}
    by_letter = {name.rpartition(".")[2].upper(): name for name in channels}
    least, most = COUNTS.get(role, (1, 1))
    if len(layers) != 1:
        return ()
    if len(channels) == least == most == 1:
        return tuple(channels)
    for letters in ("XYZW", "XYZ", "RGBA", "RGB", "UV", "XY", "RG"):
        fits = least <= len(letters) <= most and set(by_letter) == set(letters)
        if fits and not (role is Role.MOTION and letters[0] == "R"):
            return tuple(by_letter[letter] for letter in letters)
    return ()


def _listed(names: Iterable[str]) -> str:
    return ", ".join(names)


def _example(role: Role) -> str:
    if role is Role.MOTION:
        return "R,G"
    return {1: "Z", 3: "X,Y,Z"}.get(COUNTS.get(role, (1, 1))[1], "R,G,B,A")
