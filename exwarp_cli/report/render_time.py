"""What a farm wants to know first: the time that was not rendered, against the tool's own."""

from __future__ import annotations

from typing import Any

from exwarp_cli.domain.results import FrameKind, RunSummary
from exwarp_cli.report.quality import mean


def render_time(run: RunSummary) -> dict[str, Any] | None:
    """Return what a run saved, from the render times in the headers of its key frames.

    Frames of an earlier run are left out, as this one spent no time on them, and so are key frames
    of intervals that it kept whole; so are repeats, which do not count as rendered. Key frames
    that fall on no output instant were rendered too.

    Returns
    -------
    dict or None
        ``key_frame_s``, mean render time of a key frame; ``key_frames``, how many headers state it;
        ``source``, the attribute; ``generated_frame_s``, this run's time for each generated frame,
        reading and writing included, scoring not; ``saved_s``, what rendering the generated frames
        would have taken beyond the key frames, less the run's time; ``saved_share``, that as a
        share of rendering all frames. None where no header tells, or nothing was generated.
    """
    render_times = [frame.render for frame in run.frames if frame.render is not None]
    made = sum(frame.kind is FrameKind.GENERATED and not frame.resumed for frame in run.frames)
    each = mean(seconds for seconds, _ in render_times)
    if each is None or not made:
        return None
    worked = {frame.key for frame in run.frames if not frame.resumed}
    rendered = (FrameKind.KEY, FrameKind.RENDERED)
    keys = sum(frame.kind in rendered and frame.key in worked for frame in run.frames)
    spent = max(run.wall_seconds - _scoring_s(run), 0.0)
    shown = {frame.key for frame in run.frames if frame.kind is FrameKind.KEY}
    unseen = len({frame.key for frame in run.frames if not frame.resumed} - shown)
    saved = (made - unseen) * each - spent
    return {
        "key_frame_s": each,
        "key_frames": len(render_times),
        "source": render_times[0][1],
        "generated_frame_s": spent / made,
        "saved_s": saved,
        "saved_share": saved / ((made + keys) * each),
    }


def _scoring_s(run: RunSummary) -> float:
    """Return the seconds that went into scores, which a run without ground truth does not need.

    Frames are scored one after the other, between those that are made.
    """
    return sum(frame.timing_ms.get("score", 0.0) for frame in run.frames) / 1e3


def duration(seconds: float) -> str:
    """Write a time as people say it: 42.1 s, 13 min, 2 h 5 min."""
    if abs(seconds) < 120:
        return f"{seconds:.1f} s"
    minutes = round(abs(seconds) / 60)
    sign = "-" if seconds < 0 else ""
    hours, rest = divmod(minutes, 60)
    return f"{sign}{hours} h {rest} min" if hours else f"{sign}{minutes} min"
