"""Which decisions a run took: nodes d1 to d5 and paths S1 to S6 of the paper's decision tree."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from exwarp_cli.domain.results import FrameKind, FrameRecord
from exwarp_cli.report.quality import quality

WARP = "warp"
EXTRAPOLATE = "extrapolate"
NODES = ("d1", "d2", "d3", "d4", "d5")


@dataclass(frozen=True)
class DecisionPath:
    """One way through the decision tree of a key interval.

    Attributes
    ----------
    choices
        The choice at every node that the path passes.
    made_by
        What makes the frame of slots 1, 2 and 3; None where the frame before is repeated. Slot 2 is
        extrapolated without a node of its own when d1 chose to extrapolate.
    """

    choices: dict[str, str]
    made_by: tuple[str | None, str | None, str | None]


PATHS = {
    "S1": DecisionPath({"d1": EXTRAPOLATE, "d3": EXTRAPOLATE}, (None, EXTRAPOLATE, None)),
    "S2": DecisionPath({"d1": EXTRAPOLATE, "d3": WARP}, (None, EXTRAPOLATE, WARP)),
    "S3": DecisionPath(
        {"d1": WARP, "d2": EXTRAPOLATE, "d4": EXTRAPOLATE}, (WARP, EXTRAPOLATE, EXTRAPOLATE)
    ),
    "S4": DecisionPath({"d1": WARP, "d2": EXTRAPOLATE, "d4": WARP}, (WARP, EXTRAPOLATE, WARP)),
    "S5": DecisionPath({"d1": WARP, "d2": WARP, "d5": EXTRAPOLATE}, (WARP, WARP, EXTRAPOLATE)),
    "S6": DecisionPath({"d1": WARP, "d2": WARP, "d5": WARP}, (WARP, WARP, WARP)),
}


def decisions(path: str | None, intervals: int) -> dict[str, Any]:
    """Count the decisions of a run that took one fixed path in every key interval.

    Parameters
    ----------
    path
        S1 to S6; None for a method outside the paper's paths, whose counts are all None.
    intervals
        Key intervals with all their slots.
    """
    if path is None:
        return {
            "nodes": {node: {WARP: None, EXTRAPOLATE: None} for node in NODES},
            "paths": dict.fromkeys(PATHS),
            "warp_share": None,
        }
    choices = PATHS[path].choices
    warps = sum(choice == WARP for choice in choices.values())
    return {
        "nodes": {
            node: {
                choice: intervals * (choices.get(node) == choice) for choice in (WARP, EXTRAPOLATE)
            }
            for node in NODES
        },
        "paths": {name: intervals * (name == path) for name in PATHS},
        "warp_share": warps / len(choices) if intervals else None,
    }


def quality_by_decision(path: str | None, frames: tuple[FrameRecord, ...]) -> dict[str, Any]:
    """Average the scores of generated frames by what made them; no frame for path None."""
    chosen: dict[str, list[FrameRecord]] = {WARP: [], EXTRAPOLATE: []}
    if path is not None:
        for frame in frames:
            maker = PATHS[path].made_by[frame.slot - 1] if frame.slot else None
            if frame.kind is FrameKind.GENERATED and maker is not None:
                chosen[maker].append(frame)
    return {choice: quality(f.score for f in made) for choice, made in chosen.items()}
