"""Finding out what a shot's depth and positions are, where its own pixels tell."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator
from dataclasses import replace
from functools import lru_cache

import numpy as np

from exwarp_cli.domain.frame import Float32
from exwarp_cli.domain.motion import MotionConvention
from exwarp_cli.errors import InputError
from exwarp_cli.io.channels import Role
from exwarp_cli.io.depth import DepthKind, DepthReading, is_negative, measured, relative_to_camera
from exwarp_cli.io.frames import read_planes, read_raw
from exwarp_cli.io.shot import Shot
from exwarp_cli.io.soundness import first_of
from exwarp_cli.pipeline.shots import pair_beside_hold, pairs_within
from exwarp_cli.synthesis.gbuffer_values import OrderVotes, camera_end, occlusion_votes

ENOUGH, AGREE = 200, 0.75
"""Places where one surface covers another by which the first pair of frames tells alone that depth
is a distance, and the share of them that has to agree. Of the example's shots 85 to 94 % do."""

LEAST_VOTES, AGAINST = 60, 0.4
"""Fewer places say nothing; up to this share of agreeing ones speaks against a distance."""

LEAST_OF_PAIR = 10
"""Places from which a pair of frames, one way, has to agree with the others. Vectors that miss the
neighbour frame speak against a distance in one pair and for it in the next."""

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
    shot = _with_sign(shot)
    stated = shot.depth.kind
    known = stated in (DepthKind.AXIS, DepthKind.RAY, DepthKind.NEGATIVE) or (
        stated is DepthKind.UNKNOWN and shot.layout.producer in KNOWN
    )
    if known or not {Role.DEPTH, Role.POSITION} <= set(shot.layout.roles):
        return shot
    # As written, whatever kind is stated.
    plain = replace(shot, depth=DepthReading())
    raw = read_raw(plain, shot.first, (Role.DEPTH, Role.POSITION))
    depth, position = raw.gbuffer.depth, raw.gbuffer.position
    assert depth is not None and position is not None
    found = measured(depth, position)
    agrees = found is not None and stated in (DepthKind.UNKNOWN, found.kind)
    return replace(shot, depth=found) if found is not None and agrees else shot


def _with_sign(shot: Shot) -> Shot:
    """Return a shot whose distances count where they are written below 0."""
    kinds = (DepthKind.UNKNOWN, DepthKind.AXIS, DepthKind.RAY)
    if Role.DEPTH not in shot.layout or shot.depth.kind not in kinds:
        return shot
    (ref, *_) = shot.layout.roles[Role.DEPTH]
    planes, _ = read_planes(shot, shot.first, (ref,))
    if not is_negative(planes[ref].astype(np.float32, copy=False)):
        return shot
    evidence = f"{_layer_of(shot)!r} is negative and read as the distance |z|"
    return replace(shot, depth=DepthReading(DepthKind.NEGATIVE, evidence=evidence))


def with_depth_ordered(
    shot: Shot,
    convention: MotionConvention | None,
    starts: Collection[int] = (),
) -> Shot:
    """Return a shot whose depth grows away from the camera by its own vectors.

    Depth that names, a channel map or world positions do not explain is taken for a distance, as
    long as vectors do not speak against it. The pairs of frames are those that vectors are measured
    by, so that any part of the sequence finds the same.

    Parameters
    ----------
    shot
        The shot, of which depth is read so far as a distance or as its name says.
    convention
        Of its vectors; None without.
    starts
        Numbers of frames before which cuts are known.

    Returns
    -------
    Shot
        With another reading of depth, or without depth, where it speaks against what covers what.
    """
    by_hand = shot.channel_map is not None and shot.channel_map.depth_kind is not None
    uncertain = shot.depth.kind in (DepthKind.UNKNOWN, DepthKind.INVERSE) and not by_hand
    if convention is None or shot.depth.measured or not uncertain:
        return shot
    if Role.DEPTH not in shot.layout:
        return shot
    numbers = shot.sequence.numbers

    def parted(index: int) -> bool:
        return numbers[index] in starts

    @lru_cache(maxsize=1)  # a pair is looked at twice in a row
    def ways(first: int) -> list[tuple[Float32, Float32, Float32]]:
        return list(_ways(shot, (numbers[first], numbers[first + 1]), convention))

    def is_hold(first: int) -> bool:
        return any(
            np.any(motion) and np.array_equal(here, there, equal_nan=True)
            for here, there, motion in ways(first)
        )

    votes, each, ends = OrderVotes(), [], []
    for first in pairs_within(len(numbers), parted):
        for here, there, motion in ways(pair_beside_hold(first, len(numbers), parted, is_hold)):
            each.append(occlusion_votes(here, there, motion))
            votes += each[-1]
            ends.append((here, motion))
        if votes.count >= ENOUGH and votes.small_share >= AGREE:
            return shot
    if votes.count < LEAST_VOTES or not all(
        one.small_share <= AGAINST for one in (votes, *each) if one.count >= LEAST_OF_PAIR
    ):
        return shot
    return _turned(shot, votes, ends)


