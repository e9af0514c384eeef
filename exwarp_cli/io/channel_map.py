"""Channel maps: a TOML file that says by hand which channels of a shot hold what.

What a map leaves out is recognised as usual, so that it can correct a single role. Channels have
the names that ``exwarp inspect`` prints: with their layer, without their view, and with
``AOV:`` in front where they lie in an AOV's own file.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from exwarp_cli.errors import (
    DamagedFileError,
    ExwarpError,
    InputError,
    OutputExistsError,
    UsageError,
)
from exwarp_cli.io.aov_files import AovFile, check_count, parse_aovs, role_of
from exwarp_cli.io.channels import Role
from exwarp_cli.io.config_file import read_toml
from exwarp_cli.io.depth import DepthKind
from exwarp_cli.io.files import atomic_write_text

SCHEMA = "exwarp.channel-map/1"

_TEXTS = {
    "producer": "the program that wrote the files, for reports",
    "view": "the view that is read, where there are several; --view says otherwise",
    "motion": "what the motion channels mean, as --motion takes it; without it, it is measured",
    "depth_kind": "what the depth channel holds: " + ", ".join(kind.value for kind in DepthKind),
}
_TABLES = ("channels", "aovs")


@dataclass(frozen=True)
class ChannelMap:
    """What a shot's channels hold, as far as the file says so.

    Attributes
    ----------
    path
        The file.
    channels
        Names by role, components in order; () says that the shot does not have a role.
    aovs
        Roles whose channels lie in sequences of their own.
    producer, view, motion
        As in `_TEXTS`; None where it is not said.
    depth_kind
        What the depth channel holds; None where it is not said.
    """

    path: Path
    channels: Mapping[Role, tuple[str, ...]] = field(default_factory=dict)
    aovs: tuple[AovFile, ...] = ()
    producer: str | None = None
    view: str | None = None
    motion: str | None = None
    depth_kind: DepthKind | None = None

    def option(self, key: str) -> str:
        """Name a key for a message."""
        return f"{key} in the channel map {self.path}"


def read_channel_map(path: Path) -> ChannelMap:
    """Read a channel map.

    Raises
    ------
    InputError
        When it cannot be read, or is not TOML.
    DamagedFileError
        When a key is unknown or its value is of another type.
    UsageError
        When a role, or its number of channels, cannot be.
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
    _check(document, path)
    channels: dict[Role, tuple[str, ...]] = {}
    for name, value in document.get("channels", {}).items():
        option = f"channels.{name} in the channel map {path}"
        role = role_of(name, option)
        if role in channels:
            raise UsageError(f"{option} names {role.value} twice; write each role once")
        channels[role] = (value,) if isinstance(value, str) else tuple(value)
        if channels[role]:
            check_count(role, channels[role], option)
    aovs = _aovs(document.get("aovs", {}), path)
    for aov in aovs:
        if channels.get(aov.role):
            raise UsageError(
                f"the channel map {path} names {aov.role.value} in [channels] and in [aovs]; "
                "leave one of them out"
            )
    return ChannelMap(
        path,
        channels,
        aovs,
        document.get("producer"),
        document.get("view"),
        document.get("motion"),
        _kind(document, path),
    )


def write_channel_map(path: Path, text: str, overwrite: bool) -> None:
    """Write the text of a channel map, whole or not at all.

    Raises
    ------
    OutputExistsError
        When the file exists and is not to be replaced.
    OutputError
        When it cannot be written.
    """
    if path.exists() and not overwrite:
        raise OutputExistsError(f"{path} exists; choose another name, or add --overwrite")
    atomic_write_text(path, text)


