"""Names of frames and of passes: tokens such as ``####``, padding, grouping. Strings only.

The frame number stands right before the image suffix, or further ahead
(``beauty_0101_denoised.exr``): then it is the one that varies. It may carry a minus sign where the
text before it is empty or ends in a separator, so ``shot-0001.exr`` is frame 1 and
``shot.-0001.exr`` is frame -1.

Movie Render Queue, Redshift, V-Ray and Arnold can write a sequence a pass. The beauty has the
shot's name alone, or a name of its own behind it; each pass has the pass's name behind the shot's:
``shot.####.exr``, ``shot.Z.####.exr``.
"""

from __future__ import annotations

import re
from collections import Counter, defaultdict
from collections.abc import Iterable
from dataclasses import dataclass

from exwarp_cli.io.channels import CRYPTOMATTE_NAME, Role, role_named

_TOKEN = re.compile(r"#+|@+|%[0-9]{0,2}d|\$F[0-9]{0,2}")
_NUMBER = re.compile(r"-?[0-9]+")
# The text before a number that is written as a version: v001, ver2, Version3.
VERSION = re.compile(r"(^|.*[^a-z])v(er(sion)?)?", re.DOTALL | re.IGNORECASE)
_BETWEEN = re.compile(r"(?<![^._ -])-?[0-9]+(?=[._ -])")
_TRAILING_NUMBER = re.compile(r"(?P<base>.*?)(?P<number>-?[0-9]+)", re.DOTALL)

SEPARATORS = "._- "
# What programs put before the name of a pass, as V-Ray's VRayVelocity.
_PROGRAM = re.compile(r"(?i)(vray|redshift|arnold|movierenderqueue)[ _]*(?=[A-Za-z])")
# Where a pass's name may begin: after a separator, or at a capital as in shotBeauty.
_PART = re.compile(r"(?<=[._\- ])(?=[^._\- ])")
_BOUNDARY = re.compile(r"(?<=[._\- ])(?=[^._\- ])|(?<=[a-z0-9])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])")


@dataclass(frozen=True, order=True)
class NamePattern:
    """A file name with a frame number in it.

    `base` and `suffix` are the texts before and after the number, ``shot.`` and ``.exr``; `padding`
    is its least count of digits.
    """

    base: str
    padding: int
    suffix: str

    @staticmethod
    def parse(name: str) -> NamePattern | None:
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
        return NamePattern(name[: token.start()], max(padding, 1), name[token.end() :])

    def __str__(self) -> str:
        return f"{self.base}{'#' * self.padding}{self.suffix}"

    def name(self, number: int) -> str:
        """Return a frame's name; a minus sign counts as one of the digits, as in C's ``%04d``."""
        return f"{self.base}{number:0{self.padding}d}{self.suffix}"

    def number_text(self, name: str) -> str | None:
        """Return the digits, and sign, at the place of the frame number, or None."""
        if not (name.startswith(self.base) and name.endswith(self.suffix)):
            return None
        text = name[len(self.base) : len(name) - len(self.suffix)]
        return text if _NUMBER.fullmatch(text) and _is_sign(self.base, text) else None


def _is_sign(base: str, number: str) -> bool:
    """False for a hyphen that separates the text before from the number."""
    if number[0] != "-":
        return True
    return int(number) != 0 and not (base and base[-1].isalnum())


