"""From what a user wants measured of two sequences to who measures it."""

from __future__ import annotations

from collections.abc import Sequence as Listed
from pathlib import Path

from exwarp_cli.domain.metric import METRICS
from exwarp_cli.domain.results import FrameKind
from exwarp_cli.domain.settings import PRESETS, MeasureSettings
from exwarp_cli.errors import InputError, UsageError
from exwarp_cli.io.output import written_attributes
from exwarp_cli.io.sequence import Sequence
from exwarp_cli.pipeline.comparing import ExtranetScores, Scorer, SequenceScores
from exwarp_cli.pipeline.flow import Flow, open_flow


def require_consistent(measuring: MeasureSettings, holes: str | None) -> None:
    """Refuse what contradicts itself, before any work; raises UsageError."""
    if holes is None:
        limits = [limit for limit in measuring.thresholds if limit.scope == "holes"]
        if limits:
            raise UsageError(
                f"{limits[0].option} {limits[0].name} is on holes, which are not known; give masks "
                "with --holes"
            )
    if measuring.preset is None:
        return
    offered = PRESETS[measuring.preset]
    if foreign := [name for name in measuring.measured if name not in offered]:
        names = {metric.field: metric.option for metric in METRICS}
        raise UsageError(
            f"--preset {measuring.preset} measures {', '.join(names[o] for o in offered)} and not "
            f"{names[foreign[0]]}; "
            "leave that or the preset out"
        )
    if holes is not None:
        raise UsageError(
            f"--preset {measuring.preset} measures whole frames; leave --holes or the preset out"
        )


def scorer(
    measuring: MeasureSettings, spec: str, reference: Sequence, test: Listed[Path]
) -> tuple[Scorer, tuple[str, ...]]:
    """Return who scores, and what a reader of the numbers should know of it.

    Parameters
    ----------
    measuring
        What is wanted.
    spec, reference
        The true sequence: what the user named it by, and what was found.
    test
        Files of the frames that will be scored, in order.
    """
    if measuring.preset is not None:
        generated = _generated(test)
        if generated is not None and not any(generated):
            raise InputError(
                f"by their headers none of the frames from {test[0]} on is generated, and "
                f"--preset {measuring.preset} scores nothing else; leave the preset out"
            )
        return ExtranetScores(measuring.measured, len(test), generated), ()
    if "flicker" not in measuring.measured:
        return SequenceScores(measuring.measured, None), ()
    flow = open_flow(spec, reference)
    if isinstance(flow, Flow):
        return SequenceScores(measuring.measured, flow), ()
    note = f"flicker is not measured, as it follows the motion of the first sequence: {flow}"
    return SequenceScores(measuring.measured, None), (note,)


def _kinds(files: Listed[Path]) -> list[str | None]:
    """Return what the headers call the frames: None for a frame that ExWarp did not make."""
    return [written_attributes(path).get("kind") for path in files]


def _generated(files: Listed[Path]) -> list[bool] | None:
    """Return which frames the headers call generated; None where no header says anything."""
    kinds = _kinds(files)
    if not any(kinds):
        return None
    return [kind == FrameKind.GENERATED.value for kind in kinds]


def rendered_note(files: Listed[Path]) -> tuple[str, ...]:
    """Say that frames which were rendered raise the means over an upsampled sequence, if any do."""
    rendered = _kinds(files).count(None)
    if rendered in (0, len(files)):
        return ()
    return (
        f"the means are over all {len(files)} frames, {rendered} of which are rendered ones by "
        "their headers",
    )
