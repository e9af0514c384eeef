"""What a run did, in the few lines that commands print at their end."""

from __future__ import annotations

from typing import Any

from exwarp_cli.domain.metric import BY_OPTION, KEY_FRAMES, METRICS
from exwarp_cli.domain.wording import pluralise


def summary_lines(
    document: dict[str, Any], place: str = "", is_scored: bool | None = None
) -> list[str]:
    """Say in a few lines what was done.

    Parameters
    ----------
    document
        What report.json holds; at least one frame was written.
    place
        Where the frames are; empty where that is not known.
    is_scored
        Whether ground truth was given; None to tell by the scores that are there.
    """
    from exwarp_cli.report.sentences import (
        describe_cuts,
        describe_gate,
        describe_holds,
        describe_left_out,
        describe_nonfinite,
        describe_review,
    )

    frames, quality = document["frames"], document["quality"]["all"]
    decisions, pulse = document["decisions"], document["pulse"]
    if is_scored is None:
        is_scored = bool(quality["frames"])
    lines = _frame_lines(document, place)
    if document["cuts"]:
        lines.append(describe_cuts(document["cuts"]))
    if document["held"]:
        lines.append(describe_holds(document["held"]))
    lines.extend(_decision_lines(decisions))
    if decisions["gate"]:
        lines.append(describe_gate(decisions["gate"]))
    lines.extend(_holes_line(document["holes"], frames["generated"] + frames["dropped"]))
    if is_scored and frames["written"] > frames["key"]:
        lines.append(_quality_line(quality))
    if pulse is not None and pulse["against"] == KEY_FRAMES:
        lines.append(_pulse_line(pulse))
    if document["review"] is not None:
        lines.append(describe_review(document["review"]))
    if document["left_out"]:
        lines.append(describe_left_out(document["left_out"]))
    if document["nonfinite"]:
        lines.append(describe_nonfinite(document["nonfinite"]))
    return lines + _file_lines(document)


def _frame_lines(document: dict[str, Any], place: str) -> list[str]:
    from exwarp_cli.report.sentences import format_rendered

    frames, fps = document["frames"], document["fps"]
    effective = "" if fps["effective"] is None else f", effective {fps['effective']:g}"
    lines = [
        f"{pluralise(frames['written'], 'frame')}{place and f' in {place}'}: "
        f"{format_rendered(frames)}, {frames['generated']} generated, {frames['dropped']} repeated",
        f"{fps['base']:g} fps in, {fps['output']:g} out{effective}",
    ]
    if frames["resumed"] or frames["replaced"]:
        lines.append(
            f"{frames['resumed']} kept of an earlier run, {frames['made']} made, "
            f"{frames['replaced']} replaced"
        )
    return lines


def _decision_lines(decisions: dict[str, Any]) -> list[str]:
    paths = {name: count for name, count in decisions["paths"].items() if count}
    if not paths:  # a method outside the paper's decision tree
        return []
    share, cost = decisions["warp_share"], decisions["cost"]
    if cost is None:
        listed = ", ".join(f"{name} {count}" for name, count in paths.items())
        return [f"paths of the key intervals: {listed}; {share:.0%} of the decisions are warps"]
    total = sum(paths.values())
    listed = ", ".join(f"{name} {count / total:.0%}" for name, count in paths.items())
    return [f"paths of the tiles: {listed}; the network made {cost:.0%} of the new frames' area"]


def _quality_line(quality: dict[str, Any]) -> str:
    if not quality["frames"]:
        return "against ground truth: it has none of the frames between the rendered ones"
    values = (
        f"{metric.name} {metric.with_unit(quality[metric.field])}"
        for metric in METRICS
        if quality[metric.field] is not None
    )
    return f"against ground truth ({quality['frames']} frames): {', '.join(values)}"


def _pulse_line(pulse: dict[str, Any]) -> str:
    metric = BY_OPTION["pulse"]
    mean, worst = (metric.with_unit(pulse[name]) for name in ("mean", "worst"))
    frames = pluralise(pulse["frames"], "frame")
    return f"pulse against {pulse['against']} ({frames}): {mean}, at worst {worst}"


def _file_lines(document: dict[str, Any]) -> list[str]:
    """Say what was read back, and what rendering would have taken by the renderer's own times."""
    from exwarp_cli.report.sentences import format_time

    lines = []
    if document["verified"] is not None:
        lines.append(f"{pluralise(document['verified'], 'file')} read back, all as written")
    if (times := document["render_time"]) is not None:
        lines.append(
            f"render time saved: {format_time(times['saved_s'])} ({times['saved_share']:.0%}); "
            f"a key frame took {format_time(times['key_frame_s'])} to render, a new one takes "
            f"{format_time(times['generated_frame_s'])}"
        )
    return lines


def _holes_line(holes: dict[str, Any], count_between: int) -> list[str]:
    if holes["mean_fraction"] is None:
        return []
    count = sum(holes["histogram"]["counts"])
    # Where not all frames between key frames are warped, it is said how many are.
    warped = "" if count == count_between else f", of {pluralise(count, 'warped frame')}"
    return [f"holes {holes['mean_fraction']:.1%} of the pixels on average{warped}"]
