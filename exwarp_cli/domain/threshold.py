"""Limits on quality that a farm sets: a comparison that is worse than one of them fails."""

from __future__ import annotations

import math
from dataclasses import dataclass

from exwarp_cli.domain.metric import BY_OPTION, Metric
from exwarp_cli.errors import UsageError

GENERATED = "generated"

SCOPES = {"": "all", "generated": GENERATED, "holes": "holes", "worst": "worst"}
"""What a limit may be on, by what stands before the metric's name: the mean over all frames, over
those that their headers call generated, over the holes, or the worst single frame."""


@dataclass(frozen=True)
class Threshold:
    """One limit.

    Attributes
    ----------
    metric
        What is limited.
    scope
        "all", "generated", "holes" or "worst".
    limit
        The worst value that passes.
    """

    metric: Metric
    scope: str
    limit: float

    @property
    def name(self) -> str:
        """As it is written on the command line: ``psnr``, ``worst.ssim``."""
        prefix = next(prefix for prefix, scope in SCOPES.items() if scope == self.scope)
        return f"{prefix}.{self.metric.option}" if prefix else self.metric.option

    @property
    def option(self) -> str:
        """The option that sets it."""
        return "--fail-below" if self.metric.more_is_better else "--fail-above"

    def passes(self, value: float) -> bool:
        """Whether a measured value is good enough; the limit itself is."""
        return value >= self.limit if self.metric.more_is_better else value <= self.limit


def parse_threshold(text: str, option: str) -> Threshold:
    """Read a limit such as ``psnr=35``, ``generated.psnr=30`` or ``holes.ssim=0.8``.

    Parameters
    ----------
    text
        What the user wrote.
    option
        "--fail-below" or "--fail-above".

    Raises
    ------
    UsageError
        When it is none, or limits the metric from its good side.
    """
    name, _, value = text.partition("=")
    prefix, _, plain = name.strip().lower().rpartition(".")
    metric = BY_OPTION.get(plain)
    if metric is None or prefix not in SCOPES:
        raise UsageError(
            f"{option} {text!r} is no limit; write for example psnr=35, generated.psnr=30, "
            f"worst.psnr=30 or holes.ssim=0.8, with a metric out of {', '.join(BY_OPTION)}"
        )
    try:
        limit = float(value)
    except ValueError:
        limit = math.nan
    if not math.isfinite(limit):
        raise UsageError(f"{option} {text!r} has no number behind '='; write for example psnr=35")
    found = Threshold(metric, SCOPES[prefix], limit)
    if found.option != option:
        good = "more" if metric.more_is_better else "less"
        raise UsageError(
            f"{option} {text!r} would fail good frames and pass bad ones, as {good} {plain} is "
            f"better; write {found.option} {text}"
        )
    if found.scope == "holes" and not metric.in_holes:
        raise UsageError(f"{option} {text!r} can never be judged: {plain} is one of whole frames")
    return found
