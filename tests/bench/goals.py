"""What a bench measured, beside the goal it has; how far a goal may be missed.

Every bench ends in `finish`: ``--json FILE`` keeps its figures, ``--check`` makes a missed goal an
error. ``python -m tests.bench`` runs all of them (``make bench``, ``make bench-check``).
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from tests.bench.timing import Ratio, print_ratios

SLACK = 1.2
"""A median may lie above its goal by a fifth: between runs of one machine ratios differ by less."""

RATIO = "x"


@dataclass(frozen=True)
class Figure:
    """A median that a bench found.

    Attributes
    ----------
    bench, name
        What was measured, as its table calls it.
    value, low, high
        Median, least and greatest of the rounds; less is better.
    goal
        The value it should not exceed; None where it is only reported.
    unit
        Of the value and its goal; `RATIO` for a multiple of something run beside it.
    """

    bench: str
    name: str
    value: float
    low: float
    high: float
    goal: float | None = None
    unit: str = RATIO

    @property
    def missed(self) -> bool:
        """Whether it is above its goal by more than the slack; NaN is."""
        return self.goal is not None and not self.value <= SLACK * self.goal

    def __str__(self) -> str:
        unit = self.unit if self.unit == RATIO else f" {self.unit}"
        text = f"{self.bench}: {self.name}: {self.value:.3g}{unit}"
        if self.goal is None:
            return text
        return f"{text}, goal {self.goal:.3g}{unit}, {_distance(self.value / self.goal - 1)}"


def table(
    bench: str, title: str, base: str, ratios: Mapping[str, Ratio], goals: Mapping[str, float]
) -> list[Figure]:
    """Print ratios to `base`, and return them as figures; every goal has to have its row."""
    if missing := goals.keys() - ratios.keys():
        raise ValueError(f"{bench}: goals without a measurement: {', '.join(sorted(missing))}")
    print_ratios(title, base, ratios, goals)
    return [
        Figure(bench, f"{name} / {base}", ratio.median, ratio.low, ratio.high, goals.get(name))
        for name, ratio in ratios.items()
    ]


def parser_of(
    module: str, about: str | None, rounds: int | None = None, threads: bool = False
) -> argparse.ArgumentParser:
    """Return the beginning of a bench's options.

    Parameters
    ----------
    module, about
        Its name after ``python -m``, and what its help says.
    rounds
        How often it measures by default; None where there is no such option.
    threads
        Whether the number of threads is an option; all cores by default.
    """
    parser = argparse.ArgumentParser(f"python -m {module}", description=about)
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write the figures there")
    parser.add_argument(
        "--check", action="store_true", help="fail when a median misses its goal by over a fifth"
    )
    if rounds is not None:
        parser.add_argument("--rounds", type=int, default=rounds)
    if threads:
        parser.add_argument("--threads", type=int, default=os.cpu_count() or 1)
    return parser


def finish(figures: Sequence[Figure], options: argparse.Namespace) -> int:
    """Keep the figures, tell what missed its goal, and return the exit status."""
    if options.json is not None:
        write(figures, options.json)
    return verdict(figures) if options.check else 0


def verdict(figures: Iterable[Figure]) -> int:
    """Name each missed goal on standard error; 1 when there is one, else 0."""
    missed = [figure for figure in figures if figure.missed]
    for figure in missed:
        print(f"missed: {figure}", file=sys.stderr)
    return 1 if missed else 0


def write(figures: Sequence[Figure], path: Path) -> None:
    """Write figures as a JSON list of objects."""
    records = [{**asdict(figure), "missed": figure.missed} for figure in figures]
    path.write_text(json.dumps(records, indent=1) + "\n")


def read(path: Path) -> list[Figure]:
    """Read what `write` wrote."""
    records = json.loads(path.read_text())
    return [Figure(**{k: v for k, v in r.items() if k != "missed"}) for r in records]


def _distance(over: float) -> str:
    return f"{over:.0%} above" if over > 0 else f"{-over:.0%} below"
