"""Whether a comparison is as good as the limits that were set."""

from __future__ import annotations

from typing import Any

from exwarp_cli.domain.metric import GENERATED, Threshold
from exwarp_cli.errors import QualityError, UsageError
from exwarp_cli.pipeline.evaluation import Comparison
from exwarp_cli.report.quality import quality


def verdicts(result: Comparison) -> list[dict[str, Any]]:
    """Judge every limit of a comparison.

    Returns
    -------
    list of dict
        ``name`` as on the command line, ``metric``, ``scope`` ("all", "generated", "holes"
        or "worst"), ``limit``, ``fails`` ("below" or "above" it; of pulse it is the magnitude that
        fails), ``value`` (None where it was not measured) and ``passed``, which is false then.
    """
    found = []
    for limit in result.measuring.thresholds:
        value = _value(result, limit)
        found.append(
            {
                "name": limit.name,
                "metric": limit.metric.field,
                "scope": limit.scope,
                "limit": limit.limit,
                "fails": limit.option.removeprefix("--fail-"),
                "value": value,
                "passed": value is not None and limit.passes(value),
            }
        )
    return found


def require_quality(result: Comparison) -> None:
    """Raise what a comparison fails by.

    Raises
    ------
    UsageError
        When a limit is on something that was not measured: nothing passes unseen.
    QualityError
        When a value is worse than its limit.
    """
    judged = zip(result.measuring.thresholds, verdicts(result), strict=True)
    failed = [(limit, verdict["value"]) for limit, verdict in judged if not verdict["passed"]]
    unknown = [limit.name for limit, value in failed if value is None]
    if unknown:
        why = f" ({'; '.join(result.notes)})" if result.notes else ""
        raise UsageError(
            f"the limit on {unknown[0]} cannot be judged, as it was not measured{why}; leave that "
            "limit out"
        )
    if failed:
        named = ", ".join(limit.failure(value) for limit, value in failed)
        raise QualityError(
            f"{result.test.pattern} is not good enough: {named}; look at the worst frame, "
            f"{result.worst.test}, or set other limits"
        )


def _value(result: Comparison, limit: Threshold) -> float | None:
    name = limit.metric.field
    if limit.scope == "all":
        return quality(frame.score for frame in result.frames)[name]
    if limit.scope == GENERATED:
        return quality(frame.score for frame in result.frames if frame.origin.generated)[name]
    if limit.scope == "holes":
        return quality(frame.hole_score for frame in result.frames)[name]
    known = [getattr(frame.score, name) for frame in result.frames]
    measured: list[float] = [value for value in known if value is not None]
    if not measured:
        return None
    return max(measured, key=limit.metric.badness)
