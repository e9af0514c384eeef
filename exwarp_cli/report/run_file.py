"""run.json: all that a run found out, without loss, so that reports can be merged.

Fields are those of `exwarp_cli.domain.results.RunSummary` and the dataclasses in it.
"""

from __future__ import annotations

import json
import math
from dataclasses import fields, is_dataclass
from enum import Enum
from fractions import Fraction
from functools import cache
from hashlib import sha256
from itertools import repeat
from types import UnionType
from typing import Any, get_args, get_origin, get_type_hints

import numpy as np

from exwarp_cli.domain.results import RunSummary

SCHEMA = "exwarp.run/1"


def format_run(run: RunSummary, report: str) -> str:
    """Write run.json; `report` is the text of the report.json beside it."""
    document = {"schema": SCHEMA, "report_sha256": _digest(report), "run": _encode(run)}
    return json.dumps(document, allow_nan=False, separators=(",", ":")) + "\n"


def parse_run(text: str, report: str) -> RunSummary:
    """Read run.json back.

    Raises
    ------
    ValueError, TypeError, LookupError, AttributeError, RecursionError
        When it holds something else, or belongs to another report.json than `report`.
    """
    document = json.loads(text)
    if document["schema"] != SCHEMA or document["report_sha256"] != _digest(report):
        raise ValueError("run.json is of another report")
    run: RunSummary = _decode(RunSummary, document["run"])
    return run


def _digest(text: str) -> str:
    return sha256(text.encode()).hexdigest()


def _encode(value: Any) -> Any:
    if is_dataclass(value):
        return {field.name: _encode(getattr(value, field.name)) for field in fields(value)}
    if isinstance(value, dict):
        return {key: _encode(item) for key, item in value.items()}
    if isinstance(value, tuple):
        return [_encode(item) for item in value]
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, Enum):
        return value.value
    if isinstance(value, Fraction) or (isinstance(value, float) and not math.isfinite(value)):
        return str(value)
    return value


_type_hints = cache(get_type_hints)


def _decode(kind: Any, value: Any) -> Any:
    """Return a value of an annotated type from what `_encode` returned; refuse other types."""
    if kind in (int, str, bool):
        if type(value) is not kind:
            raise TypeError(f"{value!r} is no {kind.__name__}")
        return value
    if kind is float:
        # Integers stay integers, so that tables have the same text again.
        if type(value) in (int, float):
            return value
        return float(value) if isinstance(value, str) else _decode(int, value)
    arguments = get_args(kind)
    if isinstance(kind, UnionType):
        return None if value is None else _decode(arguments[0], value)
    if get_origin(kind) is tuple:
        kinds = repeat(arguments[0], len(value)) if arguments[-1] is Ellipsis else arguments
        return tuple(_decode(*pair) for pair in zip(kinds, value, strict=True))
    if get_origin(kind) is dict:
        return {key: _decode(arguments[1], item) for key, item in value.items()}
    if isinstance(kind, type) and is_dataclass(kind):
        hints = _type_hints(kind)
        return kind(**{name: _decode(hints[name], item) for name, item in value.items()})
    return kind(value)  # an Enum or a Fraction
