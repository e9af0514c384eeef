"""How long E takes for an 854x480 frame, part by part, beside the bare network.

``python -m tests.bench.bench_extrapolate [--model FILE] [--threads N]``.
"""

from __future__ import annotations

import argparse
import statistics
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from exwarp_cli.domain.frame import GBuffer, KeyFrame
from exwarp_cli.io.models import load_extrapolator
from exwarp_cli.kernels import jit
from exwarp_cli.synthesis.geometry import settle_motion
from exwarp_cli.synthesis.history import past_of
from exwarp_cli.synthesis.interval import Interval
from tests.unit.analytic_scene import STEP, surface
from tests.unit.scenes import town

SIZE = (854, 480)
ROUNDS = 5
K = 3
SLOT = 2


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser("python -m tests.bench.bench_extrapolate", description=__doc__)
    parser.add_argument("--model", type=Path, help="default: the one that comes with ExWarp")
    parser.add_argument("--threads", type=int, default=2)
    options = parser.parse_args(arguments)
    jit.set_threads(options.threads)
    network = load_extrapolator(options.model, options.threads, "cpu")
    print(
        f"E at {SIZE[0]}x{SIZE[1]}, {options.threads} threads, medians of {ROUNDS} rounds, seconds"
    )
    for setting in ("key", "slot"):
        parts = {name: [] for name in ("motion field", "history", "inputs", "network", "finish")}
        for _ in range(ROUNDS + 1):
            _round(setting, network, parts)
        medians = {name: statistics.median(times[1:]) for name, times in parts.items()}
        whole = sum(medians.values())
        told = ", ".join(f"{name} {seconds:.3f}" for name, seconds in medians.items())
        print(f"{setting}: {whole:.3f} ({told}); {whole / medians['network']:.2f} of the network")
    return 0


def _round(setting: str, network, parts: dict[str, list[float]]) -> None:
    interval = _interval(setting)
    _timed(parts["motion field"], lambda: interval.back(SLOT))
    _timed(parts["history"], lambda: interval.look_back(SLOT))
    prepared = _timed(parts["inputs"], lambda: interval.prepared(SLOT))
    answer = _timed(parts["network"], lambda: network(prepared.inputs))
    _timed(parts["finish"], lambda: prepared.finish(answer))


def _timed(times: list[float], work: Callable):
    begin = time.perf_counter()
    made = work()
    times.append(time.perf_counter() - begin)
    return made


def _interval(setting: str) -> Interval:
    keys = [_key(K - j) for j in range(3)]
    slots = tuple(_slot(K, i) for i in (1, 2, 3)) if setting == "slot" else ()
    return Interval(keys[0], None, slots, past_of(keys))


_KNOWN: dict[float, KeyFrame] = {}


def _key(k: int) -> KeyFrame:
    return _frame(float(k), 1.0)


def _slot(k: int, i: int) -> GBuffer:
    gbuffer = _frame(k + STEP * i, STEP).gbuffer
    assert gbuffer is not None
    return gbuffer


def _frame(when: float, step: float) -> KeyFrame:
    """Return an instant with settled motion and surface, made once."""
    if when not in _KNOWN:
        view = town(SIZE).view(when)
        frame = view.key(1)
        gbuffer = replace(view.gbuffer(step=step), **surface(view))
        _KNOWN[when] = replace(frame, gbuffer=settle_motion(gbuffer))
    return _KNOWN[when]


if __name__ == "__main__":
    sys.exit(main())
