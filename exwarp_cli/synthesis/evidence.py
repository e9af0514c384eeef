"""How well readings of motion channels explain pairs of frames."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from exwarp_cli.domain.motion import AxisMap
from exwarp_cli.synthesis.probing import Instant, Probe, probe
from exwarp_cli.synthesis.readings import FREE_STEP, Form, fixed, forms, free, nearby

F64 = npt.NDArray[np.float64]

ROUGH, COARSE = 400, 1500
"""Samples that candidates are compared on: the many of any scale, and those of the usual ones."""

SAME_PIXELS = 0.3
"""Candidates whose vectors differ by less than this on average count as one."""

AROUND, FITTED = 1.15, 1.002
"""Ratio of neighbouring scales at which fitting one begins around a usual one, and ends."""

CLEARLY_BETTER, CLEAR_FLOOR = 1.25, 0.01
"""A usual scale stands unless another near it has an error that is smaller by this ratio, and
more."""

ALPHA = ("a", "alpha")
"""Names of a channel that others are premultiplied by."""

Key = tuple[tuple[int, int], bool]


@dataclass
class Evidence:
    """Errors of candidates for one pair of channels in one direction, over all frame pairs."""

    channels: tuple[int, int]
    later: bool
    size: tuple[int, int]
    more: tuple[int | None, int | None] = (None, None)
    probes: list[Probe] = field(default_factory=list)

    def error(self, axis_map: AxisMap, count: int | None = None) -> float:
        """Mean error of a candidate."""
        return float(np.mean([p.error(_apply(axis_map, p, count), count) for p in self.probes]))

    def still(self) -> float:
        """Mean error of no motion."""
        return float(np.mean([p.error(np.zeros((1, 2))) for p in self.probes]))

    @property
    def raw(self) -> F64:
        """The motion channels' values, [N, C]."""
        return np.concatenate([p.raw for p in self.probes])

    @property
    def empty(self) -> bool:
        """Whether both channels hold one value everywhere: a pass that was never written."""
        return bool((np.ptp(self.raw[:, self.channels], axis=0) == 0).all())

    @property
    def forms(self) -> tuple[Form, ...]:
        """What the values may be."""
        return forms(self.raw, self.channels, *self.more)

    def ranked(self) -> list[tuple[float, AxisMap]]:
        """Candidates of usual scale by error: all roughly, the best of them on every sample."""
        rough = [(self.error(c, COARSE), i, c) for i, c in enumerate(self.usual())]
        best = sorted(rough, key=lambda entry: entry[:2])[:12]
        exact = [(self.error(c), i, c) for _, i, c in best]
        return [(e, c) for e, _, c in sorted(exact, key=lambda entry: entry[:2])]

    def usual(self) -> Iterator[AxisMap]:
        """Yield the candidates of the usual scales."""
        for form in self.forms:
            yield from fixed(form, self.channels, *self.size)

    def ranked_freely(self) -> list[tuple[float, AxisMap]]:
        """Candidates of any scale by error, the best ones' scales fitted."""
        raw, seen = self.raw, self.forms
        # Where values may be offsets, they are all of one sign: as displacements, unlikely.
        likely = [form for form in seen if form.still] or seen
        every = (c for f in likely for c in free(f, self.channels, raw, *self.size))
        one = replace(self, probes=[max(self.probes, key=lambda p: p.error(np.zeros((1, 2))))])
        rough = sorted(
            ((one.error(c, ROUGH), i, c) for i, c in enumerate(every)), key=lambda entry: entry[:2]
        )
        # Readings of one sign and aspect stand side by side; the best of each is fitted.
        kinds = {_kind(c): c for _, _, c in reversed(rough)}
        best = sorted(kinds.values(), key=lambda c: self.error(c, COARSE))[:4]
        fitted = [self._scaled(c, FREE_STEP) for c in best]
        rest = [(self.error(c), c) for c in kinds.values() if c not in best]
        return sorted(fitted + rest, key=lambda entry: entry[0])

    def scaled_is_better(self, axis_map: AxisMap) -> bool:
        """Whether another scale, near a candidate's own, is clearly better."""
        better, _ = self._scaled(axis_map, AROUND)
        return better * CLEARLY_BETTER + CLEAR_FLOOR < self.error(axis_map)

    def _scaled(self, axis_map: AxisMap, reach: float) -> tuple[float, AxisMap]:
        """Fit a candidate's scale within a ratio, by ever smaller steps."""
        best = (self.error(axis_map, COARSE), axis_map)
        while reach > FITTED:
            tried = [(self.error(c, COARSE), c) for c in nearby(best[1], reach)]
            best = min([best, *tried], key=lambda entry: entry[0])
            reach **= 0.5
        return self.error(best[1]), best[1]

    def differ(self, a: AxisMap, b: AxisMap) -> bool:
        """Whether two candidates move the samples differently enough to be told apart."""
        gaps = [np.abs(_apply(a, p, COARSE) - _apply(b, p, COARSE)).mean() for p in self.probes]
        return float(np.mean(gaps)) > SAME_PIXELS


def _kind(axis_map: AxisMap) -> tuple[object, ...]:
    """What tells candidates apart but their scale."""
    return (
        axis_map.x_channel,
        axis_map.x_scale > 0,
        axis_map.y_scale > 0,
        abs(axis_map.x_scale) == abs(axis_map.y_scale),
        axis_map.still,
        axis_map.alpha,
    )


def channel_pairs(names: tuple[str, ...]) -> list[tuple[int, int]]:
    """Return the pairs of channels that may be one direction's."""
    return [(first, first + 1) for first in range(0, len(names) - 1, 2)]


def gathered(
    pairs: Sequence[tuple[Instant, Instant]], names: tuple[str, ...]
) -> dict[Key, Evidence]:
    """Gather empty or filled evidence for every pair of channels and both directions."""
    height, width = pairs[0][0].motion.shape[:2]
    odd = len(names) - 1 if len(names) % 2 else None
    more = (
        (None, odd)
        if odd is not None and names[odd].rsplit(".")[-1].lower() in ALPHA
        else (odd, None)
    )
    out: dict[Key, Evidence] = {}
    for channels in channel_pairs(names):
        used = [*channels, *(index for index in more if index is not None)]
        for later in (False, True):
            evidence = Evidence(channels, later, (width, height), more)
            for a, b in pairs:
                found = probe(a, b, used) if later else probe(b, a, used)
                if found is not None:
                    evidence.probes.append(found)
            out[channels, later] = evidence
    return out


def _apply(axis_map: AxisMap, sampled: Probe, count: int | None) -> F64:
    """Displacements [N, 2] of a probe's samples."""
    raw = sampled.raw if count is None else sampled.raw[:: max(1, len(sampled.xy) // count)]
    return axis_map.apply(raw.astype(np.float32)).astype(np.float64)
