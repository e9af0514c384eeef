"""Which decisions a run took: nodes d1 to d5 and paths S1 to S6 of the paper's decision tree."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from typing import Any

from exwarp_cli.domain.decision import CHOICES, NODES, PATHS, WARP
from exwarp_cli.domain.results import FrameKind, FrameRecord
from exwarp_cli.report.quality import quality


def decisions(paths: Iterable[str] | None) -> dict[str, Any]:
    """Count the decisions of a run.

    Parameters
    ----------
    paths
        S1 to S6 of each key interval with all its slots; None for a method outside the paper's
        decision tree, whose counts are all None.
    """
    if paths is None:
        return {
            "nodes": {node: dict.fromkeys(CHOICES) for node in NODES},
            "paths": dict.fromkeys(PATHS),
            "warp_share": None,
        }
    taken = Counter(paths)
    steps = Counter[tuple[str, str]]()
    for name, count in taken.items():
        for step in PATHS[name].choices.items():
            steps[step] += count
    warped = sum(count for (_, choice), count in steps.items() if choice == WARP)
    return {
        "nodes": {node: {choice: steps[node, choice] for choice in CHOICES} for node in NODES},
        "paths": {name: taken[name] for name in PATHS},
        "warp_share": warped / steps.total() if steps else None,
    }


def quality_by_decision(decides: bool, frames: tuple[FrameRecord, ...]) -> dict[str, Any]:
    """Average the scores of generated frames by what made them; none outside the tree."""
    chosen: dict[str, list[FrameRecord]] = {choice: [] for choice in CHOICES}
    for frame in frames:
        if decides and frame.kind is FrameKind.GENERATED and frame.made_by in chosen:
            chosen[frame.made_by].append(frame)
    return {choice: quality(f.score for f in made) for choice, made in chosen.items()}
