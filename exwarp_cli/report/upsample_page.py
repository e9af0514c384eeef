"""The page of an ``upsample`` run."""

from __future__ import annotations

from typing import Any

from exwarp_cli.domain.decision import FEATURES, HOLD, NODES
from exwarp_cli.domain.metric import KEY_FRAMES
from exwarp_cli.domain.results import FrameKind, FrameRecord, RunSummary
from exwarp_cli.domain.timeline import ranges
from exwarp_cli.domain.wording import pluralise
from exwarp_cli.metrics.display import PEAK
from exwarp_cli.report.gallery import Album, worst_of
from exwarp_cli.report.page import (
    Block,
    Cell,
    Link,
    Number,
    Page,
    Section,
    Table,
    Text,
    Viewer,
)
from exwarp_cli.report.page_parts import (
    BY_FIELD,
    better,
    cuts_line,
    facts_of,
    file_name,
    held_line,
    metric_plots,
    nonfinite_line,
    number,
    percent,
    quality_numbers,
    quality_table,
    rendered_text,
    time_text,
    worst_table,
)
from exwarp_cli.report.plot_style import Figure, Labels
from exwarp_cli.report.plots import histogram, lines, points, series_panels, stacked_bars
from exwarp_cli.report.quality import mean
from exwarp_cli.report.review import review_line, worth_a_look
from exwarp_cli.report.strip import Cell as StripCell
from exwarp_cli.report.strip import strip

PREDICTED = (
    "How wrong each new frame is expected to be, without ground truth. It is a forecast by how "
    "much key frames disagree, by holes, and by how well they predict each other."
)

PLACES_NOTE = (
    "light: shadows, reflections or highlights differ between the key frames. holes: key frames do "
    "not show what is behind. motion: things move apart there, and outlines are uncertain. The "
    "viewer above shows the forecast as a map: choose Forecast under View."
)

TRIALS_NOTE = (
    "Both predict a rendered key frame from the ones around it, and the better one makes the new "
    "frames. dB: PSNR; between key frames the mean of the frame's tiles."
)

MOST_PLACES = 20
"""Of the list on the page; review.csv has more."""

MOST_ROWS = 200
"""Of a table on the page; report.json has them all."""


def upsample_page(run: RunSummary, document: dict[str, Any], album: Album | None = None) -> Page:
    """Build the page of a run.

    Parameters
    ----------
    run
        The run; its frames are plotted.
    document
        What `exwarp_cli.report.summary.report` made of it: tables and headline.
    album
        Pictures of its frames; None for a page without a viewer.
    """
    frames = run.frames
    if album is not None:
        for frame in frames:
            album.tell(frame.number, made_by(frame), _facts(frame), frame.risk)
        _start_at_worst(album, frames)
    shown = () if album is None else tuple(album.frames)
    source = document["input"]
    count = document["frames"]["written"]
    return Page(
        file_name(source["pattern"]),
        f"{run.method} on {source['pattern']}: {count} frames, "
        f"{source['width']}x{source['height']}",
        headline(document),
        (
            Section("frames", "Frames", [Viewer(album)] if album and album.frames else []),
            Section("review", "Worth a look", _review(run, document, shown)),
            Section("quality", "Quality", _quality(run, document, shown)),
            Section("decisions", "Decisions", _decisions(run, document)),
            Section("holes", "Holes and features", _evidence(run, document)),
            Section("timing", "Time", _timing(frames, document)),
            Section("left-out", "Left out", _left_out(document)),
            Section("nonfinite", "NaN and infinities", _nonfinite(document)),
            Section("input", "Input and settings", _settings(document)),
        ),
    )


def _start_at_worst(album: Album, frames: tuple[FrameRecord, ...]) -> None:
    """Show the worst frame first, if it was kept: VMAF and flicker are known only at the end."""
    worst = worst_of(frames)
    if worst in album.frames:
        album.start = worst


def made_by(frame: FrameRecord) -> str:
    """Say what made a frame, as `plots.KINDS` names it."""
    if frame.kind in (FrameKind.KEY, FrameKind.RENDERED):
        return str(frame.kind.value)
    if frame.kind is FrameKind.DROPPED:
        return HOLD
    return frame.made_by or frame.method


