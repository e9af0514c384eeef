"""The decision tree (paper, section IV-B): nodes d1 to d5, paths S1 to S6, features; and the gate.

The gate lets a network make frames only where it improves this shot's own key frames.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

# Names of the features, in the order of `Features.values`
FEATURES = ("N_d", "EMD_Wn", "EMD_Wp", "Var_x", "Var_y", "R")


@dataclass(frozen=True)
class Features:
    """The features of one instant, per slot (quarter of a key interval); finite, 0 or more."""

    objects: int  # N_d, number of connected dynamic objects
    # EMD_Wn, 0 to 2: earth mover's distance of world normals from the instant before
    emd_normal: float
    # EMD_Wp, the same of world positions, scene units; both are means of x, y and z
    emd_position: float
    var_x: float  # variances of the motion vectors' components, square pixels
    var_y: float
    width: int  # of the rendered frame, pixels
    height: int
    distance: float  # median distance from the camera, scene units; 0 when unknown

    @property
    def values(self) -> tuple[float, float, float, float, float, float]:
        """The six features in the order of FEATURES."""
        emd = self.emd_normal, self.emd_position
        return (self.objects, *emd, self.var_x, self.var_y, self.width * self.height)


# The makers of a frame: W, E, or the repetition of the frame before.
WARP = "warp"
EXTRAPOLATE = "extrapolate"
HOLD = "hold"
INTERPOLATE = "interpolate"  # no choice of the tree: frames of an interpolator

# Method of a frame that repeats the key frame, as the next one shows the same picture.
HELD = "held"

CHOICES = (WARP, EXTRAPOLATE)  # a node's choices, in the order of the network's outputs

NODE_SLOTS = {"d1": 1, "d2": 2, "d3": 3, "d4": 3, "d5": 3}  # the slot that each node decides

NODES = tuple(NODE_SLOTS)

FIRST_NODE = "d1"

# Choices that repeat the frame before, as the extrapolated one is not ready in time.
REPEATING_CHOICES = {("d1", EXTRAPOLATE), ("d3", EXTRAPOLATE)}

# The node after a choice; none after the third slot's.
NEXT_NODE = {
    ("d1", WARP): "d2",
    ("d1", EXTRAPOLATE): "d3",
    ("d2", WARP): "d5",
    ("d2", EXTRAPOLATE): "d4",
}


@dataclass(frozen=True)
class DecisionPath:
    """A path through the decision tree of a key interval."""

    choices: dict[str, str]  # by node, in the order of the path
    # Makers of slots 1, 2 and 3. Slot 2 is extrapolated without a node of its own after d1 = E.
    made_by: tuple[str, str, str]

    @property
    def generated(self) -> int:
        """Number of new frames."""
        return sum(maker != HOLD for maker in self.made_by)

    @property
    def extrapolates(self) -> bool:
        """True if the network makes any frame."""
        return EXTRAPOLATE in self.made_by


# Every path by its name in the paper
PATHS = {
    "S1": DecisionPath({"d1": EXTRAPOLATE, "d3": EXTRAPOLATE}, (HOLD, EXTRAPOLATE, HOLD)),
    "S2": DecisionPath({"d1": EXTRAPOLATE, "d3": WARP}, (HOLD, EXTRAPOLATE, WARP)),
    "S3": DecisionPath(
        {"d1": WARP, "d2": EXTRAPOLATE, "d4": EXTRAPOLATE}, (WARP, EXTRAPOLATE, EXTRAPOLATE)
    ),
    "S4": DecisionPath({"d1": WARP, "d2": EXTRAPOLATE, "d4": WARP}, (WARP, EXTRAPOLATE, WARP)),
    "S5": DecisionPath({"d1": WARP, "d2": WARP, "d5": EXTRAPOLATE}, (WARP, WARP, EXTRAPOLATE)),
    "S6": DecisionPath({"d1": WARP, "d2": WARP, "d5": WARP}, (WARP, WARP, WARP)),
}

ONLY_WARPS = "S6"  # the path that runs no network


@dataclass(frozen=True)
class Decision:
    """The choice at one node of a key interval, and its grounds."""

    node: str  # out of NODES
    choice: str  # out of CHOICES
    features: Features | None = None  # None if they were not computed
    inputs: tuple[int, ...] = ()  # of the network, in Q16.16; empty if no network decided
    # Of the network or an oracle, in the order of CHOICES; None if nothing was compared
    outputs: tuple[float, float] | None = None


@dataclass(frozen=True)
class Plan:
    """The decisions of one key interval."""

    path: str  # S1 to S6
    decisions: tuple[Decision, ...]  # those that led to it, in order

    @classmethod
    def fixed(cls, path: str) -> Plan:
        """Return the plan that always takes a path."""
        steps = PATHS[path].choices.items()
        return cls(path, tuple(Decision(node, choice) for node, choice in steps))

    @property
    def extrapolates(self) -> bool:
        """True if the network makes any frame."""
        return PATHS[self.path].extrapolates


def walk_tree(choose: Callable[[str], str]) -> str:
    """Walk the tree from d1 on by the choices of `choose`; return the name of the path."""
    choices: dict[str, str] = {}
    node: str | None = FIRST_NODE
    while node is not None:
        choices[node] = choose(node)
        node = NEXT_NODE.get((node, choices[node]))
    return next(name for name, path in PATHS.items() if path.choices == choices)


SOFTSPLAT = "softsplat"  # both key frames splatted to the slot and blended by depth and time

LOOKAHEAD = "lookahead"  # the same, mixed by the weights of a network

BLEND = "blend"  # a cross-fade of both key frames

KEY = "key"  # a renderer

# The step on which a maker's time is booked, where it has another name.
TIMING_STEPS = {SOFTSPLAT: WARP, BLEND: WARP}


def infer_maker(made_by: str | None, method: str | None) -> str | None:
    """Return what made a frame, by its header or its row in a table."""
    # ExWarp 0.1 wrote "warp" for frames of `softsplat` and `blend`.
    return method if made_by == WARP and method in TIMING_STEPS else made_by


TRIAL_BLOCK = 8  # key intervals that one trial decides for

NO_TRIAL = "no trial"


@dataclass(frozen=True)
class Trial:
    """The prediction of a rendered key frame by two methods."""

    # Input number of the predicted key frame; None if none could be predicted
    frame: int | None = None
    # PSNR of the prediction by warping, dB; None without one. Of `causal`; between key frames the
    # mean of their tiles' PSNR, see `exwarp_cli.pipeline.gate`.
    cheap_db: float | None = None
    dear_db: float | None = None  # the same by a network

    @property
    def pays(self) -> bool:
        """True if the network's prediction is better."""
        if self.cheap_db is None or self.dear_db is None:
            return False
        return self.dear_db > self.cheap_db

    @property
    def text(self) -> str:
        """The trial on one line: ``1005 34.2011 34.3560``, or ``no trial``."""
        if self.frame is None:
            return NO_TRIAL
        return f"{self.frame} {self.cheap_db:.4f} {self.dear_db:.4f}"

    @classmethod
    def parsed(cls, text: str) -> Trial:
        """Read `text` again; raises ValueError when it is no such text."""
        if text == NO_TRIAL:
            return cls()
        frame, cheap, dear = text.split(" ")
        return cls.measured(int(frame), float(cheap), float(dear))

    @classmethod
    def measured(cls, frame: int, cheap_db: float, dear_db: float) -> Trial:
        """Return a trial whose values are rounded as in `text`."""
        # So a run that resumes decides by the headers of its frames.
        if math.isnan(cheap_db) or math.isnan(dear_db):
            raise ValueError(f"a trial of {cheap_db} and {dear_db} dB")
        return cls(frame, round(cheap_db, 4), round(dear_db, 4))
