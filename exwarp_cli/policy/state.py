"""The state that a decision is made in: the network's 44 inputs (paper, section IV-C).

A state is S = (E, T): the six features of an instant, each scaled to 0 … 1, and the node as five
numbers, one of them 1. The input is the current state and the last three, the newest first: the
earlier nodes of this key interval, then node d1 of the key frames before. The oldest is repeated
where there are fewer.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from exwarp_cli.accel.fixed_point import to_fixed
from exwarp_cli.accel.kernel import MlpKernel
from exwarp_cli.accel.quantised_mlp import QuantisedMlp
from exwarp_cli.domain.decision import (
    CHOICES,
    FEATURES,
    FIRST,
    NODES,
    PATHS,
    SLOTS,
    Decision,
    Features,
    Plan,
    path_of,
    walk,
)

F64 = npt.NDArray[np.float64]

STATES = 4
"""The current one and three before."""

STATE_SIZE = len(FEATURES) + len(NODES)
INPUTS = STATES * STATE_SIZE
"""44."""

STATE_VERSION = 1
"""Of the order and the scales below; a policy's metadata have it as ``state``."""

KEYS_BACK = 3
"""Key frames before F_k whose features are looked at: at d1 all of them."""

PASSED = {
    node: next(
        tuple(path.choices)[: tuple(path.choices).index(node)]
        for path in PATHS.values()
        if node in path.choices
    )
    for node in NODES
}
"""The nodes that lead to each node; there is one way to each."""


@dataclass(frozen=True)
class Scale:
    """How a feature becomes a number from 0 to 1: log(1 + v / unit), 1 at `top` and beyond.

    Attributes
    ----------
    unit
        Below it the scale is nearly linear.
    top
        Where it saturates.
    """

    unit: float
    top: float

    def __call__(self, value: float) -> float:
        """Scale a value that is 0 or more."""
        return min(math.log1p(value / self.unit) / math.log1p(self.top / self.unit), 1.0)

    def of_all(self, values: F64) -> F64:
        """Scale many values that are 0 or more, float64 of any shape."""
        return np.minimum(np.log1p(values / self.unit) / math.log1p(self.top / self.unit), 1.0)


SCALES = {
    "N_d": Scale(1.0, 63.0),
    "EMD_Wn": Scale(1e-3, 0.5),
    "EMD_Wp": Scale(1e-3, 1.0),
    "Var_x": Scale(1e-7, 1e-2),
    "Var_y": Scale(1e-7, 1e-2),
    "R": Scale(0.05, 33.2),
}
"""Of N_d; EMD_Wn; EMD_Wp in median distances from the camera; variances in squared frame widths; R
in megapixels (saturating at 8K). Raw R alone would overflow Q16.16 at 480p.

Units are where differences stop to matter: with a tenth of those of the distances, and a hundredth
of those of the variances, a shot calmer than all that were learned from was another world."""


@dataclass(frozen=True)
class Surroundings:
    """What the states of a key interval are made of.

    Attributes
    ----------
    now
        Features of the instants t, t + 1/4 and t + 1/2, at which slots 1, 2 and 3 are decided; with
        G-buffers of key frames only, three times those of F_k.
    before
        Features of F_k-1, F_k-2 and F_k-3, the newer first, as far as they are there.
    """

    now: tuple[Features, Features, Features]
    before: tuple[Features, ...]

    def inputs(self, node: str) -> F64:
        """Return the network's inputs at a node, float64 [44], 0 to 1."""
        here = [node, *reversed(PASSED[node])]
        found = [(self.now[SLOTS[name] - 1], name) for name in here]
        found += [(features, FIRST) for features in self.before]
        found = (found + [found[-1]] * STATES)[:STATES]
        return np.concatenate([state(features, name) for features, name in found])


def state(features: Features, node: str) -> F64:
    """Return one state, float64 [11], 0 to 1: scaled features and the node."""
    return np.concatenate([scaled(features), np.array([name == node for name in NODES], float)])


def scaled(features: Features) -> F64:
    """Return the features scaled, float64 [6], 0 to 1, in the order of FEATURES."""
    relative = {
        "N_d": features.objects,
        "EMD_Wn": features.emd_normal,
        "EMD_Wp": features.emd_position / features.distance if features.distance > 0 else 0.0,
        "Var_x": features.var_x / features.width**2,
        "Var_y": features.var_y / features.width**2,
        "R": features.resolution / 1e6,
    }
    return np.array([SCALES[name](relative[name]) for name in FEATURES])


class LearnedPolicy:
    """The predictor as the accelerator runs it: integers from the state's inputs to the decision.

    Parameters
    ----------
    network
        Takes the 44 inputs of `exwarp_cli.policy.state`.
    """

    def __init__(self, network: QuantisedMlp) -> None:
        self._kernel = MlpKernel(network)

    def plan(self, surroundings: Surroundings) -> Plan:
        """Decide all slots of a key interval; the larger output wins, a tie goes to warping."""
        decisions: list[Decision] = []

        def choose(node: str) -> str:
            state = surroundings.inputs(node)
            fixed = to_fixed(state)
            outputs, chosen = self._kernel.decide(fixed)
            choice = CHOICES[chosen]
            decisions.append(
                Decision(
                    node,
                    choice,
                    surroundings.now[SLOTS[node] - 1],
                    tuple(int(value) for value in fixed),
                    outputs,
                )
            )
            return choice

        return Plan(path_of(dict(walk(choose))), tuple(decisions))
