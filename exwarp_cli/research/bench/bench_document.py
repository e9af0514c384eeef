"""The contract of bench.json, schema ``exwarp.bench/1``: a table or figure of the paper a key."""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Iterable
from importlib import resources
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from exwarp_cli import __version__, accelerator
from exwarp_cli.accelerator.mac_array import Schedule
from exwarp_cli.domain.decision import CHOICES, FEATURES, HOLD, PATHS
from exwarp_cli.domain.results import Score
from exwarp_cli.domain.timeline import FACTOR
from exwarp_cli.report.schema import count_decisions, mean, mean_scores, to_plain
from exwarp_cli.research.bench import paper, systems
from exwarp_cli.research.bench.benchmark import GBUFFERS_OF, Benchmark, Measured
from exwarp_cli.research.bench.real_time import BASE_FPS, REFRESH_HZ, SLOT_MS, clocked_row

SCHEMA = "exwarp.bench/1"

# Bins of the histogram of hole shares (Figure 2); the last one holds 1, too.
HOLE_EDGES = (0.0, 0.01, 0.05, 0.1, 0.2, 0.3, 0.4, 1.0)

# Features that vary within a sequence: R, the resolution, does not.
VARYING_FEATURES = FEATURES[:-1]

# Points from which on a correlation says anything.
MIN_POINTS = 3

Document = dict[str, Any]


def bench_document(benchmark: Benchmark, predictor: Schedule, clock_hz: float) -> Document:
    """Turn a benchmark into the dictionary of bench.json.

    The time of `predictor`, the accelerator's schedule, is stated at `clock_hz`. None is what was
    not measured, never 0; no number is NaN or infinite. What the paper prints stands under
    ``paper``. ``real_time`` is there with a clock alone.
    """
    rows, clock = benchmark.measured, benchmark.settings.clock
    tables: dict[str, list[Document]] = defaultdict(list)
    for row in rows:
        of_row = _time_rows(row) | _frame_rows(row) | _score_rows(row)
        for name, values in of_row.items():
            tables[name].append(identify(row) | values)
    document = {
        "schema": SCHEMA,
        "version": __version__,
        "networks": benchmark.networks,
        "metrics": sorted(benchmark.settings.metrics),
        "systems": {
            name: {
                "about": systems.ABOUT.get(name, f"network {name.removeprefix(systems.ONNX)}"),
                "lookahead": systems.is_lookahead(name),
            }
            for name in benchmark.systems
        },
        "sequences": [
            identify(row)
            | {"intervals": len(row.parts)}
            | {name: row.about[name] for name in ("fps", "producer", "policy")}
            | {"machine": row.timing["machine"]}
            for row in rows
        ],
        "runtime": tables["runtime"],
        "holes": tables["holes"],
        "features": [_features_row([row], identify(row)) for row in rows]
        + [_features_row(rows, {"name": "all", "setting": None, "size": None})],
        "quality": tables["quality"],
        "comparison": tables["comparison"],
        "fps": tables["fps"],
        "decisions": tables["decisions"],
        "predictor": _predictor_cost(predictor, clock_hz),
        "extranet_procedure": tables["extranet_procedure"],
        "render_time": tables["render_time"],
    }
    if clock is not None:
        document["real_time"] = {
            "clock": clock,
            "refresh_hz": REFRESH_HZ,
            "slot_ms": SLOT_MS,
            "base": BASE_FPS,
            "rows": [
                identify(row) | clocked_row(row.about, row.timing["steps_ms"], row.parts, clock)
                for row in rows
            ],
        }
    plain: Document = to_plain(document)
    return plain


def identify(row: Measured) -> Document:
    """Return how rows of all tables name a sequence.

    ``app`` is the paper's abbreviation for a scene of its themes; None for another scene.
    """
    about, subject = row.about, row.subject
    app = paper.SCENES.get(subject.name)
    if app is not None:
        app += next(mark for least, mark in paper.SIZES if about["height"] >= least)
    return {
        "name": subject.name,
        "setting": subject.setting,
        "size": f"{about['width']}x{about['height']}",
        "app": app,
    }


