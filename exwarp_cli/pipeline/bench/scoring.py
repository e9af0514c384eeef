"""Scores of the pictures of a key interval, and of the systems that show them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from exwarp_cli.domain.decision import CHOICES, NODES, PATHS
from exwarp_cli.domain.decision import SLOTS as SLOT_OF
from exwarp_cli.domain.frame import Bool, Float32
from exwarp_cli.domain.results import Score
from exwarp_cli.metrics import extranet
from exwarp_cli.metrics.flicker import error
from exwarp_cli.metrics.registry import score
from exwarp_cli.pipeline.bench.pictures import Pictures, name_on
from exwarp_cli.pipeline.scoring import SLOTS, Steps, flicker_of, vmaf_of
from exwarp_cli.policy.outcomes import METRICS as JUDGED

Scored = tuple[Score, Score | None]

MIDDLE = 2
"""The slot that ExtraNet makes: it doubles the frame rate."""


@dataclass
class Scores:
    """Scores of pictures at the slots where they are shown; each is found once.

    Attributes
    ----------
    pictures
        Of the interval, on the display window.
    truth
        Ground truth of slots 0 to 3, and 4 where there is one: float32 [H, W, 3 or more],
        scene-linear, on the display window.
    masks
        bool [H, W], holes of W at slots 1 to 3, on the display window.
    steps
        How surfaces move through the interval; None where flicker is not measured.
    metrics
        Names as in `Score`.
    """

    pictures: Pictures
    truth: Mapping[int, Float32]
    masks: Mapping[int, Bool]
    steps: Steps | None
    metrics: frozenset[str]
    _scored: dict[tuple[str, int], Scored] = field(default_factory=dict, init=False)
    _errors: dict[tuple[str, int], Float32] = field(default_factory=dict, init=False)

    def of(self, name: str, slot: int) -> Scored:
        """Score a picture shown at a slot, over all pixels and in holes; one by one frame."""
        if (name, slot) not in self._scored:
            self._scored[name, slot] = score(
                self.truth[slot], self.pictures[name], self.masks.get(slot), self.metrics
            )
        return self._scored[name, slot]

    def add_vmaf(self, shown: Sequence[tuple[str, ...]]) -> None:
        """Add VMAF to the pictures of some systems, all in one go.

        VMAF looks at a frame and at how the ground truth changes around it, so every picture is
        scored once, in whatever order pictures are strung together.
        """
        if "vmaf" not in self.metrics:
            return
        columns = [sorted({names[slot - 1] for names in shown}) for slot in SLOTS]
        most = max(map(len, columns))
        filled = [column + column[-1:] * (most - len(column)) for column in columns]
        rows = list(zip(*filled, strict=True))
        found = vmaf_of(self.truth, [[self.pictures[name] for name in row] for row in rows])
        for row, values in zip(rows, found, strict=True):
            for slot, name, value in zip(SLOTS, row, values, strict=True):
                everywhere, holes = self.of(name, slot)
                self._scored[name, slot] = replace(everywhere, vmaf=value), holes

    def system(self, names: tuple[str, ...]) -> list[Scored]:
        """Return the scores of slots 1 to 3 of a system that shows these pictures."""
        found = [self.of(name, slot) for slot, name in zip(SLOTS, names, strict=True)]
        if self.steps is None:
            return found
        errors = {slot: self._error(name, slot) for slot, name in zip(SLOTS, names, strict=True)}
        flickers = flicker_of(errors, self.masks, self.steps)
        return [
            (replace(everywhere, flicker=over), holes and replace(holes, flicker=inside))
            for (everywhere, holes), (over, inside) in zip(found, flickers, strict=True)
        ]

    def _error(self, name: str, slot: int) -> Float32:
        if (name, slot) not in self._errors:
            self._errors[name, slot] = error(self.truth[slot], self.pictures[name])
        return self._errors[name, slot]

    def outcomes(self) -> npt.NDArray[np.float64]:
        """Return what each choice of the decision tree leads to: see `policy.outcomes`."""
        return np.array(
            [[self._quality(node, choice) for choice in CHOICES] for node in NODES], np.float64
        )

    def as_extranet(self, name: str) -> Score:
        """Score a picture shown midway between key frames as ExtraNet's authors do."""
        return extranet.score(self.truth[MIDDLE], self.pictures[name])

    def _quality(self, node: str, choice: str) -> list[float]:
        path = next(name for name, path in PATHS.items() if path.choices.get(node) == choice)
        everywhere, _ = self.of(name_on(path, SLOT_OF[node]), SLOT_OF[node])
        return [getattr(everywhere, name) for name in JUDGED]
