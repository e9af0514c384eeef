"""What ``exwarp bench`` is asked, and the systems that it compares."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

from exwarp_cli.domain.decision import PATHS

SETTINGS = ("slot", "key")
"""G-buffers of every slot, as the paper has them, or of the key frames only."""

POLICY, BEST_PSNR, BEST_RETURN = "exwarp", "oracle", "oracle-return"
"""Systems that choose a path for every key interval."""

CHOOSERS = (POLICY, BEST_PSNR, BEST_RETURN)

FIXED = tuple(name.lower() for name in PATHS)
"""Systems that take one path throughout, s1 to s6; s1 is what ExtraNet does, s6 warps alone."""

MINTERPOLATE = "minterpolate"

LOOKAHEAD = ("softsplat", "blend", MINTERPOLATE)
"""Systems that wait for the next key frame; networks given by --interpolator are others."""

CAUSAL = (*CHOOSERS, *FIXED, "hold")

SYSTEMS = (*CAUSAL, *LOOKAHEAD)
"""What is always there to be compared, by name."""

EXTRANET, EXTRANET_FAST = "extranet", "extranet-s3"
"""Paths S1 and S3 with the network that --extranet names in place of ours."""

TIMED = 3
"""Key intervals of a sequence on which run times are measured; the medians count."""


@dataclass(frozen=True)
class BenchSettings:
    """What a benchmark measures.

    Attributes
    ----------
    inputs
        Data set folders; or one sequence, with its ground truth.
    output
        Folder for everything.
    ground_truth, gbuffers, motion, fps
        Of a sequence, as `upsample` takes them.
    scenes
        Of a data set; empty for all benchmark scenes.
    settings
        Of a data set, out of `SETTINGS`.
    frames
        Range of key frames by number; None for all.
    every
        Only every so-manieth key interval.
    systems
        Out of `SYSTEMS`; networks that options name come on top.
    interpolators
        ONNX files with their cards.
    extrapolator, policy
        None for those that come with ExWarp.
    extranet
        ONNX file of the imported ExtraNet; None to leave it out.
    metrics
        Names as ``--metrics`` takes them.
    jobs
        Key intervals that are measured side by side; None for one a core.
    device
        What networks run on.
    clock
        Out of `real_time.CLOCKS`, to measure what a display shows in real time as well; None for
        the offline figures alone.
    """

    inputs: tuple[str, ...]
    output: Path
    ground_truth: str | None = None
    gbuffers: str | None = None
    motion: str | None = None
    fps: Fraction | None = None
    scenes: tuple[str, ...] = ()
    settings: tuple[str, ...] = SETTINGS[:1]
    frames: str | None = None
    every: int = 1
    systems: tuple[str, ...] = SYSTEMS
    interpolators: tuple[Path, ...] = ()
    extrapolator: Path | None = None
    policy: Path | None = None
    extranet: Path | None = None
    metrics: tuple[str, ...] = ()
    jobs: int | None = None
    device: str = "cpu"
    clock: str | None = None


def is_lookahead(system: str) -> bool:
    """Whether a system waits for the next key frame; networks that interpolate do."""
    return system in LOOKAHEAD or system.startswith(ONNX)


ONNX = "onnx:"
"""Before the name of an interpolation network."""


def needs_network(systems: Iterable[str]) -> bool:
    """Whether any of the systems may extrapolate."""
    return any(name in CHOOSERS or name in FIXED[:-1] for name in systems)