def channel_map_text(
    about: str,
    texts: Mapping[str, str | None],
    channels: Mapping[Role, tuple[str, ...]],
    aovs: tuple[AovFile, ...],
    unused: Iterable[str] = (),
) -> str:
    """Write out a channel map, with comments that say what can be changed.

    Parameters
    ----------
    about
        What it is of, for the first line.
    texts
        Values of `_TEXTS`; what is absent or None becomes a comment.
    channels
        Names by role; roles that are absent become comments.
    aovs
        Roles in sequences of their own.
    unused
        Names of the channels without a role, which become comments.
    """
    lines = [
        f"# What the channels of {quoted(about)} hold, for exwarp --channel-map.",
        "# What is left out is recognised as without a map; channels = [] leaves a role out.",
        f"schema = {quoted(SCHEMA)}",
    ]
    for key, meaning in _TEXTS.items():
        value = texts.get(key)
        lines += ["", f"# {key}: {meaning}"]
        lines.append(f'# {key} = ""' if value is None else f"{key} = {quoted(value)}")
    lines += ["", "# Channels with their layer, in the order of their components (R G B A, X Y Z)."]
    lines.append("[channels]")
    apart = {aov.role for aov in aovs}
    for role in (role for role in Role if role not in apart):
        named = ", ".join(quoted(name) for name in channels.get(role, ()))
        lines.append(f"{'' if named else '# '}{role.value} = [{named}]")
    if names := tuple(unused):
        lines += ["", "# Channels that have no role so far:", *(f"# {quoted(n)}" for n in names)]
    lines += ["", "# Roles in sequences of their own, as --aov takes them: PATTERN[:CHANNELS]."]
    lines.append("[aovs]")
    for aov in aovs:
        lines.append(f"{aov.role.value} = {quoted(aov.pattern + aov.chosen)}")
    return "\n".join(lines) + "\n"


def quoted(text: str) -> str:
    """Write a text as TOML's basic string.

    JSON's escapes are TOML's; but TOML also wants that of DEL, and UTF-8 has no lone surrogates,
    which stand for bytes of file names that are no text.
    """
    plain = text.encode("utf-8", "replace").decode()
    return json.dumps(plain, ensure_ascii=False).replace("\x7f", "\\u007f")


def _check(document: Mapping[str, Any], path: Path) -> None:
    """Refuse unknown keys and other types."""
    known = ("schema", *_TEXTS, *_TABLES)
    for key, value in document.items():
        if key not in known:
            raise _wrong(path, key, f"is unknown; the keys are {', '.join(known)}")
        if key in _TABLES and not isinstance(value, dict):
            raise _wrong(path, key, f"has to be a table; write [{key}] on a line of its own")
        if key not in _TABLES and not (isinstance(value, str) and value):
            raise _wrong(path, key, "has to be a text in quotes; correct it, or leave it out")
    if document.get("schema", SCHEMA) != SCHEMA:
        raise _wrong(path, "schema", f"is not {SCHEMA}; this version of ExWarp reads that alone")
    for name, value in document.get("channels", {}).items():
        _check_type(path, f"channels.{name}", value, _are_names, "a list of channel names")
    for name, value in document.get("aovs", {}).items():
        _check_type(path, f"aovs.{name}", value, _is_name, "a text such as PATTERN:R,G")


def _check_type(
    path: Path, key: str, value: object, fits: Callable[[object], bool], wanted: str
) -> None:
    if not fits(value):
        raise _wrong(path, key, f"has to be {wanted}; correct it, or leave it out")


def _is_name(value: object) -> bool:
    return isinstance(value, str) and bool(value)


def _are_names(value: object) -> bool:
    return _is_name(value) or (isinstance(value, list) and all(map(_is_name, value)))


def _wrong(path: Path, key: str, what: str) -> DamagedFileError:
    return DamagedFileError(f"{key} in the channel map {path} {what}")


def _aovs(table: Mapping[str, str], path: Path) -> tuple[AovFile, ...]:
    try:
        return parse_aovs(f"{role}={text}" for role, text in table.items())
    except ExwarpError as error:
        raise type(error)(f"in [aovs] of the channel map {path}: {error}") from error


def _kind(document: Mapping[str, Any], path: Path) -> DepthKind | None:
    text = document.get("depth_kind")
    if text is None or text in [kind.value for kind in DepthKind]:
        return None if text is None else DepthKind(text)
    known = ", ".join(kind.value for kind in DepthKind)
    raise _wrong(path, "depth_kind", f"is {text!r}; write one of {known}")
