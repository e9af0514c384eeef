"""How long `upsample` takes to begin: until its first frames, and in all for one key frame.

``python -m tests.bench.bench_startup``. Everything is a ratio to the bare ``import numba`` of the
same round, as no kernel runs without that; wall time until a frame, processor time in all. The
kernels' cache, the files' and Python's own are warm; where bytecode is not to be written, it is
kept in a temporary folder for the bench.
"""

from __future__ import annotations

import argparse
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

from tests.bench.goals import Figure, finish, parser_of
from tests.bench.running import cleared, module, run, upsample

BENCH = "start"
ROUNDS = 7
POLL = 0.002
"""Seconds between two looks whether a frame is there."""

FIRST_KEY, FIRST_MADE = "until the first key frame", "until the first generated frame"
ONE_KEY, HELP = "processor time, one key frame", "processor time, --help"
PLAIN = "processor time, python -c pass"
GOALS = {FIRST_MADE: 6.0, ONE_KEY: 9.0, HELP: 0.5}
"""Multiples of ``import numba``, which takes 0.33 s on two cores: 2 s, 3 s and 0.15 s there."""


def main(arguments: Sequence[str] | None = None) -> int:
    parser = parser_of("tests.bench.bench_startup", __doc__, ROUNDS, threads=True)
    parser.add_argument("--keys", type=Path, help="a sequence as big_input makes; default: make it")
    options = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory(prefix="exwarp-bench-") as folder:
        keys = options.keys or Path(folder) / "keys"
        if options.keys is None:
            subprocess.run(module("tests.bench.big_input", str(keys)), check=True)
        env = {"PYTHONDONTWRITEBYTECODE": "", "PYTHONPYCACHEPREFIX": f"{folder}/bytecode"}
        measured = _measure(keys, Path(folder) / "out", options.threads, options.rounds, env)
    figures = [_figure(name, ratios) for name, (ratios, _) in measured.items()]
    _print(measured, options)
    return finish(figures, options)


def _measure(
    keys: Path, out: Path, threads: int, rounds: int, env: Mapping[str, str]
) -> dict[str, tuple[list[float], list[float]]]:
    """Return ratios and seconds of every round, by what was measured."""
    numba, plain = [sys.executable, "-c", "import numba"], [sys.executable, "-c", "pass"]
    first = min(keys.glob("*.exr")).stem.rsplit(".", 1)[-1]
    whole = upsample(keys, out, "s6", threads)
    one = [*whole, "--frames", str(int(first))]
    helping = module("exwarp_cli", "--help")
    for command in (numba, one, helping):  # unmeasured: compiles, and fills every cache
        run(command, env)
    out_of: dict[str, tuple[list[float], list[float]]] = {}
    for _ in range(rounds):
        bare = run(numba, env)
        cleared(out)
        key, made = _first_frames(whole, out, env)
        cleared(out)
        found = {
            FIRST_KEY: (key, bare.wall),
            FIRST_MADE: (made, bare.wall),
            ONE_KEY: (run(one, env).cpu, bare.cpu),
            HELP: (run(helping, env).cpu, bare.cpu),
            PLAIN: (run(plain, env).cpu, bare.cpu),
        }
        for name, (seconds, base) in found.items():
            ratios, times = out_of.setdefault(name, ([], []))
            ratios.append(seconds / base)
            times.append(seconds)
    return out_of


def _first_frames(command: Sequence[str], out: Path, env: Mapping[str, str]) -> tuple[float, float]:
    """Run a command until two frames are there; return when each was, in seconds."""
    begin = time.perf_counter()
    running = subprocess.Popen(
        command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, env={**os.environ, **env}
    )
    seen: list[float] = []
    try:
        while len(seen) < 2:
            seen += [time.perf_counter() - begin] * (len(list(out.glob("*.exr"))) - len(seen))
            if running.poll() is not None and len(seen) < 2:
                raise subprocess.CalledProcessError(running.returncode, list(command))
            time.sleep(POLL)
    finally:
        running.terminate()
        running.wait()
    return seen[0], seen[1]


def _figure(name: str, ratios: Sequence[float]) -> Figure:
    middle = statistics.median(ratios)
    return Figure(BENCH, name, middle, min(ratios), max(ratios), GOALS.get(name))


def _print(
    measured: Mapping[str, tuple[list[float], list[float]]], options: argparse.Namespace
) -> None:
    print(f"\nstart of upsample, 1920x1080, {options.threads} threads, {options.rounds} rounds")
    print(f"{'':34}{'ratio to import numba':>24}{'min':>8}{'max':>8}{'seconds':>10}")
    for name, (ratios, seconds) in measured.items():
        goal = f"  goal {GOALS[name]:g}" if name in GOALS else ""
        print(
            f"{name:34}{statistics.median(ratios):24.2f}{min(ratios):8.2f}{max(ratios):8.2f}"
            f"{statistics.median(seconds):10.2f}{goal}"
        )


if __name__ == "__main__":
    sys.exit(main())
