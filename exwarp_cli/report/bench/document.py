"""The contract of bench.json, schema ``exwarp.bench/1``: a table or figure of the paper a key."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import asdict
from typing import Any

import numpy as np

from exwarp_cli import __version__
from exwarp_cli.accel.mac_array import Schedule
from exwarp_cli.domain.bench import CHOOSERS, EXTRANET, EXTRANET_FAST, ONNX, is_lookahead
from exwarp_cli.domain.decision import EXTRAPOLATE, HOLD, PATHS, WARP
from exwarp_cli.domain.features import FEATURES
from exwarp_cli.domain.results import Score
from exwarp_cli.pipeline.bench.work import Benchmark, Measured
from exwarp_cli.report.bench import paper
from exwarp_cli.report.bench.statistics import pearson, share, spearman
from exwarp_cli.report.decisions import decisions
from exwarp_cli.report.quality import mean, quality
from exwarp_cli.report.summary import finite

SCHEMA = "exwarp.bench/1"

HOLE_EDGES = (0.0, 0.01, 0.05, 0.1, 0.2, 0.3, 0.4, 1.0)
"""Bins of the histogram of hole shares (Figure 2); the last one holds 1, too."""

EFFECTIVE = FEATURES[:-1]
"""Features that vary within a sequence: R, the resolution, does not."""

Document = dict[str, Any]


def document(found: Benchmark, predictor: Schedule, clock_hz: float) -> Document:
    """Turn a benchmark into the dictionary of bench.json.

    Parameters
    ----------
    found
        What was measured.
    predictor
        The accelerator's schedule.
    clock_hz
        At which its time is stated.

    Returns
    -------
    dict
        None is what was not measured, never 0; no number is NaN or infinite. What the paper prints
        stands under ``paper``.
    """
    rows = found.measured
    plain: Document = finite(
        {
            "schema": SCHEMA,
            "version": __version__,
            "networks": found.networks,
            "metrics": sorted(found.settings.metrics),
            "systems": {name: about_system(name) for name in found.systems},
            "sequences": [_sequence(one) for one in rows],
            "runtime": [_runtime(one) for one in rows],
            "holes": [_holes(one) for one in rows],
            "features": [_features([one], identify(one)) for one in rows]
            + [_features(rows, {"name": "all", "setting": None, "size": None})],
            "quality": [_quality(one) for one in rows],
            "comparison": [_comparison(one) for one in rows],
            "fps": [_fps(one) for one in rows],
            "decisions": [_decisions(one) for one in rows],
            "predictor": _predictor(predictor, clock_hz),
            "extranet_procedure": [_by_extranet(one) for one in rows],
            "render_time": [_render_time(one) for one in rows],
        }
    )
    return plain


def identify(one: Measured) -> Document:
    """Return how rows of all tables name a sequence."""
    about, subject = one.about, one.subject
    return {
        "name": subject.name,
        "setting": subject.setting,
        "size": f"{about['width']}x{about['height']}",
        "app": paper.app_of(subject.name, about["height"]),
    }


def about_system(name: str) -> Document:
    """Say what a system is, and what it waits for."""
    if name in CHOOSERS:
        label = {
            "exwarp": "ExWarp: the learned policy, in 8-bit integers",
            "oracle": "best path of every interval by PSNR, by ground truth",
            "oracle-return": "best path by the paper's reward, by ground truth",
        }[name]
    elif name.upper() in PATHS:
        label = (
            "path "
            + name.upper()
            + {"s1": ", ExtraNet's way with our E", "s6": ", warping alone"}.get(name, "")
        )
    elif name in (EXTRANET, EXTRANET_FAST):
        label = "imported ExtraNet, path " + ("S1" if name == EXTRANET else "S3")
    elif name.startswith(ONNX):
        label = f"network {name.removeprefix(ONNX)}"
    else:
        label = {
            "softsplat": "both key frames splatted by the renderer's motion, blended by depth",
            "blend": "cross-fade",
            "minterpolate": "ffmpeg's minterpolate, from colour alone",
            "hold": "the key frame again",
        }[name]
    return {"about": label, "lookahead": is_lookahead(name)}


def shown(one: Measured, system: str) -> list[Document]:
    """Return the frames that a system shows at slots 1 to 3 of all key intervals."""
    return [frame for part in one.parts for frame in part["systems"][system]]


def scores(frames: Iterable[Document], where: str = "all") -> Document:
    """Average scores of frames; `where` is "all" or "holes"."""
    return quality(None if f[where] is None else Score(**f[where]) for f in frames)


def _sequence(one: Measured) -> Document:
    return identify(one) | {
        "intervals": len(one.parts),
        "fps": one.about["fps"],
        "producer": one.about["producer"],
        "policy": one.about["policy"],
        "machine": one.timing["machine"],
    }


def _runtime(one: Measured) -> Document:
    """Return a row of Table III: milliseconds a generated frame."""
    steps, row = one.timing["steps_ms"], identify(one)
    gbuffer = one.about["render_s"]["gbuffer"]
    printed = paper.RUNTIME.get(row["app"])
    return row | {
        "gbuffer_ms": None if gbuffer is None else 1e3 * gbuffer,
        "warping_ms": steps["warp"],
        "hole_marking_ms": steps.get("holes"),
        "inference_ms": steps.get("network"),
        "others_ms": {
            name: value for name, value in steps.items() if name not in ("warp", "holes", "network")
        },
        "paper": None if printed is None else asdict(printed),
    }


def _holes(one: Measured) -> Document:
    """Return what Figure 2 draws: how many frames have how many holes."""
    row = identify(one)
    known = [hole for part in one.parts for hole in part["holes"] if hole is not None]
    if not known:
        return row | {"mean": None, "below_10": None, "above_20": None, "histogram": None}
    counts, _ = np.histogram(known, bins=HOLE_EDGES)
    return row | {
        "mean": mean(known),
        "p95": float(np.percentile(known, 95)),
        "below_10": share(hole < 0.1 for hole in known),
        "above_20": share(hole > 0.2 for hole in known),
        "histogram": {"edges": list(HOLE_EDGES), "counts": counts.tolist()},
        "paper": paper.HOLES.get(row["app"]),
    }


def feature_points(one: Measured) -> list[Document]:
    """Return the features of every slot's decision beside the PSNR of W at that slot (Figure 4)."""
    return [
        {
            "key": part["key"],
            "slot": slot,
            **dict(zip(FEATURES, values, strict=False)),
            "EMD_Wp": values[2],
            "distance": values[7],
            "warp_psnr_db": part["warp_psnr_db"][slot - 1],
            "hole_fraction": part["holes"][slot - 1],
        }
        for part in one.parts
        for slot, values in enumerate(part["features"], start=1)
    ]


