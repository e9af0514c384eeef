"""What options take: their values as a config file or an environment variable writes them.

Values become what the shell would have handed over, text, so that click and the commands judge
them as they judge the command line; switches become True and False.
"""

from __future__ import annotations

import os
from datetime import date, datetime, time
from pathlib import Path
from typing import Any

import click

from exwarp_cli.commands.option_names import long_name, names_paths, takes_list
from exwarp_cli.errors import UsageError

Value = bool | str | tuple[str, ...]

SEPARATOR = ";"
"""Between the values of one variable: paths and channels may hold commas, colons and spaces."""

_SWITCH = {
    **dict.fromkeys(("1", "true", "yes", "on"), True),
    **dict.fromkeys(("0", "false", "no", "off"), False),
}
_KINDS: dict[type, str] = {
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
_INTEGER = (click.IntRange, type(click.INT))
_NUMBER = (click.FloatRange, type(click.FLOAT))


def from_toml(option: click.Option, value: object, folder: Path, where: str) -> Value:
    """Turn a value of a config file into what an option takes.

    Parameters
    ----------
    option
        The option.
    value
        As `tomllib` reads it.
    folder
        What relative paths begin at.
    where
        The key and its file, for messages.

    Raises
    ------
    UsageError
        When the value is of another type.
    """
    if option.is_flag:
        if not isinstance(value, bool):
            raise _wrong(where, "true or false", value)
        return value
    if not isinstance(value, list):
        text = _text(option, value, where)
        if option.multiple:
            return (_placed(option, text, folder),)
        return _placed(option, text, folder)
    if option.multiple:
        return tuple(_placed(option, _text(option, one, where), folder) for one in value)
    if takes_list(option):
        return ",".join(_text(option, one, where) for one in value)
    if option.nargs > 1:
        return tuple(_text(option, one, where) for one in value)
    raise _wrong(where, _wanted(option), value)


def from_environment(option: click.Option, text: str, variable: str) -> Value:
    """Turn the text of an environment variable into what an option takes.

    Raises
    ------
    UsageError
        When a switch is neither on nor off.
    """
    if option.is_flag:
        switch = _SWITCH.get(text.strip().lower())
        if switch is None:
            raise UsageError(f"{variable} is {text!r}; write 1 or 0, for on or off")
        return switch
    if option.multiple or option.nargs > 1:
        return tuple(one for one in (part.strip() for part in text.split(SEPARATOR)) if one)
    return text


def _text(option: click.Option, value: object, where: str) -> str:
    """Write one value as on a command line, if its type is one that the option takes."""
    if isinstance(value, bool) or not isinstance(value, str | int | float):
        raise _wrong(where, _wanted(option), value)
    if isinstance(option.type, _INTEGER):
        fits = isinstance(value, int)
    elif isinstance(option.type, _NUMBER):
        fits = not isinstance(value, str)
    else:
        fits = isinstance(value, str) or not names_paths(option)
    if not fits:
        raise _wrong(where, _wanted(option), value)
    text = str(value)
    if "\0" in text:
        raise UsageError(f"{where} holds a NUL character, as no path or word can; remove it")
    return text


def _wanted(option: click.Option) -> str:
    """Say what an option takes."""
    if isinstance(option.type, _INTEGER):
        one = "a whole number"
    elif isinstance(option.type, _NUMBER):
        one = "a number"
    elif names_paths(option):
        one = "text, a path"
    else:
        one = "text"
    return f"{one}, or an array of such" if option.multiple or takes_list(option) else one


def _wrong(where: str, wanted: str, value: Any) -> UsageError:
    found = _KINDS.get(type(value), type(value).__name__)
    return UsageError(f"{where} must be {wanted}, and is {found}; correct it")


def _placed(option: click.Option, text: str, folder: Path) -> str:
    """Let a relative path begin at the folder of the file that names it, and ~ at home."""
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
    if path in ("", "-") or Path(path).is_absolute() or _is_here(folder):
        return f"{role}{equals}{path}"
    return f"{role}{equals}{folder}{os.sep}{path}"  # no Path: a last slash says that it is a folder


def _is_here(folder: Path) -> bool:
    """Whether paths that begin at a folder can stay as they are written."""
    try:
        return folder == Path.cwd()
    except OSError:
        return False
