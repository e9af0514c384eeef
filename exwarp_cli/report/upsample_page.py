"""The page of an ``upsample`` run."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from exwarp_cli.domain.colour import PEAK
from exwarp_cli.domain.decision import CHOICES, FEATURES, HOLD, LOOKAHEAD, NODES, SOFTSPLAT
from exwarp_cli.domain.metric import KEY_FRAMES
from exwarp_cli.domain.results import FrameKind, FrameRecord, RunSummary
from exwarp_cli.domain.settings import SRGB_VIEW
from exwarp_cli.domain.timeline import ranges
from exwarp_cli.domain.wording import pluralise
from exwarp_cli.report import html, plots, sentences
from exwarp_cli.report.gallery import Album, worst_frame
from exwarp_cli.report.review import places_worth_a_look
from exwarp_cli.report.schema import mean

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

LOOK_AHEAD_KINDS = ((SOFTSPLAT, "cheap"), (LOOKAHEAD, "dear"))

TILES_NOTE = "Frames that are made of both, tile by tile, are counted in parts."

PULSE_NOTE = (
    "How much softer (below 0) or sharper new frames are than the key frames around, weighted "
    "by time. Softer frames make textures shimmer."
)

# By metric, the title of its plot by slot, and what a good one looks like.
SLOT_PLOTS = {
    "pulse": (
        "Sharpness by slot",
        "Good: a flat line near 0, new frames are as sharp as key frames. Not good: a dip between "
        "the key frames, textures go soft and sharp again at the key rate.",
    ),
    "flicker": (
        "Flicker by slot",
        "Good: low and flat, new frames change in time as the true ones do; 0 is best. Not good: "
        "one slot far above the others, something jumps there in each key interval.",
    ),
}

MAX_PLACES = 20  # of the list on the page; review.csv has more
MAX_ROWS = 200  # of a table on the page; report.json has them all


def upsample_page(run: RunSummary, document: dict[str, Any], album: Album) -> html.Page:
    """Build the page of a run.

    `document` is what `schema.run_document` returned: tables and headline. `album` has pictures of
    the run's frames, and gets facts and the worst frame as its start.
    """
    for frame in run.frames:
        facts = {"slot": f"{frame.slot} after key frame {frame.key}"}
        if frame.path is not None:
            facts["path"] = frame.path
        if frame.decision is not None:
            facts["decision"] = f"{frame.decision.node} = {frame.decision.choice}"
        facts |= html.score_facts(frame.score, frame.hole_score)
        if frame.key_pulse is not None:
            metric = html.BY_FIELD["pulse"]
            facts[f"{metric.name} against {KEY_FRAMES}"] = metric.with_unit(frame.key_pulse)
        if frame.risk is not None:
            facts["predicted error"] = f"{frame.risk.error:.1f} of 255"
        if frame.has_holes:
            facts["holes"] = sentences.format_percent(frame.hole_fraction or 0.0)
        album.set_facts(frame.number, frame_maker(frame), facts, frame.risk)
    # The first frame after each cut, as far as it was written.
    first = {frame.key: frame.number for frame in reversed(run.frames)}
    cuts = [first[cut.number] for cut in run.cuts or () if cut.number in first]
    # VMAF and flicker are known only now.
    if (worst := worst_frame(run.frames)) in album.frames:
        album.start = worst
    album.fps = document["fps"]["output"]
    source = document["input"]
    return html.Page(
        html.file_name(source["pattern"]),
        f"{run.method} on {source['pattern']}: {document['frames']['written']} frames, "
        f"{source['width']}x{source['height']}",
        headline(document),
        (
            html.Section("frames", "Frames", [album] if album.frames else []),
            html.Section("review", "Worth a look", _review(run, document, album, cuts)),
            html.Section("quality", "Quality", _quality(run, document, album, cuts)),
            html.Section("decisions", "Decisions", _decisions(run, document["decisions"])),
            html.Section("holes", "Holes and features", _holes_and_features(run, document, cuts)),
            html.Section("timing", "Time", _timing(run, document["timing_ms"])),
            *_unused_input(document),
            html.Section("input", "Input and settings", [_settings(document)]),
        ),
    )


def frame_maker(frame: FrameRecord) -> str:
    """Return what made a frame, as `plots.KINDS` names it."""
    if frame.kind in (FrameKind.KEY, FrameKind.RENDERED):
        return str(frame.kind.value)
    if frame.kind is FrameKind.DROPPED:
        return HOLD
    return frame.made_by or frame.method


def headline(document: dict[str, Any]) -> list[html.Number]:
    """Return the numbers on top: the saved time first, where the headers state it."""
    frames, fps, holes = document["frames"], document["fps"], document["holes"]
    decisions, pulse = document["decisions"], document["pulse"]
    numbers = []
    if (saved := document["render_time"]) is not None:
        share = f"{sentences.format_percent(saved['saved_share'], 0)} of rendering all"
        for label, value, note in (
            ("Render time saved", saved["saved_s"], share),
            ("Rendered frame", saved["key_frame_s"], "by the headers, on average"),
            ("Generated frame", saved["generated_frame_s"], "reading and writing included"),
        ):
            numbers.append(html.Number(label, str(sentences.format_time(value)), note))
    kinds = f"{sentences.format_rendered(frames)}, {frames['generated']} generated"
    if frames["dropped"]:
        kinds += f", {frames['dropped']} repeated"
    numbers.append(html.Number("Frames", f"{frames['written']:,}", kinds))
    numbers.append(
        html.Number("Frame rate", f"{fps['base']:g} → {fps['output']:g} fps", fps["source"])
    )
    if fps["effective"] is not None:
        numbers.append(html.Number("Effective", f"{fps['effective']:.1f} fps", "new frames alone"))
    numbers += html.quality_numbers(document["quality"]["all"])
    if pulse is not None and pulse["against"] == KEY_FRAMES:
        metric = html.BY_FIELD["pulse"]
        note = f"{html.better(metric)}; against {KEY_FRAMES}"
        numbers.append(html.Number(metric.name, metric.with_unit(pulse["mean"]), note))
    for key, label, note in (
        ("frames", "Left out", "frames whose input cannot be used"),
        ("rendered", "Not used", "rendered frames, which are generated"),
        ("scores", "Not scored", "frames whose ground truth cannot be used"),
    ):
        if count := sum(len(interval[key]) for interval in document["left_out"]):
            numbers.append(html.Number(label, f"{count:,}", note))
    if document["input"]["motion"]["source"] == "estimated":
        note = "from colour by optical flow, far less exact than a renderer's vectors"
        numbers.append(html.Number("Motion", "estimated", note))
    if holes["mean_fraction"] is not None:
        note = (
            f"of the pixels of {pluralise(sum(holes['histogram']['counts']), 'frame')}, on average"
        )
        numbers.append(html.Number("Holes", sentences.format_percent(holes["mean_fraction"]), note))
    if decisions["warp_share"] is not None:
        note = "of decisions" if decisions["cost"] is None else "of the area"
        numbers.append(
            html.Number("Warps", sentences.format_percent(decisions["warp_share"], 0), note)
        )
    if fps["throughput"]:
        time = sentences.format_time(1 / fps["throughput"])
        numbers.append(html.Number("Time", str(time), "per written frame, all threads"))
    return numbers


def _review(
    run: RunSummary, document: dict[str, Any], album: Album, cuts: Sequence[int]
) -> list[html.Block]:
    """List what is most worth a look, and draw the predicted error of the new frames."""
    review = document["review"]
    if review is None:
        return []
    blocks: list[html.Block] = [f"{PREDICTED} {sentences.describe_review(review).capitalize()}."]
    errors = [(frame, frame.risk.error) for frame in run.frames if frame.risk is not None]
    if len(errors) > 1:
        numbers = [frame.number for frame, _ in errors]
        series: dict[str, list[float | None]] = {"predicted": [error for _, error in errors]}
        psnr = [None if frame.score is None else frame.score.psnr_db for frame, _ in errors]
        if any(db is not None for db in psnr):
            series["measured"] = [None if db is None else PEAK / 10 ** (db / 20) for db in psnr]
        labels = plots.Labels(
            "Predicted error per frame",
            "frame",
            "RMS of 255 levels",
            "How wrong each new frame is expected to be; lower is better.",
        )
        worst = numbers.index(review["predicted_error"]["worst_frame"])
        blocks.append(plots.draw_lines(labels, numbers, series, worst, cuts))
    if places := places_worth_a_look(run)[:MAX_PLACES]:
        rows: list[list[html.Cell]] = [
            [
                html.frame_cell(place.frame, album),
                f"{place.error:.1f}",
                f"{place.width}x{place.height} at {place.x},{place.y}",
                place.reason,
            ]
            for place in places
        ]
        columns = ("frame", "predicted error", "pixels", "why")
        blocks.append(html.Table("Places worth a look", columns, rows, PLACES_NOTE))
    return blocks


def _quality(
    run: RunSummary, document: dict[str, Any], album: Album, cuts: Sequence[int]
) -> list[html.Block]:
    blocks: list[html.Block] = []
    scored = [frame for frame in run.frames if frame.score is not None]
    if scored:
        numbers, scores = [f.number for f in scored], [f.score for f in scored]
        makers = [frame_maker(frame) for frame in scored]
        psnr = [None if score is None else score.psnr_db for score in scores]
        if len(scored) > 1 and any(value is not None for value in psnr):
            labels = plots.Labels(
                "PSNR per frame",
                "frame",
                "PSNR dB",
                "PSNR of every scored frame, coloured by what made it; higher is better.",
            )
            blocks.append(plots.draw_points(labels, numbers, psnr, makers, cuts))
        quality = document["quality"]
        parts = {"holes only": quality["holes"]}
        parts |= {f"made by {name}": part for name, part in quality["by_decision"].items()}
        parts["repeated"] = quality["dropped"]
        parts = {name: part for name, part in parts.items() if part["frames"]}
        note = "Means over the frames between key frames."
        all_parts = {"all pixels": quality["all"], **parts}
        blocks.append(html.quality_table("Against ground truth", all_parts, note))
        blocks += html.metric_plots(numbers, scores, skip=("psnr_db",), cuts=cuts)
        blocks += html.worst_tables(numbers, scores, album, makers)
    blocks += _slot_plots(scored or run.frames)

    pulse, metric = document["pulse"], html.BY_FIELD["pulse"]
    if pulse is not None and pulse["against"] == KEY_FRAMES:
        pulses = [(f.number, f.key_pulse) for f in run.frames if f.key_pulse is not None]
        if len(pulses) > 1:
            labels = plots.Labels(f"{metric.name} per frame", "frame", metric.title, PULSE_NOTE)
            numbers = [number for number, _ in pulses]
            series = {metric.title: [value for _, value in pulses]}
            worst = numbers.index(pulse["worst_frame"])
            blocks.append(plots.draw_lines(labels, numbers, series, worst, cuts))
        rows = (
            ("mean of the new frames", metric.text(pulse["mean"])),
            (f"worst, frame {pulse['worst_frame']}", metric.text(pulse["worst"])),
        )
        blocks.append(html.Table("Sharpness", ("", metric.title), rows, PULSE_NOTE))
    return blocks


def _slot_plots(frames: Sequence[FrameRecord]) -> list[plots.Figure]:
    """Draw sharpness and flicker by slot: the mean, lowest and highest of the key intervals."""
    figures = []
    for field, (title, note) in SLOT_PLOTS.items():
        metric = html.BY_FIELD[field]
        values: dict[int, list[float]] = {}
        for frame in frames:
            source = frame if field == "pulse" else frame.score
            value = None if source is None else getattr(source, field)
            if frame.slot and value is not None:
                values.setdefault(frame.slot, []).append(value)
        if len(values) < 2:
            continue
        slots = sorted(values)
        series: dict[str, list[float | None]] = {
            "mean": [mean(values[slot]) for slot in slots],
            "lowest": [min(values[slot]) for slot in slots],
            "highest": [max(values[slot]) for slot in slots],
        }
        x_label = "slot"
        if metric.signed:  # key frames are as sharp as themselves
            slots = [0, *slots, slots[-1] + 1]
            series = {name: [0.0, *row, 0.0] for name, row in series.items()}
            x_label = f"slot, with the key frames at 0 and {slots[-1]}"
        labels = plots.Labels(title, x_label, metric.title, f"{metric.title} by slot. {note}", note)
        figures.append(plots.draw_lines(labels, slots, series))
    return figures


def _decisions(run: RunSummary, decisions: dict[str, Any]) -> list[html.Block]:
    if not any(frame.slot for frame in run.frames):
        return []
    blocks: list[html.Block] = [_draw_makers(run.frames)]
    by_methods: dict[tuple[str, ...], list[dict[str, Any]]] = {}
    for trial in decisions["gate"] or ():
        by_methods.setdefault(tuple(n for n in trial if n.endswith("_db")), []).append(trial)
    for (cheap, dear), trials in by_methods.items():
        rows = [
            (
                "none" if trial["frame"] is None else str(trial["frame"]),
                sentences.format_number(trial[cheap], 2),
                sentences.format_number(trial[dear], 2),
                trial["used"],
                ranges(trial["keys"]),
            )
            for trial in trials
        ]
        names = [name.removesuffix("_db") for name in (cheap, dear)]
        columns = ("key frame", *(f"{name}, dB" for name in names), "used", "intervals")
        title = f"{' and '.join(names)} on the shot's own key frames"
        blocks.append(html.Table(title, columns, rows, TRIALS_NOTE))
    if ahead := decisions["look_ahead"]:
        made = [(name, sentences.format_number(ahead[kind], 1)) for name, kind in LOOK_AHEAD_KINDS]
        blocks.append(html.Table("Between key frames", ("method", "frames"), made, TILES_NOTE))
    if any(decisions["paths"].values()):
        counts = decisions["nodes"]
        nodes = [
            [node, *(sentences.format_number(counts[node][choice], 0) for choice in CHOICES)]
            for node in NODES
        ]
        blocks.append(html.Table("Decisions by node", ("node", *CHOICES), nodes))
        paths = [(path, sentences.format_number(n, 0)) for path, n in decisions["paths"].items()]
        title, unit = "key intervals", "intervals"
        if decisions["cost"] is not None:
            title = unit = "tiles"
        blocks.append(html.Table(f"Paths of the {title}", ("path", unit), paths))
    return blocks


def _draw_makers(frames: Sequence[FrameRecord]) -> plots.Figure:
    """Draw what made each slot: key intervals from left to right, slots below each other."""
    slots = range(1, 1 + max(frame.slot for frame in frames))
    intervals: dict[int, list[plots.TimelineCell | None]] = {}
    for frame in frames:
        column = intervals.setdefault(frame.key, [None] * len(slots))
        if frame.slot:
            decision = frame.decision
            why = "" if decision is None else f", {decision.node} = {decision.choice}"
            path = "" if frame.path is None else f", path {frame.path}"
            hint = f"frame {frame.number}: {frame_maker(frame)}{why}{path}"
            column[frame.slot - 1] = plots.TimelineCell(frame_maker(frame), hint)
    labels = plots.Labels(
        "What made each frame",
        description="A column a key interval and a row a slot, coloured by what made the frame.",
    )
    kinds = dict.fromkeys(frame_maker(frame) for frame in frames if frame.slot)
    rows = [f"slot {slot}" for slot in slots]
    return plots.draw_timeline(labels, rows, list(intervals.values()), list(kinds))


def _holes_and_features(
    run: RunSummary, document: dict[str, Any], cuts: Sequence[int]
) -> list[html.Block]:
    blocks: list[html.Block] = []
    holes = [frame for frame in run.frames if frame.has_holes]
    if len(holes) > 1:
        labels = plots.Labels(
            "Hole share per frame",
            "frame",
            "holes, % of pixels",
            "Share of pixels that the warp from the key frame cannot see.",
        )
        shares = [100 * (frame.hole_fraction or 0.0) for frame in holes]
        numbers = [frame.number for frame in holes]
        blocks.append(plots.draw_lines(labels, numbers, {"holes": shares}, cuts=cuts))
        if histogram := document["holes"]["histogram"]:
            # As the paper's Figure 2, up to the last bin with frames.
            edges, counts = histogram["edges"], histogram["counts"]
            bins = max(i + 1 for i, count in enumerate(counts) if count)
            p95 = sentences.format_percent(document["holes"]["p95_fraction"])
            labels = plots.Labels(
                "Frames by hole share",
                "holes, % of pixels",
                "frames",
                f"Histogram of the hole share; 95 % of the frames have at most {p95}.",
            )
            percents = [100 * edge for edge in edges[: bins + 1]]
            blocks.append(plots.draw_histogram(labels, percents, counts[:bins]))
    features = [
        (f.number, f.decision.features) for f in run.frames if f.decision and f.decision.features
    ]
    if features:
        labels = plots.Labels(
            "Features that the policy sees",
            "frame",
            description="The features of each decision's instant, per slot.",
        )
        series = {
            name: [float(entry.values[i]) for _, entry in features]
            for i, name in enumerate(FEATURES)
            if name != "R"
        }
        blocks.append(plots.draw_series_panels(labels, [number for number, _ in features], series))
    return blocks


def _timing(run: RunSummary, timing_ms: dict[str, float | None]) -> list[html.Block]:
    steps = [step for step, ms in timing_ms.items() if ms is not None]
    if not steps:
        return []
    groups: dict[str, list[FrameRecord]] = {}
    for frame in run.frames:
        if frame.timing_ms:
            groups.setdefault(frame_maker(frame), []).append(frame)
    parts = {
        step: [mean(f.timing_ms.get(step, 0.0) for f in group) for group in groups.values()]
        for step in steps
    }
    labels = plots.Labels(
        "Time per frame by what made it",
        "ms",
        description="Mean milliseconds of each step for each kind of frame, end to end.",
        note="Steps overlap on several threads: reading runs ahead and writing behind.",
    )
    rows = [(step, sentences.format_number(timing_ms[step])) for step in steps]
    return [
        plots.draw_stacked_bars(labels, list(groups), parts),
        html.Table("Mean of the frames that had the step", ("step", "ms"), rows),
    ]


def _unused_input(document: dict[str, Any]) -> Iterator[html.Section]:
    """Yield the sections of what was left out, and of what is not finite, if there is any."""
    if left_out := document["left_out"]:
        rows: list[list[html.Cell]] = [
            [
                str(interval["key"]),
                *(ranges(interval[name]) for name in ("frames", "scores", "rendered")),
                interval["reason"],
            ]
            for interval in left_out
        ]
        title = "Not scored"
        if any(interval["frames"] for interval in left_out):
            title = "Key intervals left out"
        elif any(interval["rendered"] for interval in left_out):
            title = "Rendered frames that are not used"
        columns = ("key frame", "frames", "not scored", "rendered, not used", "why")
        yield html.Section("left-out", "Left out", [html.Table(title, columns, rows)])
    if nonfinite := document["nonfinite"]:
        view = ("view",) if nonfinite[0]["view"] else ()
        rows = [
            [
                *(str(entry[name]) for name in ("key", "slot", *view, "channels")),
                sentences.format_number(entry["pixels"], 0),
            ]
            for entry in nonfinite[:MAX_ROWS]
        ]
        columns = ("key frame", "slot", *view, "channels", "pixels")
        note = sentences.describe_nonfinite(nonfinite)
        table = html.Table("Not finite in the input", columns, rows, note)
        yield html.Section("nonfinite", "NaN and infinities", [table])


def _settings(document: dict[str, Any]) -> html.Table:
    source, fps = document["input"], document["fps"]
    geometry = {"key": "for the key frames", "slot": "for every slot"}[document["setting"]]
    if source["motion"]["source"] == "estimated":
        geometry = "none with vectors"
    cuts = "not looked for"
    if document["cuts"] is not None:
        cuts = sentences.describe_cuts(document["cuts"]) if document["cuts"] else "none"
    rows: list[list[html.Cell]] = [
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
        ["cuts", cuts],
        ["holds", sentences.describe_holds(document["held"]) if document["held"] else None],
        ["method", document["method"]],
        ["uses the next key frame", "yes" if document["lookahead"] else "no"],
    ]
    for name in ("extrapolator", "interpolator", "policy"):
        for key, value in (document[name] or {}).items():
            if isinstance(value, bool):
                value = "yes" if value else "no"
            elif isinstance(value, list):
                value = ", ".join(map(str, value)) or "none"
            if value is not None:
                rows.append([f"{name} {key}", str(value)])
    if document["view_transform"] != SRGB_VIEW:
        rows.append(["pictures shown by", document["view_transform"]])
    if document["verified"] is not None:
        rows.append(["files read back, all as written", str(document["verified"])])
    rows.append(["ExWarp", document["version"]])
    return html.Table("", ("", ""), rows)