def _time_rows(row: Measured) -> Document:
    """Return the rows of a sequence that state times: Table III, beside rendering, and Figure 8.

    A rate is base x (1 + mean number of new frames a key interval).
    """
    steps, render_s = row.timing["steps_ms"], row.about["render_s"]
    printed = paper.RUNTIME.get(identify(row)["app"])
    runtime = {
        "gbuffer_ms": None if render_s["gbuffer"] is None else 1e3 * render_s["gbuffer"],
        "warping_ms": steps["warp"],
        "hole_marking_ms": steps.get("holes"),
        "inference_ms": steps.get("network"),
        "others_ms": {
            name: value for name, value in steps.items() if name not in ("warp", "holes", "network")
        },
        "paper": printed and dict(zip(paper.RUNTIME_STEPS, printed, strict=True)),
    }
    new_frames: dict[str, float] = {}
    for name in row.parts[0]["systems"]:
        makers = [frame["made_by"] for part in row.parts for frame in part["systems"][name]]
        new_frames[name] = sum(maker != HOLD for maker in makers) / len(row.parts)
    base = row.about["fps"]
    fps = {
        "base": base,
        "effective": {name: base * (1 + new) for name, new in new_frames.items()},
        "paper": paper.EFFECTIVE_FPS,
    }
    rendered: float | None = render_s["key"]
    generated = {name: ms / 1e3 for name, ms in row.timing["systems_ms"].items()}
    faster = shares = None
    if rendered is not None:
        faster = {name: rendered / each for name, each in generated.items() if each > 0}
        shares = {}
        for name, seconds in generated.items():
            # Repeats cost time and save none, as they would not have been rendered.
            new = new_frames[name]
            shares[name] = (new * rendered - len(systems.SLOTS) * seconds) / ((1 + new) * rendered)
    render_time = {
        "key_frame_s": rendered,
        "generated_frame_s": generated,
        "times_faster": faster,
        "saved_share": shares,
    }
    return {"runtime": runtime, "render_time": render_time, "fps": fps}


def _frame_rows(row: Measured) -> Document:
    """Return the rows of Figures 2 and 9: holes and decisions."""
    holes: Document = dict.fromkeys(("mean", "below_10", "above_20", "histogram"))
    shares = [hole for part in row.parts for hole in part["holes"] if hole is not None]
    if shares:
        counts, _ = np.histogram(shares, bins=HOLE_EDGES)
        holes = {
            "mean": mean(shares),
            "p95": float(np.percentile(shares, 95)),
            "below_10": sum(hole < 0.1 for hole in shares) / len(shares),
            "above_20": sum(hole > 0.2 for hole in shares) / len(shares),
            "histogram": {"edges": list(HOLE_EDGES), "counts": counts.tolist()},
            "paper": paper.HOLES.get(identify(row)["app"]),
        }
    decisions = {
        chooser: count_decisions(part["paths"][chooser] for part in row.parts)
        for chooser in systems.CHOOSERS
        if chooser in row.parts[0]["paths"]
    }
    return {"holes": holes, "decisions": decisions | {"paper_warp_share": paper.WARP_SHARE}}


def _score_rows(row: Measured) -> Document:
    """Return the rows of Tables VI and VII, and of ExtraNet's procedure: means of scores.

    Those of Table VI have the mean return, the sum of the paper's rewards, of paths and choosers.
    """
    app, first = identify(row)["app"], row.parts[0]
    interval_ms = 1e3 / row.about["fps"]
    quality, comparison = {}, {}
    for name in first["systems"]:
        frames = [frame for part in row.parts for frame in part["systems"][name]]
        quality[name] = {
            "all": _mean_scores(frames),
            "holes": _mean_scores(frames, "holes"),
            "by_decision": {
                choice: _mean_scores(f for f in frames if f["made_by"] == choice)
                for choice in CHOICES
            },
            "dropped": _mean_scores(f for f in frames if f["made_by"] == HOLD),
        }
        comparison[name] = {
            "lookahead": systems.is_lookahead(name),
            "waits_ms": interval_ms if systems.is_lookahead(name) else 0.0,
            "frame_ms": row.timing["systems_ms"].get(name),
            **quality[name]["all"],
        }
    returns = None
    if first["returns"] is not None:
        gains = [dict(zip(PATHS, part["returns"], strict=True)) for part in row.parts]
        returns = {path.lower(): mean(each[path] for each in gains) for path in PATHS}
        for chooser in systems.CHOOSERS:
            returns[chooser] = mean(
                each[part["paths"][chooser]]
                for each, part in zip(gains, row.parts, strict=True)
                if chooser in part["paths"]
            )
    psnr = {name: quality[name]["all"]["psnr_db"] for name in systems.FIXED if name in quality}
    extranet = {
        name: {
            metric: mean(part["extranet"][name][metric] for part in row.parts)
            for metric in ("psnr_db", "ssim")
        }
        for name in first["extranet"]
    }
    return {
        "quality": {
            "systems": quality,
            "returns": returns,
            "best_path": max(psnr, key=lambda name: psnr[name]) if psnr else None,
            "paper": paper.QUALITY.get(app),
        },
        "comparison": {"systems": comparison, "paper": paper.INTERPOLATION.get(app)},
        "extranet_procedure": {"systems": extranet, "frames": len(row.parts)},
    }


