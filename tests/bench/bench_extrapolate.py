"""How long E takes for an 854x480 frame, part by part, beside its network alone in onnxruntime.

``python -m tests.bench.bench_extrapolate [--model FILE] [--threads N]``.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import onnxruntime

from exwarp_cli.domain.extrapolator import TIME, Extrapolator, NetworkInputs
from exwarp_cli.domain.frame import GBuffer, KeyFrame
from exwarp_cli.io.model_checks import stated_stride
from exwarp_cli.io.models import load_extrapolator, shipped_folder
from exwarp_cli.kernels import jit
from exwarp_cli.synthesis.geometry import settle_motion
from exwarp_cli.synthesis.history import past_of
from exwarp_cli.synthesis.interval import Interval
from tests.bench import goals
from tests.bench.timing import Ratio
from tests.unit.analytic_scene import STEP, surface
from tests.unit.scenes import town

SIZE = (854, 480)
ROUNDS = 5
K = 3
SLOT = 2
BARE, WHOLE = "session alone", "E"
PARTS = ("motion field", "history", "inputs", "network", "finish")
GOALS = {f"{WHOLE}, {setting} G-buffers": 1.1 for setting in ("key", "slot")}

Bare = Callable[[NetworkInputs], object]


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser("python -m tests.bench.bench_extrapolate", description=__doc__)
    parser.add_argument("--model", type=Path, help="default: the one that comes with ExWarp")
    parser.add_argument("--rounds", type=int, default=ROUNDS)
    parser.add_argument("--threads", type=int, default=os.cpu_count() or 1)
    goals.add_options(parser)
    options = parser.parse_args(arguments)
    jit.set_threads(options.threads)
    network = load_extrapolator(options.model, options.threads, "cpu")
    path = options.model or shipped_folder() / "extrapolator.onnx"
    bare = _session(path, options.threads)
    ratios: dict[str, Ratio] = {}
    for setting in ("key", "slot"):
        times: dict[str, list[float]] = {name: [] for name in (BARE, *PARTS)}
        for _ in range(options.rounds + 1):
            _round(setting, network, bare, times)
        measured = {name: taken[1:] for name, taken in times.items()}  # the first one compiles
        whole = [sum(parts) for parts in zip(*(measured[p] for p in PARTS), strict=True)]
        named = {WHOLE: whole, **{name: measured[name] for name in PARTS}}
        ratios |= {
            f"{name}, {setting} G-buffers": Ratio.of(taken, measured[BARE])
            for name, taken in named.items()
        }
    title = f"E at {SIZE[0]}x{SIZE[1]}, {options.threads} threads, {options.rounds} rounds"
    return goals.finish(goals.table("extrapolate", title, BARE, ratios, GOALS), options)


def _session(path: Path, threads: int) -> Bare:
    """Return the network as onnxruntime runs it by default."""
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = threads
    session: Any = onnxruntime.InferenceSession(path, options, providers=["CPUExecutionProvider"])
    known = {node.name for node in session.get_inputs()}
    stride = stated_stride(path, session.get_modelmeta().custom_metadata_map)

    def work(inputs: NetworkInputs) -> object:
        fed = _padded(inputs, stride)
        return session.run(None, {name: made for name, made in fed if name in known})

    return work


def _padded(inputs: NetworkInputs, stride: int) -> list[tuple[str, np.ndarray]]:
    height, width = inputs.mask.shape[1:]
    padding = ((0, 0), (0, -height % stride), (0, -width % stride))
    pictures = [(n, np.pad(p, padding, mode="edge")[None]) for n, p in inputs.pictures.items()]
    return [*pictures, (TIME, np.array([inputs.time], np.float32))]


def _round(setting: str, network: Extrapolator, bare: Bare, times: dict[str, list[float]]) -> None:
    interval = _interval(setting)
    _timed(times["motion field"], lambda: interval.back(SLOT))
    _timed(times["history"], lambda: interval.look_back(SLOT))
    prepared = _timed(times["inputs"], lambda: interval.prepared(SLOT))
    answer = _timed(times["network"], lambda: network(prepared.inputs))
    _timed(times["finish"], lambda: prepared.finish(answer))
    _timed(times[BARE], lambda: bare(prepared.inputs))


def _timed(times: list[float], work: Callable[[], Any]) -> Any:
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