def _turned(shot: Shot, votes: OrderVotes, seen: Iterable[tuple[Float32, Float32]]) -> Shot:
    """Return a shot with its depth read the other way round, or without depth."""
    name = _layer_of(shot)
    said = f"of {votes.count} places where one surface covers another"
    if votes.small_share > 1 - AGREE:
        evidence = (
            f"{name!r} is left out: in {votes.near_large} {said}, the nearer one has the larger "
            "value, in the others the smaller one; check the pass, or say what it is by depth_kind "
            "in a channel map"
        )
        return _without_depth(shot, evidence)
    if shot.depth.kind is DepthKind.INVERSE:
        evidence = f"{name!r} is read as a distance, against its name, by {votes.near_large} {said}"
        return replace(shot, depth=DepthReading(evidence=evidence))
    seen = list(seen)
    found_ends = (camera_end(values, motion) for values, motion in seen)
    end = next((end for end in found_ends if end is not None), None)
    if end is None:
        # Nothing but its order is known; a range that ends at 1 is a picture of distances.
        largest = max((float(v[np.isfinite(v)].max(initial=0)) for v, _ in seen), default=0.0)
        end = 1.0 if largest <= 1 else np.inf
    kind, reading = "inverse", DepthReading(DepthKind.INVERSE)
    if np.isfinite(end):
        kind, reading = (
            f"reversed, {end:.3g} at the camera",
            DepthReading(DepthKind.REVERSED, end, -1.0),
        )
    evidence = (
        f"{name!r} grows towards the camera, by {votes.near_large} {said}, and is read as {kind}"
    )
    return replace(shot, depth=replace(reading, evidence=evidence))


def read_alike(shot: Shot, other: Shot) -> Shot:
    """Return a shot with depth read, or left out, as another one of the same render has it."""
    if Role.DEPTH not in other.layout:
        return _without_depth(shot, other.depth.evidence)
    return replace(shot, depth=other.depth)


def _without_depth(shot: Shot, evidence: str) -> Shot:
    roles = dict(shot.layout.roles)
    del roles[Role.DEPTH]
    said = f"{_layer_of(shot)!r} contradicts the vectors"
    incomplete = {**shot.layout.incomplete, Role.DEPTH: said}
    found = replace(shot.layout, roles=roles, incomplete=incomplete)
    return replace(shot, layout=found, depth=DepthReading(evidence=evidence))


def _ways(
    shot: Shot,
    pair: tuple[int, int],
    convention: MotionConvention,
) -> Iterator[tuple[Float32, Float32, Float32]]:
    """Yield the depth of a frame and of its neighbour, and the motion between, both ways.

    Of a pair that cannot be read nothing: that is said when its turn comes.
    """
    buffers = []
    for number in pair:
        try:
            raw = read_raw(shot, number, (Role.DEPTH, Role.MOTION))
        except InputError:
            return
        buffers.append(raw.settle(convention).on(shot.display))
    before, after = buffers
    ways = ((before, after, before.to_next), (after, before, after.to_previous))
    for here, there, motion in ways:
        if motion is not None and here.depth is not None and there.depth is not None:
            yield here.depth, there.depth, motion


def _layer_of(shot: Shot) -> str:
    """Return the name of the depth's layer, or of the channel where it has none."""
    ref = shot.layout.roles[Role.DEPTH][0]
    return ref.name.rpartition(".")[0] or ref.aov or ref.name


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
