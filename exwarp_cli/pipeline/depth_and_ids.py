"""Settling what a shot's depth, positions and ids are, where its own pixels tell."""

from __future__ import annotations

import hashlib
from collections.abc import Collection, Iterable, Iterator
from dataclasses import replace
from itertools import chain

import numpy as np

from exwarp_cli.domain.frame import Float32
from exwarp_cli.domain.motion import MotionConvention
from exwarp_cli.errors import DamagedFileError, InputError, LayoutError
from exwarp_cli.io import cryptomatte
from exwarp_cli.io.channels import Role
from exwarp_cli.io.depth import (
    FAR,
    DepthKind,
    DepthReading,
    is_relative_to_camera,
    measure_depth_reading,
)
from exwarp_cli.io.frames import read_planes, read_raw
from exwarp_cli.io.shot import Shot, first_usable
from exwarp_cli.pipeline.shots import pairs_around, pairs_within
from exwarp_cli.synthesis.gbuffer_values import OrderVotes, camera_end, occlusion_votes

# Places where one surface covers another by which the first pair of frames tells alone that depth
# is a distance, and the share of them that has to agree. Of the example's shots 85 to 94 % do.
ENOUGH, AGREE = 200, 0.75

# Fewer places say nothing; up to this share of agreeing ones speaks against a distance.
LEAST_VOTES, AGAINST = 60, 0.4

# Places from which a pair of frames, one way, has to agree with the others. Vectors that miss the
# neighbour frame speak against a distance in one pair and for it in the next.
LEAST_OF_PAIR = 10

# Producers whose depth is a distance and whose positions are in world space: nothing is read.
KNOWN = ("Blender", "Unreal (one file per AOV)")


def with_depth_measured(shot: Shot) -> Shot:
    """Return a shot whose depth is read as its first frame's world positions tell.

    The kind that a name or a channel map says stands, with the range that is measured for it; and
    what nothing tells is taken for a distance. Raises InputError when the first frame cannot be
    read.
    """
    stated = shot.depth.kind
    kinds = (DepthKind.UNKNOWN, DepthKind.AXIS, DepthKind.RAY)
    if Role.DEPTH in shot.layout and stated in kinds:
        ref = shot.layout.roles[Role.DEPTH][0]
        written = read_planes(shot, shot.first, (ref,))[ref].values
        written = written.astype(np.float32, copy=False)
        with np.errstate(invalid="ignore"):
            surface = written[np.isfinite(written) & (np.abs(written) < FAR)]
        # Along a camera's -z axis distances are negative. Filters that ring leave a few pixels
        # below 0 in any depth, so more pixels must lie below 0 than above.
        if np.count_nonzero(surface < 0) > np.count_nonzero(surface > 0):
            evidence = f"{_depth_layer(shot)!r} is negative and read as the distance |z|"
            return replace(shot, depth=DepthReading(DepthKind.NEGATIVE, evidence=evidence))
    is_certain = stated in (DepthKind.AXIS, DepthKind.RAY, DepthKind.NEGATIVE) or (
        stated is DepthKind.UNKNOWN and shot.layout.producer in KNOWN
    )
    if is_certain or not {Role.DEPTH, Role.POSITION} <= set(shot.layout.roles):
        return shot
    # As written, whatever kind is stated.
    raw = read_raw(
        replace(shot, depth=DepthReading()), shot.first, (Role.DEPTH, Role.POSITION)
    ).gbuffer
    assert raw.depth is not None and raw.position is not None
    reading = measure_depth_reading(raw.depth, raw.position)
    if reading is None or stated not in (DepthKind.UNKNOWN, reading.kind):
        return shot
    return replace(shot, depth=reading)


def with_depth_ordered(
    shot: Shot, convention: MotionConvention | None, starts: Collection[int] = ()
) -> Shot:
    """Return a shot whose depth grows away from the camera by its own vectors.

    Depth that names, a channel map or world positions do not explain is taken for a distance, as
    long as vectors do not speak against it. Where they do, it is read the other way round, or left
    out. The pairs of frames are those that vectors are measured by, so that any part of the
    sequence finds the same. `starts` are numbers of frames before which cuts are known.
    """
    by_hand = shot.channel_map is not None and shot.channel_map.depth_kind is not None
    uncertain = shot.depth.kind in (DepthKind.UNKNOWN, DepthKind.INVERSE) and not by_hand
    if convention is None or shot.depth.measured or not uncertain or Role.DEPTH not in shot.layout:
        return shot
    numbers = shot.sequence.numbers

    cuts = {index for index, number in enumerate(numbers) if number in starts}

    def both_directions(first: int) -> list[tuple[Float32, Float32, Float32]]:
        """Return depth of a frame and of its neighbour, and the motion between, both ways."""
        try:
            pair = (numbers[first], numbers[first + 1])
            raw = (read_raw(shot, number, (Role.DEPTH, Role.MOTION)) for number in pair)
            before, after = (each.settle(convention).on(shot.display) for each in raw)
        except InputError:  # which is said when the frame's turn comes
            return []
        directions = ((before, after, before.to_next), (after, before, after.to_previous))
        return [
            (frame.depth, neighbour.depth, motion)
            for frame, neighbour, motion in directions
            if motion is not None and frame.depth is not None and neighbour.depth is not None
        ]

    total, by_pair, ends = OrderVotes(), [], []
    for first in pairs_within(len(numbers), cuts.__contains__):
        pairs = map(both_directions, pairs_around(first, len(numbers), cuts.__contains__))
        wanted = next(pairs)
        for pair in chain((wanted,), pairs):
            # A hold tells nothing: both frames are the same, but their vectors show motion.
            if not any(np.any(m) and np.array_equal(a, b, equal_nan=True) for a, b, m in pair):
                wanted = pair
                break
        for depth, neighbour, motion in wanted:
            votes = occlusion_votes(depth, neighbour, motion)
            by_pair.append(votes)
            total += votes
            ends.append((depth, motion))
        if total.count >= ENOUGH and total.small_share >= AGREE:
            return shot
    speak_against = all(
        votes.small_share <= AGAINST for votes in (total, *by_pair) if votes.count >= LEAST_OF_PAIR
    )
    if total.count < LEAST_VOTES or not speak_against:
        return shot
    return _with_depth_turned(shot, total, ends)