def _mean_scores(frames: Iterable[Document], region: str = "all") -> Document:
    """Average scores of frames; `region` is "all" or "holes"."""
    return mean_scores(None if f[region] is None else Score(**f[region]) for f in frames)


def feature_points(row: Measured) -> list[Document]:
    """Return the features of every slot's decision beside the PSNR of W at that slot (Figure 4)."""
    return [
        {
            "key": part["key"],
            "slot": slot,
            **dict(zip(FEATURES, values, strict=False)),
            "R": values[5] * values[6],
            "distance": values[7],
            "warp_psnr_db": part["warp_psnr_db"][slot - 1],
            "hole_fraction": part["holes"][slot - 1],
        }
        for part in row.parts
        for slot, values in enumerate(part["features"], start=1)
    ]


def _features_row(rows: Iterable[Measured], identity: Document) -> Document:
    """Return how the features go together with the quality of W."""
    points = [point for row in rows for point in feature_points(row)]
    psnr = [point["warp_psnr_db"] for point in points]
    correlation = {}
    for name in VARYING_FEATURES:
        values = [point[name] for point in points]
        correlation[name] = {"pearson": pearson(values, psnr), "spearman": spearman(values, psnr)}
    return identity | {
        "points": len(points),
        "correlation": correlation,
        "paper": paper.CORRELATION,
    }


def pearson(x: ArrayLike, y: ArrayLike) -> float | None:
    """Return the linear correlation, -1 to 1; None for few points or a constant series."""
    a, b = np.asarray(x, np.float64), np.asarray(y, np.float64)
    if len(a) < MIN_POINTS or np.ptp(a) == 0 or np.ptp(b) == 0:
        return None
    a, b = a - a.mean(), b - b.mean()
    return float((a * b).sum() / np.sqrt((a * a).sum() * (b * b).sum()))


def spearman(x: ArrayLike, y: ArrayLike) -> float | None:
    """Return the correlation of ranks, -1 to 1; equal values share their mean rank."""
    ranks = []
    for values in (x, y):
        _, inverse, counts = np.unique(values, return_inverse=True, return_counts=True)
        ranks.append((np.cumsum(counts) - (counts - 1) / 2)[inverse])
    return pearson(*ranks)


def _predictor_cost(schedule: Schedule, clock_hz: float) -> Document:
    """Return the synthesis table: ours, counted or measured by `make hardware`, and the paper's."""
    measured = resources.files(accelerator).joinpath("verilog", "measured.json")
    return {
        "clock_hz": clock_hz,
        "cycles": schedule.cycles,
        "mac_cycles": schedule.mac_cycles,
        "utilisation": schedule.utilisation,
        "latency_ns": schedule.latency_ns(clock_hz),
        "memory_bytes": sum(schedule.core_bytes),
        "fullest_core_bytes": max(schedule.core_bytes),
        "cache_bytes": schedule.array.cache_bytes,
        "refill_bytes": schedule.refill_bytes,
        "synthesis": json.loads(measured.read_text(encoding="utf-8")),
        "paper": {
            "area_mm2": paper.AREA_MM2,
            "power_mw": paper.POWER_MW,
            "latency_ns": paper.LATENCY_NS,
        },
    }


def describe_benchmark(document: Document) -> str:
    """Say in a few sentences what was measured, and on what."""
    sequences = document["sequences"]
    sizes = dict.fromkeys(row["size"] for row in sequences)
    rates = dict.fromkeys(row["fps"] for row in sequences)
    settings = {row["setting"] for row in sequences}
    gbuffers = " and ".join(text for key, text in GBUFFERS_OF.items() if key in settings)
    intervals = sum(row["intervals"] for row in sequences)
    machines = dict.fromkeys(
        f"{row['machine']['processor']}, {row['machine']['cores']} cores" for row in sequences
    )
    text = (
        f"{len(sequences):,} sequence{'' if len(sequences) == 1 else 's'} of {', '.join(sizes)} "
        f"pixels, {intervals:,} key interval{'' if intervals == 1 else 's'}, "
        + " and ".join(f"{rate:g} to {FACTOR * rate:g}" for rate in rates)
        + f" frames per second, G-buffers for {gbuffers}, ExWarp {document['version']}. "
        f"Run times on {'; '.join(machines)}."
    )
    unseen = [row["name"] for row in sequences if row["policy"]["trained_without_it"]]
    if unseen:
        names = ", ".join(dict.fromkeys(unseen))
        text += f" The policy of each scene was trained without it ({names})."
    return text
