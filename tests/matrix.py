"""How much is tried: which tests run by default, and how many of their cases.

``pytest`` alone runs what takes under four minutes on two cores. With files, ``-m``, ``-k`` or
``--lf`` it runs what these name, with ``--all`` everything, as ``make test`` does. Of combinations
it tries a spread, with EXWARP_TESTS=full every one.
"""

from __future__ import annotations

import itertools
import os
from collections.abc import Iterable, Sequence
from typing import TypeVar

T = TypeVar("T")

# Folders and files under tests that `pytest` alone leaves out, by the mark of their tests.
MARKED = {
    "blender": ("blender",),
    "cluster": ("cli/cluster",),
    "hardware": ("hardware",),
    "process": (
        "faults",
        "packaging",
        "cli/test_cores.py",
        "cli/test_encodings.py",
        "cli/test_farm_openjd.py",
        "cli/test_farm_runs.py",
        "cli/test_first_run.py",
        "cli/test_signals.py",
        "cli/test_standard_streams.py",
        "cli/test_systems.py",
        "unit/test_kernel_cache.py",
        "unit/test_telemetry.py",
    ),
    "slow": (
        "cli/decisions/test_bench.py",
        "cli/decisions/test_bytes.py",
        "cli/decisions/test_features.py",
        "cli/decisions/test_oracles.py",
        "cli/test_clips.py",
        "cli/test_cryptomatte.py",
        "cli/test_cuts.py",
        "cli/test_depth_direction.py",
        "cli/test_extrapolation.py",
        "cli/test_extrapolation_bytes.py",
        "cli/test_holds.py",
        "cli/test_hostile_names.py",
        "cli/test_keep_going.py",
        "cli/test_keep_going_splits.py",
        "cli/test_locked_off.py",
        "cli/test_merge_of_inputs.py",
        "cli/test_moving_light.py",
        "cli/test_ownership.py",
        "cli/test_producers.py",
        "cli/test_rates.py",
        "cli/test_review.py",
        "cli/test_stereo.py",
        "cli/test_tail.py",
        "cli/test_tiles.py",
        "cli/test_truth_rates.py",
        "cli/test_verify.py",
        "cli/test_video_colour.py",
        "unit/test_judging.py",
        "unit/test_kernels_builds.py",
        "unit/test_miniature.py",
    ),
    "training": ("unit/training", "cli/test_train_command.py", "cli/test_train_policy.py"),
    "web": ("web",),
}

DEFAULT_SUITE = f"not ({' or '.join(MARKED)})"

FULL = os.environ.get("EXWARP_TESTS") == "full"
"""Whether everything is tried, as `make test-full` does."""


def combinations(*axes: Sequence[object]) -> list[tuple[object, ...]]:
    """Return all combinations if `FULL`, else so few that each value of each axis is in one."""
    if FULL:
        return list(itertools.product(*axes))
    count = max(len(axis) for axis in axes)
    return [tuple(axis[i % len(axis)] for axis in axes) for i in range(count)]


def spread(cases: Iterable[T], count: int) -> list[T]:
    """Return all cases if `FULL`, else `count` of them, evenly spread, first and last included."""
    found = list(cases)
    if FULL or count >= len(found):
        return found
    return [found[round(i * (len(found) - 1) / max(1, count - 1))] for i in range(count)]