def _with_depth_turned(shot: Shot, votes: OrderVotes, ends: list[tuple[Float32, Float32]]) -> Shot:
    """Return a shot with its depth read the other way round, or without depth.

    `ends` are depth and motion of the frames that were looked at.
    """
    name = _depth_layer(shot)
    places = f"of {votes.count} places where one surface covers another"
    if votes.small_share > 1 - AGREE:
        evidence = (
            f"{name!r} is left out: in {votes.near_large} {places}, the nearer one has the larger "
            "value, in the others the smaller one; check the pass, or say what it is by depth_kind "
            "in a channel map"
        )
        shot = replace(shot, depth=DepthReading(evidence=evidence))
        return _without_role(shot, Role.DEPTH, f"{name!r} contradicts the vectors")
    if shot.depth.kind is DepthKind.INVERSE:
        evidence = (
            f"{name!r} is read as a distance, against its name, by {votes.near_large} {places}"
        )
        return replace(shot, depth=DepthReading(evidence=evidence))
    camera_ends = (camera_end(values, motion) for values, motion in ends)
    at_camera = next((end for end in camera_ends if end is not None), None)
    if at_camera is None:
        # Nothing but its order is known; a range that ends at 1 is a picture of distances.
        largest = max((float(v[np.isfinite(v)].max(initial=0)) for v, _ in ends), default=0.0)
        at_camera = 1.0 if largest <= 1 else np.inf
    kind, reading = "inverse", DepthReading(DepthKind.INVERSE)
    if np.isfinite(at_camera):
        kind = f"reversed, {at_camera:.3g} at the camera"
        reading = DepthReading(DepthKind.REVERSED, at_camera, -1.0)
    evidence = (
        f"{name!r} grows towards the camera, by {votes.near_large} {places}, and is read as {kind}"
    )
    return replace(shot, depth=replace(reading, evidence=evidence))


def read_alike(shot: Shot, like: Shot) -> Shot:
    """Return a shot with depth read, or left out, as another one of the same render has it."""
    if Role.DEPTH not in like.layout:
        reason = f"{_depth_layer(shot)!r} contradicts the vectors"
        shot = _without_role(shot, Role.DEPTH, reason)
    return replace(shot, depth=like.depth)


def _without_role(shot: Shot, role: Role, reason: str) -> Shot:
    roles = {each: refs for each, refs in shot.layout.roles.items() if each is not role}
    incomplete = {**shot.layout.incomplete, role: reason}
    return replace(shot, layout=replace(shot.layout, roles=roles, incomplete=incomplete))


def _depth_layer(shot: Shot) -> str:
    """Return the name of the depth's layer, or of the channel where it has none."""
    ref = shot.layout.roles[Role.DEPTH][0]
    return ref.name.rpartition(".")[0] or ref.aov or ref.name


def with_world_positions(shot: Shot) -> Shot:
    """Return a shot without positions that are relative to its moving camera.

    By those no surface point is found again, and all that is judged by them would come out wrong.
    Raises InputError when a frame cannot be read.
    """
    numbers = shot.sequence.numbers
    refs = shot.layout.roles.get(Role.POSITION)
    if refs is None or shot.layout.producer in KNOWN or len(numbers) < 2:
        return shot

    def positions(number: int) -> Float32:
        position = read_raw(shot, number, (Role.POSITION,)).gbuffer.position
        assert position is not None
        return position

    first, middle = positions(shot.first), len(numbers) // 2
    # Of a shot with damaged frames, the nearest sound one.
    nearest = sorted(range(len(numbers)), key=lambda i: abs(i - middle))
    candidates = nearest if shot.keep_going else nearest[:1]
    later = first_usable((numbers[i] for i in candidates), positions)
    if not is_relative_to_camera(first, later):
        return shot
    reason = f"{refs[0].name.rpartition('.')[0]!r} is relative to the camera"
    return _without_role(shot, Role.POSITION, reason)


