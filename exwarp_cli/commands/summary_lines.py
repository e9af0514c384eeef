"""What a run did, in the few lines that commands print at their end."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

from exwarp_cli.domain.metric import BY_OPTION, KEY_FRAMES, METRICS
from exwarp_cli.domain.wording import pluralise


def summary_lines(
    document: dict[str, Any], place: str = "", scored: bool | None = None
) -> list[str]:
    """Say in a few lines what was done.

    Parameters
    ----------
    document
        What report.json holds; at least one frame was written.
    place
        Where the frames are; empty where that is not known.
    scored
        Whether ground truth was given; None to tell by the scores that are there.
    """
    from exwarp_cli.report.page_parts import rendered_text

    frames, fps, quality = document["frames"], document["fps"], document["quality"]["all"]
    effective = "" if fps["effective"] is None else f", effective {fps['effective']:g}"
    lines = [
        f"{pluralise(frames['written'], 'frame')}{place and f' in {place}'}: "
        f"{rendered_text(frames)}, {frames['generated']} generated, {frames['dropped']} repeated",
        f"{fps['base']:g} fps in, {fps['output']:g} out{effective}",
    ]
    if frames["resumed"] or frames["replaced"]:
        lines.append(
            f"{frames['resumed']} kept of an earlier run, {frames['made']} made, "
            f"{frames['replaced']} replaced"
        )
    lines.extend(_lines_of_lists(document, ("cuts", "held")))
    lines.extend(_decisions(document["decisions"]))
    if document["decisions"]["gate"]:
        from exwarp_cli.report.decisions import gate_line

        lines.append(gate_line(document["decisions"]["gate"]))
    if document["holes"]["mean_fraction"] is not None:
        lines.append(_holes(document["holes"], frames["generated"] + frames["dropped"]))
    compared = bool(quality["frames"]) if scored is None else scored
    if compared and frames["written"] > frames["key"]:
        lines.append(f"against ground truth{_scores(quality)}")
    pulse = document["pulse"]
    if pulse is not None and pulse["against"] == KEY_FRAMES:
        lines.append(_pulse(pulse))
    if document["review"] is not None:
        from exwarp_cli.report.review import review_line

        lines.append(review_line(document["review"]))
    lines.extend(_lines_of_lists(document, ("left_out", "nonfinite")))
    if document["verified"] is not None:
        lines.append(f"{pluralise(document['verified'], 'file')} read back, all as written")
    if document["render_time"] is not None:
        lines.append(_saved(document["render_time"]))
    return lines


def _decisions(decisions: dict[str, Any]) -> Iterator[str]:
    """Say which paths were taken; nothing outside the paper's decision tree."""
    taken = {name: count for name, count in decisions["paths"].items() if count}
    if not taken:
        return
    share, cost = decisions["warp_share"], decisions["cost"]
    if cost is None:
        listed = ", ".join(f"{name} {count}" for name, count in taken.items())
        yield f"paths of the key intervals: {listed}; {share:.0%} of the decisions are warps"
        return
    count = sum(taken.values())
    listed = ", ".join(f"{name} {number / count:.0%}" for name, number in taken.items())
    yield f"paths of the tiles: {listed}; the network made {cost:.0%} of the new frames' area"


def _lines_of_lists(document: dict[str, Any], keys: tuple[str, ...]) -> Iterator[str]:
    """Yield a line for each of a report's lists that is not empty."""
    from exwarp_cli.report.page_parts import cuts_line, held_line, left_out_line, nonfinite_line

    lines: dict[str, Callable[[list[Any]], str]] = {
        "cuts": cuts_line,
        "held": held_line,
        "left_out": left_out_line,
        "nonfinite": nonfinite_line,
    }
    for key in keys:
        if document[key]:
            yield lines[key](document[key])


def _scores(quality: dict[str, Any]) -> str:
    """Say how good the frames between the rendered ones are."""
    if not quality["frames"]:
        return ": it has none of the frames between the rendered ones"
    values = (
        f"{metric.name} {metric.with_unit(quality[metric.field])}"
        for metric in METRICS
        if quality[metric.field] is not None
    )
    return f" ({quality['frames']} frames): {', '.join(values)}"


def _pulse(found: dict[str, Any]) -> str:
    """Say how sharp new frames are beside their key frames."""
    metric = BY_OPTION["pulse"]
    mean, worst = (metric.with_unit(found[name]) for name in ("mean", "worst"))
    frames = pluralise(found["frames"], "frame")
    return f"pulse against {found['against']} ({frames}): {mean}, at worst {worst}"


def _saved(found: dict[str, Any]) -> str:
    """Say what rendering would have taken, by the renderer's own times."""
    from exwarp_cli.report.page_parts import time_text

    return (
        f"render time saved: {time_text(found['saved_s'])} ({found['saved_share']:.0%}); a key "
        f"frame took {time_text(found['key_frame_s'])} to render, a new one takes "
        f"{time_text(found['generated_frame_s'])}"
    )


def _holes(holes: dict[str, Any], between: int) -> str:
    """Say how large holes are; and of which frames, where not all between key frames warp."""
    count = sum(holes["histogram"]["counts"])
    some = "" if count == between else f", of {pluralise(count, 'warped frame')}"
    return f"holes {holes['mean_fraction']:.1%} of the pixels on average{some}"
