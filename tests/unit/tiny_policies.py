"""Small policies whose decisions are known, made by hand; as files, too."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from exwarp_cli.accelerator.mlp import QuantisedLayer, QuantisedMlp, Requantisation
from exwarp_cli.models.policy_files import save_network
from exwarp_cli.policy.state import STATE_VERSION
from tests.reference.decisions import PATHS

STATE = 11
"""Numbers of one state: six features and five for the node."""

INPUTS = 4 * STATE
NODES = ("d1", "d2", "d3", "d4", "d5")
CHOICES = ("warp", "extrapolate")
Weights = Mapping[tuple[str, int], int]


def layer(weights: Weights, biases: tuple[int, int] = (0, 0)) -> QuantisedMlp:
    """One layer: each input is 0 to 127 of its range, each output a weighted sum and a bias.

    Parameters
    ----------
    weights
        By choice and index of the input; 0 where there is none.
    biases
        Of the two outputs.
    """
    matrix = np.zeros((2, INPUTS), np.int8)
    for (choice, index), weight in weights.items():
        matrix[CHOICES.index(choice), index] = weight
    to_127 = Requantisation(np.full(INPUTS, 127, np.int32), np.full(INPUTS, 16, np.uint8))
    return QuantisedMlp(to_127, (QuantisedLayer(matrix, np.array(biases, np.int32), None),))


def always(choice: str) -> QuantisedMlp:
    """Choose the same at every node."""
    return layer({}, (1, 0) if choice == "warp" else (0, 1))


def taking(path: str) -> QuantisedMlp:
    """Take one path, by what the current state says of the node."""
    steps = PATHS[path].items()
    return layer({(choice, 6 + NODES.index(node)): 1 for node, choice in steps})


def watching() -> QuantisedMlp:
    """Look at all features of all four states: what moves more than before is extrapolated."""
    weights = {}
    for age in range(4):
        for feature, weight in enumerate((3, 40, 60, 11, 13, 1)):
            sign = 1 if age == 0 else -1
            weights["extrapolate", STATE * age + feature] = sign * max(weight // (age + 1), 1)
    return layer(weights, (700, 0))


def save(path: Path, network: QuantisedMlp, **metadata: object) -> Path:
    """Write a policy for the states of this version."""
    save_network(path, network, {"state": STATE_VERSION} | metadata)
    return path
