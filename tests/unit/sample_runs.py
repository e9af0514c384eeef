"""Runs made by hand for the tests of the report."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from exwarp_cli.domain.results import FrameKind, FrameRecord, InputSummary, RunSummary, Score
from exwarp_cli.report.gallery import Album

INPUT = InputSummary(
    "/in/shot.####.exr", 1001, 1002, 64, 32, "Blender", "calibrated", "measured on one pair"
)

# What stands at slots 1 to 3 on each path of the paper's table: (d)ropped or (g)enerated.
SLOTS = {"S1": "dgd", "S2": "dgg", "S3": "ggg", "S4": "ggg", "S5": "ggg", "S6": "ggg"}
# What made it: the (h)eld frame before, (w)arping or (e)xtrapolation.
MAKERS = {"S1": "heh", "S2": "hew", "S3": "wee", "S4": "wew", "S5": "wwe", "S6": "www"}
WORDS = {"h": "hold", "w": "warp", "e": "extrapolate"}


def no_pictures() -> Album:
    return Album((), "", "")


def record(number: int, key: int, slot: int, kind: FrameKind, **more: Any) -> FrameRecord:
    method = "key" if kind is FrameKind.KEY else "warp"
    return FrameRecord(number, f"shot.{number}.exr", key, slot, kind, method, (key,), **more)


def interval(key: int, slots: str, first: int) -> list[FrameRecord]:
    """Key frame and what follows it."""
    kinds = {"d": FrameKind.DROPPED, "g": FrameKind.GENERATED}
    frames = [record(first, key, 0, FrameKind.KEY)]
    frames += [record(first + i, key, i, kinds[c]) for i, c in enumerate(slots, 1)]
    return frames


def run(frames: list[FrameRecord], **more: Any) -> RunSummary:
    made = RunSummary("warp", "key", False, INPUT, 24.0, "header", 2.0, tuple(frames))
    return replace(made, **more)


def path_run(path: str, intervals: int = 3, scored: bool = False) -> RunSummary:
    """Run one path in every interval; scores tell the slots apart (slot i has i * 10 dB)."""
    frames = []
    for k in range(intervals):
        for frame in interval(1001 + k, SLOTS[path], 1001 + 4 * k):
            score = Score(frame.slot * 10.0, 0.5, 0.1) if scored and frame.slot else None
            if frame.slot:
                maker = WORDS[MAKERS[path][frame.slot - 1]]
                frame = replace(frame, made_by=maker, path=path)
            frames.append(replace(frame, score=score))
    return run(frames, decides=True)
