"""The decision tree of a key interval: nodes d1 to d5 and paths S1 to S6 (paper, section IV-B)."""

from __future__ import annotations

from dataclasses import dataclass

WARP = "warp"
EXTRAPOLATE = "extrapolate"
HOLD = "hold"
"""What makes a frame: W, E, or the repetition of the frame before."""

CHOICES = (WARP, EXTRAPOLATE)
"""What a node chooses between."""

NODES = ("d1", "d2", "d3", "d4", "d5")


@dataclass(frozen=True)
class DecisionPath:
    """One way through the decision tree of a key interval.

    Attributes
    ----------
    choices
        The choice at every node that the path passes.
    made_by
        What makes the frame of slots 1, 2 and 3. Slot 2 is extrapolated without a node of its own
        when d1 chose to extrapolate.
    """

    choices: dict[str, str]
    made_by: tuple[str, str, str]


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
