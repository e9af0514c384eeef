"""The real-time clock: what a display at 120 Hz shows of each decision path, and what it drops.

Slots follow each other every 1000/120 ms. A slot's frame is requested when its node decides, one
slot earlier; E(F) of a path that extrapolates at d1 is requested with the key frame, two slots
earlier. One engine runs E, a frame at a time; W does not need it.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from math import ceil, inf
from typing import Any

import numpy as np
import numpy.typing as npt

from exwarp_cli.domain.decision import EXTRAPOLATE, FIRST_NODE, HOLD, PATHS, WARP
from exwarp_cli.domain.timeline import FACTOR
from exwarp_cli.policy.outcomes import clocked_returns
from exwarp_cli.report.schema import count_decisions, mean
from exwarp_cli.research.bench import paper, systems

REFRESH_HZ = 120  # slots a second: the paper's display
BASE_FPS = REFRESH_HZ / FACTOR  # key frames a second
SLOT_MS = 1000 / REFRESH_HZ

# Why a slot repeats the frame before: the path makes no frame for it; its frame is not ready at the
# slot; or the engine still runs an earlier E when its own is requested. A request that meets a busy
# engine is refused: where the engine is still busy, E takes so long that it would be late.
BY_PATH, LATE, BUSY = "by path", "late", "busy"
REASONS = (BY_PATH, LATE, BUSY)

# Systems that the clock runs, where they were measured: all with our W and E.
CLOCKED_SYSTEMS = (systems.POLICY, *systems.FIXED, systems.BEST_PSNR, systems.BEST_RETURN)

F64 = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Latencies:
    """Milliseconds from the request of a frame until it can be shown; infinite for never."""

    warp_ms: float
    extrapolate_ms: float

    @property
    def extrapolate_slots(self) -> int | None:
        """Slots until E's frame can be shown; None if it never comes."""
        slots = self.extrapolate_ms / SLOT_MS
        return ceil(slots) if slots < inf else None


@dataclass(frozen=True)
class ClockedInterval:
    """What a key interval shows under the clock."""

    # What makes the frame of slots 1, 2 and 3: warp, extrapolate or hold. A W of slot 3 samples
    # E(F) only where slot 2 shows it, else the key frame.
    made_by: tuple[str, ...]
    dropped: tuple[str | None, ...]  # for each slot out of `REASONS`; None for a new frame
    busy_slots: float  # how long E's engine works on after the next key frame

    @property
    def generated(self) -> int:
        """How many of the three frames are new; repeats are not."""
        return self.dropped.count(None)


def play_interval(path: str, latencies: Latencies, busy_slots: float = 0.0) -> ClockedInterval:
    """Run a decision path, S1 to S6, against the clock.

    `busy_slots` is how long the engine still works on an E of the key interval before.
    """
    made_by: list[str] = []
    dropped: list[str | None] = []
    engine_free = busy_slots
    for slot, maker in enumerate(PATHS[path].made_by, start=1):
        starts_with_key = slot == 2 and PATHS[path].choices[FIRST_NODE] == EXTRAPOLATE
        requested = 0 if starts_with_key else slot - 1
        reason: str | None
        if maker == HOLD:
            reason = BY_PATH
        elif maker == EXTRAPOLATE and engine_free > requested:
            reason = BUSY
        else:
            ms = latencies.extrapolate_ms if maker == EXTRAPOLATE else latencies.warp_ms
            ready = requested + ms / SLOT_MS
            reason = LATE if ready > slot else None
            if maker == EXTRAPOLATE:
                engine_free = ready  # an E that is late runs to its end, too
        made_by.append(maker if reason is None else HOLD)
        dropped.append(reason)
    return ClockedInterval(tuple(made_by), tuple(dropped), max(engine_free - FACTOR, 0.0))


def play(paths: Iterable[str], latencies: Latencies) -> tuple[ClockedInterval, ...]:
    """Run the paths of key intervals that follow each other; the engine goes on between them."""
    played: list[ClockedInterval] = []
    for path in paths:
        busy = played[-1].busy_slots if played else 0.0
        played.append(play_interval(path, latencies, busy))
    return tuple(played)


def table_latencies(pixels: int) -> Latencies:
    """Return the latencies of the paper's Table III for frames of so many pixels.

    W is G-buffer generation and warping, E all four steps. Means over the applications of each size
    are interpolated by pixels; smaller frames count as 480p, larger ones in proportion to 1080p.
    """
    sizes = [systems.TABLE_PIXELS[size] for size in paper.RUNTIME_APPS]
    steps = [
        np.mean([paper.RUNTIME[app] for app in apps], axis=0)
        for apps in paper.RUNTIME_APPS.values()
    ]
    larger = max(pixels / sizes[-1], 1.0)
    warp, extrapolate = (
        float(np.interp(pixels, sizes, [each[:count].sum() for each in steps])) * larger
        for count in (2, 4)
    )
    return Latencies(warp, extrapolate)


