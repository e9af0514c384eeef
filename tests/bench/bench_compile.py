"""What compiling the kernels adds to the first run on a machine: seconds, by method.

``python -m tests.bench.bench_compile [--methods s6 …]``: the command with an empty cache of
kernels, then the same again. The frames are small, so nearly all the rest is start-up, which both
have. Processor seconds are compared with the goal: other work on the machine moves wall time.
"""

from __future__ import annotations

import argparse
import statistics
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from tests.bench import goals
from tests.bench.running import Run, cleared, run, upsample

METHODS = ("s6", "softsplat", "causal")
GOAL = 30.0
"""Seconds of processor time, for all the kernels that a command uses."""

ROUNDS = 3
FRAMES = "1-3"


def main(arguments: Sequence[str] | None = None) -> int:
    parser = goals.parser_of("tests.bench.bench_compile", __doc__, ROUNDS, threads=True)
    parser.add_argument("--keys", type=Path, default=next(iter(Path("examples").glob("*/keys"))))
    parser.add_argument("--frames", default=FRAMES, help="which of them, as upsample takes it")
    parser.add_argument("--methods", nargs="+", default=METHODS)
    options = parser.parse_args(arguments)
    print(f"first run beside the next, {options.threads} threads, seconds, {options.rounds} rounds")
    print(f"{'':12}{'first: cpu':>12}{'wall':>8}{'next: cpu':>12}{'wall':>8}{'compiling':>12}")
    figures = []
    for method in options.methods:
        pairs = [_pair(method, options) for _ in range(options.rounds)]
        extra = [cold.cpu - warm.cpu for cold, warm in pairs]
        columns = [statistics.median(x) for x in zip(*map(_columns, pairs), strict=True)]
        cells = "{:12.2f}{:8.2f}{:12.2f}{:8.2f}".format(*columns)
        compiling = statistics.median(extra)
        print(f"{method:12}{cells}{compiling:12.2f}  goal {GOAL:g}", flush=True)
        name = f"compiling for {method}"
        ends = (compiling, min(extra), max(extra))
        figures.append(goals.Figure("compile", name, *ends, GOAL, "s"))
    return goals.finish(figures, options)


def _pair(method: str, options: argparse.Namespace) -> tuple[Run, Run]:
    """Run with an empty cache of kernels, and again with what that left."""
    with tempfile.TemporaryDirectory(prefix="exwarp-bench-") as folder:
        out, cache = Path(folder) / "out", Path(folder) / "cache"
        cache.mkdir()
        frames = ("--frames", options.frames)
        command = upsample(options.keys, out, method, options.threads, *frames)
        first = run(command, {"NUMBA_CACHE_DIR": str(cache)})
        cleared(out)
        return first, run(command, {"NUMBA_CACHE_DIR": str(cache)})


def _columns(pair: tuple[Run, Run]) -> tuple[float, ...]:
    first, following = pair
    return first.cpu, first.wall, following.cpu, following.wall


if __name__ == "__main__":
    sys.exit(main())