def headline(document: dict[str, Any]) -> list[Number]:
    """Return the numbers on top: the saved time first, where the headers state it."""
    frames, fps, holes = document["frames"], document["fps"], document["holes"]
    found = _saved(document.get("render_time"))
    parts = f"{rendered_text(frames)}, {frames['generated']} generated"
    if frames["dropped"]:
        parts += f", {frames['dropped']} repeated"
    found.append(Number("Frames", f"{frames['written']:,}", parts))
    found.append(Number("Frame rate", f"{fps['base']:g} → {fps['output']:g} fps", fps["source"]))
    if fps["effective"] is not None:
        found.append(Number("Effective", f"{fps['effective']:.1f} fps", "new frames alone"))
    found += quality_numbers(document["quality"]["all"])
    found += _pulse_number(document["pulse"])
    found += _left_out_numbers(document["left_out"])
    if document["input"]["motion"]["source"] == "estimated":
        note = "from colour by optical flow, far less exact than a renderer's vectors"
        found.append(Number("Motion", "estimated", note))
    if holes["mean_fraction"] is not None:
        note = (
            f"of the pixels of {pluralise(sum(holes['histogram']['counts']), 'frame')}, on average"
        )
        found.append(Number("Holes", str(percent(holes["mean_fraction"])), note))
    if document["decisions"]["warp_share"] is not None:
        found.append(
            Number(
                "Warps",
                str(percent(document["decisions"]["warp_share"], 0)),
                "of decisions" if document["decisions"]["cost"] is None else "of the area",
            )
        )
    if fps["throughput"]:
        found.append(
            Number("Time", str(time_text(1 / fps["throughput"])), "per written frame, all threads")
        )
    return found


def _left_out_numbers(left_out: list[dict[str, Any]]) -> list[Number]:
    """Return how many frames lack their input, their rendered frame or their ground truth."""
    labels = {
        "frames": ("Left out", "frames whose input cannot be used"),
        "rendered": ("Not used", "rendered frames, which are generated"),
        "scores": ("Not scored", "frames whose ground truth cannot be used"),
    }
    counts = {name: sum(len(one[name]) for one in left_out) for name in labels}
    return [
        Number(label, f"{counts[name]:,}", note)
        for name, (label, note) in labels.items()
        if counts[name]
    ]


def _pulse_number(block: dict[str, Any] | None) -> list[Number]:
    """Return the pulse where it is measured against key frames."""
    if block is None or block["against"] != KEY_FRAMES:
        return []
    metric = BY_FIELD["pulse"]
    note = f"{better(metric)}; against {block['against']}"
    return [Number(metric.name, metric.with_unit(block["mean"]), note)]


def _saved(block: dict[str, Any] | None) -> list[Number]:
    """Return what was saved, where a header said how long a frame rendered."""
    if block is None or block.get("saved_s") is None:
        return []
    share = percent(block.get("saved_share"), 0)
    found = [
        Number("Render time saved", str(time_text(block["saved_s"])), f"{share} of rendering all")
    ]
    for key, label, note in (
        ("key_frame_s", "Rendered frame", "by the headers, on average"),
        ("generated_frame_s", "Generated frame", "reading and writing included"),
    ):
        if block.get(key) is not None:
            found.append(Number(label, str(time_text(block[key])), note))
    return found


def _facts(frame: FrameRecord) -> dict[str, str]:
    """Return what is written beside a frame in the viewer."""
    facts = {"slot": f"{frame.slot} after key frame {frame.key}"}
    if frame.path is not None:
        facts["path"] = frame.path
    if frame.decision is not None:
        facts["decision"] = f"{frame.decision.node} = {frame.decision.choice}"
    facts |= facts_of(frame.score, frame.hole_score)
    if frame.key_pulse is not None:
        metric = BY_FIELD["pulse"]
        facts[f"{metric.name} against {KEY_FRAMES}"] = metric.with_unit(frame.key_pulse)
    if frame.risk is not None:
        facts["predicted error"] = f"{frame.risk.error:.1f} of 255"
    if frame.has_holes:
        facts["holes"] = str(percent(frame.hole_fraction))
    return facts


def _review(run: RunSummary, document: dict[str, Any], shown: tuple[int, ...]) -> list[Block]:
    """List what is most worth a look, and draw the predicted error of the new frames."""
    found = document["review"]
    if found is None:
        return []
    blocks: list[Block] = [Text(f"{PREDICTED} {review_line(found).capitalize()}.")]
    known = [frame for frame in run.frames if frame.risk is not None]
    if len(known) > 1:
        blocks.append(_predicted_errors(known, found, after_cuts(run)))
    rows: list[list[Cell]] = [
        [
            Link(str(place.frame), f"#viewer:{place.frame}")
            if place.frame in shown
            else str(place.frame),
            f"{place.error:.1f}",
            f"{place.width}x{place.height} at {place.x},{place.y}",
            place.reason,
        ]
        for place in worth_a_look(run)[:MOST_PLACES]
    ]
    if rows:
        columns = ("frame", "predicted error", "pixels", "why")
        blocks.append(Table("Places worth a look", columns, rows, PLACES_NOTE))
    return blocks


