"""The decision tree (paper, section IV-B): nodes d1 to d5, paths S1 to S6, and their features."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

FEATURES = ("N_d", "EMD_Wn", "EMD_Wp", "Var_x", "Var_y", "R")
"""Names of the features, in the order of `Features.values`."""


@dataclass(frozen=True)
class Features:
    """The features of one instant, per slot: a quarter of a key interval. All finite, 0 or more.

    Attributes
    ----------
    objects
        N_d, number of connected dynamic objects.
    emd_normal
        EMD_Wn, earth mover's distance of the world normals from those of the instant before; mean
        of x, y and z. 0 to 2.
    emd_position
        EMD_Wp, the same of the world positions, scene units.
    var_x, var_y
        Variance of the motion vectors' components, square pixels.
    width, height
        Of what was rendered, pixels.
    distance
        Median distance from the camera of what is seen, scene units; 0 when unknown.
    """

    objects: int
    emd_normal: float
    emd_position: float
    var_x: float
    var_y: float
    width: int
    height: int
    distance: float

    @property
    def resolution(self) -> int:
        """R, rendered pixels."""
        return self.width * self.height

    @property
    def values(self) -> tuple[float, float, float, float, float, float]:
        """The six features in the order of FEATURES."""
        return (
            self.objects,
            self.emd_normal,
            self.emd_position,
            self.var_x,
            self.var_y,
            self.resolution,
        )


WARP = "warp"
EXTRAPOLATE = "extrapolate"
HOLD = "hold"
"""What makes a frame: W, E, or the repetition of the frame before."""

HELD = "held"
"""Method of a frame that repeats the key frame, as the next one shows the same picture."""

CHOICES = (WARP, EXTRAPOLATE)
"""What a node chooses between; also the order of the network's outputs."""

SLOTS = {"d1": 1, "d2": 2, "d3": 3, "d4": 3, "d5": 3}
"""The slot that each node decides."""

NODES = tuple(SLOTS)

FIRST = "d1"
"""The node that every key interval begins with."""

DROPPING = {("d1", EXTRAPOLATE), ("d3", EXTRAPOLATE)}
"""Choices that repeat the frame before, as the extrapolated one is not ready in time."""

NEXT = {
    ("d1", WARP): "d2",
    ("d1", EXTRAPOLATE): "d3",
    ("d2", WARP): "d5",
    ("d2", EXTRAPOLATE): "d4",
}
"""The node after a choice; none after the third slot's."""


@dataclass(frozen=True)
class DecisionPath:
    """One way through the decision tree of a key interval.

    Attributes
    ----------
    choices
        The choice at every node that the path passes, in their order.
    made_by
        What makes the frame of slots 1, 2 and 3. Slot 2 is extrapolated without a node of its own
        when d1 chose to extrapolate.
    """

    choices: dict[str, str]
    made_by: tuple[str, str, str]

    @property
    def generated(self) -> int:
        """How many of the three frames are new."""
        return sum(maker != HOLD for maker in self.made_by)

    @property
    def extrapolates(self) -> bool:
        """Whether the network makes any of them."""
        return EXTRAPOLATE in self.made_by


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
"""Every path by its name in the paper."""

ONLY_WARPS = "S6"
"""The path that runs no network."""


@dataclass(frozen=True)
class Decision:
    """What was chosen at one node of a key interval, and by what.

    Attributes
    ----------
    node, choice
        Out of NODES and CHOICES.
    features
        Of the instant at which it was taken; None where none were looked at.
    inputs
        The network's inputs in Q16.16; empty where no network decided.
    outputs
        The network's two outputs in the order of CHOICES, or what an oracle found for them; None
        where nothing was weighed.
    """

    node: str
    choice: str
    features: Features | None = None
    inputs: tuple[int, ...] = ()
    outputs: tuple[float, float] | None = None


@dataclass(frozen=True)
class Plan:
    """What is done in one key interval.

    Attributes
    ----------
    path
        S1 to S6.
    decisions
        Those that led to it, in their order.
    """

    path: str
    decisions: tuple[Decision, ...]

    @classmethod
    def fixed(cls, path: str) -> Plan:
        """Return the plan to take a path whatever is seen."""
        steps = PATHS[path].choices.items()
        return cls(path, tuple(Decision(node, choice) for node, choice in steps))

    @property
    def extrapolates(self) -> bool:
        """Whether the network makes any frame."""
        return PATHS[self.path].extrapolates

    def decision_of(self, slot: int) -> Decision | None:
        """Return what was decided of a slot, 1 to 3; None for slot 2 after d1 = E."""
        return next((d for d in self.decisions if SLOTS[d.node] == slot), None)


def path_of(choices: Mapping[str, str]) -> str:
    """Return the name of the path that passes these nodes with these choices, and no others."""
    return next(name for name, path in PATHS.items() if path.choices == dict(choices))


def walk(choose: Callable[[str], str]) -> Iterator[tuple[str, str]]:
    """Go through the tree from d1 on; yield every node with what `choose` takes there."""
    node: str | None = FIRST
    while node is not None:
        choice = choose(node)
        yield node, choice
        node = NEXT.get((node, choice))


SOFTSPLAT = "softsplat"
"""Both key frames splatted to the slot and blended by depth and time."""

BLEND = "blend"
"""A cross-fade of both key frames."""

KEY = "key"
"""A renderer."""

STEPS = {SOFTSPLAT: WARP, BLEND: WARP}
"""The step of the work that a maker's time is booked on, where it has another name."""


def step_of(maker: str) -> str:
    """Name the step of the work that the time of a frame's maker is booked on."""
    return STEPS.get(maker, maker)


def maker_of(made_by: str | None, method: str | None) -> str | None:
    """Return what made a frame, from what its header or its row in a table says.

    ExWarp 0.1 wrote "warp" for frames of `softsplat` and `blend`.
    """
    return method if made_by == WARP and method in STEPS else made_by
