"""The quality metrics by name, and the limits that a farm sets on them."""

from __future__ import annotations

import math
from dataclasses import dataclass

from exwarp_cli.errors import UsageError


@dataclass(frozen=True)
class Metric:
    """A metric's name, form and direction."""

    field: str  # its name in `Score`, in every report and in every table of frames
    option: str  # its name on the command line
    title: str  # for people, followed by the unit if it has one
    digits: int  # decimals for people
    more_is_better: bool  # it says how alike two images are, not how far apart
    in_holes: bool = True  # it is defined over a part of a frame
    # Values go both ways from 0, which is best: limits and ranks take the magnitude
    signed: bool = False

    @property
    def name(self) -> str:
        """The title without the unit."""
        return self.title.partition(" ")[0]

    def text(self, value: float) -> str:
        """Format a value for people, without the unit."""
        return format(value, self.style)

    @property
    def style(self) -> str:
        """Format specification of its values."""
        return f"{'+' if self.signed else ''}.{self.digits}f"

    def with_unit(self, value: float) -> str:
        """Format a value with its unit."""
        return f"{self.text(value)} {self.title.partition(' ')[2]}".rstrip()

    def badness(self, value: float) -> float:
        """Return a number that is larger the worse a value is."""
        if self.signed:
            return abs(value)
        return -value if self.more_is_better else value


# in the order in which they are shown
METRICS = (
    Metric("psnr_db", "psnr", "PSNR dB", 2, more_is_better=True),
    Metric("ssim", "ssim", "SSIM", 4, more_is_better=True),
    Metric("flip", "flip", "FLIP", 4, more_is_better=False),
    Metric("hdr_flip", "hdr-flip", "HDR-FLIP", 4, more_is_better=False),
    Metric("vmaf", "vmaf", "VMAF", 2, more_is_better=True, in_holes=False),
    Metric("flicker", "flicker", "flicker", 3, more_is_better=False),
    Metric("pulse", "pulse", "pulse %", 2, more_is_better=False, in_holes=False, signed=True),
)

BY_OPTION = {metric.option: metric for metric in METRICS}

DEFAULT_METRICS = ("psnr_db", "ssim", "flip", "pulse")

WITHOUT_TRUTH = ("pulse",)  # measured against the key frames where there is no ground truth

# What a metric of `WITHOUT_TRUTH` is measured against.
GROUND_TRUTH, KEY_FRAMES = "ground truth", "key frames"

ALL = "all"


def parse_metrics(text: str) -> tuple[str, ...]:
    """Read a list of metrics such as ``psnr,vmaf``, or ``all``.

    Return names as in `Score`, each once, in the order of METRICS. UsageError: an unknown name, or
    an empty list.
    """
    names = [name.strip().lower() for name in text.split(",")]
    unknown = [name for name in names if name not in (*BY_OPTION, ALL)]
    if unknown:
        raise UsageError(
            f"--metrics {text!r} names {unknown[0]!r}, which is no metric; choose out of "
            f"{', '.join(BY_OPTION)}, with commas between, or {ALL}"
        )
    return tuple(m.field for m in METRICS if ALL in names or m.option in names)


GENERATED = "generated"

# A limit's scope by the prefix of the metric's name: the mean over all frames, over those that
# their headers call generated, over the holes, or the worst single frame.
SCOPES = {"": "all", "generated": GENERATED, "holes": "holes", "worst": "worst"}


@dataclass(frozen=True)
class Threshold:
    """A limit on a metric."""

    metric: Metric
    scope: str  # "all", "generated", "holes" or "worst"
    limit: float  # the worst value that passes; of a signed metric its magnitude

    @property
    def name(self) -> str:
        """As it is written on the command line: ``psnr``, ``worst.ssim``."""
        return self.metric.option if self.scope == "all" else f"{self.scope}.{self.metric.option}"

    @property
    def option(self) -> str:
        """The option that sets it."""
        return "--fail-below" if self.metric.more_is_better else "--fail-above"


def parse_threshold(text: str, option: str) -> Threshold:
    """Read a limit such as ``psnr=35``, ``generated.psnr=30`` or ``holes.ssim=0.8``.

    UsageError: it is none, or limits the metric from its good side.
    """
    name, _, value = text.partition("=")
    prefix, _, base = name.strip().lower().rpartition(".")
    metric = BY_OPTION.get(base)
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
    threshold = Threshold(metric, SCOPES[prefix], limit)
    if threshold.option != option:
        good = "more" if metric.more_is_better else "less"
        raise UsageError(
            f"{option} {text!r} would fail good frames and pass bad ones, as {good} {base} is "
            f"better; write {threshold.option} {text}"
        )
    if metric.signed and limit < 0:
        raise UsageError(
            f"{option} {text!r} would fail every frame, as the magnitude of {base} is compared; "
            f"write {threshold.name}={-limit:g}"
        )
    if threshold.scope == "holes" and not metric.in_holes:
        raise UsageError(f"{option} {text!r} can never be judged: {base} is one of whole frames")
    return threshold