def _predicted_errors(known: list[FrameRecord], found: dict[str, Any], cuts: list[int]) -> Figure:
    """Draw the predicted error of each new frame, beside the measured one where there is one."""
    numbers = [frame.number for frame in known]
    series: dict[str, list[float | None]] = {
        "predicted": [None if frame.risk is None else frame.risk.error for frame in known]
    }
    scores = [None if frame.score is None else frame.score.psnr_db for frame in known]
    if any(score is not None for score in scores):
        series["measured"] = [None if db is None else PEAK / 10 ** (db / 20) for db in scores]
    labels = Labels(
        "Predicted error per frame", "frame", "RMS of 255 levels",
        "How wrong each new frame is expected to be; lower is better.",
    )  # fmt: skip
    worst = numbers.index(found["predicted_error"]["worst_frame"])
    return lines(labels, numbers, series, (worst,), cuts)


def after_cuts(run: RunSummary) -> list[int]:
    """Return the output number of the first frame after each cut, as far as it was written."""
    first: dict[int, int] = {}
    for frame in run.frames:
        first.setdefault(frame.key, frame.number)
    return [first[cut.number] for cut in run.cuts or () if cut.number in first]


def _quality(run: RunSummary, document: dict[str, Any], shown: tuple[int, ...]) -> list[Block]:
    scored = [frame for frame in run.frames if frame.score is not None]
    keyed = _keyed_pulses(run, document)
    if not scored:
        return keyed
    quality = document["quality"]
    blocks = {"all pixels": quality["all"], "holes only": quality["holes"]}
    blocks |= {f"made by {name}": part for name, part in quality["by_decision"].items()}
    blocks["repeated"] = quality["dropped"]
    blocks = {name: part for name, part in blocks.items() if part["frames"] or name == "all pixels"}
    numbers, scores = [f.number for f in scored], [f.score for f in scored]
    made = [made_by(f) for f in scored]
    table = quality_table(
        "Against ground truth", blocks, "Means over the frames between key frames."
    )
    values = [None if score is None else score.psnr_db for score in scores]
    found: list[Block] = [table]
    cuts = after_cuts(run)
    if len(scored) > 1 and any(value is not None for value in values):
        labels = Labels(
            "PSNR per frame",
            "frame",
            "PSNR dB",
            "PSNR of every scored frame, coloured by what made it; higher is better.",
        )
        found.insert(0, points(labels, numbers, values, made, cuts=cuts))
    found += metric_plots(numbers, scores, skip=("psnr_db",), cuts=cuts)
    worst = worst_table(numbers, scores, shown, made)
    return [*found, *([] if worst is None else [worst]), *keyed]


def _keyed_pulses(run: RunSummary, document: dict[str, Any]) -> list[Block]:
    """Draw the pulse of new frames against their key frames, where there is no ground truth."""
    block, metric = document["pulse"], BY_FIELD["pulse"]
    if block is None or block["against"] != KEY_FRAMES:
        return []
    known = [(f.number, f.key_pulse) for f in run.frames if f.key_pulse is not None]
    numbers, values = [n for n, _ in known], [value for _, value in known]
    note = (
        "How much softer (below 0) or sharper new frames are than the key frames around, weighted "
        "by time. Softer frames make textures shimmer."
    )
    rows: list[list[Cell]] = [
        ["mean of the new frames", metric.text(block["mean"])],
        [f"worst, frame {block['worst_frame']}", metric.text(block["worst"])],
    ]
    found: list[Block] = [Table("Sharpness", ("", metric.title), rows, note)]
    if len(known) > 1:
        labels = Labels(f"{metric.name} per frame", "frame", metric.title, note)
        worst = numbers.index(block["worst_frame"])
        series = {metric.title: values}
        found.insert(0, lines(labels, numbers, series, (worst,), cuts=after_cuts(run)))
    return found


