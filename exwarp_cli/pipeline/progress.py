"""How a long run tells how far it is.

On stderr, since stdout carries results; only ``openjd`` speaks on stdout, where farms listen.
"""

from __future__ import annotations

import json
import os
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol, TextIO

from exwarp_cli.domain.timeline import Slot
from exwarp_cli.domain.wording import one_line, pluralise
from exwarp_cli.errors import (
    ExwarpError,
    IncompleteError,
    OutOfMemoryError,
    OutputError,
    UsageError,
    known_error,
)
from exwarp_cli.runtime.compilation import compilation

if TYPE_CHECKING:
    from rich.progress import Progress as RichProgress
    from rich.progress import TaskID

    from exwarp_cli.domain.frame import Bool, Float32
    from exwarp_cli.domain.results import Score
from exwarp_cli.domain.tiles import Risk

INTERVAL_S = 5.0
"""Least seconds between two lines of a log: a farm's stays readable, a person sees life."""

Clock = Callable[[], float]

ANY = ""
"""The kind of all frames where kinds are not distinguished."""


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
        self._logged_at = self._last
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
        self._last = self._logged_at = self._clock()

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
        return pluralise(self.total, "frame")

    def due(self) -> bool:
        """Whether a log is to tell of the last frame that was counted.

        The first and the last one always are, others when `INTERVAL_S` has gone by.
        """
        now = self._clock()
        if self.done not in (1, self.total) and now - self._logged_at < INTERVAL_S:
            return False
        self._logged_at = now
        return True

    def state(self, frame: int, note: str | None) -> str:
        """Say how far a run is, which frame was the last, and how long it takes yet."""
        return f"{self.done}/{self.total}, {named(frame, note)}, {self.left}"


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


class Progress(Protocol):
    """What a pipeline tells while it works.

    `start` comes once and first; `finish` comes last and always, after an error too, so call it in
    a ``finally``. `message` may come at any time. `fail` is for :func:`reporting` alone, after all
    others. Texts may hold anything: a reporter sees to it that they stay on their line.
    """

    def start(self, total: int, kinds: Mapping[str, int] | None = None, at_once: int = 1) -> None:
        """Begin work on `total` frames; see `Estimate.start` for what the rest tells."""

    def advance(
        self, frame: int, note: str | None = None, kind: str = ANY, made: bool = True
    ) -> None:
        """One more frame is done: its output number, and a word on it such as "skipped".

        `kind` is one of those that `start` received; `made` is false where no work was done.
        """

    def message(self, text: str) -> None:
        """Tell the user something, one line."""

    def finish(self) -> None:
        """Stop reporting."""

    def fail(self, text: str, exit_code: int) -> None:
        """Tell a program that watches why the command fails, and what it will exit with."""


class FrameListener(Protocol):
    """Is shown some of the frames of a run, pixel by pixel, while they are in memory.

    Reading a frame back costs time, so that a run asks first. Frames come in their order, from the
    thread that computes; one whose score is known late may come again at the end.
    """

    def plan(self, groups: Sequence[Sequence[int]]) -> None:
        """Hear, before the work, the numbers of all frames that will come.

        Parameters
        ----------
        groups
            Frames that are best seen together: the slots of a key interval, or single frames.
        """

    def wants(self, number: int, score: Score | None, risk: Risk | None = None) -> bool:
        """Whether the frame of this number, with this score and predicted error, is to be shown."""

    def frame(
        self, number: int, shown: Float32, truth: Float32 | None, mask: Bool | None, is_key: bool
    ) -> None:
        """Show a frame.

        Parameters
        ----------
        number
            Its output number.
        shown
            float32 [H, W, 3] or more, scene-linear, on the display window.
        truth
            What it ought to be, as `shown`; None without ground truth. A key frame is the truth.
        mask
            bool [H, W], its holes; None where nothing tells.
        is_key
            Whether it is a rendered frame.
        """


class NoProgress:
    """Says nothing but messages, which may be warnings."""

    def __init__(self, stream: TextIO | None = None) -> None:
        self._stream = stream or sys.stderr

    def start(self, total: int, kinds: Mapping[str, int] | None = None, at_once: int = 1) -> None:
        """Say nothing."""

    def advance(
        self, frame: int, note: str | None = None, kind: str = ANY, made: bool = True
    ) -> None:
        """Say nothing."""

    def message(self, text: str) -> None:
        """Print a line."""
        _print_line(self._stream, f"exwarp: {text}")

    def finish(self) -> None:
        """Say nothing."""

    def fail(self, text: str, exit_code: int) -> None:
        """Say nothing: the command prints the sentence itself."""


