"""What a report holds, in numbers with units and lines for people."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

from exwarp_cli.domain.timeline import ranges
from exwarp_cli.domain.wording import pluralise


def format_number(value: float | None, digits: int = 1) -> str | None:
    """Write a number, thousands apart; None stays None."""
    return None if value is None else f"{value:,.{digits}f}"


def format_percent(share: float, digits: int = 1) -> str:
    """Write a share as per cent."""
    return f"{share * 100:.{digits}f} %"


def format_time(seconds: float | None) -> str | None:
    """Write seconds as people say it: 250 ms, 42.1 s, 13 min, 2 h 5 min; None stays None."""
    if seconds is None:
        return None
    if abs(seconds) < 1:
        return f"{1000 * seconds:.0f} ms"
    if abs(seconds) < 120:
        return f"{seconds:.1f} s"
    sign = "-" if seconds < 0 else ""
    hours, minutes = divmod(round(abs(seconds) / 60), 60)
    return f"{sign}{hours} h {minutes} min" if hours else f"{sign}{minutes} min"


def format_rendered(frames: Mapping[str, int]) -> str:
    """Say how many frames were rendered, as `report.json` counts them."""
    after_all = frames["rendered"]
    if not after_all:
        return f"{frames['key']} rendered"
    return f"{frames['key'] + after_all} rendered ({after_all} of them after all)"


def describe_cuts(cuts: Sequence[Mapping[str, Any]]) -> str:
    """Say where cuts are, as `report.json` lists them; at least one."""
    by_source: dict[str, list[str]] = {}
    for cut in cuts:
        by_source.setdefault(cut["source"], []).append(str(cut["frame"]))
    places = ", ".join(f"{', '.join(frames)} ({source})" for source, frames in by_source.items())
    s = "s" if len(cuts) > 1 else ""
    return f"cut{s} before key frame{s} {places}; nothing is interpolated across"


def describe_holds(held: Sequence[int]) -> str:
    """Say where the picture is held, as `report.json` lists it; at least one."""
    s = "s" if len(held) > 1 else ""
    return (
        f"held after key frame{s} {ranges(held)}, which the next key frame repeats: the frames "
        "between show the same picture"
    )


def describe_left_out(left_out: Sequence[Mapping[str, Any]]) -> str:
    """Say what was left out, as `report.json` lists it; at least one."""
    missing = sum(bool(interval["frames"]) for interval in left_out)
    frames, scores, rendered = (
        ranges(sorted({number for interval in left_out for number in interval[name]}))
        for name in ("frames", "scores", "rendered")
    )
    lines = []
    if missing:
        lines.append(f"{pluralise(missing, 'key interval')} left out: frames {frames}")
    if scores:
        lines.append(f"not scored: frames {scores}")
    if rendered:
        lines.append(f"generated, although rendered: frames {rendered}")
    return "; ".join(lines)


def describe_nonfinite(nonfinite: Sequence[Mapping[str, Any]]) -> str:
    """Say what is NaN or infinite in the input, as `report.json` lists it; at least one."""
    pixels = Counter[str]()
    for entry in nonfinite:
        pixels[entry["channels"]] += entry["pixels"]
    text = ", ".join(f"{channels} in {pluralise(n, 'pixel')}" for channels, n in pixels.items())
    frames = pluralise(len({(entry["key"], entry["slot"]) for entry in nonfinite}), "frame")
    return f"NaN or infinite in {frames} of the input: {text}; nothing is made of them"


def describe_gate(trials: list[dict[str, Any]]) -> str:
    """Say in a line what the gate decided."""
    used = Counter[str]()
    for trial in trials:
        used[trial["used"]] += len(trial["keys"])
    untried = sum(len(trial["keys"]) for trial in trials if trial["frame"] is None)
    shares = ", ".join(f"{name} in {pluralise(count, 'interval')}" for name, count in used.items())
    alone = f"; {untried} of these without a key frame to try it on" if untried else ""
    return f"network tried on the shot's own key frames: {shares}{alone}"


def describe_review(review: dict[str, Any]) -> str:
    """Say in a line what is most worth a look, as `report.json` has it."""
    error = review["predicted_error"]
    line = (
        f"predicted error {error['mean']:.1f} of 255 levels on average, worst "
        f"{error['worst']:.1f} in frame {error['worst_frame']}"
    )
    if not review["places"]:
        return f"{line}; nothing stands out"
    line += f"; {pluralise(review['places'], 'place')} worth a look"
    return f"{line}; frames most worth rendering: {review['render']}" if review["render"] else line