def _features(rows: Iterable[Measured], row: Document) -> Document:
    """Return how the features go together with the quality of W."""
    points = [point for one in rows for point in feature_points(one)]
    psnr = [point["warp_psnr_db"] for point in points]
    return row | {
        "points": len(points),
        "correlation": {
            name: {
                "pearson": pearson([point[name] for point in points], psnr),
                "spearman": spearman([point[name] for point in points], psnr),
            }
            for name in EFFECTIVE
        },
        "paper": paper.CORRELATION,
    }


def _quality(one: Measured) -> Document:
    """Return a row of Table VI, with every system: means over slots 1 to 3."""
    row, printed = identify(one), paper.QUALITY.get(identify(one)["app"] or "")
    systems = {}
    for name in one.parts[0]["systems"]:
        frames = shown(one, name)
        made = {maker: [f for f in frames if f["made_by"] == maker] for maker in MAKERS}
        systems[name] = {
            "all": scores(frames),
            "holes": scores(frames, "holes"),
            "by_decision": {choice: scores(made[choice]) for choice in (WARP, EXTRAPOLATE)},
            "dropped": scores(made[HOLD]),
        }
    return row | {
        "systems": systems,
        "returns": _returns(one),
        "best_path": _best(systems),
        "paper": printed,
    }