class PlainProgress(NoProgress):
    """Lines such as ``exwarp:  25% 10/40, frame 1010, 1:20 left``, for logs."""

    def __init__(self, stream: TextIO | None = None, clock: Clock = time.monotonic) -> None:
        super().__init__(stream)
        self._estimate = Estimate(clock)

    def start(self, total: int, kinds: Mapping[str, int] | None = None, at_once: int = 1) -> None:
        """Tell how many frames there are to do."""
        self._estimate.start(total, kinds, at_once)
        self._tell(f"{self._estimate.frames} to do")

    def advance(
        self, frame: int, note: str | None = None, kind: str = ANY, made: bool = True
    ) -> None:
        """Tell of the first and the last frame, and now and then between."""
        self._estimate.advance(kind, made)
        if self._estimate.due():
            self._tell(self._estimate.state(frame, note))

    def _tell(self, status: str) -> None:
        percent = f"{self._estimate.percent:3d}% " if self._estimate.done else ""
        self.message(f"{percent}{status}")


class OpenJdProgress(PlainProgress):
    """Lines of Open Job Description's sessions, for farms that run its jobs.

    ``openjd_progress: 25.0`` and ``openjd_status: 10/40, frame 1010, 1:20 left`` come together, as
    often as plain lines; ``openjd_fail: SENTENCE`` at the end of a command that fails, but for one
    that left out what it was allowed to leave out: its sentence is the last status. Messages are
    plain lines of the log: as a status each would stand there until the next one, though it is no
    state. The specification lets actions write to stdout or stderr ("How Jobs Are Run", Stdout and
    Stderr Messages), and there are runners that read stdout alone.
    """

    def __init__(self, stream: TextIO | None = None, clock: Clock = time.monotonic) -> None:
        super().__init__(stream or sys.stdout, clock)

    def fail(self, text: str, exit_code: int) -> None:
        """Tell why; the runner learns the exit code from the process itself."""
        if exit_code == IncompleteError.exit_code:
            _print_line(self._stream, f"openjd_status: {text}")
            return
        # Never empty: a runner takes no line that ends with the colon.
        _print_line(self._stream, f"openjd_fail: {one_line(text) or f'exit code {exit_code}'}")

    def _tell(self, status: str) -> None:
        estimate = self._estimate
        if estimate.done and estimate.done == estimate.total:
            status = f"{estimate.frames} done"
        _print_line(self._stream, f"openjd_progress: {estimate.tenths}")
        _print_line(self._stream, f"openjd_status: {status}")


class JsonProgress:
    """One JSON object a line, flushed, for machines.

    Keys: ``event`` ("start", "frame", "message", "finish" or "fail"), ``done``, ``total``; with
    "frame" also ``frame``, ``note`` and ``eta_s``, null while it is unknown; with "message" and
    "fail" also ``text``; with "fail" also ``exit_code``.
    """

    def __init__(self, stream: TextIO | None = None, clock: Clock = time.monotonic) -> None:
        self._stream = stream or sys.stderr
        self._estimate = Estimate(clock)

    def start(self, total: int, kinds: Mapping[str, int] | None = None, at_once: int = 1) -> None:
        """Write the event "start"."""
        self._estimate.start(total, kinds, at_once)
        self._write("start")

    def advance(
        self, frame: int, note: str | None = None, kind: str = ANY, made: bool = True
    ) -> None:
        """Write the event "frame"."""
        self._estimate.advance(kind, made)
        eta = self._estimate.eta_s
        self._write("frame", frame=frame, note=note, eta_s=None if eta is None else round(eta, 3))

    def message(self, text: str) -> None:
        """Write the event "message"."""
        self._write("message", text=text)

    def finish(self) -> None:
        """Write the event "finish"; `done` below `total` means that the run broke off."""
        self._write("finish")

    def fail(self, text: str, exit_code: int) -> None:
        """Write the event "fail"."""
        self._write("fail", text=text, exit_code=exit_code)

    def _write(self, event: str, **rest: object) -> None:
        record = {"event": event, "done": self._estimate.done, "total": self._estimate.total}
        # JSON spells out line ends itself, and a line that is cut would be no JSON.
        _write_line(self._stream, json.dumps(record | rest))