def _decisions(run: RunSummary, document: dict[str, Any]) -> list[Block]:
    made = [frame for frame in run.frames if frame.slot]
    if not made:
        return []
    found: list[Block] = [_strip(run.frames)]
    decisions = document["decisions"]
    if decisions["gate"]:
        found.append(_trials(decisions["gate"]))
    if decisions["warp_share"] is None:
        return found
    rows: list[list[Cell]] = [
        [node, *(number(decisions["nodes"][node][choice], 0) for choice in ("warp", "extrapolate"))]
        for node in NODES
    ]
    found.append(Table("Decisions by node", ("node", "warp", "extrapolate"), rows))
    paths: list[list[Cell]] = [
        [name, number(count, 0)] for name, count in decisions["paths"].items()
    ]
    of_tiles = decisions["cost"] is not None
    title, unit = ("tiles", "tiles") if of_tiles else ("key intervals", "intervals")
    found.append(Table(f"Paths of the {title}", ("path", unit), paths))
    return found


def _trials(trials: list[dict[str, Any]]) -> Table:
    """List on which key frames methods were tried, and which of them was used where."""
    cheap, dear = (name.removesuffix("_db") for name in trials[0] if name.endswith("_db"))
    rows: list[list[Cell]] = [
        [
            "none" if trial["frame"] is None else str(trial["frame"]),
            number(trial[f"{cheap}_db"], 2),
            number(trial[f"{dear}_db"], 2),
            trial["used"],
            ranges(trial["keys"]),
        ]
        for trial in trials
    ]
    columns = ("key frame", f"{cheap}, dB", f"{dear}, dB", "used", "intervals")
    return Table("The network on the shot's own key frames", columns, rows, TRIALS_NOTE)


def _strip(frames: tuple[FrameRecord, ...]) -> Figure:
    """Draw what made each slot: key intervals from left to right, slots below each other."""
    intervals: dict[int, list[StripCell | None]] = {}
    count = max(frame.slot for frame in frames)
    for frame in frames:
        column = intervals.setdefault(frame.key, [None] * count)
        if frame.slot:
            taken = frame.decision
            why = "" if taken is None else f", {taken.node} = {taken.choice}"
            path = "" if frame.path is None else f", path {frame.path}"
            hint = f"frame {frame.number}: {made_by(frame)}{why}{path}"
            column[frame.slot - 1] = StripCell(made_by(frame), hint)
    labels = Labels(
        "What made each frame",
        description="A column a key interval and a row a slot, coloured by what made the frame.",
    )
    kinds = dict.fromkeys(made_by(frame) for frame in frames if frame.slot)
    return strip(
        labels, [f"slot {i + 1}" for i in range(count)], list(intervals.values()), list(kinds)
    )


def _evidence(run: RunSummary, document: dict[str, Any]) -> list[Block]:
    """Draw the hole share, and the features that decisions were taken by."""
    found: list[Block] = []
    frames = run.frames
    holes = [frame for frame in frames if frame.has_holes]
    if len(holes) > 1:
        labels = Labels(
            "Hole share per frame", "frame", "holes, % of pixels",
            "Share of pixels that the warp from the key frame cannot see.",
        )  # fmt: skip
        shares = [100 * (frame.hole_fraction or 0.0) for frame in holes]
        numbers = [frame.number for frame in holes]
        found.append(lines(labels, numbers, {"holes": shares}, cuts=after_cuts(run)))
        if document["holes"]["histogram"] is not None:
            found.append(_hole_histogram(document["holes"]))
    seen = [(f.number, f.decision.features) for f in frames if f.decision and f.decision.features]
    if seen:
        labels = Labels(
            "Features that the policy sees", "frame",
            description="The features of each decision's instant, per slot.",
        )  # fmt: skip
        columns = zip(*(features.values for _, features in seen), strict=True)
        series = {
            name: list(map(float, values))
            for name, values in zip(FEATURES, columns, strict=True)
            if name != "R"
        }
        found.append(series_panels(labels, [n for n, _ in seen], series))
    return found


def _hole_histogram(holes: dict[str, Any]) -> Figure:
    """Draw how many frames have which hole share, as the paper's Figure 2; bins up to the last."""
    edges, counts = holes["histogram"]["edges"], holes["histogram"]["counts"]
    bins = max(i + 1 for i, count in enumerate(counts) if count)
    labels = Labels(
        "Frames by hole share", "holes, % of pixels", "frames",
        f"Histogram of the hole share; 95 % of the frames have at most "
        f"{percent(holes['p95_fraction'])}.",
    )  # fmt: skip
    return histogram(labels, [100 * e for e in edges[: bins + 1]], {"frames": counts[:bins]})


