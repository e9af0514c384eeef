"""Finding out what a shot's depth and positions are, where its own pixels tell."""

from __future__ import annotations

from dataclasses import replace

from exwarp_cli.domain.frame import Float32
from exwarp_cli.io.channels import Role
from exwarp_cli.io.depth import DepthKind, DepthReading, measured, relative_to_camera
from exwarp_cli.io.frames import read_raw
from exwarp_cli.io.shot import Shot
from exwarp_cli.io.soundness import first_of

KNOWN = ("Blender", "Unreal (one file per AOV)")
"""Producers whose depth is a distance and whose positions are in world space: nothing is read."""


def with_depth_measured(shot: Shot) -> Shot:
    """Return a shot whose depth is read as its first frame's world positions tell.

    The kind that a name or a channel map says stands, with the range that is measured for it; and
    what nothing tells is taken for a distance.

    Raises
    ------
    InputError
        When the first frame cannot be read.
    """
    told = shot.depth.kind
    known = told in (DepthKind.AXIS, DepthKind.RAY) or (
        told is DepthKind.UNKNOWN and shot.layout.producer in KNOWN
    )
    if known or not {Role.DEPTH, Role.POSITION} <= set(shot.layout.roles):
        return shot
    # As written, whatever kind is told.
    plain = replace(shot, depth=DepthReading())
    raw = read_raw(plain, shot.first, (Role.DEPTH, Role.POSITION))
    depth, position = raw.gbuffer.depth, raw.gbuffer.position
    assert depth is not None and position is not None
    found = measured(depth, position)
    agrees = found is not None and told in (DepthKind.UNKNOWN, found.kind)
    return replace(shot, depth=found) if found is not None and agrees else shot


def with_world_positions(shot: Shot) -> Shot:
    """Return a shot without positions that are relative to its moving camera.

    By those no surface point is found again, and all that is judged by them would come out wrong.

    Raises
    ------
    InputError
        When a frame cannot be read.
    """
    numbers = shot.sequence.numbers
    refs = shot.layout.roles.get(Role.POSITION)
    if refs is None or shot.layout.producer in KNOWN or len(numbers) < 2:
        return shot
    first, other = _positions(shot, shot.first), _in_the_middle(shot)
    if not relative_to_camera(first, other):
        return shot
    layout = shot.layout
    roles = dict(layout.roles)
    del roles[Role.POSITION]
    said = f"{refs[0].name.rpartition('.')[0]!r} is relative to the camera"
    incomplete = {**layout.incomplete, Role.POSITION: said}
    return replace(shot, layout=replace(layout, roles=roles, incomplete=incomplete))


def _in_the_middle(shot: Shot) -> Float32:
    """Return the positions of a frame in the middle; of the nearest sound one, if others may go."""
    numbers = shot.sequence.numbers
    middle = len(numbers) // 2
    if not shot.keep_going:
        return _positions(shot, numbers[middle])
    nearest = sorted(range(len(numbers)), key=lambda i: abs(i - middle))
    return first_of((numbers[i] for i in nearest), lambda number: _positions(shot, number))


def _positions(shot: Shot, number: int) -> Float32:
    position = read_raw(shot, number, (Role.POSITION,)).gbuffer.position
    assert position is not None
    return position
