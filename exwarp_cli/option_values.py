"""Values of options: which of them are paths or lists, how TOML writes them, and unusable paths.

Shells, other systems and links make paths that the user does not mean: an unquoted ``*``, a ``~``
that no shell replaced, a ``-`` for standard output, a drive letter, a loop of links. Each is
refused in one sentence.
"""

from __future__ import annotations

import errno
import os
import re
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from datetime import date, datetime, time
from pathlib import Path
from typing import Any

import click
from click.types import StringParamType

from exwarp_cli.errors import InputError, OutputError, UsageError

# A value as the command line gives it: text, so that click judges it; switches are bool.
Value = bool | str | tuple[str, ...]

# Words of a metavar that stand for files, folders and sequences, or for several values.
PATH_WORDS = frozenset({"SEQ", "SEQUENCE", "FILE", "DIR", "FOLDER", "PATTERN", "VIDEO", "PATH"})
LIST_WORDS = frozenset({"LIST", "RANGE"})

# Parameters that name what a command writes, files of other machines, and paths in which ExWarp
# itself replaces ~.
WRITTEN = frozenset({"output", "report_folder", "write_holes", "video", "bundle"})
ON_WORKERS = frozenset({"program"})
EXPANDED = frozenset({"inputs", "data"})

# Of ``--config``, which ``exwarp`` and each of its commands have.
CONFIG_ATTRIBUTES: dict[str, Any] = {
    "type": click.Path(),
    "metavar": "FILE",
    "help": "TOML file to take options from, or none; else EXWARP_CONFIG, or exwarp.toml in this "
    "folder or one above.",
}

_TYPE_NAMES: dict[type, str] = {
    bool: "true or false",
    str: "text",
    int: "a whole number",
    float: "a number",
    list: "an array",
    dict: "a table",
    datetime: "a date",
    date: "a date",
    time: "a time",
}


def long_name(option: click.Option) -> str:
    """Return the first long name of an option, without dashes."""
    long = [name for name in option.opts if name.startswith("--")]
    return (long or option.opts)[0].lstrip("-")


def names_paths(parameter: click.Parameter) -> bool:
    """True if a parameter names files, folders or sequences, by its type or its metavar."""
    if isinstance(parameter.type, click.Path | click.File):
        return True
    words = re.findall("[A-Z]+", parameter.metavar or "")
    return isinstance(parameter.type, StringParamType) and not PATH_WORDS.isdisjoint(words)


def toml_value(option: click.Option, value: object, folder: Path, origin: str) -> Value:
    """Return a value of a config file as the command line would give it.

    Relative paths begin at `folder`. Raises UsageError for a value of a wrong type.
    """
    types: tuple[type, ...]
    if option.is_flag:
        expected, types = "true or false", (bool,)
    elif isinstance(option.type, click.IntRange | type(click.INT)):
        expected, types = "a whole number", (int,)
    elif isinstance(option.type, click.FloatRange | type(click.FLOAT)):
        expected, types = "a number", (int, float)
    elif names_paths(option):
        expected, types = "text, a path", (str,)
    else:
        expected, types = "text", (str, int, float)
    # One value may hold several, with commas between.
    metavar = option.metavar or ""
    is_list = "," in metavar or not LIST_WORDS.isdisjoint(re.findall("[A-Z]+", metavar))
    has_several = option.multiple or (isinstance(option.type, StringParamType) and is_list)
    if has_several:
        expected += ", or an array of such"
    items = value if isinstance(value, list) and has_several else [value]
    for item in items:
        if not isinstance(item, types) or isinstance(item, bool) != option.is_flag:
            actual = _TYPE_NAMES.get(type(item), type(item).__name__)
            raise UsageError(f"{origin} must be {expected}, and is {actual}; correct it")
        if isinstance(item, str) and "\0" in item:
            raise UsageError(f"{origin} holds a NUL character, as no path or word can; remove it")
    if isinstance(value, bool):
        return value
    if option.multiple:
        return tuple(_anchored(option, str(item), folder) for item in items)
    if isinstance(value, list):
        return ",".join(map(str, items))
    return _anchored(option, str(value), folder)