def split_names(names: Iterable[str], suffixes: tuple[str, ...]) -> dict[str, NamePattern]:
    """Return the patterns of a folder's files by name, without names that have no frame number.

    The digits right before one of `suffixes` (any case) are the number; their count is the padding.
    Names without such digits, or with those of a version that no other file has, are read by the
    number between separators that varies most among the files; of several, or of a file that stands
    alone, the last.
    """
    ends: dict[str, NamePattern | None] = {}
    inner: dict[str, list[NamePattern]] = defaultdict(list)
    for name in names:
        length = next((len(s) for s in suffixes if name.lower().endswith(s)), 0)
        if not length:
            continue
        stem, end = name[:-length], None
        if match := _TRAILING_NUMBER.fullmatch(stem):
            base, number = match["base"], match["number"]
            if not _is_sign(base, number):
                base, number = base + number[0], number[1:]
            end = NamePattern(base, len(number), name[-length:])
        ends[name] = end
        if end is None or VERSION.fullmatch(end.base):
            for match in _BETWEEN.finditer(stem):
                start = match.start()
                start += not _is_sign(name[:start], match[0])
                width = match.end() - start
                inner[name].append(NamePattern(name[:start], width, name[match.end() :]))
    trailing = Counter((end.base, end.suffix) for end in ends.values() if end is not None)
    varying = Counter((p.base, p.suffix) for patterns in inner.values() for p in patterns)
    split: dict[str, NamePattern] = {}
    for name, end in ends.items():
        patterns = inner.get(name, ())
        best = max(patterns, key=lambda p: (varying[p.base, p.suffix], len(p.base)), default=None)
        if end is not None and best is not None:
            is_alone = trailing[end.base, end.suffix] == 1
            best = best if is_alone and varying[best.base, best.suffix] > 1 else end
        if (pattern := best or end) is not None:
            split[name] = pattern
    return split


def file_type(suffix: str) -> str:
    """Return the image suffix of the text after a frame number, in lower case."""
    return f".{suffix.rpartition('.')[2].lower()}"


def group_names(pattern: NamePattern, names: Iterable[str]) -> list[tuple[int, dict[int, str]]]:
    """Group names with a pattern's base and suffix by padding: names by frame number, ascending.

    Leading zeros tell the padding; names without any belong to the widest padding that would
    print them so, and are unpadded where there is none: ``9, 10`` have padding 1, ``0999, 1000``
    padding 4, ``0001, 9`` are two sequences.
    """
    texts = {text: name for name in sorted(names) if (text := pattern.number_text(name))}
    filled = [text for text in texts if len(text) > 1 and text.lstrip("-").startswith("0")]
    # Programs disagree on whether a minus sign counts, so positive numbers decide where there are.
    lengths = {len(t) for t in filled if t[0] != "-"} or {len(t) for t in filled}
    widths = sorted(lengths, reverse=True)
    groups: dict[int, dict[int, str]] = defaultdict(dict)
    for text, name in texts.items():
        paddings = (width for width in widths if is_padded_to(text, width))
        groups[next(paddings, 0)].setdefault(int(text), name)
    if 0 in groups:
        unpadded = groups.pop(0)
        groups[min(len(str(abs(number))) for number in unpadded)] = unpadded
    return [(padding, dict(sorted(groups[padding].items()))) for padding in sorted(groups)]


def is_padded_to(text: str, padding: int) -> bool:
    """Return True if `text` is its number filled to `padding`, the sign counted in or not."""
    number = int(text)
    return text in (f"{number:0{padding}d}", f"{'-' * (number < 0)}{abs(number):0{padding}d}")


@dataclass(frozen=True)
class PassName:
    """A sequence's name split into its shot's and its pass's; see `split_pass`."""

    stem: str  # without separators at its end
    shot: str  # the stem if no pass is known
    name: str = ""
    role: Role | None = None
    is_data: bool = False  # True for a pass that cannot be a beauty

    def extends(self, shot: str) -> bool:
        """Return True if the name is a shot's with another word behind it."""
        stem, length = self.stem, len(shot)
        if not shot or not stem.startswith(shot) or len(stem) == length:
            return False
        return stem[length] in SEPARATORS or _BOUNDARY.match(stem, length) is not None


def split_pass(base: str) -> PassName:
    """Split the text before a sequence's number into the shot's name and the pass's.

    The pass has the role that its name stands for, with or without its program's name.
    """
    stem = base.rstrip(SEPARATORS)
    # At separators first: shot.VRayVelocity is no pass of shot.VRay.
    for boundary in (_PART, _BOUNDARY):
        for start in (0, *(match.start() for match in boundary.finditer(stem))):
            tail = stem[start:]
            is_matte = tail.lower().startswith("crypto") and bool(CRYPTOMATTE_NAME.search(tail))
            role = role_named(_PROGRAM.sub("", tail, count=1) if _PROGRAM.match(tail) else tail)
            if role is not None or is_matte:
                is_data = is_matte or role is not Role.COLOUR
                return PassName(stem, stem[:start].rstrip(SEPARATORS), tail, role, is_data)
    return PassName(stem, stem)
