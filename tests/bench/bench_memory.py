"""Peak memory of the whole command at 1920x1080 and 3840x2160, beside its bounds.

``python -m tests.bench.bench_memory [--count 5]``. Memory does not grow with the length, which
``tests/cli/test_report.py`` pins, so a few key frames show the peak.

This program itself stays small, since Linux counts a parent's memory at the moment of the fork as
its child's.
"""

from __future__ import annotations

import argparse
import statistics
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from tests.bench import goals
from tests.bench.running import cleared, module, run, upsample

HD, UHD = 1080, 2160
GOALS = {
    ("s6", HD): 700.0,
    ("softsplat", HD): 700.0,
    ("s3", HD): 2000.0,
    ("s6", UHD): 2000.0,
    ("softsplat", UHD): 2000.0,
    ("s3", UHD): 2000.0,
}
"""MB by method and lines of the frame; s3 has two of three new frames extrapolated."""

EXTRAPOLATES = "s3"
COUNT, ROUNDS = 5, 1


def main(arguments: Sequence[str] | None = None) -> int:
    parser = goals.parser_of("tests.bench.bench_memory", __doc__, ROUNDS, threads=True)
    parser.add_argument("--count", type=int, default=COUNT, help="key frames, 4 or more")
    options = parser.parse_args(arguments)
    figures = []
    with tempfile.TemporaryDirectory(prefix="exwarp-bench-") as folder:
        for height in (HD, UHD):
            keys = Path(folder) / str(height)
            size = ("--count", str(options.count), "--height", str(height))
            run(module("tests.bench.big_input", str(keys), *size))
        print(f"\npeak memory of upsample, {options.count} key frames, {options.threads} threads")
        print(f"{'':24}{'peak MB':>9}{'goal':>9}")
        for (method, height), goal in GOALS.items():
            figures.append(_figure(Path(folder), method, height, goal, options))
    return goals.finish(figures, options)


def _figure(
    folder: Path, method: str, height: int, goal: float, options: argparse.Namespace
) -> goals.Figure:
    """Run a method some times; print its peak, and return it."""
    keys, out = folder / str(height), folder / "out"
    # The third key frame is the first with two others before it, which networks see.
    frames = ("--frames", "3") if method == EXTRAPOLATES else ()
    peaks = []
    for _ in range(options.rounds):
        cleared(out)
        peaks.append(run(upsample(keys, out, method, options.threads, *frames)).peak_mb)
    name = f"{method}, {height} lines"
    print(f"{name:24}{statistics.median(peaks):9.0f}{goal:9.0f}")
    ends = (statistics.median(peaks), min(peaks), max(peaks))
    return goals.Figure("memory", name, *ends, goal, "MB")


if __name__ == "__main__":
    sys.exit(main())
