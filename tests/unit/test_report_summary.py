"""report.json: its keys, its counts, and null where nothing was measured."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from fractions import Fraction
from typing import Any

import numpy as np
import pytest

from exwarp_cli import __version__
from exwarp_cli.domain.results import FrameKind, NetworkSummary, PolicySummary, RunSummary, Score
from exwarp_cli.report.schema import run_document, to_json, to_plain
from tests.unit.sample_runs import interval, path_run, record, run

METRICS = ("psnr_db", "ssim", "flip", "hdr_flip", "vmaf", "flicker", "pulse")
QUALITY = dict.fromkeys((*METRICS, "frames"))
CONTRACT: dict[str, Any] = {
    "schema": None,
    "version": None,
    "method": None,
    "setting": None,
    "lookahead": None,
    "input": {
        **dict.fromkeys(("pattern", "first", "last", "width", "height", "producer")),
        "motion": {"source": None, "evidence": None},
        **dict.fromkeys(("dynamic", "depth", "step", "selected")),
    },
    "frames": dict.fromkeys(
        ("key", "written", "generated", "dropped", "rendered", "resumed", "made", "replaced")
    ),
    "fps": dict.fromkeys(("base", "effective", "output", "throughput", "source", "factor")),
    "holes": dict.fromkeys(("mean_fraction", "p95_fraction", "histogram")),
    "decisions": {
        "nodes": {f"d{i}": {"warp": None, "extrapolate": None} for i in range(1, 6)},
        "paths": {f"S{i}": None for i in range(1, 7)},
        "warp_share": None,
        "gate": None,
        "look_ahead": None,
        "cost": None,
    },
    "quality": {
        "all": QUALITY,
        "holes": QUALITY,
        "by_decision": {"warp": QUALITY, "extrapolate": QUALITY},
        "dropped": QUALITY,
    },
    "pulse": None,
    "review": None,
    "timing_ms": dict.fromkeys(
        ("read", "features", "decide", "warp", "holes", "extrapolate", "write")
    ),
    "extrapolator": None,
    "policy": None,
    "interpolator": None,
    "render_time": None,
    "cuts": None,
    "held": None,
    "views": None,
    "layers": None,
    "left_out": None,
    "files": None,
    "verified": None,
    "nonfinite": None,
    "view_transform": None,
    "wall_s": None,
}


def keys_of(value: Any) -> Any:
    return {key: keys_of(item) for key, item in value.items()} if isinstance(value, dict) else None


def known(quality: dict[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in quality.items() if value is not None}


def test_keys_are_exactly_the_contract() -> None:
    found = run_document(run(interval(1001, "ggg", 1001)))
    assert keys_of(found) == CONTRACT
    assert list(found) == list(CONTRACT)
    assert found["schema"] == "exwarp.report/1"
    assert found["version"] == __version__


def test_what_was_not_measured_is_null() -> None:
    found = run_document(run(interval(1001, "ggg", 1001), wall_seconds=0.0))
    unknown = {**dict.fromkeys(METRICS), "frames": 0}
    assert found["quality"]["all"] == unknown
    assert found["quality"]["by_decision"] == {"warp": unknown, "extrapolate": unknown}
    assert found["holes"] == {"mean_fraction": None, "p95_fraction": None, "histogram": None}
    assert set(found["timing_ms"].values()) == {None}
    assert found["fps"]["throughput"] is None
    assert keys_of(found["decisions"]) == found["decisions"], "nothing but null"


def test_pulse_is_that_of_new_frames_by_what_there_is() -> None:
    frames = interval(1001, "dgg", 1001)
    scored = [replace(frame, score=Score(pulse=-6.0)) for frame in frames[1:]]
    keyed = [replace(frames[2], key_pulse=2.0), replace(frames[3], key_pulse=-4.0)]
    found = run_document(run([frames[0], *scored]))
    expected = {"mean": -6.0, "worst": -6.0, "worst_frame": 1003, "frames": 2}
    assert found["pulse"] == {**expected, "against": "ground truth"}
    assert found["quality"]["all"]["pulse"] == -6
    found = run_document(run([*frames[:2], *keyed]))
    expected = {"mean": -1.0, "worst": -4.0, "worst_frame": 1004, "frames": 2}
    assert found["pulse"] == {**expected, "against": "key frames"}
    found = run_document(run([*frames[:2], keyed[0], scored[2]]))
    expected = {"mean": -6.0, "worst": -6.0, "worst_frame": 1004, "frames": 1}
    assert found["pulse"] == {**expected, "against": "ground truth"}, "never of both"


def test_the_network_is_named() -> None:
    network = NetworkSummary("/models/a.onnx", "0" * 64, "cuda", demodulated=True)
    found = run_document(run(interval(1001, "ggg", 1001), extrapolator=network))
    expected = {"file": "/models/a.onnx", "sha256": "0" * 64, "device": "cuda", "demodulated": True}
    assert found["extrapolator"] == expected


def test_the_policy_is_listed_with_what_it_lacked() -> None:
    policy = PolicySummary("/models/p.npz", "1" * 64, "motion", ("EMD_Wn", "EMD_Wp"))
    found = run_document(run(interval(1001, "ggg", 1001), policy=policy))
    assert json.loads(to_json(found))["policy"] == {
        "file": "/models/p.npz",
        "sha256": "1" * 64,
        "objects_from": "motion",
        "missing": ["EMD_Wn", "EMD_Wp"],
        "trained_for": [],
        "note": None,
    }


def test_decisions_of_several_paths_add_up() -> None:
    """S2, S4 and S5 once each; the last interval is not whole, the first has an unknown path."""
    frames = [replace(f, path=None) for f in interval(1000, "ggg", 997)]
    for k, path in enumerate(("S2", "S4", "S5", "S6")):
        frames += [replace(f, key=1001 + k) for f in path_run(path, 1).frames]
    found = run_document(run(frames[:-1], decides=True))["decisions"]
    assert found["paths"] == {"S1": 0, "S2": 1, "S3": 0, "S4": 1, "S5": 1, "S6": 0}
    assert found["nodes"] == {
        "d1": {"warp": 2, "extrapolate": 1},
        "d2": {"warp": 1, "extrapolate": 1},
        "d3": {"warp": 1, "extrapolate": 0},
        "d4": {"warp": 1, "extrapolate": 0},
        "d5": {"warp": 0, "extrapolate": 1},
    }
    assert found["warp_share"] == pytest.approx(5 / 8)


def test_outside_the_tree_nothing_was_decided() -> None:
    """Blends are booked as warps, but no decision led to them."""
    frames = [replace(f, made_by="warp", score=Score(9, 0.5, 0.1)) for f in interval(1, "ggg", 1)]
    found = run_document(run(frames))
    assert keys_of(found["decisions"]) == found["decisions"], "nothing but null"
    assert {part["frames"] for part in found["quality"]["by_decision"].values()} == {0}


def test_an_empty_run_is_reported() -> None:
    found = run_document(run([]))
    assert set(found["frames"].values()) == {0}
    rates = {"base": 24.0, "effective": None, "output": 96.0, "factor": "4"}
    assert found["fps"] == {**rates, "throughput": None, "source": "header"}
    assert found["input"]["selected"] is None
    assert run_document(path_run("S6", 0))["decisions"]["warp_share"] is None


@pytest.mark.parametrize(
    ("path", "effective"),
    [("S1", 48), ("S2", 72), ("S3", 96), ("S4", 96), ("S5", 96), ("S6", 96)],
)
def test_effective_fps_of_every_path(path: str, effective: float) -> None:
    assert run_document(path_run(path))["fps"]["effective"] == effective


def test_effective_fps_leaves_out_incomplete_intervals() -> None:
    frames = interval(1001, "ggg", 1001) + interval(1002, "dgd", 1005) + interval(1003, "", 1009)
    assert run_document(run(frames))["fps"]["effective"] == 24 * (1 + (3 + 1) / 2)
    assert run_document(run(frames[-1:]))["fps"]["effective"] is None


def test_effective_fps_at_another_rate_counts_key_frames_that_are_shown() -> None:
    first, second = interval(1, "gg", 1), interval(2, "gg", 4)[1:]
    found = run_document(run(first + second, factor=Fraction(5, 2)))["fps"]
    assert (found["output"], found["effective"]) == (60.0, 60.0)
    # An odd number of intervals shows no more than the output has.
    assert run_document(run(first, factor=Fraction(5, 2)))["fps"]["effective"] == 60.0
    held = interval(1, "dg", 1)
    assert run_document(run(held, factor=Fraction(5, 2)))["fps"]["effective"] == 40.0


def test_throughput_counts_what_this_run_wrote() -> None:
    frames = interval(1001, "ggg", 1001)
    frames = [replace(f, resumed=f.slot < 2) for f in frames]
    found = run_document(run(frames))
    assert found["fps"]["throughput"] == 2 / 2.0
    assert found["frames"] == {
        "key": 1, "written": 4, "generated": 3, "dropped": 0, "rendered": 0,
        "resumed": 2, "made": 2, "replaced": 0,
    }  # fmt: skip
    done = [replace(f, resumed=True) for f in frames]
    assert run_document(run(done))["fps"]["throughput"] is None


# Node: (warp, extrapolate) in three intervals; the table of the decision tree.
NODES = {
    "S1": {"d1": (0, 3), "d3": (0, 3)},
    "S2": {"d1": (0, 3), "d3": (3, 0)},
    "S3": {"d1": (3, 0), "d2": (0, 3), "d4": (0, 3)},
    "S4": {"d1": (3, 0), "d2": (0, 3), "d4": (3, 0)},
    "S5": {"d1": (3, 0), "d2": (3, 0), "d5": (0, 3)},
    "S6": {"d1": (3, 0), "d2": (3, 0), "d5": (3, 0)},
}
SHARE = {"S1": 0, "S2": 1 / 2, "S3": 1 / 3, "S4": 2 / 3, "S5": 2 / 3, "S6": 1}


@pytest.mark.parametrize("path", list(NODES))
def test_decisions_of_every_path(path: str) -> None:
    frames = [*path_run(path).frames, record(1013, 1004, 0, FrameKind.KEY)]  # no tail
    found = run_document(run(frames, decides=True))["decisions"]
    for node in ("d1", "d2", "d3", "d4", "d5"):
        warp, extrapolate = NODES[path].get(node, (0, 0))
        assert found["nodes"][node] == {"warp": warp, "extrapolate": extrapolate}
    assert found["paths"] == {f"S{i}": 3 if path == f"S{i}" else 0 for i in range(1, 7)}
    assert found["warp_share"] == pytest.approx(SHARE[path])


# Path: slots whose frame is warped, extrapolated, repeated.
MADE_BY = {
    "S1": ([], [2], [1, 3]),
    "S2": ([3], [2], [1]),
    "S3": ([1], [2, 3], []),
    "S4": ([1, 3], [2], []),
    "S5": ([1, 2], [3], []),
    "S6": ([1, 2, 3], [], []),
}


@pytest.mark.parametrize("path", list(MADE_BY))
def test_quality_is_split_by_what_made_the_frame(path: str) -> None:
    found = run_document(path_run(path, scored=True))["quality"]
    parts = (found["by_decision"]["warp"], found["by_decision"]["extrapolate"], found["dropped"])
    for part, slots in zip(parts, MADE_BY[path], strict=True):
        assert part["frames"] == 3 * len(slots)
        assert part["psnr_db"] == (10 * sum(slots) / len(slots) if slots else None)
    assert known(found["all"]) == {
        "psnr_db": 20,
        "ssim": 0.5,
        "flip": pytest.approx(0.1),
        "frames": 9,
    }


def test_key_frames_are_never_scored_and_resumed_ones_are() -> None:
    frames = interval(1001, "gdg", 1001)
    scores = [Score(100, 1, 0), Score(30, 0.9, 0.2), Score(20, 0.7, 0.4), None]
    frames = [replace(f, score=s, resumed=True) for f, s in zip(frames, scores, strict=True)]
    frames[1] = replace(frames[1], hole_score=Score(10, 0.5, 0.6))
    found = run_document(run(frames))["quality"]
    overall = {"psnr_db": 25, "ssim": 0.8, "flip": pytest.approx(0.3), "frames": 2}
    assert known(found["all"]) == overall
    assert known(found["holes"]) == {"psnr_db": 10, "ssim": 0.5, "flip": 0.6, "frames": 1}
    assert known(found["dropped"]) == {"psnr_db": 20, "ssim": 0.7, "flip": 0.4, "frames": 1}


def test_a_metric_is_averaged_over_the_frames_that_have_it() -> None:
    scores = [None, Score(30, vmaf=80), Score(20, flicker=1.5), Score(vmaf=90)]
    frames = [
        replace(f, score=score)
        for f, score in zip(interval(1001, "ggg", 1001), scores, strict=True)
    ]
    found = run_document(run(frames))["quality"]["all"]
    assert known(found) == {"psnr_db": 25, "vmaf": 85, "flicker": 1.5, "frames": 3}


def test_holes_are_summed_up_over_shown_slots() -> None:
    fractions = [0.9, 0.0, 0.05, 1.0, None, 0.0, 0.049, 0.051]
    frames = interval(1001, "ggd", 1001) + interval(1002, "gdg", 1005)
    frames = [replace(f, hole_fraction=h) for f, h in zip(frames, fractions, strict=True)]
    found = run_document(run(frames))["holes"]
    known = [0.0, 0.05, 1.0, 0.0, 0.049, 0.051]
    assert found["mean_fraction"] == pytest.approx(np.mean(known))
    assert found["p95_fraction"] == pytest.approx(np.percentile(known, 95))
    assert found["histogram"]["edges"] == [i / 20 for i in range(21)]
    assert found["histogram"]["counts"] == [3, 2, *[0] * 17, 1]


def test_timing_is_the_mean_over_frames_with_that_step() -> None:
    frames = interval(1001, "gg", 1001)
    timings: list[dict[str, float]] = [{"read": 10}, {"warp": 4, "flip": 1}, {"warp": 6}]
    frames = [replace(f, timing_ms=t) for f, t in zip(frames, timings, strict=True)]
    found = run_document(run(frames))["timing_ms"]
    assert (found["read"], found["warp"], found["flip"], found["write"]) == (10, 5, 1, None)


def test_input_without_motion_keeps_its_keys() -> None:
    made = run([])
    still = replace(made, input=replace(made.input, motion_source=None, motion_evidence=None))
    assert run_document(still)["input"]["motion"] == {"source": None, "evidence": None}


def spoilt_run() -> RunSummary:
    frames = [
        replace(
            f,
            score=Score(math.inf, math.nan, np.float64(0.1)),
            hole_fraction=np.float32(0.25),
            timing_ms={"warp": math.nan},
        )
        for f in interval(1001, "ggg", 1001)
    ]
    return run(frames, base_fps=np.float64(23.976), wall_seconds=math.nan)


def test_no_number_is_nan_or_infinite() -> None:
    found = json.loads(to_json(run_document(spoilt_run())), parse_constant=pytest.fail)
    assert found["quality"]["all"]["psnr_db"] is None
    assert found["holes"]["mean_fraction"] == 0.25
    assert found["timing_ms"]["warp"] is None


def test_floats_keep_their_digits() -> None:
    value = 0.1 + 0.2
    assert json.loads(to_json({"a": value}))["a"] == value
    assert to_plain((np.int64(3), [np.float32(0.5)], -math.inf)) == [3, [0.5], None]
