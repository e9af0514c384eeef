"""Reporters of the progress of a long run, chosen by ``--progress``.

They write to stderr, because stdout carries results. Only ``openjd`` writes to stdout, which farms
read.
"""

from __future__ import annotations

import json
import os
import sys
import time
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Protocol, TextIO

from exwarp_cli import errors
from exwarp_cli.domain.wording import one_line, pluralise
from exwarp_cli.runtime.compilation import compilation

if TYPE_CHECKING:
    from rich.progress import Progress as RichProgress

    from exwarp_cli.domain.frame import Bool, Float32
    from exwarp_cli.domain.results import Score
    from exwarp_cli.domain.tiles import Risk

INTERVAL_S = 5.0  # least seconds between two lines of a log
ANY = ""  # the kind of all frames where kinds are not distinguished

Clock = Callable[[], float]


def kind_of(index: int) -> str:
    """Return the kind of work of a slot by its index in the key interval, 0 for the key frame."""
    # Methods differ by index: `s3` warps slot 1 and extrapolates slots 2 and 3.
    return f"slot {index}" if index else "key"


class Progress:
    """Receives the progress of a pipeline; this one shows only messages, which may be warnings.

    `start` comes once and first; `finish` comes last, after an error too. `message` may come at any
    time. Only :func:`reporting` calls `fail`, after all others. Reporters keep any text on one
    line.

    The time left is known when every kind that remains was seen, because a key frame that is passed
    through takes a small part of what an extrapolated frame takes.
    """

    def __init__(self, stream: TextIO | None = None, clock: Clock = time.monotonic) -> None:
        self._stream, self._clock = stream or sys.stderr, clock
        self.total = self.done = 0

    def start(self, total: int, kinds: Mapping[str, int] | None = None, at_once: int = 1) -> None:
        """Begin work on `total` frames.

        `kinds` says how many of the frames are of which kind; None where all take about as long.
        `at_once` processes work in parallel. So many first frames of a kind are left out of its
        mean: they pay for compiled kernels and full caches.
        """
        self.total, self.done = total, 0
        self._remaining = Counter({ANY: total} if kinds is None else kinds)
        self._at_once = at_once
        # By kind: frames that took work, and seconds of the first ones and of the others.
        self._counts: Counter[str] = Counter()
        self._first_s: dict[str, float] = defaultdict(float)
        self._later_s: dict[str, float] = defaultdict(float)
        self._last = self._clock()  # when the newest frame was done
        self._show()

    def advance(
        self, frame: int, note: str | None = None, kind: str = ANY, made: bool = True
    ) -> None:
        """Count one more frame as done, by its output number.

        `note` is a word about it, such as "skipped", `kind` one of those that `start` received.
        `made` is False where no work was done: for frames of an earlier run and for skipped ones.
        """
        now = self._clock()
        kind = kind if kind in self._remaining else ANY
        self.done += 1
        self._remaining[kind] -= 1
        if made:
            self._counts[kind] += 1
            seconds = self._first_s if self._counts[kind] <= self._at_once else self._later_s
            seconds[kind] += now - self._last
        self._last = now
        self._show(frame, note)

    @property
    def tenths(self) -> float:
        """Per cent done with one decimal, 0 to 100; 100 only at the end."""
        return min(1000 * self.done // self.total, 1000) / 10 if self.total else 100.0

    @property
    def eta_s(self) -> float | None:
        """Seconds left; None before each kind that remains was seen."""
        if self.done >= self.total:
            return 0.0
        remaining = {kind: count for kind, count in self._remaining.items() if count > 0}
        if not remaining.keys() <= self._counts.keys():
            return None
        eta = 0.0
        for kind, count in remaining.items():
            later = self._counts[kind] - self._at_once
            # The first ones begin together, so as many end in the time of one.
            mean = self._later_s[kind] / later if later > 0 else self._first_s[kind] / self._at_once
            eta += count * mean
        return eta

    @property
    def left(self) -> str:
        """`eta_s` in words."""
        seconds = self.eta_s
        if seconds is None:
            return "time left unknown"
        minutes, seconds = divmod(round(seconds), 60)
        hours, minutes = divmod(minutes, 60)
        text = f"{hours}:{minutes:02d}:{seconds:02d}" if hours else f"{minutes}:{seconds:02d}"
        return f"{text} left"

    def message(self, text: str) -> None:
        """Show the user one line."""
        self._write_line(one_line(f"exwarp: {text}"))

    def finish(self) -> None:
        """Stop reporting."""

    def fail(self, text: str, exit_code: int) -> None:
        """Send a watching program the reason why the command fails, and its exit code."""

    def _show(self, frame: int | None = None, note: str | None = None) -> None:
        """Show a frame that is done; without one, at the start, what there is to do."""

    def _write_line(self, line: str) -> None:
        """Write text without line ends in what the stream can encode."""
        encoding = getattr(self._stream, "encoding", None) or "utf-8"
        with suppress(OSError, errors.OutputError):  # a stream that fails must not end the work
            self._stream.write(line.encode(encoding, "backslashreplace").decode(encoding) + "\n")
            self._stream.flush()


class Silence(Progress):
    """Shows nothing at all, for callers from Python."""

    def message(self, text: str) -> None:
        """Drop a line."""


class FrameListener(Protocol):
    """Is shown some of the frames of a run, pixel by pixel, while they are in memory.

    A run asks first, because reading a frame back costs time. Frames come in their order, from the
    thread that computes; one whose score is known late may come again at the end.
    """

    def plan(self, groups: Sequence[Sequence[int]]) -> None:
        """Receive, before the work, the numbers of all frames that will come.

        Frames of a group are best seen together: the slots of a key interval, or single frames.
        """

    def wants(self, number: int, score: Score | None, risk: Risk | None = None) -> bool:
        """Return whether to show the frame of a number, with its score and predicted error."""

    def frame(
        self, number: int, shown: Float32, truth: Float32 | None, mask: Bool | None, is_key: bool
    ) -> None:
        """Show a frame, by its output number.

        `shown` is float32 [H, W, 3] or more, scene-linear, on the display window; `truth` is what
        it ought to be, alike, None without ground truth. A key frame is the truth. `mask` is bool
        [H, W], its holes; None where they are unknown. `is_key` is True for a rendered frame.
        """


class PlainProgress(Progress):
    """Lines such as ``exwarp:  25% 10/40, frame 1010, 1:20 left``, for logs."""

    _logged_at = 0.0

    def _show(self, frame: int | None = None, note: str | None = None) -> None:
        is_due = self._last - self._logged_at >= INTERVAL_S
        if frame is None:
            self._logged_at = self._last
            self._print_status(f"{pluralise(self.total, 'frame')} to do")
        elif is_due or self.done in (1, self.total):
            self._logged_at = self._last
            word = f" ({note})" if note else ""
            self._print_status(f"{self.done}/{self.total}, frame {frame}{word}, {self.left}")

    def _print_status(self, status: str) -> None:
        percent = f"{int(self.tenths):3d}% " if self.done else ""
        self.message(f"{percent}{status}")


class OpenJdProgress(PlainProgress):
    """Lines of Open Job Description's sessions, for farms that run its jobs.

    ``openjd_progress: 25.0`` and ``openjd_status: 10/40, frame 1010, 1:20 left`` come as often as
    plain lines. ``openjd_fail: SENTENCE`` ends a command that fails. Where that only skipped what
    it was allowed to skip, its sentence is the last status. Messages are plain lines, because a
    status would stay until the next one.
    """

    def fail(self, text: str, exit_code: int) -> None:
        """Print the reason; the runner gets the exit code from the process."""
        if exit_code == errors.IncompleteError.exit_code:
            self._write_line(one_line(f"openjd_status: {text}"))
            return
        # Never empty: runners ignore a line that ends with the colon.
        reason = one_line(text) or f"exit code {exit_code}"
        self._write_line(one_line(f"openjd_fail: {reason}"))

    def _print_status(self, status: str) -> None:
        if self.done and self.done == self.total:
            status = f"{pluralise(self.total, 'frame')} done"
        self._write_line(f"openjd_progress: {self.tenths}")
        self._write_line(one_line(f"openjd_status: {status}"))


class JsonProgress(Progress):
    """One JSON object a line, flushed, for machines.

    Keys: ``event`` ("start", "frame", "message", "finish" or "fail"), ``done``, ``total``; with
    "frame" also ``frame``, ``note`` and ``eta_s``, null while it is unknown; with "message" and
    "fail" also ``text``; with "fail" also ``exit_code``.
    """

    def _show(self, frame: int | None = None, note: str | None = None) -> None:
        if frame is None:
            self._write("start")
            return
        eta = self.eta_s
        self._write("frame", frame=frame, note=note, eta_s=None if eta is None else round(eta, 3))

    def message(self, text: str) -> None:
        """Write the event "message"."""
        self._write("message", text=text)

    def finish(self) -> None:
        """Write the event "finish"; `done` below `total` means that the run stopped early."""
        self._write("finish")

    def fail(self, text: str, exit_code: int) -> None:
        """Write the event "fail"."""
        self._write("fail", text=text, exit_code=exit_code)

    def _write(self, event: str, **more: object) -> None:
        record = {"event": event, "done": self.done, "total": self.total}
        # JSON escapes line ends itself, and a line that is cut would be no JSON.
        self._write_line(json.dumps(record | more))


class BarProgress(Progress):
    """A bar with the time left, for a terminal."""

    _bar: RichProgress | None = None

    def _show(self, frame: int | None = None, note: str | None = None) -> None:
        if frame is not None and self._bar is not None:
            description = one_line(f"frame {frame} ({note})" if note else f"frame {frame}")
            task = self._bar.task_ids[0]
            self._bar.update(task, advance=1, description=description, left=self.left)
            return
        # Imported here: it takes 60 ms, which runs without a terminal need not pay.
        from rich import console, progress

        self._bar = progress.Progress(
            # Moves while a frame takes long; ASCII, for any terminal.
            progress.SpinnerColumn("line"),
            progress.BarColumn(),
            progress.MofNCompleteColumn(),
            progress.TextColumn("{task.fields[left]}", markup=False),
            progress.TextColumn("{task.description}", markup=False),
            console=console.Console(file=self._stream, emoji=False),
        )
        self._bar.add_task("", total=self.total, left=self.left)
        self._bar.start()

    def message(self, text: str) -> None:
        """Print a line above the bar."""
        if self._bar is None:
            super().message(text)
        else:
            self._bar.console.print(one_line(f"exwarp: {text}"), markup=False, highlight=False)

    def finish(self) -> None:
        """Leave the bar as it is and show the cursor again."""
        if self._bar is not None:
            self._bar.stop()
            self._bar = None


REPORTERS: dict[str, type[Progress]] = {
    "bar": BarProgress,
    "plain": PlainProgress,
    "json": JsonProgress,
    "openjd": OpenJdProgress,
    "none": Progress,
}
KINDS = ("auto", *REPORTERS)  # choices of ``--progress``


@contextmanager
def reporting(kind: str = "auto", *, results_on_stdout: bool = False) -> Iterator[Progress]:
    """Yield the reporter that ``--progress`` names; it receives the reason of a failure.

    `kind` is a name in `REPORTERS`, or "auto": the bar on a terminal, else plain lines. With
    `results_on_stdout` the command prints a table or a JSON document there, which a program reads:
    then ``openjd`` goes to stderr too. Interruptions are no failure: the sender knows about them.
    Raises UsageError for another name.
    """
    if kind == "auto":
        is_terminal = sys.stderr.isatty() and os.environ.get("TERM") != "dumb"
        kind = "bar" if is_terminal else "plain"
    if kind not in REPORTERS:
        raise errors.UsageError(f"--progress {kind!r} is unknown; choose one of {', '.join(KINDS)}")
    # "How Jobs Are Run", Stdout and Stderr Messages, allows both streams; some runners read stdout
    # alone.
    is_for_runner = kind == "openjd" and not results_on_stdout
    progress = REPORTERS[kind](sys.stdout if is_for_runner else sys.stderr)
    try:
        with compilation.messages_to(progress.message):
            yield progress
    except Exception as error:
        user_error = errors.to_exwarp_error(error)
        if user_error is not None:
            progress.fail(str(user_error), user_error.exit_code)
        elif isinstance(error, MemoryError):
            progress.fail("the memory does not suffice", errors.OutOfMemoryError.exit_code)
        else:  # a defect, which stderr shows in full
            text = f"unexpected {type(error).__name__}: {error}"
            progress.fail(text, errors.ExwarpError.exit_code)
        raise