MAKERS = (WARP, EXTRAPOLATE, HOLD)


def _best(systems: Mapping[str, Document]) -> str | None:
    """Return the fixed path with the best PSNR."""
    known = {n: systems[n]["all"]["psnr_db"] for n in map(str.lower, PATHS) if n in systems}
    return max(known, key=lambda name: known[name]) if known else None


def _returns(one: Measured) -> Document | None:
    """Return the mean return (sum of the paper's rewards) of every path and of who chooses."""
    if one.parts[0]["returns"] is None:
        return None
    names = tuple(PATHS)
    found: Document = {
        name.lower(): mean(part["returns"][i] for part in one.parts) for i, name in enumerate(names)
    }
    for chooser in CHOOSERS:
        found[chooser] = mean(
            part["returns"][names.index(part["paths"][chooser])]
            for part in one.parts
            if chooser in part["paths"]
        )
    return found


def _comparison(one: Measured) -> Document:
    """Return a row of Table VII: look-ahead systems beside causal ones, with their latency."""
    row, spent = identify(one), one.timing["systems_ms"]
    wait = 1e3 / one.about["fps"]
    printed = paper.INTERPOLATION.get(row["app"] or "")
    return row | {
        "systems": {
            name: {
                "lookahead": is_lookahead(name),
                "waits_ms": wait if is_lookahead(name) else 0.0,
                "frame_ms": spent.get(name),
                **scores(shown(one, name)),
            }
            for name in one.parts[0]["systems"]
        },
        "paper": printed,
    }


def _fps(one: Measured) -> Document:
    """Return what Figure 8 draws: base x (1 + mean number of new frames a key interval)."""
    base = one.about["fps"]
    effective = {}
    for name in one.parts[0]["systems"]:
        new = sum(frame["made_by"] != HOLD for frame in shown(one, name))
        effective[name] = base * (1 + new / len(one.parts))
    return identify(one) | {"base": base, "effective": effective, "paper": paper.EFFECTIVE_FPS}


def _decisions(one: Measured) -> Document:
    """Return what Figure 9 draws: decisions, nodes and paths of the systems that choose."""
    found = {
        chooser: decisions(part["paths"][chooser] for part in one.parts)
        for chooser in CHOOSERS
        if chooser in one.parts[0]["paths"]
    }
    return identify(one) | found | {"paper_warp_share": paper.WARP_SHARE}


def _predictor(plan: Schedule, clock_hz: float) -> Document:
    """Return the synthesis table: ours where it can be counted, the paper's where it cannot."""
    return {
        "clock_hz": clock_hz,
        "cycles": plan.cycles,
        "mac_cycles": plan.mac_cycles,
        "utilisation": plan.utilisation,
        "latency_ns": plan.latency_ns(clock_hz),
        "memory_bytes": sum(plan.core_bytes),
        "fullest_core_bytes": max(plan.core_bytes),
        "cache_bytes": plan.array.cache_bytes,
        "refill_bytes": plan.refill_bytes,
        "paper": {
            "area_mm2": paper.AREA_MM2,
            "power_mw": paper.POWER_MW,
            "latency_ns": paper.LATENCY_NS,
        },
    }


def _by_extranet(one: Measured) -> Document:
    """Average what ExtraNet's procedure gives for the frame midway between key frames."""
    found = {
        name: {
            metric: mean(part["extranet"][name][metric] for part in one.parts)
            for metric in ("psnr_db", "ssim")
        }
        for name in one.parts[0]["extranet"]
    }
    return identify(one) | {"systems": found, "frames": len(one.parts)}


def _render_time(one: Measured) -> Document:
    """Return what rendering a key frame took beside making a frame, in seconds."""
    rendered, spent = one.about["render_s"]["key"], one.timing["systems_ms"]
    return identify(one) | {
        "key_frame_s": rendered,
        "generated_frame_s": {name: ms / 1e3 for name, ms in spent.items()},
        "times_faster": None
        if rendered is None
        else {name: 1e3 * rendered / ms for name, ms in spent.items() if ms > 0},
    }