def measured_latencies(steps_ms: Mapping[str, float]) -> Latencies:
    """Return the latencies of this machine; `steps_ms` is from `measurement.time_subject`.

    W is geometry, warping and hole marking, E these, the network's inputs and the network.
    """
    warp = sum(steps_ms.get(step, 0.0) for step in ("geometry", "warp", "holes"))
    if "network" not in steps_ms:
        return Latencies(warp, np.inf)
    return Latencies(warp, warp + steps_ms["inputs"] + steps_ms["network"])


def clocked_row(
    about: Mapping[str, Any],
    steps_ms: Mapping[str, float],
    parts: Sequence[dict[str, Any]],
    clock: str,
) -> dict[str, Any]:
    """Return what a sequence shows under a clock; arguments as in `benchmark.Measured`."""
    if clock == systems.MEASURED:
        latencies = measured_latencies(steps_ms)
    elif clock in systems.TABLE_AS:
        latencies = table_latencies(systems.TABLE_PIXELS[systems.TABLE_AS[clock]])
    else:
        latencies = table_latencies(about["width"] * about["height"])
    # What each path shows in an interval that begins with a free engine.
    schedules = {path: play_interval(path, latencies) for path in PATHS}
    taken = {name: [name.upper()] * len(parts) for name in systems.FIXED}
    taken[systems.POLICY] = [part["paths"][systems.POLICY] for part in parts]
    returns: F64 | None = None  # sums of rewards, float64 [intervals, 6]
    if parts[0]["returns"] is not None:  # else nothing was extrapolated
        shown = [
            [systems.picture_at(each.made_by, slot) for slot in systems.SLOTS]
            for each in schedules.values()
        ]
        quality = np.array(  # PSNR and SSIM, by key interval, path and slot
            [
                [[part["slot_scores"][name][i] for i, name in enumerate(names)] for names in shown]
                for part in parts
            ]
        )
        dropped = [len(systems.SLOTS) - each.generated for each in schedules.values()]
        returns = np.array([clocked_returns(of_paths, dropped) for of_paths in quality])
        # Oracles know the clock and the truth; of equal paths they take the last, which warps more.
        backwards = list(PATHS)[::-1]
        judged = {systems.BEST_PSNR: quality[..., 0].mean(axis=-1), systems.BEST_RETURN: returns}
        for name, values in judged.items():
            taken[name] = [backwards[i] for i in np.argmax(values[:, ::-1], axis=1).tolist()]
    return {
        "latency_ms": {WARP: latencies.warp_ms, EXTRAPOLATE: latencies.extrapolate_ms},
        "extrapolate_slots": latencies.extrapolate_slots,
        "paths": {
            path: {"made_by": each.made_by, "dropped": each.dropped, "new": each.generated}
            for path, each in schedules.items()
        },
        "systems": {
            name: _clocked_system(parts, taken[name], latencies, returns)
            for name in CLOCKED_SYSTEMS
            if name in parts[0]["systems"]
        },
    }


def _clocked_system(
    parts: Sequence[dict[str, Any]], paths: Sequence[str], latencies: Latencies, returns: F64 | None
) -> dict[str, Any]:
    """Return what a system that takes these paths shows."""
    played = play(paths, latencies)
    slots = Counter(
        reason or maker
        for interval in played
        for maker, reason in zip(interval.made_by, interval.dropped, strict=True)
    )
    quality = [
        part["slot_scores"][systems.picture_at(interval.made_by, slot)][slot - 1]
        for part, interval in zip(parts, played, strict=True)
        for slot in systems.SLOTS
    ]
    new = [interval.generated for interval in played]
    gains = []
    if returns is not None:
        columns = [list(PATHS).index(path) for path in paths]
        gains = returns[np.arange(len(paths)), columns].tolist()
    return {
        "effective": BASE_FPS * (1 + sum(new) / len(new)),
        "slots": {kind: slots[kind] for kind in (WARP, EXTRAPOLATE, *REASONS)},
        "psnr_db": mean(psnr for psnr, _ in quality),
        "ssim": mean(ssim for _, ssim in quality),
        "return": mean(gains),
        "decisions": count_decisions(paths),
    }
