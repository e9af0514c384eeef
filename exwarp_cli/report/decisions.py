"""Which decisions a run took: nodes d1 to d5 and paths S1 to S6 of the paper's decision tree."""

from __future__ import annotations

from typing import Any

from exwarp_cli.domain.decision import CHOICES, NODES, PATHS, WARP
from exwarp_cli.domain.results import FrameKind, FrameRecord
from exwarp_cli.report.quality import quality


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
            "nodes": {node: dict.fromkeys(CHOICES) for node in NODES},
            "paths": dict.fromkeys(PATHS),
            "warp_share": None,
        }
    choices = PATHS[path].choices
    warps = sum(choice == WARP for choice in choices.values())
    return {
        "nodes": {
            node: {choice: intervals * (choices.get(node) == choice) for choice in CHOICES}
            for node in NODES
        },
        "paths": {name: intervals * (name == path) for name in PATHS},
        "warp_share": warps / len(choices) if intervals else None,
    }


def quality_by_decision(path: str | None, frames: tuple[FrameRecord, ...]) -> dict[str, Any]:
    """Average the scores of generated frames by what made them; no frame for path None."""
    chosen: dict[str, list[FrameRecord]] = {choice: [] for choice in CHOICES}
    if path is not None:
        for frame in frames:
            if frame.kind is FrameKind.GENERATED and frame.slot:
                chosen[PATHS[path].made_by[frame.slot - 1]].append(frame)
    return {choice: quality(f.score for f in made) for choice, made in chosen.items()}
