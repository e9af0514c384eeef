"""What a training shot is to show that is hard to warp, drawn by its seed; without Blender.

Each feature has its share of all seeds. Multiples of square roots spread evenly, so that any run of
some dozen seeds has each feature about as often as its share says, in all combinations.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

SHARES: dict[str, tuple[float, int]] = {
    "cast shadows": (0.85, 3),
    "figures": (0.4, 7),
    "crowd": (0.12, 11),
    "wind": (0.4, 14),
    "glossy ground": (0.4, 17),
    "mirror": (0.25, 19),
    "whirling": (0.4, 22),
    "lattice": (0.35, 23),
    "glass": (0.35, 29),
    "emissive": (0.3, 31),
    "crossing": (0.5, 37),
    "real shapes": (0.65, 41),
    "real textures": (0.5, 43),
}
"""By feature: its share of the seeds, and the number whose square root spreads it."""


@dataclass(frozen=True)
class Plan:
    """The features of one shot.

    Attributes
    ----------
    features : frozenset of str
        Keys of `SHARES`.
    """

    features: frozenset[str] = frozenset()

    @classmethod
    def draw(cls, seed: int) -> Plan:
        """Draw the features of a seed."""
        return cls(
            frozenset(
                name
                for name, (share, number) in SHARES.items()
                if (seed * math.sqrt(number)) % 1 < share
            )
        )

    def has(self, feature: str) -> bool:
        """Return True if the shot is to show a feature; KeyError for one that is not known."""
        if feature not in SHARES:
            raise KeyError(feature)
        return feature in self.features
