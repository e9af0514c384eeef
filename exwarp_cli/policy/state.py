"""The states that decisions are made in, and the policies that decide (paper, section IV-C).

A state is S = (E, T): six features of an instant, from its G-buffer and the one before ("List of
features"), each scaled to 0 … 1, and the node as five numbers, one of them 1. The network's 44
inputs are the current state and three earlier ones, newest first; the oldest is repeated where
there are fewer. For a frame, those are the earlier nodes of the key interval, then node d1 of the
key frames before. For a tile, only the nodes of the key interval count, so that any part of a
sequence is decided alike.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from exwarp_cli.accelerator.mlp import QuantisedMlp, to_fixed
from exwarp_cli.accelerator.mlp_kernel import MlpKernel
from exwarp_cli.domain import decision
from exwarp_cli.domain.frame import Bool, GBuffer
from exwarp_cli.domain.tiles import LOOK_AHEAD_FEATURES, TILE_FEATURES, TilePlan
from exwarp_cli.domain.timeline import FACTOR
from exwarp_cli.kernels import frame_statistics
from exwarp_cli.kernels.connected_components import measure_component_areas

F64 = npt.NDArray[np.float64]

BLOCK = 16  # side of the blocks whose mean motion has the variance, pixels

# Objects are connected areas of one id above 0. Smaller ones than this share of the frame, or than
# this many pixels, are not counted: leaves and sparks would outnumber what matters for warping.
MIN_AREA, MIN_PIXELS = 1e-4, 4

STATE_COUNT = 4  # the current one and three before

STATE_SIZE = len(decision.FEATURES) + len(decision.NODES)
INPUTS = STATE_COUNT * STATE_SIZE  # 44

STATE_VERSION = 1  # of the order and the scales below; ``state`` in a policy's metadata

OLDER_KEYS = 3  # key frames before F_k whose features count: at d1 all of them

# The nodes that lead to each node; there is one way to each.
PRECEDING_NODES = {
    node: next(
        tuple(path.choices)[: tuple(path.choices).index(node)]
        for path in decision.PATHS.values()
        if node in path.choices
    )
    for node in decision.NODES
}


def observe(now: GBuffer, before: GBuffer | None, span: int) -> decision.Features:
    """Return the features of an instant, per slot; missing parts give 0.

    `before` is the instant before, on the same window; without it, at the first, earth mover's
    distances are 0. `span` is the number of slots between the two instants, which the motion
    vectors span too: 1 with G-buffers of every slot, 4 with those of key frames.

    ValueError: the windows differ, or the span is not positive.
    """
    # Background counts for nothing but the resolution.
    if span < 1:
        raise ValueError(f"features span {span} slots; give 1 or more")
    if before is not None and before.window != now.window:
        raise ValueError(f"features of {now.window} cannot be compared with {before.window}")
    shown: Bool = ~now.background  # pixels that show a surface
    distances = [0.0, 0.0]  # of normals and positions
    if before is not None:
        earlier_shown: Bool = ~before.background
        pairs = ((before.normal, now.normal), (before.position, now.position))
        for i, (earlier, later) in enumerate(pairs):
            if earlier is not None and later is not None:
                old = frame_statistics.ValueDistribution(earlier, earlier_shown)
                new = frame_statistics.ValueDistribution(later, shown)
                distances[i] = float(frame_statistics.earth_movers_distances(old, new).mean())
    # Of the means of blocks, over the whole span.
    var_x, var_y = 0.0, 0.0
    motion = now.to_next if now.to_previous is None else now.to_previous
    if motion is not None:
        height, width = now.window.shape
        means = np.empty((-(-height // BLOCK), -(-width // BLOCK), 2))
        frame_statistics.block_means(motion, shown, BLOCK, means)
        known = means[~np.isnan(means[..., 0])]
        if len(known):
            var_x, var_y = map(float, known.var(axis=0))
    objects = 0
    if now.stencil is not None:
        areas = np.empty(now.stencil.size + 1, np.int64)
        count = measure_component_areas(now.stencil, areas)
        least = max(MIN_AREA * now.stencil.size, MIN_PIXELS)
        objects = int((areas[1:count] >= least).sum())
    return decision.Features(
        objects=objects,
        emd_normal=distances[0] / span,
        emd_position=distances[1] / span,
        var_x=var_x / span**2,
        var_y=var_y / span**2,
        width=now.window.width,
        height=now.window.height,
        distance=_median_distance(now, shown),
    )


def _median_distance(gbuffer: GBuffer, shown: Bool) -> float:
    """Return the median distance from the camera, scene units; 0 when unknown."""
    median = np.float64(0)
    with np.errstate(over="ignore"):
        if gbuffer.depth is not None:
            median = np.float64(frame_statistics.positive_median(gbuffer.depth, shown))
        elif gbuffer.position is not None:
            # The median distance of the positions from their mean: the camera's place is unknown,
            # but the extent of the visible scene grows with the distance.
            places = gbuffer.position[shown].astype(np.float64)
            places = places[np.isfinite(places).all(axis=-1)]
            if len(places):
                away = np.linalg.norm(places - places.mean(axis=0), axis=-1)
                median = np.median(away, overwrite_input=True)
    return float(median) if math.isfinite(median) else 0.0


@dataclass(frozen=True)
class Scale:
    """How a feature becomes a number from 0 to 1: log(1 + v / unit), 1 at `top` and beyond."""

    unit: float  # below it the scale is nearly linear
    top: float  # where it saturates

    def __call__(self, values: F64 | float) -> F64:
        """Scale values that are 0 or more, of any shape."""
        return np.minimum(np.log1p(values / self.unit) / math.log1p(self.top / self.unit), 1.0)


# EMD_Wp in median distances from the camera; variances in squared frame widths; R in megapixels,
# saturating at 8K. Raw R alone would overflow Q16.16 at 480p.
#
# Units are where differences stop to matter: with a tenth of those of the distances, and a
# hundredth of those of the variances, shots calmer than all training shots were decided badly.
SCALES = {
    "N_d": Scale(1.0, 63.0),
    "EMD_Wn": Scale(1e-3, 0.5),
    "EMD_Wp": Scale(1e-3, 1.0),
    "Var_x": Scale(1e-7, 1e-2),
    "Var_y": Scale(1e-7, 1e-2),
    "R": Scale(0.05, 33.2),
}


@dataclass(frozen=True)
class StateHistory:
    """What the states of a key interval are made of."""

    # At t, t + 1/4 and t + 1/2, for slots 1 to 3; with G-buffers of key frames only, three times
    # F_k's
    now: tuple[decision.Features, decision.Features, decision.Features]
    # Of F_k-1, F_k-2 and F_k-3, the newer first, as far as they exist
    before: tuple[decision.Features, ...]

    def inputs(self, node: str) -> F64:
        """Return the network's inputs at a node, float64 [44], 0 to 1."""
        nodes = [node, *reversed(PRECEDING_NODES[node])]
        states = [(self.now[decision.NODE_SLOTS[name] - 1], name) for name in nodes]
        states += [(features, decision.FIRST_NODE) for features in self.before]
        states = (states + [states[-1]] * STATE_COUNT)[:STATE_COUNT]
        return np.concatenate([state(features, name) for features, name in states])


