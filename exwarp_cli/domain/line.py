"""Text on one line, for logs, terminals and the programs that read them."""

from __future__ import annotations

import re

LONGEST = 4000
"""Characters of a line, at most: Deadline Cloud takes 4,096 of a status, and the runner of Open Job
Description reads lines in pieces of 64,000, of which a later one could pass for a line of its own.
"""

_BREAK = re.compile(r"\s*[\t-\r\x1c-\x1f\x85\u2028\u2029]\s*")
"""Whatever some reader takes for the end of a line, with the space around it."""

_MISLEADING = re.compile(r"[\0-\x1f\x7f-\x9f\u2028-\u202e\u2066-\u2069]")
"""Control characters, ends of lines and paragraphs, and what overrides or embeds a direction."""


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
    line = _BREAK.sub(" ", text).strip()
    if not line.isprintable():
        line = "".join(c if c.isprintable() else _spelled(c) for c in line)
    if len(line) > LONGEST:
        half = LONGEST // 2 - 2
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
    return _MISLEADING.sub(lambda found: _spelled(found[0]), text)


def misleads(text: str) -> bool:
    """Whether text holds what `printable` spells out; a command with it is not what is seen."""
    return _MISLEADING.search(text) is not None


def _spelled(character: str) -> str:
    return character.encode("unicode_escape").decode("ascii")
