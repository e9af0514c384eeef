"""How long E takes for two 854x480 frames of an interval, beside its network alone.

``python -m tests.bench.bench_extrapolate [--model FILE] [--threads N]``.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from exwarp_cli.domain.frame import GBuffer, KeyFrame
from exwarp_cli.domain.network_api import TIME_INPUT, Extrapolator, NetworkPictures
from exwarp_cli.kernels import _row_bands
from exwarp_cli.models.model_file import shipped_folder
from exwarp_cli.models.picture_network import load_extrapolator
from exwarp_cli.models.session import open_session
from exwarp_cli.synthesis.history import older_key_frames
from exwarp_cli.synthesis.interval import Interval
from exwarp_cli.synthesis.motion_fields import settle_motion
from tests.bench import goals
from tests.bench.timing import Ratio
from tests.unit.analytic_scene import STEP, surface
from tests.unit.scenes import town

SIZE = (854, 480)
ROUNDS = 5
K = 3
SLOTS = (2, 3)
"""Those that are extrapolated where most are: by the path S3."""

BARE, WHOLE = "session alone", "E"
PARTS = ("motion field", "inputs", "network", "finish")
GOALS = {f"{WHOLE}, {setting} G-buffers": 1.1 for setting in ("key", "slot")}

Fed = dict[str, np.ndarray]
Bare = Callable[[Fed], object]


def main(arguments: Sequence[str] | None = None) -> int:
    parser = goals.parser_of("tests.bench.bench_extrapolate", __doc__, ROUNDS, threads=True)
    parser.add_argument("--model", type=Path, help="default: the one that comes with ExWarp")
    options = parser.parse_args(arguments)
    _row_bands.set_threads(options.threads)
    network = load_extrapolator(options.model, options.threads, "cpu")
    path = options.model or shipped_folder() / "extrapolator.onnx"
    bare = _session(path, options.threads)
    ratios: dict[str, Ratio] = {}
    for setting in ("key", "slot"):
        times: dict[str, list[float]] = {name: [] for name in (BARE, *PARTS)}
        for _ in range(options.rounds + 1):
            _round(setting, network, bare, network.stride, times)
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
    """Return what runs the network alone, with the settings of the product."""
    session = open_session(path, path.read_bytes(), threads, "cpu")
    known = {node.name for node in session.get_inputs()}

    def work(fed: Fed) -> object:
        return session.run(None, {name: made for name, made in fed.items() if name in known})

    return work


def _padded(inputs: NetworkPictures, stride: int) -> Fed:
    height, width = inputs.shape
    padding = ((0, 0), (0, -height % stride), (0, -width % stride))
    fed = {n: np.pad(p, padding, mode="edge")[None] for n, p in inputs.pictures.items()}
    return fed | {TIME_INPUT: np.array([inputs.time], np.float32)}


def _round(
    setting: str, network: Extrapolator, bare: Bare, stride: int, times: dict[str, list[float]]
) -> None:
    """Make both slots, which share what is found out once for an interval."""
    interval, taken = _interval(setting), {name: 0.0 for name in times}
    for slot in SLOTS:
        _timed(taken, "motion field", lambda s=slot: interval.back(s))
        prepared = _timed(taken, "inputs", lambda s=slot: interval.prepared(s))
        fed = _padded(prepared.inputs.part(slice(None), slice(None)), stride)
        _timed(taken, BARE, lambda f=fed: bare(f))
        answer = _timed(taken, "network", lambda p=prepared: network(p.inputs))
        _timed(taken, BARE, lambda f=fed: bare(f))
        _timed(taken, "finish", lambda p=prepared, a=answer: p.finish(a))
    taken[BARE] /= 2  # before and after: who comes first wakes the threads, and finds cold caches
    for name, seconds in taken.items():
        times[name].append(seconds)


def _timed(taken: dict[str, float], name: str, work: Callable[[], Any]) -> Any:
    begin = time.perf_counter()
    made = work()
    taken[name] += time.perf_counter() - begin
    return made


def _interval(setting: str) -> Interval:
    """Return one of a run of such: of F_k-2 the interval before has found out what it can."""
    keys = [_key(K - j) for j in range(3)]
    past = older_key_frames(keys)
    Interval(keys[1], None, _slots(setting, K - 1), past[1:]).look_back(SLOTS[0])
    return Interval(keys[0], None, _slots(setting, K), past)


def _slots(setting: str, k: int) -> tuple[GBuffer, ...]:
    return tuple(_slot(k, i) for i in (1, 2, 3)) if setting == "slot" else ()


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