def state(features: decision.Features, node: str) -> F64:
    """Return a state, float64 [11], 0 to 1: scaled features in the order of FEATURES, and node."""
    relative = {
        "N_d": features.objects,
        "EMD_Wn": features.emd_normal,
        "EMD_Wp": features.emd_position / features.distance if features.distance > 0 else 0.0,
        "Var_x": features.var_x / features.width**2,
        "Var_y": features.var_y / features.width**2,
        "R": features.width * features.height / 1e6,
    }
    scaled = [SCALES[name](relative[name]) for name in decision.FEATURES]
    return np.array([*scaled, *(name == node for name in decision.NODES)], float)


def plan_slots(policy: MlpKernel, history: StateHistory) -> decision.Plan:
    """Decide all slots of a key interval; the larger output wins, a tie goes to warping."""
    decisions: list[decision.Decision] = []

    def choose(node: str) -> str:
        fixed = to_fixed(history.inputs(node))
        outputs, chosen = policy.decide(fixed)
        choice, features = decision.CHOICES[chosen], history.now[decision.NODE_SLOTS[node] - 1]
        numbers = tuple(fixed.tolist())
        decisions.append(decision.Decision(node, choice, features, numbers, outputs))
        return choice

    return decision.Plan(decision.walk_tree(choose), tuple(decisions))


# Nodes that decide about a tile; d1 always warps, as repeated frames are not wanted.
TILE_NODES = ("d2", "d4", "d5")

