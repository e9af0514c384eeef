"""What is said of key intervals that are left out."""

from __future__ import annotations

from collections.abc import Sequence

from exwarp_cli.domain.results import LeftOut, RunSummary
from exwarp_cli.domain.timeline import Slot, Timeline, ranges
from exwarp_cli.domain.wording import counted
from exwarp_cli.errors import IncompleteError
from exwarp_cli.pipeline.progress import Progress


def left_out(timeline: Timeline, key: int, slots: Sequence[Slot], reason: str) -> LeftOut:
    """Return what is recorded of an interval, by its index, that lacks some slots."""
    frames = tuple(timeline.number(slot) for slot in slots)
    return LeftOut(timeline.numbers[key], frames, reason)


def tell_left_out(progress: Progress, one: LeftOut) -> None:
    """Say at once what is left out, and why."""
    progress.message(f"left out {_named(one.frames)}: {one.reason}")


def require_complete(run: RunSummary) -> None:
    """Refuse to call a run complete that left something out.

    Raises
    ------
    IncompleteError
        When it did.
    """
    if not run.left_out:
        return
    many, frames = len(run.left_out), [n for one in run.left_out for n in one.frames]
    raise IncompleteError(
        f"{many} of {counted(len(run.selected), 'key interval')} {'was' if many == 1 else 'were'} "
        f"left out ({_named(frames)}), see above or left_out in report.json; mend the input and "
        "run again with --skip-existing"
    )


def _named(frames: Sequence[int]) -> str:
    return f"frame{'s' if len(frames) != 1 else ''} {ranges(frames)}"
