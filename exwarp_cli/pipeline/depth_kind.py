"""Finding out what a shot's depth channel holds, where its world positions tell."""

from __future__ import annotations

from dataclasses import replace

from exwarp_cli.io.channels import Role
from exwarp_cli.io.depth import DepthKind, measured
from exwarp_cli.io.frames import read_raw
from exwarp_cli.io.shot import Shot

DISTANCES = ("Blender", "Unreal (one file per AOV)")
"""Producers whose depth is known to be a distance: nothing is read to measure it."""


def with_depth_measured(shot: Shot) -> Shot:
    """Return a shot whose depth is read as its first frame's world positions tell.

    What a name or a channel map says stands, and what nothing tells is taken for a distance.

    Raises
    ------
    InputError
        When the first frame cannot be read.
    """
    known = shot.depth.kind is not DepthKind.UNKNOWN or shot.layout.producer in DISTANCES
    if known or not {Role.DEPTH, Role.POSITION} <= set(shot.layout.roles):
        return shot
    raw = read_raw(shot, shot.sequence.numbers[0], (Role.DEPTH, Role.POSITION))
    depth, position = raw.gbuffer.depth, raw.gbuffer.position
    assert depth is not None and position is not None
    found = measured(depth, position)
    return shot if found is None else replace(shot, depth=found)
