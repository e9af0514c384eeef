"""Ratios of run times: the machine's speed and its other work cancel out, milliseconds do not."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass

Work = Callable[[], object]

ROUNDS = 7
LEAST_SECONDS = 0.03
"""Short work is repeated until it takes this long, so that the clock and waking threads vanish."""


@dataclass(frozen=True)
class Ratio:
    """How long something takes, as a multiple of something else.

    Attributes
    ----------
    median, low, high
        Over the rounds.
    milliseconds
        Median run time.
    """

    median: float
    low: float
    high: float
    milliseconds: float

    @classmethod
    def of(cls, times: list[float], bases: list[float]) -> Ratio:
        """Build from pairs of run times, in seconds, that were measured next to each other."""
        ratios = [a / b for a, b in zip(times, bases, strict=True)]
        median = statistics.median(ratios)
        return cls(median, min(ratios), max(ratios), 1e3 * statistics.median(times))


def compare(works: Mapping[str, tuple[Work, Work]], rounds: int = ROUNDS) -> dict[str, Ratio]:
    """Time each piece of work against its base, by turns.

    Parameters
    ----------
    works
        Work and base by name. Each is run once unmeasured: compiling is not timed.
    rounds
        How often all of them are measured. In every round the base is timed before and after the
        work and counts with its mean, so a slow drift of the machine's speed cancels out too.
    """
    counts = {name: (_count(work), _count(base)) for name, (work, base) in works.items()}
    times: dict[str, list[float]] = {name: [] for name in works}
    bases: dict[str, list[float]] = {name: [] for name in works}
    for _ in range(rounds):
        for name, (work, base) in works.items():
            many, many_base = counts[name]
            before = _time(base, many_base)
            times[name].append(_time(work, many))
            bases[name].append((before + _time(base, many_base)) / 2)
    return {name: Ratio.of(times[name], bases[name]) for name in works}


def print_ratios(
    title: str, base: str, ratios: Mapping[str, Ratio], goals: Mapping[str, float]
) -> None:
    """Print a table, with goals beside the ratios that have one."""
    print(f"\n{title}\n{'':34}{'ratio to ' + base:>26}{'min':>9}{'max':>9}{'ms':>10}")
    for name, ratio in ratios.items():
        goal = f"  goal {goals[name]:.3g}" if name in goals else ""
        print(
            f"{name:34}{ratio.median:26.3f}{ratio.low:9.3f}{ratio.high:9.3f}"
            f"{ratio.milliseconds:10.2f}{goal}"
        )


def _count(work: Work) -> int:
    """Warm up, and return how many runs fill the least time."""
    work()
    return max(1, int(LEAST_SECONDS / max(_time(work, 1), 1e-6)))


def _time(work: Work, count: int) -> float:
    """Seconds for one run, mean of `count`."""
    begin = time.perf_counter()
    for _ in range(count):
        work()
    return (time.perf_counter() - begin) / count
