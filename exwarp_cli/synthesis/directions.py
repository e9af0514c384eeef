"""Readings of the channels to the previous and to the next frame that belong together.

A renderer writes both by one convention: over the same span of time, and with the same axes. Their
signs may be opposite, as in Blender's.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from exwarp_cli.domain.motion import AxisMap
from exwarp_cli.synthesis.evidence import COARSE, FITTED, FREE_STEP, Evidence, Key, nearby

TIE_FLOOR = 0.01
"""Errors that differ by less than this, of 6000 samples, are equal."""

CLEARLY_WORSE = 1.5
"""Every other reading's error above this multiple settles a convention known by name: of 6000
samples the mean error is known to a hundredth."""

Ranked = dict[Key, list[tuple[float, AxisMap]]]
"""Readings of channels in a direction, and their errors: the best first."""

Chosen = dict[Key, tuple[float, AxisMap]]
"""A reading of each direction's channels, and its error."""


def together(
    ranked: Ranked, measured: dict[Key, Evidence], chosen: Chosen
) -> tuple[Chosen, float] | None:
    """Return the best reading of both directions that has one span and one sign convention.

    Each direction by itself may be explained a little better by another span: vectors over one
    frame of four, read as three of them in a shot that slows down.

    Returns
    -------
    tuple or None
        The readings, and the error of the best such reading that moves points elsewhere. None
        where the directions agree already, or are clearly better apart.
    """
    if len(chosen) != 2 or alike(*(axes for _, axes in chosen.values())):
        return None
    joint = sorted(_joint(ranked, measured, tuple(chosen)), key=mean_error)
    best = joint[0]
    if any(axes not in measured[key].usual() for key, (_, axes) in best.items()):
        best = fitted_together(best, measured, FREE_STEP)
    if mean_error(best) > CLEARLY_WORSE * mean_error(chosen) + TIE_FLOOR:
        return None

    def differs(other: Chosen) -> bool:
        return any(measured[key].differ(other[key][1], best[key][1]) for key in best)

    return best, next((mean_error(other) for other in joint if differs(other)), 1.0)


def _joint(
    ranked: Ranked, measured: dict[Key, Evidence], option: tuple[Key, ...]
) -> Iterator[Chosen]:
    """Yield readings of both directions with one span and one sign convention."""
    for key, other in (option, option[::-1]):
        places = dict(zip(key[0], other[0], strict=True))
        for error, axes in ranked[key]:
            partners = [
                replace(
                    axes,
                    x_channel=places[axes.x_channel],
                    y_channel=places[axes.y_channel],
                    x_scale=sign * axes.x_scale,
                    y_scale=sign * axes.y_scale,
                )
                for sign in (1.0, -1.0)
            ]
            for partner_error, partner in zip(
                measured[other].errors(partners), partners, strict=True
            ):
                yield {key: (error, axes), other: (partner_error, partner)}


def fitted_together(chosen: Chosen, measured: dict[Key, Evidence], reach: float) -> Chosen:
    """Fit the scale of readings together within a ratio, by ever smaller steps."""
    best = chosen
    while reach > FITTED:
        near = {key: list(nearby(axes, reach)) for key, (_, axes) in best.items()}
        tried = {
            key: list(zip(measured[key].errors(maps, COARSE), maps, strict=True))
            for key, maps in near.items()
        }
        count = len(next(iter(near.values())))
        steps = [{key: entries[i] for key, entries in tried.items()} for i in range(count)]
        best = min([best, *steps], key=mean_error)
        reach **= 0.5
    return {key: (measured[key].error(axes), axes) for key, (_, axes) in best.items()}


def mean_error(chosen: Chosen) -> float:
    """Return the mean error of readings."""
    return float(np.mean([error for error, _ in chosen.values()]))


def alike(a: AxisMap, b: AxisMap) -> bool:
    """Whether readings of two directions have one span and one sign convention."""
    return (
        (a.x_channel < a.y_channel) == (b.x_channel < b.y_channel)
        and abs(a.x_scale) == abs(b.x_scale)
        and a.x_scale * b.y_scale == a.y_scale * b.x_scale
        and (a.still, a.length, a.alpha) == (b.still, b.length, b.alpha)
    )
