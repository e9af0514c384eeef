"""The state that a tile's decision is made in, and the policy that decides tile by tile.

It is the paper's state (section IV-C) with a tile's features in the place of a frame's: S = (E, T)
as `exwarp_cli.policy.state` has it, six scaled features and the node as five numbers. The input is
the current state and those of the nodes before it in the key interval, which tell what was chosen;
the oldest is repeated. No state holds anything of earlier key intervals, so that any part of a
sequence is decided alike.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from exwarp_cli.accel.fixed_point import to_fixed
from exwarp_cli.accel.kernel import MlpKernel
from exwarp_cli.accel.quantised_mlp import QuantisedMlp
from exwarp_cli.domain.decision import NODES, SLOTS
from exwarp_cli.domain.tiles import TILE_FEATURES, TilePlan
from exwarp_cli.domain.timeline import FACTOR
from exwarp_cli.policy.state import PASSED, STATES, Scale

F64 = npt.NDArray[np.float64]

DECIDED = ("d2", "d4", "d5")
"""The nodes that decide something of a tile; d1 always warps, as no repeated frame is wanted."""

SCALES = {
    "holes": Scale(0.01, 1.0),
    "outlines": Scale(0.01, 1.0),
    "Var_x": Scale(1e-7, 1e-2),
    "Var_y": Scale(1e-7, 1e-2),
    "light": Scale(1.0, 4000.0),
    "motion": Scale(1.0, 4000.0),
}
"""Of shares of pixels; of variances in squared frame widths a slot; of squared display levels. A
change of these, or of their order, is one of `domain.tiles.TILE_STATE`."""


def scaled(features: F64, width: int) -> F64:
    """Return features [..., 6], in the order of `TILE_FEATURES`, as numbers from 0 to 1.

    `width` is that of the frame, in pixels.
    """
    units = {name: (width * FACTOR) ** 2 if name.startswith("Var") else 1 for name in SCALES}
    return np.stack(
        [
            SCALES[name].of_all(features[..., index] / units[name])
            for index, name in enumerate(TILE_FEATURES)
        ],
        axis=-1,
    )


def tile_inputs(slots: Sequence[F64], node: str) -> F64:
    """Return the network's inputs at a node, float64 [N, 44].

    Parameters
    ----------
    slots
        Scaled features of slots 1 to 3, float64 [N, 6] each.
    node
        Out of `DECIDED`.
    """
    passed = [node, *reversed(PASSED[node])]
    passed = (passed + [passed[-1]] * STATES)[:STATES]
    count = len(slots[0])
    parts = []
    for name in passed:
        marks = np.tile(np.array([name == other for other in NODES], float), (count, 1))
        parts += [slots[SLOTS[name] - 1], marks]
    return np.concatenate(parts, axis=-1)


def tile_paths(chosen: Mapping[str, npt.NDArray[np.bool_]]) -> npt.NDArray[np.str_]:
    """Return the path of each tile, by whether each node of `DECIDED` chooses to extrapolate."""
    after_e = np.where(chosen["d4"], "S3", "S4")
    after_w = np.where(chosen["d5"], "S5", "S6")
    return np.where(chosen["d2"], after_e, after_w)


class TilePolicy:
    """The predictor as the accelerator runs it, for each tile of a key interval.

    Parameters
    ----------
    network
        Takes the 44 inputs of `tile_inputs`.
    price
        By how much the output for extrapolation has to be larger than that for warping.
    """

    def __init__(self, network: QuantisedMlp, price: int = 0) -> None:
        self._kernel = MlpKernel(priced(network, price))

    def plan(self, features: Sequence[F64], width: int) -> TilePlan:
        """Decide all tiles; the larger output wins, a tie goes to warping.

        Parameters
        ----------
        features
            Of slots 1 to 3, float64 [rows, columns, 6], in the order of `TILE_FEATURES`.
        width
            Of the frame, pixels.
        """
        rows, columns = features[0].shape[:2]
        slots = [scaled(found, width).reshape(-1, len(TILE_FEATURES)) for found in features]
        chosen = {}
        for node in DECIDED:
            _, choices = self._kernel.decide_many(to_fixed(tile_inputs(slots, node)))
            chosen[node] = choices == 1
        return TilePlan(columns, rows, tuple(map(str, tile_paths(chosen))))


def price_of(efforts: Sequence[Sequence[float]], share: float) -> int:
    """Return the price at which a share of the area is extrapolated on the scenes learned from.

    Parameters
    ----------
    efforts
        Shares, ascending, each with its price, as a policy's metadata have them; none for no price.
    share
        0 to 1; beyond the first and the last, theirs counts.
    """
    if not efforts:
        return 0
    shares, prices = zip(*efforts, strict=True)
    return round(float(np.interp(share, shares, prices)))


def priced(network: QuantisedMlp, price: int) -> QuantisedMlp:
    """Return a network whose output for warping is larger by a price, in the units of its sums."""
    last = network.layers[-1]
    biases = last.biases.copy()
    biases[0] += price
    return QuantisedMlp(network.inputs, (*network.layers[:-1], replace(last, biases=biases)))
