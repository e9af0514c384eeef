"""The whole command at 1920x1080 beside the codec floor: wall time as a ratio, and peak memory.

``python -m tests.bench.bench_command``. This program itself stays small, since Linux counts a
parent's memory at the moment of the fork as its child's.
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

METHODS = ("s6", "softsplat")
GOALS = {"s6": 1.10}
FLOOR = "codec floor"
ROUNDS = 5


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser("python -m tests.bench.bench_command", description=__doc__)
    parser.add_argument("--rounds", type=int, default=ROUNDS)
    parser.add_argument("--threads", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--keys", type=Path, help="a sequence as big_input makes; default: make it")
    options = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory(prefix="exwarp-bench-") as folder:
        keys = options.keys or Path(folder) / "keys"
        if options.keys is None:
            _module("tests.bench.big_input", str(keys))
        seconds, memory = _measure(keys, Path(folder) / "out", options.threads, options.rounds)
    _print(seconds, memory, options)
    return 0


def _module(name: str, *arguments: str) -> None:
    subprocess.run([sys.executable, "-m", name, *arguments], check=True)


def _measure(
    keys: Path, out: Path, threads: int, rounds: int
) -> tuple[dict[str, list[float]], dict[str, float]]:
    """Run everything by turns; return seconds of every run and the largest memory, in MB."""
    common = ["--threads", str(threads)]
    exwarp = [sys.executable, "-m", "exwarp_cli", "upsample", str(keys), "--progress", "none"]
    commands = {
        FLOOR: [sys.executable, "-m", "tests.bench.codec_floor", str(keys), str(out), *common]
    }
    for method in METHODS:
        commands[method] = [*exwarp, "-o", str(out), "--method", method, "--overwrite", *common]
    seconds: dict[str, list[float]] = {name: [] for name in commands}
    memory = dict.fromkeys(commands, 0.0)
    for command in commands.values():  # unmeasured: compiles kernels, and brings files into memory
        _run(command, out)
    for _ in range(rounds):
        for name, command in commands.items():
            elapsed, peak = _run(command, out)
            seconds[name].append(elapsed)
            memory[name] = max(memory[name], peak)
    return seconds, memory


def _run(command: list[str], out: Path) -> tuple[float, float]:
    """Run a command; return wall seconds and peak memory in MB."""
    for frame in out.glob("*.exr"):
        frame.unlink()
    os.sync()  # what earlier runs left to be written to disk is not this run's
    begin = time.perf_counter()
    running = subprocess.Popen(command, stdout=subprocess.DEVNULL)
    _, status, usage = os.wait4(running.pid, 0)
    elapsed = time.perf_counter() - begin
    running.returncode = os.waitstatus_to_exitcode(status)
    if running.returncode:
        raise subprocess.CalledProcessError(running.returncode, command)
    return elapsed, usage.ru_maxrss / (1024 if sys.platform != "darwin" else 1024**2)


def _print(
    seconds: dict[str, list[float]], memory: dict[str, float], options: argparse.Namespace
) -> None:
    print(f"\nupsample, 1920x1080, {options.threads} threads, {options.rounds} rounds")
    print(f"{'':16}{'ratio to ' + FLOOR:>22}{'min':>8}{'max':>8}{'seconds':>10}{'peak MB':>10}")
    for name, times in seconds.items():
        ratios = [a / b for a, b in zip(times, seconds[FLOOR], strict=True)]
        goal = f"  goal {GOALS[name]:.2f}" if name in GOALS else ""
        print(
            f"{name:16}{statistics.median(ratios):22.3f}{min(ratios):8.3f}{max(ratios):8.3f}"
            f"{statistics.median(times):10.2f}{memory[name]:10.0f}{goal}"
        )


if __name__ == "__main__":
    sys.exit(main())
