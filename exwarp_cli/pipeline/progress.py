"""How a long run tells how far it is: always on stderr, since stdout carries results."""

from __future__ import annotations

import json
import os
import sys
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Protocol, TextIO

from exwarp_cli.errors import UsageError

if TYPE_CHECKING:
    from rich.progress import Progress as RichProgress
    from rich.progress import TaskID

PLAIN_INTERVAL_S = 5.0
"""Least seconds between two plain lines: a farm's log stays readable, a person sees life."""

Clock = Callable[[], float]


class Progress(Protocol):
    """What a pipeline tells while it works.

    `start` comes once and first; `finish` comes last and always, after an error too, so call it in
    a ``finally``. `message` may come at any time.
    """

    def start(self, total: int) -> None:
        """Begin work on `total` frames."""

    def advance(self, frame: int, note: str | None = None) -> None:
        """One more frame is done: its output number, and a word on it such as "skipped"."""

    def message(self, text: str) -> None:
        """Tell the user something, one line."""

    def finish(self) -> None:
        """Stop reporting."""


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
    def eta_s(self) -> float | None:
        """Seconds that the rest will take; None before the first frame."""
        rest = max(self.total - self.done, 0)
        if self.done == 0:
            return None
        if self.done == 1:
            return rest * (self._first - self._begin)
        return rest * (self._clock() - self._first) / (self.done - 1)


class NoProgress:
    """Says nothing but messages, which may be warnings."""

    def __init__(self, stream: TextIO | None = None) -> None:
        self._stream = stream or sys.stderr

    def start(self, total: int) -> None:
        """Say nothing."""

    def advance(self, frame: int, note: str | None = None) -> None:
        """Say nothing."""

    def message(self, text: str) -> None:
        """Print a line."""
        _print_line(self._stream, f"exwarp: {text}")

    def finish(self) -> None:
        """Say nothing."""


class PlainProgress:
    """Lines such as ``exwarp:  25% 10/40, frame 1010, 1:20 left``, for logs."""

    def __init__(self, stream: TextIO | None = None, clock: Clock = time.monotonic) -> None:
        self._stream = stream or sys.stderr
        self._clock = clock
        self._estimate = Estimate(clock)
        self._printed_at = -PLAIN_INTERVAL_S

    def start(self, total: int) -> None:
        """Say how many frames there are to do."""
        self._estimate.start(total)
        self._printed_at = self._clock()
        self.message(f"{total} frame{'' if total == 1 else 's'} to do")

    def advance(self, frame: int, note: str | None = None) -> None:
        """Print a line for the first and the last frame, and now and then between."""
        estimate, now = self._estimate, self._clock()
        estimate.advance()
        ends = estimate.done == 1 or estimate.done == estimate.total
        if not ends and now - self._printed_at < PLAIN_INTERVAL_S:
            return
        self._printed_at = now
        tail = f" ({note})" if note else ""
        self.message(
            f"{estimate.percent:3d}% {estimate.done}/{estimate.total}, frame {frame}{tail}, "
            f"{_clock_text(estimate.eta_s or 0.0)} left"
        )

    def message(self, text: str) -> None:
        """Print a line."""
        _print_line(self._stream, f"exwarp: {text}")

    def finish(self) -> None:
        """Say nothing: the last frame had its line."""


class JsonProgress:
    """One JSON object a line, flushed, for machines.

    Keys: ``event`` ("start", "frame", "message" or "finish"), ``done``, ``total``; with "frame"
    also ``frame``, ``note`` and ``eta_s``; with "message" also ``text``.
    """

    def __init__(self, stream: TextIO | None = None, clock: Clock = time.monotonic) -> None:
        self._stream = stream or sys.stderr
        self._estimate = Estimate(clock)

    def start(self, total: int) -> None:
        """Write the event "start"."""
        self._estimate.start(total)
        self._write("start")

    def advance(self, frame: int, note: str | None = None) -> None:
        """Write the event "frame"."""
        self._estimate.advance()
        eta = self._estimate.eta_s
        self._write("frame", frame=frame, note=note, eta_s=None if eta is None else round(eta, 3))

    def message(self, text: str) -> None:
        """Write the event "message"."""
        self._write("message", text=text)

    def finish(self) -> None:
        """Write the event "finish"; `done` below `total` means that the run broke off."""
        self._write("finish")

    def _write(self, event: str, **rest: object) -> None:
        record = {"event": event, "done": self._estimate.done, "total": self._estimate.total}
        _print_line(self._stream, json.dumps(record | rest))


class BarProgress:
    """A bar with the time left, for a terminal."""

    def __init__(self, stream: TextIO | None = None) -> None:
        self._stream = stream or sys.stderr
        self._bar: RichProgress | None = None
        self._task: TaskID | None = None

    def start(self, total: int) -> None:
        """Show the bar."""
        # Imported here: it takes 60 ms, which runs without a terminal need not pay.
        from rich.console import Console
        from rich.progress import (
            BarColumn,
            MofNCompleteColumn,
            Progress,
            TextColumn,
            TimeRemainingColumn,
        )

        self._bar = Progress(
            BarColumn(),
            MofNCompleteColumn(),
            TimeRemainingColumn(),
            TextColumn("{task.description}", markup=False),
            console=Console(file=self._stream),
        )
        self._task = self._bar.add_task("", total=total)
        self._bar.start()

    def advance(self, frame: int, note: str | None = None) -> None:
        """Move the bar."""
        if self._bar is not None and self._task is not None:
            text = f"frame {frame}" + (f" ({note})" if note else "")
            self._bar.update(self._task, advance=1, description=text)

    def message(self, text: str) -> None:
        """Print a line above the bar."""
        if self._bar is None:
            _print_line(self._stream, f"exwarp: {text}")
        else:
            self._bar.console.print(f"exwarp: {text}", markup=False, highlight=False)

    def finish(self) -> None:
        """Leave the bar as it stands and give the cursor back."""
        if self._bar is not None:
            self._bar.stop()
            self._bar = None


REPORTERS: dict[str, Callable[[], Progress]] = {
    "bar": BarProgress,
    "plain": PlainProgress,
    "json": JsonProgress,
    "none": NoProgress,
}
"""Every way of reporting by its name in ``--progress``."""

KINDS = ("auto", *REPORTERS)
"""Choices of ``--progress``."""


def make_progress(kind: str = "auto") -> Progress:
    """Make the reporter that ``--progress`` names.

    Parameters
    ----------
    kind
        A name in `REPORTERS`, or "auto": the bar on a terminal, plain lines elsewhere.

    Raises
    ------
    UsageError
        For another name.
    """
    if kind == "auto":
        is_terminal = sys.stderr.isatty() and os.environ.get("TERM") != "dumb"
        kind = "bar" if is_terminal else "plain"
    if kind not in REPORTERS:
        raise UsageError(f"--progress {kind!r} is unknown; choose one of {', '.join(KINDS)}")
    return REPORTERS[kind]()


def _print_line(stream: TextIO, line: str) -> None:
    stream.write(line + "\n")
    stream.flush()


def _clock_text(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{rest:02d}" if hours else f"{minutes}:{rest:02d}"
