"""Which decisions a run took: nodes d1 to d5 and paths S1 to S6 of the paper's decision tree."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from typing import Any

from exwarp_cli.domain.decision import CHOICES, EXTRAPOLATE, NODES, PATHS, SOFTSPLAT, WARP, Trial
from exwarp_cli.domain.network_api import LOOKAHEAD
from exwarp_cli.domain.results import FrameKind, FrameRecord, RunSummary
from exwarp_cli.domain.tiles import paths_from_makers
from exwarp_cli.domain.wording import pluralise
from exwarp_cli.report.quality import quality


def decisions(paths: Iterable[str] | None) -> dict[str, Any]:
    """Count the decisions of a run.

    Parameters
    ----------
    paths
        S1 to S6 of each key interval with all its slots, or of each of its tiles; None for a
        method outside the paper's decision tree, whose counts are all None.
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


def paths_of_tiles(interval: Iterable[FrameRecord]) -> tuple[str, ...]:
    """Return the path of each tile of a key interval; none where its tiles were not decided."""
    tiles = {frame.slot: frame.tiles for frame in interval}
    second, third = tiles.get(2), tiles.get(3)
    return () if second is None or third is None else paths_from_makers(second, third)


def tile_shares(run: RunSummary) -> dict[str, Any]:
    """Say how much of the new frames' area each maker made, where tiles were decided.

    Returns
    -------
    dict
        ``cost``: the share that the network computed, slot 1 included; None where no tiles were
        decided. Where they were, also ``warp_share``: the rest.
    """
    costs = [frame.tiles.share(EXTRAPOLATE) for frame in run.frames if frame.tiles is not None]
    if not costs:
        return {"cost": None}
    cost = sum(costs) / len(costs)
    return {"cost": cost, "warp_share": 1 - cost}


def gate(run: RunSummary) -> dict[str, Any]:
    """Say what the gate decided, and by what.

    Returns
    -------
    dict
        ``gate``: a trial each, with the key frame that was predicted (None where none could be),
        the PSNR of both predictions, which of the two was used, and in which key
        intervals; None without a gate. ``look_ahead``: the frames that warping and the network
        made; None where the method does not look ahead or has no gate.
    """
    intervals: dict[Trial, dict[int, None]] = {}
    for frame in run.frames:
        if frame.trial is not None:
            intervals.setdefault(frame.trial, {})[frame.key] = None
    if not intervals:
        return {"gate": None, "look_ahead": None}
    names = (SOFTSPLAT, LOOKAHEAD) if run.lookahead else CHOICES
    trials = [
        {
            "frame": trial.frame,
            f"{names[0]}_db": trial.cheap_db,
            f"{names[1]}_db": trial.dear_db,
            "used": names[trial.pays],
            "keys": list(keys),
        }
        for trial, keys in intervals.items()
    ]
    makers = Counter(frame.made_by for frame in run.frames)
    made = {"cheap": makers[SOFTSPLAT], "dear": makers[LOOKAHEAD]}
    return {"gate": trials, "look_ahead": made if run.lookahead else None}


def gate_line(trials: list[dict[str, Any]]) -> str:
    """Say in a line what the gate decided."""
    used = Counter[str]()
    for trial in trials:
        used[trial["used"]] += len(trial["keys"])
    untried = sum(len(trial["keys"]) for trial in trials if trial["frame"] is None)
    shares = ", ".join(f"{name} in {pluralise(count, 'interval')}" for name, count in used.items())
    alone = f"; {untried} of these without a key frame to try it on" if untried else ""
    return f"network tried on the shot's own key frames: {shares}{alone}"


def quality_by_decision(decides: bool, frames: tuple[FrameRecord, ...]) -> dict[str, Any]:
    """Average the scores of generated frames by what made them; none outside the tree."""
    chosen: dict[str, list[FrameRecord]] = {choice: [] for choice in CHOICES}
    for frame in frames:
        if decides and frame.kind is FrameKind.GENERATED and frame.made_by in chosen:
            chosen[frame.made_by].append(frame)
    return {choice: quality(f.score for f in made) for choice, made in chosen.items()}
