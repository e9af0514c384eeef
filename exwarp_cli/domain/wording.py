"""Text for people: counts, sizes, lists, and foreign text on one safe line."""

from __future__ import annotations

import re
from collections.abc import Sequence

_UNITS = ("bytes", "KiB", "MiB", "GiB", "TiB")


def size_text(count: int) -> str:
    """Write a number of bytes with its unit."""
    value, unit = float(count), 0
    while value >= 1024 and unit < len(_UNITS) - 1:
        value, unit = value / 1024, unit + 1
    return f"{value:.1f} {_UNITS[unit]}" if unit and value < 10 else f"{value:.0f} {_UNITS[unit]}"


def enumerated(names: Sequence[str]) -> str:
    """Write names as in a sentence: a, b and c."""
    return " and ".join((", ".join(names[:-1]), names[-1])) if len(names) > 1 else "".join(names)


def pluralise(count: int, noun: str) -> str:
    """Write a number with its noun, in the plural with an s."""
    return f"{count} {noun}{'' if count == 1 else 's'}"


def first_line(error: BaseException) -> str:
    """Return the message of another library's error, on one line without a full stop."""
    text = next((line.strip() for line in str(error).splitlines() if line.strip()), "")
    text = text.rstrip(".") or type(error).__name__
    return text if len(text) <= 200 else text[:197] + "..."


# Characters of a line, at most: Deadline Cloud takes 4,096 of a status, and the runner of Open Job
# Description reads lines in pieces of 64,000, of which a later one could pass for a line of its
# own.
MAX_LINE = 4000


def one_line(text: str) -> str:
    """Return text as one line of printable characters.

    Names of files, layers and views come from others and hold what they like: line ends, which
    would begin a line that a farm obeys, and control characters, which a terminal obeys. Line ends
    become spaces; what else cannot be printed is spelled out, as ``\\x1b``. Of a text that is too
    long the middle is left out: its end says what to do.

    Examples
    --------
    >>> one_line("a.exr is damaged;\\nrender it again")
    'a.exr is damaged; render it again'
    """
    # Every line break of any reader, with the space around it.
    line = re.sub(r"\s*[\t-\r\x1c-\x1f\x85\u2028\u2029]\s*", " ", text).strip()
    if not line.isprintable():
        line = "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in line)
    if len(line) > MAX_LINE:
        half = MAX_LINE // 2 - 2
        line = f"{line[:half]} … {line[-half:]}"
    return line


def printable(text: str) -> str:
    """Return text of which a terminal shows all and obeys nothing.

    Line ends, control characters and what turns the direction of others are spelled out, all else
    is as it was, so that names can be copied.

    Examples
    --------
    >>> printable("a\\nb")
    'a\\\\nb'
    """
    # Control characters, ends of lines and paragraphs, and what overrides or embeds a direction.
    misleading = r"[\0-\x1f\x7f-\x9f\u2028-\u202e\u2066-\u2069]"
    return re.sub(misleading, lambda found: found[0].encode("unicode_escape").decode(), text)
