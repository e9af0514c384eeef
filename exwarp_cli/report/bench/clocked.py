"""What a display shows in real time: latencies, rate, decisions and quality under the clock."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import astuple

import numpy as np
import numpy.typing as npt

from exwarp_cli.domain.bench import BEST_PSNR, BEST_RETURN, FIXED, POLICY
from exwarp_cli.domain.decision import EXTRAPOLATE, PATHS, WARP
from exwarp_cli.domain.real_time import (
    BASE_FPS,
    MEASURED,
    REASONS,
    REFRESH_HZ,
    SLOT_MS,
    TABLE_AS,
    TABLE_PIXELS,
    ClockedInterval,
    Latencies,
    effective_fps,
    play,
    play_interval,
)
from exwarp_cli.pipeline.bench.measure import SLOT_SCORES
from exwarp_cli.pipeline.bench.pictures import name_on
from exwarp_cli.pipeline.bench.work import Benchmark, Measured
from exwarp_cli.pipeline.scoring import SLOTS
from exwarp_cli.policy.outcomes import clocked_returns
from exwarp_cli.report.bench import paper
from exwarp_cli.report.bench.naming import Document, identify
from exwarp_cli.report.decisions import decisions
from exwarp_cli.report.quality import mean

SYSTEMS = (POLICY, *FIXED, BEST_PSNR, BEST_RETURN)
"""Systems that the clock runs, where they were measured: all with our W and E."""

F64 = npt.NDArray[np.float64]

Schedules = Mapping[str, ClockedInterval]
"""What each decision path shows in an interval that begins with a free engine."""


def real_time(found: Benchmark) -> Document:
    """Return everything under the clock; a row a sequence."""
    clock = found.settings.clock
    assert clock is not None
    return {
        "clock": clock,
        "refresh_hz": REFRESH_HZ,
        "slot_ms": SLOT_MS,
        "base": BASE_FPS,
        "rows": [clocked_row(one, clock) for one in found.measured],
    }


def clocked_row(one: Measured, clock: str) -> Document:
    """Return what a sequence shows under a clock."""
    if clock == MEASURED:
        latencies = measured_latencies(one.timing["steps_ms"])
    else:
        own = one.about["width"] * one.about["height"]
        latencies = table_latencies(TABLE_PIXELS[TABLE_AS[clock]] if clock in TABLE_AS else own)
    schedules = {path: play_interval(path, latencies) for path in PATHS}
    taken = _paths(one, schedules)
    return identify(one) | {
        "latency_ms": {WARP: latencies.warp_ms, EXTRAPOLATE: latencies.extrapolate_ms},
        "extrapolate_slots": latencies.extrapolate_slots,
        "paths": {
            path: {"made_by": each.made_by, "dropped": each.dropped, "new": each.generated}
            for path, each in schedules.items()
        },
        "systems": {
            name: _system(one, taken[name], latencies, schedules)
            for name in SYSTEMS
            if name in one.parts[0]["systems"]
        },
    }


def table_latencies(pixels: int) -> Latencies:
    """Return the latencies of the paper's Table III for frames of so many pixels.

    W is G-buffer generation and warping, E all four steps. Means over the applications of each size
    are interpolated by pixels; smaller frames count as 480p, larger ones in proportion to 1080p.
    """
    sizes = [TABLE_PIXELS[size] for size in paper.RUNTIME_APPS]
    steps = [
        np.mean([astuple(paper.RUNTIME[app]) for app in apps], axis=0)
        for apps in paper.RUNTIME_APPS.values()
    ]
    larger = max(pixels / sizes[-1], 1.0)
    warp, extrapolate = (
        float(np.interp(pixels, sizes, [each[:count].sum() for each in steps])) * larger
        for count in (2, 4)
    )
    return Latencies(warp, extrapolate)


def measured_latencies(steps_ms: Mapping[str, float]) -> Latencies:
    """Return the latencies of this machine; `steps_ms` as `bench.timing.time_subject` returns them.

    W is geometry, warping and hole marking, E these, the network's inputs and the network.
    """
    warp = sum(steps_ms.get(step, 0.0) for step in ("geometry", "warp", "holes"))
    if "network" not in steps_ms:
        return Latencies(warp, np.inf)
    return Latencies(warp, warp + steps_ms["inputs"] + steps_ms["network"])


def _paths(one: Measured, schedules: Schedules) -> dict[str, list[str]]:
    """Return the path of every interval by system; oracles know the clock and the truth."""
    taken = {name: [name.upper()] * len(one.parts) for name in FIXED}
    taken[POLICY] = [part["paths"][POLICY] for part in one.parts]
    if BEST_PSNR in one.parts[0]["paths"]:
        psnr = [_quality(part, schedules)[..., 0].mean(axis=-1) for part in one.parts]
        taken[BEST_PSNR] = [_best(values) for values in psnr]
        taken[BEST_RETURN] = [_best(_returns(part, schedules)) for part in one.parts]
    return taken


def _quality(part: Document, schedules: Schedules) -> F64:
    """Return PSNR and SSIM of what slots 1 to 3 of each path show, float64 [6, 3, 2]."""
    return np.array([_shown(part, schedules[path]) for path in PATHS], np.float64)


def _shown(part: Document, played: ClockedInterval) -> list[list[float]]:
    """Return PSNR and SSIM of what slots 1 to 3 of a key interval show."""
    scores = part[SLOT_SCORES]
    return [scores[name_on(played.made_by, slot)][slot - 1] for slot in SLOTS]


def _returns(part: Document, schedules: Schedules) -> F64:
    """Return the sum of rewards of each path, float64 [6]."""
    dropped = [len(SLOTS) - each.generated for each in schedules.values()]
    return clocked_returns(_quality(part, schedules), dropped)


def _best(values: F64) -> str:
    """Name the best path; of equal ones the last, which warps more."""
    return list(PATHS)[len(PATHS) - 1 - int(np.argmax(values[::-1]))]


def _system(
    one: Measured, paths: Sequence[str], latencies: Latencies, schedules: Schedules
) -> Document:
    """Return what a system that takes these paths shows."""
    played = play(paths, latencies)
    slots = Counter(
        reason or maker
        for interval in played
        for maker, reason in zip(interval.made_by, interval.dropped, strict=True)
    )
    psnr, ssim = (
        mean(
            score[metric]
            for part, interval in zip(one.parts, played, strict=True)
            for score in _shown(part, interval)
        )
        for metric in range(2)
    )
    return {
        "effective": effective_fps(played),
        "slots": {kind: slots[kind] for kind in (WARP, EXTRAPOLATE, *REASONS)},
        "psnr_db": psnr,
        "ssim": ssim,
        "return": _return(one, paths, schedules),
        "decisions": decisions(paths),
    }


def _return(one: Measured, paths: Sequence[str], schedules: Schedules) -> float | None:
    """Return the mean return a key interval; None where nothing was extrapolated."""
    if one.parts[0]["returns"] is None:
        return None
    names = list(PATHS)
    return mean(
        float(_returns(part, schedules)[names.index(path)])
        for part, path in zip(one.parts, paths, strict=True)
    )
