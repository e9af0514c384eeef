"""What is said of what is left out."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from exwarp_cli.domain.results import LeftOut, RunSummary
from exwarp_cli.domain.timeline import Slot, Timeline, ranges
from exwarp_cli.domain.wording import counted
from exwarp_cli.errors import IncompleteError
from exwarp_cli.pipeline.progress import Progress


def left_out(timeline: Timeline, key: int, slots: Sequence[Slot], reason: str) -> LeftOut:
    """Return what is recorded of an interval, by its index, that lacks some slots."""
    frames = tuple(timeline.number(slot) for slot in slots)
    return LeftOut(timeline.numbers[key], frames, reason)


def unscored(timeline: Timeline, key: int, reasons: Mapping[int, str]) -> Iterator[LeftOut]:
    """Yield what is recorded of an interval whose ground truth cannot be used, by slot."""
    for slot, reason in sorted(reasons.items()):
        number = timeline.number(Slot(key, slot))
        yield LeftOut(timeline.numbers[key], (), reason, (number,))


def tell_left_out(progress: Progress, one: LeftOut) -> None:
    """Say at once what is left out, and why."""
    what = f"left out {_named(one.frames)}" if one.frames else f"not scored {_named(one.scores)}"
    progress.message(f"{what}: {one.reason}")


def require_complete(run: RunSummary) -> None:
    """Refuse to call a run complete that left something out.

    Raises
    ------
    IncompleteError
        When it did.
    """
    if not run.left_out:
        return
    missing = [one for one in run.left_out if one.frames]
    many, frames = len(missing), [n for one in missing for n in one.frames]
    scores = sorted({n for one in run.left_out for n in one.scores})
    told, cause = [], []
    if missing:
        verb = "was" if many == 1 else "were"
        whole = counted(len(run.selected), "key interval")
        told.append(f"{many} of {whole} {verb} left out ({_named(frames)})")
        cause.append("the input")
    if scores:
        told.append(f"{_named(scores)} {'was' if len(scores) == 1 else 'were'} not scored")
        cause.append("the ground truth")
    raise IncompleteError(
        f"{', and '.join(told)}, see above or left_out in report.json; mend {' and '.join(cause)} "
        "and run again with --skip-existing"
    )


def _named(frames: Sequence[int]) -> str:
    return f"frame{'s' if len(frames) != 1 else ''} {ranges(frames)}"
