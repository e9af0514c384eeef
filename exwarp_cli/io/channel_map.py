"""Channels named by hand: the option ``--aov``, and channel maps, TOML files for a whole shot.

What a map leaves out is recognised as usual, so that it can correct a single role. Channels have
the names that ``exwarp inspect`` prints: with their layer, without their view, and with
``AOV:`` in front where they lie in an AOV's own file.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from exwarp_cli.errors import DamagedFileError, ExwarpError, InputError, LayoutError, UsageError
from exwarp_cli.io.channels import ChannelRef, Layout, Role, detect_layout
from exwarp_cli.io.depth import DepthKind
from exwarp_cli.io.exr.header import Channel
from exwarp_cli.io.files import read_toml

SCHEMA = "exwarp.channel-map/1"

# Least and most channels of a role, and how a message writes them as an example.
CHANNEL_COUNTS: Mapping[Role, tuple[int, int, str]] = {
    **dict.fromkeys(Role, (1, 1, "Z")),
    **dict.fromkeys((Role.NORMAL, Role.POSITION, Role.ALBEDO, Role.SPECULAR), (3, 3, "X,Y,Z")),
    Role.COLOUR: (3, 4, "R,G,B,A"),
    Role.MOTION: (2, 5, "R,G"),
}

_ROLES = {role.value: role for role in Role} | {"color": Role.COLOUR}
_FILE = re.compile(r"(?P<pattern>.*?\.exr)(?::(?P<channels>.*))?", re.IGNORECASE | re.DOTALL)
# Without a suffix it is a folder; the colon of a drive belongs to it.
_FOLDER = re.compile(
    r"(?P<pattern>[A-Za-z]:[/\\][^:]*|[^:]+)(?::(?P<channels>[^/\\]*))?", re.DOTALL
)

_TEXTS = {
    "producer": "the program that wrote the files, for reports",
    "view": "the view that is read, where there are several; --view says otherwise",
    "motion": "what the motion channels mean, as --motion takes it; without it, it is measured",
    "depth_kind": "what the depth channel holds: " + ", ".join(kind.value for kind in DepthKind),
}
_TABLES = ("channels", "aovs")


@dataclass(frozen=True)
class AovFile:
    """A role whose channels lie in a sequence of their own: a folder, pattern or any frame."""

    role: Role
    pattern: str
    channels: tuple[str, ...] = ()  # components in order; () to recognise them

    @property
    def option(self) -> str:
        """The option, for a message."""
        return f"--aov {self.role.value}={self.pattern}"

    @property
    def chosen(self) -> str:
        """The channels as they follow the pattern; "" if they are recognised."""
        return f":{','.join(self.channels)}" if self.channels else ""


@dataclass(frozen=True)
class ChannelMap:
    """What a file says of a shot's channels; `channels` has () for a role that is absent.

    The other fields are as in `_TEXTS`, None if the file does not say.
    """

    path: Path
    channels: Mapping[Role, tuple[str, ...]] = field(default_factory=dict)
    aovs: tuple[AovFile, ...] = ()
    producer: str | None = None
    view: str | None = None
    motion: str | None = None
    depth_kind: DepthKind | None = None


def parse_aovs(texts: Iterable[str]) -> tuple[AovFile, ...]:
    """Read ``ROLE=PATTERN[:CHANNELS]``, for example ``motion=vec/shot.####.exr:R,G``.

    Raises UsageError for another form, or a role that comes twice.
    """
    aovs: list[AovFile] = []
    for text in texts:
        role_name, equals, location = text.partition("=")
        match = _FILE.fullmatch(location) or _FOLDER.fullmatch(location)
        if not equals or not location or match is None:
            raise UsageError(
                f"--aov {text!r} is not understood; write ROLE=PATTERN or ROLE=PATTERN:CHANNELS, "
                "for example motion=vec/shot.####.exr:R,G"
            )
        option = f"--aov {text}"
        role = _parse_role(role_name, option)
        channels: tuple[str, ...] = ()
        if match["channels"] is not None:
            channels = tuple(name.strip() for name in match["channels"].split(","))
            if not all(channels):
                raise UsageError(
                    f"{option}: a channel's name is empty; separate names by single commas"
                )
            require_channel_count(role, channels, option)
        aovs.append(AovFile(role, match["pattern"], channels))
    for i, aov in enumerate(aovs):
        if aov.role in [other.role for other in aovs[:i]]:
            raise UsageError(f"--aov names {aov.role.value} twice; give one sequence for each role")
    return tuple(aovs)


def _parse_role(name: str, option: str) -> Role:
    role = _ROLES.get(name.strip().lower())
    if role is None:
        roles = ", ".join(role.value for role in Role)
        raise UsageError(f"{option}: {name!r} is no role; the roles are {roles}")
    return role


def detect_aov(aov: AovFile, channels: Mapping[str, Channel], name: str, file: object) -> Layout:
    """Return a layout of an AOV's role alone, out of the channels of a file's view by name.

    The layout has them in the AOV `name`.

    Raises LayoutError if a channel is absent, or none is recognised.
    """
    role = aov.role
    if aov.channels:
        names = (find_channel(text, channels, aov.option, file) for text in aov.channels)
        return Layout({role: tuple(ChannelRef(name, channel) for channel in names)})
    # By its own names; else as if its folder's role were the layer's name; else what there is.
    own = detect_layout({"": channels.values()})
    layout = own if role in own else detect_layout({role.value: channels.values()})
    members = tuple(ref.name for ref in layout.roles.get(role, ()))
    if role not in own and len({channel.rpartition(".")[0] for channel in channels}) == 1:
        # Of a file's only layer all channels, in their usual order, if they fit.
        least, most, _ = CHANNEL_COUNTS[role]
        by_letter = {channel.rpartition(".")[2].upper(): channel for channel in channels}
        all_channels = tuple(channels) if len(channels) == least == most == 1 else ()
        for letters in ("XYZW", "XYZ", "RGBA", "RGB", "UV", "XY", "RG"):
            fits = least <= len(letters) <= most and set(letters) == set(by_letter)
            if fits and not (role is Role.MOTION and letters[0] == "R"):
                all_channels = tuple(by_letter[letter] for letter in letters)
        members = max(members, all_channels, key=len)
    if not members:
        raise LayoutError(
            f"{file} has no {role.value} channels that are recognised, only "
            f"{', '.join(channels)}; name them, as in {aov.option}:{CHANNEL_COUNTS[role][2]}"
        )
    return Layout(
        {role: tuple(ChannelRef(name, member) for member in members)},
        layout.guess if role in layout and role is Role.MOTION else None,
        own.producer,
        alphas=tuple(ChannelRef(name, ref.name) for ref in layout.alphas if role is Role.COLOUR),
    )


def find_channel(name: str, channels: Iterable[str], option: str, file: object) -> str:
    """Return the channel of this name, or the only one that ends in it.

    Raises LayoutError, which quotes the option and the file, if there is none, or several.
    """
    channels = tuple(channels)
    if name in channels:
        return name
    ends = [channel for channel in channels if channel.endswith(f".{name}")]
    if len(ends) == 1:
        return ends[0]
    have = f"several of that name ({', '.join(ends)})" if ends else f"only {', '.join(channels)}"
    raise LayoutError(f"{option} names the channel {name!r}, and {file} has {have}; correct it")


def require_channel_count(role: Role, channels: tuple[str, ...], option: str) -> None:
    """Refuse a number of channels that a role cannot have, and the same channel twice."""
    least, most, example = CHANNEL_COUNTS[role]
    if not least <= len(channels) <= most:
        wanted = str(least) if least == most else f"{least} to {most}"
        raise UsageError(
            f"{option} names {len(channels)} channel{'s' * (len(channels) != 1)} for "
            f"{role.value}, which takes {wanted}; write them as in {example}"
        )
    repeated = next((name for i, name in enumerate(channels) if name in channels[:i]), None)
    if repeated is not None and role is not Role.COLOUR:  # a grey beauty is one plane thrice
        raise UsageError(
            f"{option} names the channel {repeated!r} of {role.value} twice; name each component's"
        )


def read_channel_map(path: Path) -> ChannelMap:
    """Read a channel map.

    Raises InputError if it cannot be read, DamagedFileError if it is not TOML, has an unknown key
    or a value of another type, UsageError if a role or its number of channels is impossible.
    """
    try:
        document = read_toml(path)
    except OSError as error:
        raise InputError(
            f"cannot read the channel map {path}: {error.strerror or error}; check the path"
        ) from error
    except ValueError as error:
        raise DamagedFileError(
            f"the channel map {path} is not TOML ({error}); correct it, or write a "
            "new one with 'exwarp inspect SEQ --write-channel-map FILE'"
        ) from error
    for key, problem in _find_problems(document):
        raise DamagedFileError(f"{key} in the channel map {path} {problem}")
    channels: dict[Role, tuple[str, ...]] = {}
    for name, value in document.get("channels", {}).items():
        option = f"channels.{name} in the channel map {path}"
        role = _parse_role(name, option)
        if role in channels:
            raise UsageError(f"{option} names {role.value} twice; write each role once")
        channels[role] = (value,) if isinstance(value, str) else tuple(value)
        if channels[role]:
            require_channel_count(role, channels[role], option)
    try:
        aovs = parse_aovs(f"{role}={text}" for role, text in document.get("aovs", {}).items())
    except ExwarpError as error:
        raise type(error)(f"in [aovs] of the channel map {path}: {error}") from error
    for aov in aovs:
        if channels.get(aov.role):
            raise UsageError(
                f"the channel map {path} names {aov.role.value} in [channels] and in [aovs]; "
                "leave one of them out"
            )
    depth_kind = document.get("depth_kind")
    return ChannelMap(
        path,
        channels,
        aovs,
        document.get("producer"),
        document.get("view"),
        document.get("motion"),
        None if depth_kind is None else DepthKind(depth_kind),
    )


def _find_problems(document: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """Yield unknown keys and impossible values, each with half a sentence about it."""
    keys = ("schema", *_TEXTS, *_TABLES)
    for key, value in document.items():
        if key not in keys:
            yield key, f"is unknown; the keys are {', '.join(keys)}"
        if key in _TABLES and not isinstance(value, dict):
            yield key, f"has to be a table; write [{key}] on a line of its own"
        if key not in _TABLES and not (isinstance(value, str) and value):
            yield key, "has to be a text in quotes; correct it, or leave it out"
    if document.get("schema", SCHEMA) != SCHEMA:
        yield "schema", f"is not {SCHEMA}; this version of ExWarp reads that alone"
    for table, needed in (
        ("channels", "a list of channel names"),
        ("aovs", "a text such as PATTERN:R,G"),
    ):
        for name, value in document.get(table, {}).items():
            is_list = table == "channels" and isinstance(value, list)
            if not all(isinstance(text, str) and text for text in (value if is_list else [value])):
                yield f"{table}.{name}", f"has to be {needed}; correct it, or leave it out"
    kinds = [kind.value for kind in DepthKind]
    if document.get("depth_kind", kinds[0]) not in kinds:
        yield "depth_kind", f"is {document['depth_kind']!r}; write one of {', '.join(kinds)}"


def channel_map_text(
    about: str,
    texts: Mapping[str, str | None],
    channels: Mapping[Role, tuple[str, ...]],
    aovs: tuple[AovFile, ...],
    unused: Iterable[str] = (),
) -> str:
    """Format a channel map of the shot `about`, with comments that say what can be changed.

    Absent values of `_TEXTS`, absent roles and the `unused` channels become comments.
    """
    lines = [
        f"# What the channels of {quote_toml(about)} hold, for exwarp --channel-map.",
        "# What is left out is recognised as without a map; channels = [] leaves a role out.",
        f"schema = {quote_toml(SCHEMA)}",
    ]
    for key, meaning in _TEXTS.items():
        value = texts.get(key)
        lines += ["", f"# {key}: {meaning}"]
        lines.append(f'# {key} = ""' if value is None else f"{key} = {quote_toml(value)}")
    lines += ["", "# Channels with their layer, in the order of their components (R G B A, X Y Z)."]
    lines.append("[channels]")
    apart = {aov.role for aov in aovs}
    for role in (role for role in Role if role not in apart):
        listed = ", ".join(quote_toml(name) for name in channels.get(role, ()))
        lines.append(f"{'' if listed else '# '}{role.value} = [{listed}]")
    if names := [f"# {quote_toml(name)}" for name in unused]:
        lines += ["", "# Channels that have no role so far:", *names]
    lines += ["", "# Roles in sequences of their own, as --aov takes them: PATTERN[:CHANNELS]."]
    lines.append("[aovs]")
    lines += [f"{aov.role.value} = {quote_toml(aov.pattern + aov.chosen)}" for aov in aovs]
    return "\n".join(lines) + "\n"


def quote_toml(text: str) -> str:
    """Write a text as TOML's basic string."""
    # JSON's escapes are TOML's; but TOML also wants that of DEL, and UTF-8 has no lone surrogates,
    # which stand for bytes of file names that are no text.
    plain = text.encode("utf-8", "replace").decode()
    return json.dumps(plain, ensure_ascii=False).replace("\x7f", "\\u007f")