class BarProgress(NoProgress):
    """A bar with the time left, for a terminal."""

    def __init__(self, stream: TextIO | None = None, clock: Clock = time.monotonic) -> None:
        super().__init__(stream)
        self._estimate = Estimate(clock)
        self._bar: RichProgress | None = None
        self._task: TaskID | None = None

    def start(self, total: int, kinds: Mapping[str, int] | None = None, at_once: int = 1) -> None:
        """Show the bar."""
        self._estimate.start(total, kinds, at_once)
        # Imported here: it takes 60 ms, which runs without a terminal need not pay.
        from rich.console import Console
        from rich.progress import (
            BarColumn,
            MofNCompleteColumn,
            Progress,
            TextColumn,
        )

        self._bar = Progress(
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn("{task.fields[left]}", markup=False),
            TextColumn("{task.description}", markup=False),
            console=Console(file=self._stream, emoji=False),
        )
        self._task = self._bar.add_task("", total=total, left=self._estimate.left)
        self._bar.start()

    def advance(
        self, frame: int, note: str | None = None, kind: str = ANY, made: bool = True
    ) -> None:
        """Move the bar."""
        self._estimate.advance(kind, made)
        if self._bar is not None and self._task is not None:
            self._bar.update(
                self._task,
                advance=1,
                description=one_line(named(frame, note)),
                left=self._estimate.left,
            )

    def message(self, text: str) -> None:
        """Print a line above the bar."""
        if self._bar is None:
            super().message(text)
        else:
            self._bar.console.print(one_line(f"exwarp: {text}"), markup=False, highlight=False)

    def finish(self) -> None:
        """Leave the bar as it stands and give the cursor back."""
        if self._bar is not None:
            self._bar.stop()
            self._bar = None


REPORTERS: dict[str, Callable[[], Progress]] = {
    "bar": BarProgress,
    "plain": PlainProgress,
    "json": JsonProgress,
    "openjd": OpenJdProgress,
    "none": NoProgress,
}
"""Every way of reporting by its name in ``--progress``."""

KINDS = ("auto", *REPORTERS)
"""Choices of ``--progress``."""


def make_progress(kind: str = "auto", *, results_on_stdout: bool = False) -> Progress:
    """Make the reporter that ``--progress`` names.

    Parameters
    ----------
    kind
        A name in `REPORTERS`, or "auto": the bar on a terminal, plain lines elsewhere.
    results_on_stdout
        Whether the command prints a table or a JSON document there, which a program reads: then
        ``openjd`` goes to stderr too.

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
    if kind == "openjd" and results_on_stdout:
        return OpenJdProgress(sys.stderr)
    return REPORTERS[kind]()


@contextmanager
def reporting(kind: str = "auto", *, results_on_stdout: bool = False) -> Iterator[Progress]:
    """Make a reporter for a block; it receives the reason when the block raises.

    Interruptions are no failure: the sender knows of them. Parameters and errors are those of
    :func:`make_progress`; what the block raises goes on.
    """
    progress = make_progress(kind, results_on_stdout=results_on_stdout)
    try:
        with compilation.messages_to(progress.message):
            yield progress
    except Exception as error:
        progress.fail(*_reason(error))
        raise


def _reason(error: Exception) -> tuple[str, int]:
    """Return a sentence and the exit code; stderr shows those of defects in full."""
    known = known_error(error)
    if known is not None:
        return str(known), known.exit_code
    if isinstance(error, MemoryError):
        return "the memory does not suffice", OutOfMemoryError.exit_code
    return f"unexpected {type(error).__name__}: {error}", ExwarpError.exit_code


def _print_line(stream: TextIO, text: str) -> None:
    """Write one line that the stream can encode, and flush it: who reads it reads it now."""
    encoding = getattr(stream, "encoding", None) or "utf-8"
    _write_line(stream, one_line(text).encode(encoding, "backslashreplace").decode(encoding))


def _write_line(stream: TextIO, line: str) -> None:
    """Write one line and flush it; a stream that fails must not end the work."""
    with suppress(OSError, OutputError):
        stream.write(line + "\n")
        stream.flush()
