"""Means of per-frame scores, as every report writes them."""

from __future__ import annotations

from collections.abc import Iterable

from exwarp_cli.domain.metric import METRICS
from exwarp_cli.domain.results import Score


def mean(values: Iterable[float]) -> float | None:
    """Mean of the values, or None where there are none."""
    listed = [float(value) for value in values]
    return sum(listed) / len(listed) if listed else None


def values_of(score: Score | None) -> dict[str, float | None]:
    """Return a score's values by their names in every report; None what was not measured."""
    return {m.field: None if score is None else getattr(score, m.field) for m in METRICS}


def quality(scores: Iterable[Score | None]) -> dict[str, float | int | None]:
    """Average the scores that are there.

    Returns
    -------
    dict
        For every metric the mean of the per-frame values, over the frames that have one; None
        where none has. ``frames``, how many frames were scored.
    """
    known = [values_of(score) for score in scores if score is not None]
    means = {m.field: mean(_known(row[m.field] for row in known)) for m in METRICS}
    return {**means, "frames": len(known)}


def _known(values: Iterable[float | None]) -> list[float]:
    return [value for value in values if value is not None]
