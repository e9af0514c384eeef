"""How far a long run is, how long the rest takes, and when it is time to say so."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

from exwarp_cli.domain.timeline import Slot
from exwarp_cli.domain.wording import counted

INTERVAL_S = 5.0
"""Least seconds between two lines of a log: a farm's stays readable, a person sees life."""

Clock = Callable[[], float]

ANY = ""
"""The kind of frames that are not told apart."""


@dataclass
class _Cost:
    """Seconds of the steps of one kind: how many, of all, and of those that came first."""

    count: int = 0
    seconds: float = 0.0
    first: float = 0.0

    def add(self, seconds: float, at_once: int) -> None:
        """Take in a step."""
        self.count += 1
        self.seconds += seconds
        if self.count <= at_once:
            self.first += seconds

    def mean(self, at_once: int) -> float:
        """Return seconds a step, without the first ones as soon as there are others."""
        if self.count <= at_once:  # begun together, as many end in the time of one
            return self.seconds / at_once
        return (self.seconds - self.first) / (self.count - at_once)


class Estimate:
    """Counts frames and foretells the rest, by what each kind of frame took.

    A key frame that is passed through takes a small part of what an extrapolated frame takes. So
    the rest is known when every kind that is left was seen. The first frame of a kind is left out
    of its mean as soon as there are others: it pays for compiling the kernels and filling caches.
    """

    def __init__(self, clock: Clock = time.monotonic) -> None:
        self._clock = clock
        self._last = clock()
        self._rest: Counter[str] = Counter()
        self._costs: dict[str, _Cost] = {}
        self._at_once = 1
        self.total = 0
        self.done = 0

    def start(self, total: int, kinds: Mapping[str, int] | None = None, at_once: int = 1) -> None:
        """Set the count and start the clock.

        Parameters
        ----------
        total
            Frames to do.
        kinds
            How many of them are of which kind; None where all take about as long.
        at_once
            Processes that work side by side: so many first frames of a kind are left out.
        """
        self.total, self.done = total, 0
        self._rest = Counter({ANY: total} if kinds is None else kinds)
        self._costs, self._at_once = {}, at_once
        self._last = self._clock()

    def advance(self, kind: str = ANY, made: bool = True) -> None:
        """Count one frame; what an earlier run wrote, or what is left out, took no work."""
        now = self._clock()
        kind = kind if kind in self._rest else ANY
        self.done += 1
        self._rest[kind] -= 1
        if made:
            self._costs.setdefault(kind, _Cost()).add(now - self._last, self._at_once)
        self._last = now

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
        """Seconds that the rest will take; None before each kind of it was seen."""
        if self.done >= self.total:
            return 0.0
        left = {kind: count for kind, count in self._rest.items() if count > 0}
        if not left.keys() <= self._costs.keys():
            return None
        return sum(count * self._costs[kind].mean(self._at_once) for kind, count in left.items())

    @property
    def left(self) -> str:
        """`eta_s` in words: minutes and seconds, and hours where it has some."""
        seconds = self.eta_s
        if seconds is None:
            return "time left unknown"
        minutes, rest = divmod(round(seconds), 60)
        hours, minutes = divmod(minutes, 60)
        text = f"{hours}:{minutes:02d}:{rest:02d}" if hours else f"{minutes}:{rest:02d}"
        return f"{text} left"

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
        return f"{self.done}/{self.total}, {named(frame, note)}, {self.left}"


class PacedEstimate(Estimate):
    """An estimate that knows when a log wants its next line."""

    def __init__(self, clock: Clock = time.monotonic) -> None:
        super().__init__(clock)
        self._told_at = -INTERVAL_S

    def start(self, total: int, kinds: Mapping[str, int] | None = None, at_once: int = 1) -> None:
        """Set the count and start the clock; the caller tells the count."""
        super().start(total, kinds, at_once)
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


def kind_of(index: int) -> str:
    """Name the kind of work of a slot by its place in the key interval, 0 for the key frame.

    A method makes each place in its own way: `s3` warps slot 1 and extrapolates slots 2 and 3.
    """
    return f"slot {index}" if index else "key"


def kinds_of(slots: Iterable[Slot]) -> Counter[str]:
    """Count slots by their kind of work."""
    return Counter(kind_of(slot.index) for slot in slots)
