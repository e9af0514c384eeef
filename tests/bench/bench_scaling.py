"""Whether time grows in a straight line with the frame and with the length, and what two runs cost.

``python -m tests.bench.bench_scaling``: s6 on three key frames from 480 to 2160 lines; on 3 to 24
key frames of 480 lines; and two runs of one thread each, on chunks of their own, at once instead of
one after the other. The last is compared with what the codec floor loses by that, which is kept to
one core: cores share memory and caches in any case, but a run that took more than one when
it is alone would lose the rest.
"""

from __future__ import annotations

import argparse
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from tests.bench import goals
from tests.bench.running import Run, cleared, environment, module, run, upsample

METHOD = "s6"
HEIGHTS = (480, 720, 1080, 1440, 2160)
LENGTHS = (3, 6, 12, 24)
ROUNDS = 3
BENT, SHARED = 0.10, 1.1
"""Goals: the largest distance from a line, relative to it; and two runs beside two of the floor."""


def main(arguments: Sequence[str] | None = None) -> int:
    parser = goals.parser_of("tests.bench.bench_scaling", __doc__, ROUNDS, threads=True)
    parser.add_argument("--heights", type=int, nargs="+", default=HEIGHTS, metavar="LINES")
    parser.add_argument("--lengths", type=int, nargs="+", default=LENGTHS, metavar="KEYS")
    options = parser.parse_args(arguments)
    print(f"{METHOD}, {options.threads} threads, {options.rounds} rounds, seconds")
    with tempfile.TemporaryDirectory(prefix="exwarp-bench-") as folder:
        figures = _resolutions(Path(folder), options)
        keys = _keys(Path(folder), options.heights[0], max(options.lengths))
        figures += _lengths(keys, Path(folder) / "out", options)
        figures.append(_two(keys, Path(folder), options))
    return goals.finish(figures, options)


def _keys(folder: Path, height: int, count: int) -> Path:
    keys = folder / f"keys{height}x{count}"
    size = ("--height", str(height), "--count", str(count))
    run(module("tests.bench.big_input", str(keys), *size))
    return keys


def _resolutions(folder: Path, options: argparse.Namespace) -> list[goals.Figure]:
    found: dict[float, list[Run]] = {}
    for height in options.heights:  # one at a time, as frames of 4K fill a disk
        keys, out = _keys(folder, height, LENGTHS[0]), folder / "out"
        command = upsample(keys, out, METHOD, options.threads)
        run(command)  # unmeasured: kernels, and files in memory
        megapixels = height * 2 * round(height * 8 / 9) / 1e6
        found[megapixels] = [_again(command, out) for _ in range(options.rounds)]
        cleared(out)
        for key in keys.glob("*.exr"):
            key.unlink()
    return _line("megapixels", found)


def _lengths(keys: Path, out: Path, options: argparse.Namespace) -> list[goals.Figure]:
    found: dict[float, list[Run]] = {float(count): [] for count in options.lengths}
    for _ in range(options.rounds):
        for count, runs in found.items():
            frames = ("--frames", f"1-{count:.0f}")
            runs.append(_again(upsample(keys, out, METHOD, options.threads, *frames), out))
    return _line("key frames", found)


def _again(command: list[str], out: Path) -> Run:
    cleared(out)
    return run(command)


def _line(unit: str, found: dict[float, list[Run]]) -> list[goals.Figure]:
    """Print medians beside the straight lines through them."""
    sizes = list(found)
    print(f"\n{unit:>12}{'wall':>9}{'line':>9}{'cpu':>9}{'line':>9}")
    wall = [statistics.median(each.wall for each in runs) for runs in found.values()]
    cpu = [statistics.median(each.cpu for each in runs) for runs in found.values()]
    lines = [fitted(sizes, seconds) for seconds in (wall, cpu)]
    for row in zip(sizes, wall, lines[0][0], cpu, lines[1][0], strict=True):
        print("{:12.2f}{:9.2f}{:9.2f}{:9.2f}{:9.2f}".format(*row))
    figures = []
    for kind, (_, bent, r2), goal in zip(("wall", "cpu"), lines, (BENT, None), strict=True):
        print(f"{kind}: R^2 {r2:.4f}, at most {bent:.1%} off the line")
        name = f"{kind} against {unit}, off the line"
        figures.append(goals.Figure("scaling", name, bent, bent, bent, goal, "of it"))
    return figures


def fitted(sizes: Sequence[float], seconds: Sequence[float]) -> tuple[list[float], float, float]:
    """Fit a straight line; return it at the sizes, the largest relative distance, and R^2.

    Weights are such that relative distances are the least: the largest frames would have it all.
    """
    x, y = np.asarray(sizes, np.float64), np.asarray(seconds, np.float64)
    line = np.polyval(np.polyfit(x, y, 1, w=1 / y), x)
    spread = float(((y - y.mean()) ** 2).sum())
    r2 = 1 - float(((y - line) ** 2).sum()) / spread if spread else 1.0
    return line.tolist(), float(np.abs(y / line - 1).max()), r2


def _two(keys: Path, folder: Path, options: argparse.Namespace) -> goals.Figure:
    """Compare two runs at once with the same one after the other; the floor's too."""
    half = max(options.lengths) // 2
    outs = [folder / "one", folder / "two"]
    chunks = [f"1-{half}", f"{half + 1}-{2 * half}"]
    ours = [
        upsample(keys, out, METHOD, 1, "--frames", chunk)
        for out, chunk in zip(outs, chunks, strict=True)
    ]
    counted = ("--threads", "1", "--count", str(half))
    floors = [
        module("tests.bench.codec_floor", str(keys), str(out), *counted, "--core", str(core))
        for core, out in enumerate(outs)
    ]
    rounds = [
        tuple(_at_once(commands, outs) / _in_turn(commands, outs) for commands in (ours, floors))
        for _ in range(options.rounds)
    ]
    shares = [own / floor for own, floor in rounds]
    own, floor = (statistics.median(column) for column in zip(*rounds, strict=True))
    share = statistics.median(shares)
    print(
        f"\ntwo runs of one thread at once: {own:.2f} of one after the other, the codec floor's "
        f"{floor:.2f}, the cores' share {1 / min(2, os.cpu_count() or 1):.2f}"
    )
    name = "two runs at once / the codec floor's"
    return goals.Figure("scaling", name, share, min(shares), max(shares), SHARED)


def _in_turn(commands: Sequence[list[str]], outs: Sequence[Path]) -> float:
    return sum(_again(command, out).wall for command, out in zip(commands, outs, strict=True))


def _at_once(commands: Sequence[list[str]], outs: Sequence[Path]) -> float:
    for out in outs:
        cleared(out)
    begin = time.perf_counter()
    running = [
        subprocess.Popen(
            command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, env=environment()
        )
        for command in commands
    ]
    for each, command in zip(running, commands, strict=True):
        if each.wait():
            raise subprocess.CalledProcessError(each.returncode, command)
    return time.perf_counter() - begin


if __name__ == "__main__":
    sys.exit(main())
