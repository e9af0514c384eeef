"""Whether a cut lies between two neighbouring key frames: geometry and colour disagree throughout.

A frame goes on from the one before when the motion vectors of either lead to what they promise:
geometry to the same surfaces, colour to the same patterns. One of the two is enough, in one of the
two directions: a light that is switched on changes the colour alone, and what comes to fill the
frame hides the older frame from the younger, not the other way round.

Both are judged on glances of 128 cells a row, in blocks of 8x8 cells. Colour and normals count by
their correlation inside a block, so exposure, fades and flashes do not matter, and what scenes have
in common (bright above, level ground below) does not either. The limits were found on 303 pairs of
neighbouring key frames of 70 rendered shots, many of them fast, and on 246 pairs of frames that are
none: from two shots, or a second apart in one::

                                     neighbours, lowest    across a cut, highest    limit
    colour along rendered vectors                 0.238                    0.066     0.15
    colour along optical flow                     0.112                    0.116     0.15
    world positions found again                   0.705                    0.323     0.5
    normals                                       0.231                    0.044     0.15
    depth                                         0.124                    0.408     0.45

All but one in a hundred neighbours have 0.33 and more along optical flow. Geometry is only asked
where colour disagrees: a high limit costs alarms where a lamp is switched on, a low one costs cuts.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from exwarp_cli.domain.frame import Bool, Float32, KeyFrame
from exwarp_cli.synthesis.agreement import CONTRAST, LEAST_BLOCKS, Way, correlations
from exwarp_cli.synthesis.glance import Glance, glance_at

COLOUR_LIMIT = 0.15
"""Colour below this disagrees. Optical flow, which makes the best even of a cut, needs it so high:
one pair of 303 falls below, and that one has moved by half a frame."""

GEOMETRY_LIMITS = {"position": 0.5, "normal": 0.15, "depth": 0.45}
"""Geometry below this disagrees, by what it is judged by, the best first."""

SURE_SHIFT = 0.3
"""A gain of shifts from here on speaks against a cut whatever the vectors say: where they are wrong
throughout, every pair would be a cut. Across a cut it was 0.12 at most, and 0.25 in toy scenes of
even areas; of neighbours eight in ten have more."""

ALIKE_SHIFT, ALIKE_TONES = 0.2, 0.05
"""From here on it does, too, where tones are no further apart. Of 200 shots four had vectors that
missed the motion, and ten pairs of neighbours below the other limit. Seven of them had a gain of
0.24 and more and tones 0.04 apart at most; the other three, at 0.16, are too near cuts to tell."""

LIKELY_SHIFT, TONES_LIMIT = 0.12, 0.1
"""Without vectors: a smaller gain of shifts, and tones further apart, are a cut. 2 of the 303
neighbours are taken for one, and no cut between shots was missed, but 14 of 56 within a place."""

BLACK, LIT = 0.02, 0.1
"""Mean light up to which a frame is black, and from which on the change to black is no fade."""


@dataclass(frozen=True)
class CutEvidence:
    """Whether there is a cut, and what says so.

    Attributes
    ----------
    found
        Whether it is one.
    colour
        How well colour agrees along the vectors, about 0 (by chance) to 1; None where nothing can
        be said, as between even areas.
    geometry
        How well geometry does. None also where colour agrees, so that there is nothing to ask.
    judged_by
        What geometry was judged by: "position", "normal" or "depth"; "" for nothing.
    shifted
        By how much shifts of the whole frame explain the colour better than others do; None where
        nothing can be said, and where it was not asked.
    """

    found: bool
    colour: float | None = None
    geometry: float | None = None
    judged_by: str = ""
    shifted: float | None = None

    def __str__(self) -> str:
        parts = []
        if self.colour is not None:
            parts.append(f"colour agrees to {_percent(self.colour)} along the vectors")
        if self.geometry is not None:
            parts.append(f"{self.judged_by} to {_percent(self.geometry)}")
        if self.shifted is not None:
            parts.append(f"shifts of the frame explain {_percent(self.shifted)}")
        return ", ".join(parts) or "there is no structure to compare"


def is_cut(before: KeyFrame, after: KeyFrame) -> CutEvidence:
    """Tell whether a cut lies between two key frames; nothing but the two is looked at.

    Parameters
    ----------
    before, after
        Neighbouring key frames with one display window, as they were read. Vectors reach over a
        key interval; they may be those of optical flow.
    """
    return cut_between(glance_at(before), glance_at(after))


def is_cut_between(before: Glance, after: Glance) -> bool:
    """Tell the same from glances at the two frames, and nothing of what says so.

    Where vectors one way lead to the same colours, which is nearly always, the other way need not
    be looked at: half of the time.
    """
    return not _goes_on(before, after) and cut_between(before, after).found


def _goes_on(before: Glance, after: Glance) -> bool:
    """Whether colour one way tells that there is no cut; False where more has to be asked."""
    if before.to_next is None or min(before.light.mean(), after.light.mean()) <= BLACK:
        return False
    way = Way.along(before, after, before.to_next, after.to_previous)
    if way.leads_away:
        return False
    colour = way.colour()
    return colour is not None and colour >= COLOUR_LIMIT


def cut_between(before: Glance, after: Glance) -> CutEvidence:
    """Tell the same from glances at the two frames, with what says so."""
    dark, bright = sorted((float(before.light.mean()), float(after.light.mean())))
    to_black = dark <= BLACK and bright >= LIT
    if dark <= BLACK and not to_black:
        return CutEvidence(False)
    ways = [
        Way.along(here, there, vectors, back)
        for here, there, vectors, back in (
            (before, after, before.to_next, after.to_previous),
            (after, before, after.to_previous, before.to_next),
        )
        if vectors is not None
    ]
    if any(way.leads_away for way in ways):
        # A pan that leaves nothing in view, or something from outside that hides all.
        return CutEvidence(False)
    colour = _highest(way.colour() for way in ways)
    if colour is not None and colour >= COLOUR_LIMIT:
        return CutEvidence(False, colour)
    geometry, judged_by = _geometry(ways)
    if geometry is not None and geometry >= GEOMETRY_LIMITS[judged_by]:
        return CutEvidence(False, colour, geometry, judged_by)
    if to_black:
        return CutEvidence(True, colour, geometry, judged_by)
    shifted = gain_of_shifts(before.light, after.light)
    found = shifted is not None and _unexplained(shifted, _tones(before, after), bool(ways))
    return CutEvidence(found, colour, geometry, judged_by, shifted)


def _unexplained(shifted: float, tones: float, along_vectors: bool) -> bool:
    """Whether shifts and tones leave it at a cut, where nothing agreed along vectors, if any."""
    if not along_vectors:
        return shifted < LIKELY_SHIFT and tones >= TONES_LIMIT
    return shifted < (ALIKE_SHIFT if tones <= ALIKE_TONES else SURE_SHIFT)


def _geometry(ways: list[Way]) -> tuple[float | None, str]:
    """Return how well geometry agrees, judged by the first that can tell, and what that is."""
    measures: dict[str, Callable[[Way], float | None]] = {
        "position": Way.positions,
        "normal": Way.normals,
        "depth": Way.depths,
    }
    for name in GEOMETRY_LIMITS:
        found = _highest(measures[name](way) for way in ways)
        if found is not None:
            return found, name
    return None, ""


def _highest(found: Iterable[float | None]) -> float | None:
    return max((value for value in found if value is not None), default=None)


def _tones(before: Glance, after: Glance) -> float:
    """Return how far the distributions of light are apart, in their mean deviation."""
    a, b = np.sort(before.light, axis=None), np.sort(after.light, axis=None)
    return float(2 * np.abs(a - b).mean() / (a.std() + b.std() + 1e-6))


def _percent(share: float) -> str:
    return f"{100 * max(share, 0):.0f} %"


SHIFTS = 4
"""Displacements of the whole frame that are tried where there are no vectors, besides none."""


def gain_of_shifts(before: Float32, after: Float32) -> float | None:
    """Return by how much shifts of the whole frame explain a pair better than others do.

    Of each block counts the best of the few shifts that phase correlation finds (Kuglin and Hines
    1975), less what the best of as many far shifts comes to.
    """
    width = before.shape[1]
    found = _best_of([(0, 0), *_likely_shifts(before, after)], before, after)
    far = ((17, 10), (-17, 13), (12, -12), (-10, -18), (20, 3))
    others = [
        _best_of([(sign * x * width // 100, y * width // 100) for x, y in far], before, after)
        for sign in (1, -1)
    ]
    if found is None or None in others:
        return None
    return found - float(np.mean([o for o in others if o is not None]))


def _best_of(shifts: list[tuple[int, int]], before: Float32, after: Float32) -> float | None:
    """Return the mean over blocks of the best correlation that one of the shifts gives."""
    found = [correlations(before[..., None], *_shifted(after, x, y), CONTRAST) for x, y in shifts]
    measured = np.isfinite(found).any(axis=0)
    if np.count_nonzero(measured) < LEAST_BLOCKS:
        return None
    return float(np.nanmax(np.stack(found)[:, measured], axis=0).mean())


def _shifted(image: Float32, x: int, y: int) -> tuple[Float32, Bool]:
    """Return what lies x cells right and y cells below, [h, w, 1], and where that is inside."""
    height, width = image.shape
    columns, rows = np.arange(width) + x, np.arange(height) + y
    inside = ((rows >= 0) & (rows < height))[:, None] & (columns >= 0) & (columns < width)
    moved = np.roll(image, (-y, -x), axis=(0, 1))
    return moved[..., None], inside


def _likely_shifts(before: Float32, after: Float32) -> list[tuple[int, int]]:
    """Return the highest peaks of phase correlation, as (x, y) in cells, + right and down."""
    height, width = before.shape
    window = np.outer(np.hanning(height), np.hanning(width))
    a, b = (np.fft.rfft2((light - light.mean()) * window) for light in (before, after))
    cross = a.conj() * b
    cross /= np.abs(cross) + 1e-9 * np.abs(cross).max() + 1e-30
    rate = np.fft.fftfreq(height)[:, None] ** 2 + np.fft.rfftfreq(width) ** 2
    # Frequencies above a sixth of a cell's hold more noise than motion.
    peaks = np.fft.irfft2(cross * np.exp(-rate / (2 * 0.15**2)), (height, width))
    out = []
    for _ in range(SHIFTS):
        y, x = divmod(int(np.argmax(peaks)), width)
        around = np.ix_(np.arange(y - 2, y + 3) % height, np.arange(x - 2, x + 3) % width)
        peaks[around] = -np.inf
        out.append((x - width if x > width // 2 else x, y - height if y > height // 2 else y))
    return out
