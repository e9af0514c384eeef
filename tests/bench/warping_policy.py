"""A policy that always warps, of the size of the one that comes with ExWarp.

``python -m tests.bench.warping_policy FILE``. Its network computes what any does, so that a run
with it shows what features and decisions cost and nothing of what they decide.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from exwarp_cli.models.policy_files import load_policy, save_network

CERTAIN = 2**30
"""Bias towards warping, far beyond what the sums before it reach."""


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser("python -m tests.bench.warping_policy", description=__doc__)
    parser.add_argument("file", type=Path)
    options = parser.parse_args(arguments)
    shipped = load_policy(None)
    *hidden, last = shipped.network.layers
    biased = replace(last, biases=np.array([CERTAIN, -CERTAIN], np.int32))
    network = replace(shipped.network, layers=(*hidden, biased))
    save_network(options.file, network, shipped.metadata)
    return 0


if __name__ == "__main__":
    sys.exit(main())