def _anchored(option: click.Option, text: str, folder: Path) -> str:
    """Return a path that begins at the folder of its config file, or with the home folder for ~."""
    if not names_paths(option):
        return text
    role, equals, path = text.partition("=") if "=" in (option.metavar or "") else ("", "", text)
    if path.startswith("~"):
        path = os.path.expanduser(path)  # noqa: PTH111
        if path == "~" or path.startswith("~/"):
            raise UsageError(
                f"--{long_name(option)} names {path}, and there is no home folder; set HOME, or "
                "write the full path"
            )
    try:
        is_current = folder == Path.cwd()
    except OSError:  # the current folder was removed
        is_current = False
    if path in ("", "-") or Path(path).is_absolute() or is_current:
        return f"{role}{equals}{path}"
    return f"{role}{equals}{folder}{os.sep}{path}"  # no Path: a last slash says that it is a folder


def require_usable_paths(
    parameters: Iterable[click.Parameter], values: Mapping[str, object]
) -> None:
    """Refuse paths that would be read as something else than the user means.

    Raises UsageError for ``-``, for a path of Windows on another system, and for a ``~`` that no
    shell replaced; InputError or OutputError for a loop of links.
    """
    for parameter in parameters:
        # Arguments that are plain text are sequences.
        is_argument = isinstance(parameter, click.Argument)
        is_sequence = is_argument and type(parameter.type) is StringParamType
        if parameter.name in ON_WORKERS or not (is_sequence or names_paths(parameter)):
            continue
        value = values.get(parameter.name or "")
        for item in value if isinstance(value, tuple | list) else (value,):
            if isinstance(item, str | Path):
                text = str(item)
                has_role = "=" in (parameter.metavar or "")  # ROLE=PATTERN
                _require_usable(parameter, text.partition("=")[2] if has_role else text)


def _require_usable(parameter: click.Parameter, text: str) -> None:
    is_argument = isinstance(parameter, click.Argument)
    name = parameter.human_readable_name if is_argument else parameter.opts[0]
    subject = f"{name} names {text}"
    if text == "-":
        raise UsageError(
            f"{subject}, and frames do not go through standard input or output; name a folder, "
            "or the full path of one of that name"
        )
    if os.name != "nt" and re.match(r"[A-Za-z]:[\\/]|\\\\\w", text):
        raise UsageError(
            f"{subject}, which is a path of Windows, and this system has no drives; write the path "
            "as it is here, or the full path of a file of that name"
        )
    if text.split("/")[0] == "~" and parameter.name not in EXPANDED:
        raise UsageError(
            f"{subject}, and the shell did not replace ~ by the home folder; write $HOME"
            f"{text[1:]} without quotes, or the full path of a folder of that name"
        )
    for link in (*reversed(Path(text).parents), Path(text)):
        try:
            link.stat()
        except OSError as error:
            if error.errno != errno.ELOOP:
                continue
            kind = OutputError if parameter.name in WRITTEN else InputError
            raise kind(
                f"the link {link} leads back to itself; remove it, or link it to what it stands for"
            ) from error
        except ValueError:  # a null character, which is refused where the path is used
            return


def refuse_expanded(extra: Sequence[str]) -> None:
    """Refuse words of a command line that nothing takes where they are names of files.

    Raises UsageError when one exists: a shell puts all names in the place of an unquoted ``*``.
    """
    names = []
    for path in map(Path, extra):
        with suppress(OSError, ValueError):
            names += [path] if path.exists() else []
    if not names:
        return
    more = f" and {len(extra) - 1} more" if len(extra) > 1 else ""
    folder = names[0].parent
    if len({name.parent for name in names}) > 1 or names[0].is_dir():
        remedy = "name one sequence"
    else:
        # Imported here: other calls need not pay for it.
        from exwarp_cli.io.frame_names import split_names

        suffixes = (names[0].suffix.lower(),)
        pattern = split_names([name.name for name in names], suffixes).get(names[0].name)
        or_pattern = "" if pattern is None else f" or the pattern {folder / str(pattern)}"
        remedy = f"name the folder {folder}/{or_pattern}"
    raise UsageError(
        f"nothing takes {extra[0]}{more}, as the shell replaces an unquoted * by "
        f"all names; {remedy}"
    )
