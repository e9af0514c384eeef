"""From what a user wants measured of two sequences to who measures it."""

from __future__ import annotations

from collections.abc import Sequence as Listed
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from exwarp_cli.domain.decision import maker_of
from exwarp_cli.domain.metric import GENERATED, METRICS
from exwarp_cli.domain.results import FrameKind
from exwarp_cli.domain.settings import PRESETS, MeasureSettings
from exwarp_cli.errors import InputError, UsageError
from exwarp_cli.io.clip import is_clip
from exwarp_cli.io.output import facts_in
from exwarp_cli.io.sequence import Sequence
from exwarp_cli.pipeline.comparing import ExtranetScores, Flow, Scorer, SequenceScores, open_flow


@dataclass(frozen=True)
class Origin:
    """Where a frame came from, as its header tells; all None for a frame that ExWarp did not make.

    Attributes
    ----------
    kind
        A value of `FrameKind`: "generated" or "dropped".
    made_by
        "warp", "extrapolate", "softsplat", "blend", "interpolate" or "hold".
    path
        Decision path of its key interval, S1 to S6; None outside the paper's paths.
    """

    kind: str | None = None
    made_by: str | None = None
    path: str | None = None

    @property
    def generated(self) -> bool:
        """Whether it is a new frame: not a rendered one and no repeat."""
        return self.kind == FrameKind.GENERATED.value

    @property
    def dropped(self) -> bool:
        """Whether it repeats the frame before."""
        return self.kind == FrameKind.DROPPED.value

    @property
    def choice(self) -> str | None:
        """What was decided for a generated frame; None outside the decision tree."""
        return self.made_by if self.generated and self.path is not None else None


def origins_of(files: Listed[Path]) -> list[Origin]:
    """Read where frames came from, of every header once.

    Raises
    ------
    DamagedFileError
        When a header cannot be read.
    """
    return [_origin({} if is_clip(str(path)) else facts_in(path)) for path in files]


def _origin(known: dict[str, Any]) -> Origin:
    told = (known.get(name) for name in ("kind", "madeBy", "path", "method"))
    kind, made_by, path, method = (value if isinstance(value, str) else None for value in told)
    return Origin(kind, maker_of(made_by, method), path)


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


def require_generated(measuring: MeasureSettings, origins: Listed[Origin], test: Sequence) -> None:
    """Refuse limits on generated frames where no header tells of any; raises UsageError."""
    limits = [limit for limit in measuring.thresholds if limit.scope == GENERATED]
    if limits and not any(origin.generated for origin in origins):
        raise UsageError(
            f"{limits[0].option} {limits[0].name} is on generated frames, and by their headers "
            f"none of the compared frames of {test.pattern} is one; write {limits[0].metric.option}"
            f"={limits[0].limit:g} for all frames"
        )


def scorer(
    measuring: MeasureSettings, spec: str, reference: Sequence, origins: Listed[Origin]
) -> tuple[Scorer, tuple[str, ...]]:
    """Return who scores, and what a reader of the numbers should know of it.

    Parameters
    ----------
    measuring
        What is wanted.
    spec, reference
        The true sequence: what the user named it by, and what was found.
    origins
        Of the frames that will be scored, in order.
    """
    if measuring.preset is not None:
        generated = _generated(origins)
        if generated is not None and not any(generated):
            raise InputError(
                "by their headers none of the frames of the second sequence is generated, and "
                f"--preset {measuring.preset} scores nothing else; leave the preset out"
            )
        return ExtranetScores(measuring.measured, len(origins), generated), ()
    if "flicker" not in measuring.measured:
        return SequenceScores(measuring.measured, None), ()
    flow = open_flow(spec, reference, measuring.view)
    if isinstance(flow, Flow):
        return SequenceScores(measuring.measured, flow), ()
    note = f"flicker is not measured, as it follows the motion of the first sequence: {flow}"
    return SequenceScores(measuring.measured, None), (note,)


def _generated(origins: Listed[Origin]) -> list[bool] | None:
    """Return which frames the headers call generated; None where no header says anything."""
    if all(origin.kind is None for origin in origins):
        return None
    return [origin.generated for origin in origins]


def rendered_note(origins: Listed[Origin]) -> tuple[str, ...]:
    """Say that frames which were rendered raise the means over an upsampled sequence, if any do."""
    rendered = sum(not (origin.generated or origin.dropped) for origin in origins)
    if rendered in (0, len(origins)):
        return ()
    return (
        f"the means of all pixels are over all {len(origins)} frames, {rendered} of which are "
        "rendered ones by their headers",
    )
