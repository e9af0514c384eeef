"""Paths on the command line that are not what the user means, each refused in one sentence.

Shells, other systems and links play a part: an unquoted ``*``, a ``~`` that is left as it is, a
``-`` for standard output, a drive letter, a loop of links.
"""

from __future__ import annotations

import errno
import os
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import click
from click.types import StringParamType

from exwarp_cli.commands.option_names import names_paths
from exwarp_cli.errors import InputError, OutputError, UsageError

WRITTEN = frozenset({"output", "report_folder", "write_holes", "video", "bundle"})
"""Parameters that name what a command writes."""

OF_WORKERS = frozenset({"program"})
"""Parameters that name files of other machines."""

EXPANDED = frozenset({"inputs", "data"})
"""Parameters in which ExWarp itself replaces ~."""

_DRIVE = re.compile(r"[A-Za-z]:[\\/]|\\\\\w")


def require_usable_paths(
    parameters: Iterable[click.Parameter], values: Mapping[str, object]
) -> None:
    """Refuse paths that would be read as something else than the user means.

    Parameters
    ----------
    parameters
        Of the command.
    values
        What they are set to, by name.

    Raises
    ------
    UsageError
        For ``-``, for a path of Windows on another system, for a ``~`` that no shell replaced.
    InputError, OutputError
        For a loop of links.
    """
    for parameter in parameters:
        if parameter.name in OF_WORKERS or not _is_path(parameter):
            continue
        for text in _texts(parameter, values.get(parameter.name or "")):
            _refuse_misread(parameter, text)
            _refuse_loop(text, OutputError if parameter.name in WRITTEN else InputError)


def refuse_expanded(extra: Sequence[str]) -> None:
    """Refuse words that have no place in a command line where they are names of files.

    Parameters
    ----------
    extra
        Words that neither an option nor an argument takes.

    Raises
    ------
    UsageError
        When one of them exists: a shell puts all names in the place of an unquoted ``*``.
    """
    names = [Path(text) for text in extra if _exists(text)]
    if not names:
        return
    more = f" and {len(extra) - 1} more" if len(extra) > 1 else ""
    if len({name.parent for name in names}) > 1 or names[0].is_dir():
        remedy = "name one sequence"
    else:
        remedy = f"name the folder {names[0].parent}/{_or_pattern(names)}"
    raise UsageError(
        f"nothing takes {extra[0]}{more}, as the shell replaces an unquoted * by "
        f"all names; {remedy}"
    )


def _or_pattern(names: list[Path]) -> str:
    """Return the pattern of the first file, as an alternative to its folder."""
    # Imported here: other calls need not pay for it.
    from exwarp_cli.io.frame_names import split_names

    suffixes = (names[0].suffix.lower(),)
    pattern = split_names([name.name for name in names], suffixes).get(names[0].name)
    return "" if pattern is None else f" or the pattern {names[0].parent / str(pattern)}"


def _is_path(parameter: click.Parameter) -> bool:
    """Whether a parameter takes paths; arguments that are plain text are sequences."""
    is_sequence = isinstance(parameter, click.Argument) and type(parameter.type) is StringParamType
    return is_sequence or names_paths(parameter)


def _texts(parameter: click.Parameter, value: Any) -> Iterator[str]:
    """Yield the paths in a value; of ``ROLE=PATTERN`` what follows the role."""
    for one in value if isinstance(value, tuple | list) else (value,):
        if isinstance(one, str | Path):
            text = str(one)
            yield text.partition("=")[2] if "=" in (parameter.metavar or "") else text


def _refuse_misread(parameter: click.Parameter, text: str) -> None:
    named = f"{_called(parameter)} names {text}"
    if text == "-":
        raise UsageError(
            f"{named}, and frames do not go through standard input or output; name a folder, "
            "or the full path of one of that name"
        )
    if os.name != "nt" and _DRIVE.match(text):
        raise UsageError(
            f"{named}, which is a path of Windows, and this system has no drives; write the path "
            "as it is here, or the full path of a file of that name"
        )
    if text.split("/")[0] == "~" and parameter.name not in EXPANDED:
        raise UsageError(
            f"{named}, and the shell did not replace ~ by the home folder; write $HOME"
            f"{text[1:]} without quotes, or the full path of a folder of that name"
        )


def _called(parameter: click.Parameter) -> str:
    """Return the name that messages give a parameter."""
    if isinstance(parameter, click.Argument):
        return parameter.human_readable_name
    return parameter.opts[0]


def _refuse_loop(text: str, kind: type[InputError | OutputError]) -> None:
    path = Path(text)
    if not _loops(path):
        return
    link = next(part for part in (*reversed(path.parents), path) if _loops(part))
    raise kind(f"the link {link} leads back to itself; remove it, or link it to what it stands for")


def _loops(path: Path) -> bool:
    try:
        path.stat()
    except OSError as error:
        return error.errno == errno.ELOOP
    except ValueError:  # a null character, which is refused where the path is used
        return False
    return False


def _exists(text: str) -> bool:
    try:
        return Path(text).exists()
    except (OSError, ValueError):
        return False