def read_ids(dynamic: str | None, keys: Shot, slots: Shot | None) -> tuple[Shot, Shot | None]:
    """Settle which ids are read of the key frames and of the slots' G-buffers.

    `dynamic` says what moves, as ``--dynamic`` takes it. Where slots have G-buffers, their ids
    count. The shots are returned with `Shot.ids` where ids are read from a Cryptomatte. With
    `dynamic` they are the stencil, and the shots have no other one; without, they are only read
    where there is none, and where they are sound.

    Raises LayoutError when something is named as moving, and there is no Cryptomatte, or one of
    half floats; DamagedFileError when something is named, and ids were destroyed; UsageError when
    a name or pattern matches nothing.
    """
    if dynamic is None:
        return _with_best_ids(keys), None if slots is None else _with_best_ids(slots)
    shots = [shot for shot in (keys, slots) if shot is not None and shot.cryptomattes]
    needed = slots or keys
    if needed not in shots:
        raise LayoutError(
            f"--dynamic names objects of a Cryptomatte, and {needed.sequence.pattern} has none; "
            "render that pass, or leave --dynamic out"
        )
    manifests, rounded = _read_manifests(shots)
    where = f"{needed.sequence.pattern}, layer {needed.cryptomattes[0].name!r},"
    objects = cryptomatte.find_dynamic_objects(dynamic, manifests, where, rounded)

    def with_ids(shot: Shot) -> Shot:
        if shot not in shots:
            return shot
        roles = dict(shot.layout.roles)
        roles.pop(Role.STENCIL, None)
        ids = cryptomatte.IdReading(shot.cryptomattes[0], rounded, objects)
        shot = replace(shot, layout=replace(shot.layout, roles=roles), ids=ids)
        read_raw(shot, shot.first, (Role.STENCIL,), objects=True)
        return shot

    return with_ids(keys), None if slots is None else with_ids(slots)


def sound_cryptomattes(
    shot: Shot,
) -> Iterator[tuple[cryptomatte.Cryptomatte, cryptomatte.Manifest]]:
    """Yield each Cryptomatte of a shot with its first frame's manifest.

    Of one whose ids cannot be used, the manifest has no names, and says why.
    """
    for matte in shot.cryptomattes:
        try:
            matte.require_exact("the file")
            with_ids = replace(shot, ids=cryptomatte.IdReading(matte))
            read_raw(with_ids, shot.first, (Role.STENCIL,), objects=True)
        except (LayoutError, DamagedFileError) as error:
            yield matte, cryptomatte.Manifest(problem=str(error))
        else:
            yield matte, cryptomatte.read_manifest(matte, shot.files(shot.first)[matte.aov])


def _with_best_ids(shot: Shot) -> Shot:
    """Return a shot whose best Cryptomatte tells objects apart, where nothing else does."""
    if Role.STENCIL in shot.layout or not shot.cryptomattes or not shot.cryptomattes[0].exact:
        return shot
    with_ids = replace(shot, ids=cryptomatte.IdReading(shot.cryptomattes[0]))
    try:
        read_raw(with_ids, shot.first, (Role.STENCIL,), objects=True)
    except DamagedFileError:
        return shot
    return with_ids


def _read_manifests(shots: Iterable[Shot]) -> tuple[list[cryptomatte.Manifest], bool]:
    """Return the manifests of all frames, and whether any frame's ids are rounded."""
    manifests: list[cryptomatte.Manifest] = []
    rounded = False
    # What a manifest repeats is left out: they are large, and mostly the same in all frames.
    read_texts: set[bytes] = set()
    read_names: set[tuple[str, int]] = set()
    # Frames have manifests of their own: an object that comes later is in those of later frames.
    frames = ((each, number) for each in shots for number in each.sequence.numbers)
    for shot, number in frames:
        wanted = shot.cryptomattes[0]
        path = shot.files(number)[wanted.aov]
        try:
            header = shot.headers.read(path)
            channels = {wanted.aov: shot.channels(header.parts, wanted.aov).values()}
            in_file = cryptomatte.find_cryptomattes(channels, {wanted.aov: header.texts})
            mattes = [matte for matte in in_file if matte.name == wanted.name]
            for matte in mattes:
                matte.require_exact(str(path))
        except InputError:
            if not shot.keep_going:
                raise
            continue
        for matte in mattes:
            rounded = rounded or matte.rounded
            text = repr((matte.manifest, matte.sidecar, str(path.parent)))
            digest = hashlib.sha256(text.encode()).digest()
            if digest in read_texts:
                continue
            read_texts.add(digest)
            manifest = cryptomatte.read_manifest(matte, path)
            new = {name: ids for name, ids in manifest.ids.items() if (name, ids) not in read_names}
            read_names.update(new.items())
            manifests.append(replace(manifest, ids=new))
    return manifests, rounded
