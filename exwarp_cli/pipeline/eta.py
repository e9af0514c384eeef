"""How far a long run is, how long the rest takes, and when it is time to say so."""

from __future__ import annotations

import time
from collections.abc import Callable

from exwarp_cli.domain.wording import counted

INTERVAL_S = 5.0
"""Least seconds between two lines of a log: a farm's stays readable, a person sees life."""

Clock = Callable[[], float]


class Estimate:
    """Counts frames and foretells the rest.

    The first frame is left out of the rate as soon as there are others: it pays for compiling the
    kernels and filling caches, and on short runs would double the estimate.
    """

    def __init__(self, clock: Clock = time.monotonic) -> None:
        self._clock = clock
        self._begin = self._first = clock()
        self.total = 0
        self.done = 0

    def start(self, total: int) -> None:
        """Set the count and start the clock."""
        self.total, self.done = total, 0
        self._begin = self._first = self._clock()

    def advance(self) -> None:
        """Count one frame."""
        self.done += 1
        if self.done == 1:
            self._first = self._clock()

    @property
    def percent(self) -> int:
        """Whole percents done; 100 only at the end."""
        return 100 * self.done // self.total if self.total else 100

    @property
    def tenths(self) -> float:
        """Percents done with one digit behind the point, 0 to 100; 100 only at the end."""
        return min(1000 * self.done // self.total, 1000) / 10 if self.total else 100.0

    @property
    def eta_s(self) -> float | None:
        """Seconds that the rest will take; None before the first frame."""
        rest = max(self.total - self.done, 0)
        if self.done == 0:
            return None
        if self.done == 1:
            return rest * (self._first - self._begin)
        return rest * (self._clock() - self._first) / (self.done - 1)

    @property
    def left(self) -> str:
        """`eta_s` as minutes and seconds, and hours where it has some."""
        minutes, rest = divmod(round(self.eta_s or 0.0), 60)
        hours, minutes = divmod(minutes, 60)
        return f"{hours}:{minutes:02d}:{rest:02d}" if hours else f"{minutes}:{rest:02d}"

    @property
    def frames(self) -> str:
        """How many there are in all, in words."""
        return counted(self.total, "frame")

    @property
    def to_do(self) -> str:
        """What there is to do, in words."""
        return f"{self.frames} to do"

    def state(self, frame: int, note: str | None) -> str:
        """Say how far a run is, which frame was the last, and how long it takes yet."""
        return f"{self.done}/{self.total}, {named(frame, note)}, {self.left} left"


class PacedEstimate(Estimate):
    """An estimate that knows when a log wants its next line."""

    def __init__(self, clock: Clock = time.monotonic) -> None:
        super().__init__(clock)
        self._told_at = -INTERVAL_S

    def start(self, total: int) -> None:
        """Set the count and start the clock; the caller tells the count."""
        super().start(total)
        self._told_at = self._clock()

    def due(self) -> bool:
        """Whether to tell of the last frame that was counted.

        The first and the last one always are, others when `INTERVAL_S` has gone by.
        """
        now = self._clock()
        ends = self.done in (1, self.total)
        if not ends and now - self._told_at < INTERVAL_S:
            return False
        self._told_at = now
        return True


def named(frame: int, note: str | None) -> str:
    """Name a frame with the word on it."""
    return f"frame {frame}" + (f" ({note})" if note else "")
