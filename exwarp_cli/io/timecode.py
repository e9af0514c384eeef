"""Timecodes of videos (SMPTE ST 12-1), carried over to another frame rate."""

from __future__ import annotations

import re
from dataclasses import dataclass
from fractions import Fraction

MOST_RATE = 255
"""Frames per second that a timecode track of MP4 and QuickTime can count."""

_FORM = re.compile(r"(\d\d):(\d\d):(\d\d)([:;.])(\d+)")
_DAY = 24 * 3600


@dataclass(frozen=True)
class Timecode:
    """The timecode of a frame.

    Attributes
    ----------
    text
        ``HH:MM:SS:FF``; with a semicolon or a point before the frames where numbers are dropped.
    rate
        Frames per second that it counts.
    later
        Frames, or parts of one, from the one that has this timecode to the one that is meant.
    """

    text: str
    rate: Fraction
    later: Fraction = Fraction(0)

    def at(self, rate: Fraction) -> str | None:
        """Return the timecode at another rate; None if it cannot be counted there.

        At four times the rate, frame 7 of a second becomes frame 28.
        """
        found, base = _FORM.fullmatch(self.text), round(rate)
        drops = found is not None and found[4] != ":"
        # Numbers are dropped at 29.97 and its multiples alone.
        if found is None or base > MOST_RATE or (drops and rate.denominator != 1001):
            return None
        if drops and (base % 30 or round(self.rate) % 30):
            return None
        count = _count(found, round(self.rate), drops) + self.later
        return _text(int(count * rate / self.rate), base, drops)


def _dropped(base: int) -> int:
    """Return how many numbers are dropped in each minute but every tenth."""
    return base // 15


def _count(found: re.Match[str], base: int, drops: bool) -> int:
    """Return the frames since midnight."""
    hours, minutes, seconds, frames = (int(found[group]) for group in (1, 2, 3, 5))
    minutes += 60 * hours
    count = (60 * minutes + seconds) * base + frames
    return count - _dropped(base) * (minutes - minutes // 10) if drops else count


def _text(count: int, base: int, drops: bool) -> str:
    """Write frames since midnight; invert `_count`."""
    if drops:
        less = _dropped(base)
        ten = 600 * base - 9 * less
        tens, rest = divmod(count, ten)
        # The first of ten minutes drops nothing.
        minutes = 0 if rest < 60 * base else 1 + (rest - 60 * base) // (60 * base - less)
        count += less * (9 * tens + minutes)
    seconds, frames = divmod(count, base)
    hours, seconds = divmod(seconds % _DAY, 3600)
    sign = ";" if drops else ":"
    return f"{hours:02}:{seconds // 60:02}:{seconds % 60:02}{sign}{frames:02}"
