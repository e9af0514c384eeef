"""How frame numbers stand in file names: tokens such as ``####``, padding, grouping.

Strings only; nothing here looks at a disk. The frame number stands right before the image suffix,
or further ahead (``beauty_0101_denoised.exr``): then it is the one that varies. It may carry a
minus sign where the text before it is empty or ends in a separator, so ``shot-0001.exr`` is frame 1
and ``shot.-0001.exr`` is frame -1.
"""

from __future__ import annotations

import re
from collections import Counter, defaultdict
from collections.abc import Iterable
from dataclasses import dataclass

_TOKEN = re.compile(r"#+|@+|%[0-9]{0,2}d|\$F[0-9]{0,2}")
_NUMBER = re.compile(r"-?[0-9]+")
_VERSION = re.compile(r"(^|.*[^a-z])v(er(sion)?)?", re.DOTALL | re.IGNORECASE)
_BETWEEN = re.compile(r"(?<![^._ -])-?[0-9]+(?=[._ -])")
_TRAILING_NUMBER = re.compile(r"(?P<base>.*?)(?P<number>-?[0-9]+)", re.DOTALL)


@dataclass(frozen=True, order=True)
class NamePattern:
    """A file name with a frame number in it.

    Attributes
    ----------
    base
        Text before the number, for example ``shot.``.
    padding
        Digits that the number is filled up to with zeros; 1 means not filled.
    suffix
        Text after the number, for example ``.exr``.
    """

    base: str
    padding: int
    suffix: str

    @classmethod
    def parse(cls, name: str) -> NamePattern | None:
        """Read a name with a frame token: ``####``, ``@@@@``, ``%04d`` or ``$F4``; None without.

        The last token counts, so that a ``#`` or ``%`` in the title is text.
        """
        tokens = list(_TOKEN.finditer(name))
        if not tokens:
            return None
        from fileseq.constants import PAD_STYLE_HASH1  # costs more than a folder's frames
        from fileseq.filesequence import FileSequence

        token = tokens[-1]
        padding = FileSequence.getPaddingNum(token[0], pad_style=PAD_STYLE_HASH1)
        return cls(name[: token.start()], max(padding, 1), name[token.end() :])

    def __str__(self) -> str:
        return f"{self.base}{'#' * self.padding}{self.suffix}"

    @property
    def is_version(self) -> bool:
        """True if the number is written as a version: ``v001``, ``ver2``, ``Version3``."""
        return _VERSION.fullmatch(self.base) is not None

    def name(self, number: int) -> str:
        """Name of a frame; a minus sign counts as one of the digits, as in C's ``%04d``."""
        return f"{self.base}{number:0{self.padding}d}{self.suffix}"

    def number_text(self, name: str) -> str | None:
        """Return the digits, and sign, that stand where the frame number belongs, else None."""
        if not (name.startswith(self.base) and name.endswith(self.suffix)):
            return None
        text = name[len(self.base) : len(name) - len(self.suffix)]
        return text if _NUMBER.fullmatch(text) and _sign_is_sign(self.base, text) else None


def split_name(name: str, suffixes: tuple[str, ...]) -> NamePattern | None:
    """Read a frame's name: the digits right before one of `suffixes` (any case) are its number.

    Returns
    -------
    NamePattern or None
        With the padding that this one name suggests; None without suffix or digits.
    """
    length = next((len(s) for s in suffixes if name.lower().endswith(s)), 0)
    match = _TRAILING_NUMBER.fullmatch(name[: len(name) - length]) if length else None
    if match is None:
        return None
    base, number = match["base"], match["number"]
    if not _sign_is_sign(base, number):
        base, number = base + number[0], number[1:]
    return NamePattern(base, len(number), name[len(name) - length :])


def split_names(names: Iterable[str], suffixes: tuple[str, ...]) -> dict[str, NamePattern]:
    """Read the names of a folder's files: which digits of each are the frame number.

    The digits right before the suffix are it, as `split_name` has it. Names without such digits, or
    with those of a version that no other file has, are read by the number between separators that
    varies most among the files; of several, or of a file that stands alone, the last.

    Returns
    -------
    dict
        Patterns by name; names without a frame number are left out.
    """
    ends = {name: split_name(name, suffixes) for name in names}
    inner = {
        name: _inner_patterns(name, suffixes)
        for name, end in ends.items()
        if end is None or end.is_version
    }
    trailing = Counter((end.base, end.suffix) for end in ends.values() if end is not None)
    varying = Counter((p.base, p.suffix) for patterns in inner.values() for p in patterns)
    out: dict[str, NamePattern] = {}
    for name, end in ends.items():
        patterns = inner.get(name, ())
        best = max(patterns, key=lambda p: (varying[p.base, p.suffix], len(p.base)), default=None)
        if end is not None and best is not None:
            alone = trailing[end.base, end.suffix] == 1
            best = best if alone and varying[best.base, best.suffix] > 1 else end
        if (pattern := best or end) is not None:
            out[name] = pattern
    return out


def _inner_patterns(name: str, suffixes: tuple[str, ...]) -> tuple[NamePattern, ...]:
    """Return the patterns of the numbers that stand between separators, and not at the end."""
    length = next((len(s) for s in suffixes if name.lower().endswith(s)), 0)
    if not length:
        return ()
    patterns = []
    for match in _BETWEEN.finditer(name[: len(name) - length]):
        start = match.start()
        start += not _sign_is_sign(name[:start], match[0])
        patterns.append(NamePattern(name[:start], match.end() - start, name[match.end() :]))
    return tuple(patterns)


def file_type(suffix: str) -> str:
    """Return the image suffix of what stands after a frame number, in lower case."""
    return f".{suffix.rpartition('.')[2].lower()}"


def group_names(pattern: NamePattern, names: Iterable[str]) -> list[tuple[int, dict[int, str]]]:
    """Split names of one base and suffix by padding.

    Zeros in front tell the padding; names without any belong to the widest padding that would
    print them so, and are unpadded where there is none: ``9, 10`` have padding 1, ``0999, 1000``
    padding 4, ``0001, 9`` are two sequences.

    Parameters
    ----------
    pattern
        Base and suffix; its padding is not looked at.
    names
        File names; those of another base or suffix are skipped.

    Returns
    -------
    list of (int, dict)
        Padding, and names by frame number, ascending.
    """
    texts = {text: name for name in sorted(names) if (text := pattern.number_text(name))}
    known = sorted(_filled_widths(texts), reverse=True)
    groups: dict[int, dict[int, str]] = defaultdict(dict)
    for text, name in texts.items():
        padding = next((p for p in known if is_printed(text, p)), 0)
        groups[padding].setdefault(int(text), name)
    if 0 in groups:
        loose = groups.pop(0)
        groups[min(len(str(abs(number))) for number in loose)] = loose
    return [(padding, dict(sorted(groups[padding].items()))) for padding in sorted(groups)]


def is_printed(text: str, padding: int) -> bool:
    """Whether a number filled to `padding` reads like `text`, the sign counted in or not."""
    number = int(text)
    return text in (f"{number:0{padding}d}", f"{'-' * (number < 0)}{abs(number):0{padding}d}")


def _filled_widths(texts: Iterable[str]) -> set[int]:
    filled = [text for text in texts if len(text) > 1 and text.lstrip("-").startswith("0")]
    # Programs disagree on whether a minus sign counts, so positive numbers decide where there are.
    return {len(t) for t in filled if t[0] != "-"} or {len(t) for t in filled}


def _sign_is_sign(base: str, number: str) -> bool:
    if number[0] != "-":
        return True
    return int(number) != 0 and not (base and base[-1].isalnum())
