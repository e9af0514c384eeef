"""What is measured of one key interval, as a dictionary that JSON holds: a part."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, astuple
from typing import Any

from exwarp_cli import __version__
from exwarp_cli.domain.bench import BEST_PSNR, BEST_RETURN, CHOOSERS, POLICY
from exwarp_cli.domain.decision import PATHS
from exwarp_cli.domain.results import Score
from exwarp_cli.pipeline.bench.opened import Opened
from exwarp_cli.pipeline.bench.pictures import FIXED_PATHS, makers_of, names_of
from exwarp_cli.pipeline.bench.scoring import MIDDLE, Scored, Scores
from exwarp_cli.pipeline.interval_inputs import IntervalInputs
from exwarp_cli.pipeline.scoring import SLOTS, steps_of
from exwarp_cli.policy.outcomes import METRICS as JUDGED
from exwarp_cli.policy.outcomes import best_psnr, best_return, returns

PART_VERSION = 1
"""Raised whenever the same input would give other numbers."""


def identity(opened: Opened, key: int, recipes: Mapping[int, str]) -> str:
    """Return what a part depends on, digested: files, networks, systems and metrics."""
    settings = opened.settings
    told = {
        "version": [PART_VERSION, __version__],
        "recipes": sorted(recipes.items()),
        "truth": opened.truth_digests(key),
        "networks": sorted(opened.networks.checksums.items()),
        "policy": opened.policy.checksum,
        "systems": [*settings.systems, *opened.networks.systems],
        "metrics": sorted(settings.metrics),
        "device": settings.device,
    }
    return hashlib.sha256(json.dumps(told).encode()).hexdigest()


def measure(opened: Opened, inputs: IntervalInputs) -> dict[str, Any]:
    """Make and score the frames of slots 1 to 3 by every system.

    Returns
    -------
    dict
        ``key``, the key frame's number; ``holes``, the share of slots 1 to 3 that W cannot see;
        ``features`` of the three instants of decision; ``paths`` of the choosing systems;
        ``returns`` of S1 to S6; ``warp_psnr_db`` of W at slots 1 to 3; ``systems``, for each the
        scores of its three frames; ``extranet``, scores of pictures by ExtraNet's procedure.
    """
    interval = opened.interval(inputs)
    surroundings = opened.look(inputs, interval)
    wanted = frozenset((*opened.settings.metrics, *JUDGED))
    masks, display = opened.masks(interval), opened.source.keys.display
    scores = Scores(
        opened.pictures(inputs, interval),
        opened.truth(inputs.key),
        masks,
        steps_of(interval, display, inputs.followed) if "flicker" in wanted else None,
        wanted,
    )
    paths, gains = _paths(opened, scores, opened.decide(surroundings))
    shown = {name: names_of(name, paths.get(name)) for name in _systems(opened)}
    scores.add_vmaf(list(shown.values()))
    return {
        "key": opened.number(inputs.key),
        "holes": [float(masks[slot].mean()) if slot in masks else None for slot in SLOTS],
        "features": [[float(v) for v in astuple(seen)] for seen in surroundings.now],
        "paths": {name: paths[name] for name in CHOOSERS if name in paths},
        "returns": gains,
        "warp_psnr_db": [scores.of(f"W{slot}", slot)[0].psnr_db for slot in SLOTS],
        "systems": {
            name: _frames(scores.system(names), makers_of(name, paths.get(name)))
            for name, names in shown.items()
        },
        "extranet": _by_extranet(scores, shown),
    }


def _systems(opened: Opened) -> tuple[str, ...]:
    return (*opened.settings.systems, *opened.networks.systems)


def _paths(
    opened: Opened, scores: Scores, decided: str
) -> tuple[dict[str, str], list[float] | None]:
    """Return the path of every system that takes one, and the returns of all six."""
    paths = {name: path for name, path in FIXED_PATHS.items() if name in _systems(opened)}
    paths[POLICY] = decided
    if opened.networks.own is None:
        return paths, None
    outcomes = scores.outcomes()
    names = tuple(PATHS)
    paths[BEST_PSNR] = names[int(best_psnr(outcomes))]
    paths[BEST_RETURN] = names[int(best_return(outcomes))]
    return paths, [float(value) for value in returns(outcomes)]


def _frames(scored: list[Scored], makers: tuple[str, ...]) -> list[dict[str, Any]]:
    """Return what is known of the three frames of a system."""
    return [
        {"made_by": maker, "all": asdict(over), "holes": inside and asdict(inside)}
        for (over, inside), maker in zip(scored, makers, strict=True)
    ]


def _by_extranet(scores: Scores, shown: Mapping[str, tuple[str, ...]]) -> dict[str, Any]:
    """Score what each system shows midway between key frames, as ExtraNet's authors do.

    Their network doubles the frame rate; a path that has E's frame at slot 2 stands for it.
    """
    found: dict[str, Score] = {}
    for names in shown.values():
        name = names[MIDDLE - 1]
        if name not in found:
            found[name] = scores.as_extranet(name)
    return {
        system: {"psnr_db": found[names[MIDDLE - 1]].psnr_db, "ssim": found[names[MIDDLE - 1]].ssim}
        for system, names in shown.items()
    }