def _timing(frames: tuple[FrameRecord, ...], document: dict[str, Any]) -> list[Block]:
    steps = [step for step, ms in document["timing_ms"].items() if ms is not None]
    if not steps:
        return []
    groups: dict[str, list[FrameRecord]] = {}
    for frame in frames:
        if frame.timing_ms:
            groups.setdefault(made_by(frame), []).append(frame)
    parts = {
        step: [mean(f.timing_ms.get(step, 0.0) for f in made) for made in groups.values()]
        for step in steps
    }
    labels = Labels(
        "Time per frame by what made it", "ms",
        description="Mean milliseconds of each step for each kind of frame, end to end.",
    )  # fmt: skip
    rows: list[list[Cell]] = [[step, number(document["timing_ms"][step])] for step in steps]
    return [
        stacked_bars(
            labels, list(groups), parts,
            note="Steps overlap on several threads: reading runs ahead and writing behind.",
        ),
        Table("Mean of the frames that had the step", ("step", "ms"), rows),
    ]  # fmt: skip


def _left_out(document: dict[str, Any]) -> list[Block]:
    """List what was left out as its input cannot be used."""
    rows: list[list[Cell]] = [
        [
            *(str(one["key"]), ranges(one["frames"]), ranges(one["scores"])),
            *(ranges(one["rendered"]), one["reason"]),
        ]
        for one in document["left_out"]
    ]
    if not rows:
        return []
    columns = ("key frame", "frames", "not scored", "rendered, not used", "why")
    title = "Key intervals left out"
    if not any(one["frames"] for one in document["left_out"]):
        unused = any(one["rendered"] for one in document["left_out"])
        title = "Rendered frames that are not used" if unused else "Not scored"
    return [Table(title, columns, rows)]


def _nonfinite(document: dict[str, Any]) -> list[Block]:
    """List what is not finite in the input."""
    found = document["nonfinite"]
    if not found:
        return []
    rows: list[list[Cell]] = [
        [str(one["key"]), str(one["slot"]), *([one["view"]] if one["view"] else []),
         one["channels"], number(one["pixels"], 0)]
        for one in found[:MOST_ROWS]
    ]  # fmt: skip
    columns = ["key frame", "slot", *(["view"] if found[0]["view"] else []), "channels", "pixels"]
    return [Table("Not finite in the input", columns, rows, nonfinite_line(found))]


def _settings(document: dict[str, Any]) -> list[Block]:
    source, fps = document["input"], document["fps"]
    geometry = {"key": "for the key frames", "slot": "for every slot"}[document["setting"]]
    if source["motion"]["source"] == "estimated":
        geometry = "none with vectors"
    rows: list[list[Cell]] = [
        ["sequence", source["pattern"]],
        ["key frames", f"{source['first']}-{source['last']}"],
        ["size", f"{source['width']}x{source['height']}"],
        ["written by", source["producer"]],
        ["rate", f"{fps['base']:g} fps ({fps['source']})"],
        ["G-buffers", geometry],
        ["motion", source["motion"]["source"]],
        ["evidence", source["motion"]["evidence"]],
        ["depth", source["depth"]],
        ["moving by name", ", ".join(source["dynamic"]) if source["dynamic"] else None],
        ["cuts", _cuts(document["cuts"])],
        ["holds", held_line(document["held"]) if document["held"] else None],
        ["method", document["method"]],
        ["uses the next key frame", "yes" if document["lookahead"] else "no"],
    ]
    for name in ("extrapolator", "interpolator", "policy"):
        network = document.get(name) or {}
        rows += [
            [f"{name} {key}", _plain(value)] for key, value in network.items() if value is not None
        ]
    if document["verified"] is not None:
        rows.append(["files read back, all as written", str(document["verified"])])
    rows.append(["ExWarp", document["version"]])
    return [Table("", ("", ""), rows)]


def _cuts(cuts: list[dict[str, Any]] | None) -> str:
    """Say where cuts are."""
    if cuts is None:
        return "not looked for"
    return cuts_line(cuts) if cuts else "none"


def _plain(value: Any) -> str:
    """Write a setting in words."""
    if isinstance(value, bool):
        return "yes" if value else "no"
    return ", ".join(map(str, value)) or "none" if isinstance(value, list | tuple) else str(value)
