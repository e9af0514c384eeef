"""How long a renderer worked on a frame, as far as the file's header tells.

Read are Blender's ``RenderTime`` (the whole frame, with synchronisation) and, where that is
missing, the ``cycles.LAYER.render_time`` of all its layers together; and V-Ray's
``vrayInfo/rendertime``.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping
from typing import Any

BLENDER, VRAY = "RenderTime", "vrayInfo/rendertime"

_LAYER = re.compile(r"cycles\..*\.render_time", re.DOTALL)
_CLOCK = re.compile(r"(?:(?:(\d+):)?(\d+):)?(\d+(?:\.\d+)?)")
_UNITS = re.compile(r"(?:(\d+)h)?\s*(?:(\d+)m)?\s*(\d+(?:\.\d+)?)s")


def render_seconds(headers: Iterable[Mapping[str, Any]]) -> tuple[float, str] | None:
    """Return how many seconds a frame took to render, and the attribute that tells it.

    Parameters
    ----------
    headers
        Of every part of the frame's file. Parts repeat the attributes of the whole frame, so the
        first that has one counts.

    Returns
    -------
    float and str, or None
        None where no attribute tells, or none is above 0.
    """
    listed = list(headers)
    for name in (BLENDER, VRAY):
        for header in listed:
            seconds = parse_duration(header.get(name))
            if seconds:
                return seconds, name
    layers: dict[str, float] = {}
    for header in listed:
        for name, value in header.items():
            if _LAYER.fullmatch(name) and (seconds := parse_duration(value)):
                layers.setdefault(name, seconds)
    if not layers:
        return None
    return sum(layers.values()), "cycles.*.render_time"


def parse_duration(value: object) -> float | None:
    """Read ``01:02:03.45``, ``02:03.45``, ``0h 28m 39.3s`` or a number of seconds; else None."""
    if isinstance(value, int | float) and not isinstance(value, bool):
        return float(value) if math.isfinite(value) and value >= 0 else None
    if not isinstance(value, str):
        return None
    text = value.strip()
    match = _CLOCK.fullmatch(text) or _UNITS.fullmatch(text)
    if match is None:
        return None
    hours, minutes, seconds = match.groups()
    return 3600.0 * int(hours or 0) + 60.0 * int(minutes or 0) + float(seconds)
