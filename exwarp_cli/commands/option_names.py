"""What an option is called, and what its name for a value, ``metavar``, says of the value."""

from __future__ import annotations

import re

import click
from click.types import StringParamType

PATH_WORDS = frozenset({"SEQ", "SEQUENCE", "FILE", "DIR", "FOLDER", "PATTERN", "VIDEO", "PATH"})
"""Words of a metavar that stand for files, folders and sequences."""

LIST_WORDS = frozenset({"LIST", "RANGE"})
"""Words of a metavar that stand for several values with commas between."""


def long_name(option: click.Option) -> str:
    """Return the name that an option goes by: the first long one, without dashes."""
    long = [name for name in option.opts if name.startswith("--")]
    return (long or option.opts)[0].lstrip("-")


def names_paths(parameter: click.Parameter) -> bool:
    """Whether a parameter names files, folders or sequences, by its type or its metavar."""
    if isinstance(parameter.type, click.Path | click.File):
        return True
    words = set(re.split(r"[^A-Z]+", parameter.metavar or ""))
    return isinstance(parameter.type, StringParamType) and bool(words & PATH_WORDS)


def takes_list(option: click.Option) -> bool:
    """Whether one value of an option holds several, with commas between."""
    metavar = option.metavar or ""
    words = set(re.split(r"[^A-Z]+", metavar))
    return isinstance(option.type, StringParamType) and bool(words & LIST_WORDS or "," in metavar)