# Shares of pixels; variances in squared frame widths a slot; squared display levels. A change of
# these, or of their order, needs another `domain.tiles.TILE_STATE`.
TILE_SCALES = {
    "holes": Scale(0.01, 1.0),
    "outlines": Scale(0.01, 1.0),
    "Var_x": Scale(1e-7, 1e-2),
    "Var_y": Scale(1e-7, 1e-2),
    "light": Scale(1.0, 4000.0),
    "motion": Scale(1.0, 4000.0),
}


def scale_tile_features(features: F64, width: int) -> F64:
    """Return features [..., 6], in the order of `TILE_FEATURES`, scaled to 0 … 1.

    `width`: that of the frame, in pixels.
    """
    units = {name: (width * FACTOR) ** 2 if name.startswith("Var") else 1 for name in TILE_SCALES}
    scaled = [TILE_SCALES[n](features[..., i] / units[n]) for i, n in enumerate(TILE_FEATURES)]
    return np.stack(scaled, axis=-1)


# Of `LOOK_AHEAD_FEATURES`: a share of pixels, squared display levels, and a proportion.
LOOK_AHEAD_SCALES = (Scale(0.01, 1.0), *(Scale(1.0, 4000.0),) * 4, Scale(0.1, 30.0))


def look_ahead_inputs(features: F64, time: float) -> F64:
    """Return the network's inputs for tiles between two key frames, float64 [N, 44].

    `features` are `LOOK_AHEAD_FEATURES`, float64 [N, 6]; the time is the slot's, 0 < time < 1. The
    node is that which decides about the nearest of the slots 1 to 3 first. There is no other state:
    what is made of other slots changes nothing.
    """
    scaled = [scale(features[:, i]) for i, scale in enumerate(LOOK_AHEAD_SCALES)]
    slot = min(max(round(time * FACTOR), 1), FACTOR - 1)
    first = next(node for node in decision.NODES if decision.NODE_SLOTS[node] == slot)
    marks = [np.full(len(features), node == first, np.float64) for node in decision.NODES]
    return np.tile(np.stack([*scaled, *marks], axis=-1), STATE_COUNT)


def tile_inputs(
    slots: Sequence[F64],  # scaled features of slots 1 to 3, float64 [N, 6] each
    node: str,
) -> F64:
    """Return the network's inputs at a node of TILE_NODES, float64 [N, 44]."""
    nodes = [node, *reversed(PRECEDING_NODES[node])]
    nodes = (nodes + [nodes[-1]] * STATE_COUNT)[:STATE_COUNT]
    parts = []
    for name in nodes:
        marks = np.tile(np.array(decision.NODES) == name, (len(slots[0]), 1))
        parts += [slots[decision.NODE_SLOTS[name] - 1], marks.astype(float)]
    return np.concatenate(parts, axis=-1)


def plan_tiles(policy: MlpKernel, features: Sequence[F64], width: int) -> TilePlan:
    """Decide all tiles; the larger output wins, a tie goes to warping.

    Features are those of slots 1 to 3, [rows, columns, 6], in the order of `TILE_FEATURES`; `width`
    is that of the frame, in pixels.
    """
    rows, columns = features[0].shape[:2]
    slots = [scale_tile_features(f, width).reshape(-1, len(TILE_FEATURES)) for f in features]
    chosen = {}  # whether each node extrapolates
    for node in TILE_NODES:
        _, choices = policy.decide_many(to_fixed(tile_inputs(slots, node)))
        chosen[node] = choices == 1
    after_e = np.where(chosen["d4"], "S3", "S4")
    after_w = np.where(chosen["d5"], "S5", "S6")
    return TilePlan(columns, rows, tuple(map(str, np.where(chosen["d2"], after_e, after_w))))


def choose_tiles(policy: MlpKernel, features: F64, time: float) -> Bool:
    """Choose the tiles that a network makes between two key frames, bool [rows, columns].

    See `look_ahead_inputs`.
    """
    states = look_ahead_inputs(features.reshape(-1, len(LOOK_AHEAD_FEATURES)), time)
    _, choices = policy.decide_many(to_fixed(states))
    return np.asarray(choices.reshape(features.shape[:2]) == 1)


def apply_price(network: QuantisedMlp, price: int) -> QuantisedMlp:
    """Return a network whose output for warping is larger by a price, in the units of its sums.

    The output for extrapolation has to exceed that for warping by this margin then.
    """
    last = network.layers[-1]
    biases = last.biases.copy()
    biases[0] += price
    return QuantisedMlp(network.inputs, (*network.layers[:-1], replace(last, biases=biases)))
