"""Peak memory of the whole command at 1920x1080 and 3840x2160, beside its bounds.

``python -m tests.bench.bench_memory [--count 5]``. Memory does not grow with the length, which
``tests/cli/test_report.py`` pins, so a few key frames show the peak: at 1920x1080 so many that the
camera turns back among them, as key frames are read there to see whether it is a cut.

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
COUNTS = {HD: 12, UHD: 5}
"""Key frames by lines of the frame; of the example there are nine, then they go back."""

OWN = ""
"""The compression of the example, PXR24."""

GOALS = {
    ("s6", HD, OWN): 1000.0,
    ("softsplat", HD, OWN): 1000.0,
    ("s6", HD, "piz"): 1000.0,
    ("softsplat", HD, "piz"): 1000.0,
    ("s6", HD, "dwaa"): 1000.0,
    ("softsplat", HD, "dwaa"): 1000.0,
    ("s3", HD, OWN): 2000.0,
    ("causal", HD, OWN): 2000.0,
    ("s6", UHD, OWN): 2500.0,
    ("softsplat", UHD, OWN): 2500.0,
    ("s3", UHD, OWN): 2500.0,
}
"""MB by method, lines of the frame and compression; s3 has two of three new frames extrapolated,
and so has exwarp, which reads ahead meanwhile."""

EXTRAPOLATED = {"s3": range(3, 4), "causal": range(3, 6)}
"""Key frames by methods that take seconds for a frame; the third is the first with two others
before it, which networks see."""
ROUNDS = 1


def main(arguments: Sequence[str] | None = None) -> int:
    parser = goals.parser_of("tests.bench.bench_memory", __doc__, ROUNDS, threads=True)
    parser.add_argument("--count", type=int, help="key frames, 4 or more")
    options = parser.parse_args(arguments)
    figures = []
    with tempfile.TemporaryDirectory(prefix="exwarp-bench-") as folder:
        print(f"\npeak memory of upsample, {options.threads} threads")
        print(f"{'':28}{'key frames':>12}{'peak MB':>9}{'goal':>9}")
        for (method, height, compression), goal in GOALS.items():
            keys = Path(folder) / f"{height}{compression}"
            if not keys.is_dir():
                asked = _asked(height, compression, options)
                run(module("tests.bench.big_input", str(keys), *asked))
            named = f"{method}, {height} lines" + (f", {compression}" if compression else "")
            figures.append(_figure(keys, method, named, goal, options))
    return goals.finish(figures, options)


def _asked(height: int, compression: str, options: argparse.Namespace) -> list[str]:
    """Return what `big_input` is asked for."""
    size = ["--height", str(height), "--count", str(options.count or COUNTS[height])]
    return [*size, "--compression", compression] if compression else size


def _figure(
    keys: Path, method: str, name: str, goal: float, options: argparse.Namespace
) -> goals.Figure:
    """Run a method some times; print its peak, and return it."""
    out, some = keys.parent / "out", EXTRAPOLATED.get(method)
    frames = () if some is None else ("--frames", f"{some[0]}-{some[-1]}")
    count = len(list(keys.iterdir()) if some is None else some)
    peaks = []
    for _ in range(options.rounds):
        cleared(out)
        peaks.append(run(upsample(keys, out, method, options.threads, *frames)).peak_mb)
    print(f"{name:28}{count:12}{statistics.median(peaks):9.0f}{goal:9.0f}")
    ends = (statistics.median(peaks), min(peaks), max(peaks))
    return goals.Figure("memory", name, *ends, goal, "MB")


if __name__ == "__main__":
    sys.exit(main())
