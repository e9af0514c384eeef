"""Rigid objects: one motion for all pixels of an object, also where vectors are mixtures.

Renderers filter vectors like colour. Of thin things, such as the spokes of a wheel, few pixels have
the surface's own vector. World positions and ids are those of the pixel's centre, so the motion of
a rigid object has six unknowns: a rotation and a translation in the world, which many pixels tell.
On the scene market `softsplat` gained 0.5 dB by it, and wheels keep their spokes. What turns goes
on an arc from frame to frame, which was worth 0.2 dB more.

About a third of an object's vectors must be its own, or nearly: spokes 1.5 pixels wide are moved
to 0.2 pixels, of spokes one pixel wide the motion is not always recovered.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from exwarp_cli.domain.frame import Bool, Float32, GBuffer, Int32, combine_3x3
from exwarp_cli.synthesis.camera import Scene, camera_after, pixels_at
from exwarp_cli.synthesis.trajectory import displacement, uncurved

F64 = npt.NDArray[np.float64]
Index = npt.NDArray[np.intp]

LEAST_PIXELS = 48
"""Pixels that an object must show."""

MOST_SAMPLES = 1000
"""Pixels of an object that a fit looks at."""

TOLERANCE, RELATIVE_TOLERANCE = 0.1, 0.03
"""Pixels, or share of the object's motion across the picture, that a vector may be off."""

EXPLAINED = 0.95
"""Share of an object's known vectors that must be mixtures of the rigid motion and of what is
beside the pixel. Of rigid objects on market all were, also of wheels with thin spokes of which 30 %
had the rigid motion itself. Limbs of a running character are not.
"""

ROUNDS, PLAIN_ROUNDS = 20, 6
"""Steps of the fit, and how many of them count all pixels alike."""

LEAST_ERROR = 0.02
"""Median error, pixels, below which none is an outlier: the rounding of half-float vectors."""

LONGEST_TURN = 0.5
"""Radians that one step of the fit may turn."""

LEAST_TURN = 0.1
"""Radians a frame from which on an object goes on an arc: 50 pixels from its middle the arc is 0.06
pixels beside a straight line."""


@dataclass(frozen=True)
class Pose:
    """A rigid motion in the world.

    Attributes
    ----------
    centre
        float64 [3]: the point that the object turns about.
    turn
        float64 [3]: axis of the rotation, as long as its angle in radians.
    shift
        float64 [3]: where the centre goes, minus where it is.
    """

    centre: F64
    turn: F64
    shift: F64

    def place(self, points: F64) -> F64:
        """Return where points, float64 [N, 3], go."""
        with np.errstate(invalid="ignore", over="ignore"):  # of infinite points
            return (points - self.centre) @ _rotation(self.turn).T + self.centre + self.shift


Poses = tuple[Pose | None, Pose | None]
"""How an object moves to the previous and to the next frame; None where that is not known."""


def move_rigidly(
    gbuffer: GBuffer, scene: Scene | None, cameras: F64, settled: tuple[Float32, ...]
) -> Float32 | None:
    """Give all pixels of each rigid object the object's own motion.

    Parameters
    ----------
    gbuffer
        As rendered, with ids.
    scene
        The frame's points in the world; nothing is done without.
    cameras
        float64 [2, 2, 3, 4], from :func:`exwarp_cli.synthesis.camera.cameras_around`.
    settled
        Motion to the previous and to the next frame, float32 [H, 2 W] each, changed; empty where
        there is none.

    Returns
    -------
    float32 [2, H, W, 2] or None
        As in :class:`exwarp_cli.domain.frame.GBuffer`, `bend`.
    """
    if scene is None or scene.camera is None or gbuffer.stencil is None:
        return None
    shape = gbuffer.window.shape
    turning: list[tuple[Index, Poses]] = []
    for index in _objects(gbuffer.stencil):
        rigid, poses = _settle_object(gbuffer, scene, cameras, index, settled)
        if any(pose is not None and np.linalg.norm(pose.turn) > LEAST_TURN for pose in poses):
            turning.append((rigid, poses))
    if not turning:
        return None
    before, after = (each.reshape(*shape, 2) if each.size else None for each in settled)
    moved = replace(gbuffer, to_previous=before, to_next=after)
    return _bend_of(moved, scene, turning)


def _settle_object(
    gbuffer: GBuffer, scene: Scene, cameras: F64, index: Index, settled: tuple[Float32, ...]
) -> tuple[Index, Poses]:
    """Settle the motion of an object's pixels, given by flat index.

    Return those that move rigidly both ways, and how; None where it is not rigid, or nothing tells.
    """
    points, pixels = scene.points(index)[:, :3], pixels_at(index, gbuffer.window.width)
    poses: list[Pose | None] = []
    rigid = np.ones(len(index), np.bool_)
    for way, vectors in enumerate((gbuffer.to_previous, gbuffer.to_next)):
        poses.append(None)
        camera = cameras[way, 0]
        if vectors is None or not np.isfinite(camera).all():
            continue
        pose = fit_pose(points, pixels + vectors.reshape(-1, 2)[index], camera)
        if pose is None:
            continue
        motion = np.asarray(_project(camera, pose.place(points))[0] - pixels, np.float32)
        moved = settled[way].reshape(vectors.shape)
        along = _moves_along(motion, index, vectors, moved) & np.isfinite(motion).all(axis=1)
        if along.any():
            # A fit is no better than a vector that it agrees with.
            gap = np.linalg.norm(motion - moved.reshape(-1, 2)[index], axis=1)
            off = along & ~(gap <= LEAST_ERROR)
            moved.reshape(-1, 2)[index[off]] = motion[off]
            poses[-1], rigid = pose, rigid & along
    return index[rigid], (poses[0], poses[1])


def _bend_of(gbuffer: GBuffer, scene: Scene, turning: list[tuple[Index, Poses]]) -> Float32 | None:
    """Return how far objects that turn are beside their vectors half a frame before and after.

    Parameters
    ----------
    gbuffer
        With settled motion.
    scene
        Its points in the world.
    turning
        Flat indices of the pixels of each, and how it moves each way.
    """
    bend = np.zeros((2, *gbuffer.window.shape, 2), np.float32)
    for half, time in zip(bend, (-0.5, 0.5), strict=True):
        way = int(time > 0)
        if (gbuffer.to_next if way else gbuffer.to_previous) is None:
            continue
        motion = displacement(gbuffer, time)
        camera = camera_after(scene, motion, gbuffer.stencil)
        if camera is None:
            return None
        for index, poses in turning:
            pose = _pose_at(poses, time)
            if poses[way] is None or pose is None:
                continue
            seen, _ = _project(camera.matrix, pose.place(scene.points(index)[:, :3]))
            straight = pixels_at(index, gbuffer.window.width) + uncurved(gbuffer, index, time)
            half.reshape(-1, 2)[index] = np.nan_to_num(seen - straight)
    return bend


def _pose_at(poses: Poses, time: float) -> Pose | None:
    """Return the pose at a time between those of the frames before and after, -1 < time < 1.

    Turn and shift go on parabolas, or steadily where one pose alone is known. Then a box that turns
    by 60 degrees a frame is up to 1.2 pixels off: the middle of what is seen of it goes straight.
    """
    before, after = poses
    if before is None or after is None:
        pose, share = (before, -time) if after is None else (after, time)
        return None if pose is None else Pose(pose.centre, share * pose.turn, share * pose.shift)
    # With the middle of what is seen, which goes on an arc itself, that box was 0.9 pixels off.
    centre = _centre_of_rotation(before, after)
    shift = _between(before.place(centre) - centre, after.place(centre) - centre, time)
    return Pose(centre, _between(before.turn, after.turn, time), shift)


def _between(before: F64, after: F64, time: float) -> F64:
    """Return a way at a time between -1 and 1, by those to the frames before and after.

    Acceleration is held as in :func:`exwarp_cli.kernels.splat.quadratic_displacement`.
    """
    own, acceleration = after if time > 0 else before, before + after
    room, size = 2 * float(np.linalg.norm(own)), float(np.linalg.norm(acceleration))
    limit = (room / size) ** 2 if size > room else 1.0
    way: F64 = abs(time) * own + limit * (time * time - abs(time)) / 2 * acceleration
    return way


def _centre_of_rotation(before: Pose, after: Pose) -> F64:
    """Return the point, float64 [3], whose path through both poses is straight and steady.

    Of the points on the axis, the one nearest to the centre of the poses.
    """
    matrix = _rotation(before.turn) + _rotation(after.turn) - 2 * np.eye(3)
    arm = np.linalg.lstsq(matrix, -(before.shift + after.shift), rcond=0.1)[0]
    centre: F64 = after.centre + arm
    return centre


def _objects(stencil: Int32) -> Iterator[Index]:
    """Yield the flat indices of the pixels of each object that moves and is large enough."""
    flat = stencil.ravel()
    moving = np.flatnonzero(flat > 0)
    order = moving[np.argsort(flat[moving], kind="stable")]
    ids = flat[order]
    for index in np.split(order, np.flatnonzero(ids[1:] != ids[:-1]) + 1):
        if len(index) >= LEAST_PIXELS:
            yield index


def fit_pose(points: F64, ends: F64, camera: F64) -> Pose | None:
    """Fit the rigid motion after which points are seen at some pixels, most of them rightly.

    Parameters
    ----------
    points
        float64 [N, 3], world.
    ends
        float64 [N, 2], pixels; not finite where unknown.
    camera
        float64 [3, 4], world to pixels of the other frame.

    Returns
    -------
    Pose or None
        None with too few points, or if one of them comes to lie behind the camera.

    Notes
    -----
    Gauss and Newton's method on the distances in pixels, from standing still; after a few rounds
    weighted by Geman and McClure's function.
    """
    known = np.isfinite(points).all(axis=1)
    if known.sum() < LEAST_PIXELS:
        return None
    centre = points[known].mean(axis=0)  # the same one for both frames
    known &= np.isfinite(ends).all(axis=1)
    if known.sum() < LEAST_PIXELS:
        return None
    step = max(1, int(known.sum()) // MOST_SAMPLES)
    arms, ends = points[known][::step] - centre, ends[known][::step]
    rotation, shift, weights = np.eye(3), np.zeros(3), np.ones(len(ends))
    for count in range(ROUNDS):
        turned = arms @ rotation.T
        seen, depth = _project(camera, turned + centre + shift)
        if not (depth > 0).all():
            return None
        errors = ends - seen
        if count >= PLAIN_ROUNDS:
            distance = np.linalg.norm(errors, axis=1)
            scale = 1.5 * max(float(np.median(distance)), LEAST_ERROR)
            weights = (1 + (distance / scale) ** 2) ** -2
        turn_step, shift_step = _solve(_slopes(camera, turned, seen, depth), errors, weights)
        rotation, shift = _rotation(turn_step) @ rotation, shift + shift_step
    return Pose(centre, _turn_of(rotation), shift)


def _slopes(camera: F64, arms: F64, seen: F64, depth: F64) -> F64:
    """Return how pixels change with a turn and a shift, float64 [N, 2, 6]."""
    by_place = (camera[:2, :3] - seen[..., None] * camera[2, :3]) / depth[:, None, None]
    by_turn = np.cross(arms[:, None], by_place)
    return np.concatenate([by_turn, by_place], axis=2)


def _solve(slopes: F64, errors: F64, weights: F64) -> tuple[F64, F64]:
    """Return the turn, radians about the axes, and the shift that lessen errors most."""
    matrix = np.einsum("nij,nik,n->jk", slopes, slopes, weights)
    # A flat or distant object hardly tells some directions: there it is not moved.
    matrix += 1e-6 * np.diag(np.diag(matrix)) + 1e-12 * np.trace(matrix) * np.eye(6)
    step = np.linalg.solve(matrix, np.einsum("nij,ni,n->j", slopes, errors, weights))
    angle = float(np.linalg.norm(step[:3]))
    step *= min(1.0, LONGEST_TURN / angle) if angle > 0 else 1.0
    return step[:3], step[3:]


def _rotation(turn: F64) -> F64:
    """Return the rotation about an axis by its length in radians (Rodrigues)."""
    angle = float(np.linalg.norm(turn))
    x, y, z = turn
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    # sinc is exact at 0, too.
    first, second = np.sinc(angle / np.pi), np.sinc(angle / (2 * np.pi)) ** 2 / 2
    rotation: F64 = np.eye(3) + first * cross + second * cross @ cross
    return rotation


def _turn_of(rotation: F64) -> F64:
    """Invert `_rotation`, for angles below pi."""
    sine = np.array(
        [
            rotation[2, 1] - rotation[1, 2],
            rotation[0, 2] - rotation[2, 0],
            rotation[1, 0] - rotation[0, 1],
        ]
    )  # of the angle, twice
    angle = float(np.arctan2(np.linalg.norm(sine), np.trace(rotation) - 1))
    turn: F64 = sine / (2 * np.sinc(angle / np.pi))
    return turn


def _moves_along(motion: Float32, index: Index, vectors: Float32, settled: Float32) -> Bool:
    """Return which pixels of an object move rigidly, bool [N]; none where the object does not.

    Those whose vector is the rigid motion, or a mixture with what is beside the pixel. Single
    pixels among them belong to them; parts that move otherwise, such as a mouth, do not.

    Parameters
    ----------
    motion
        float32 [N, 2], the rigid motion of the object's pixels.
    index
        Flat indices of these.
    vectors, settled
        float32 [H, W, 2], as rendered, and settled without this object.
    """
    rows, columns = np.divmod(index, vectors.shape[1])
    box = tuple(slice(max(int(each.min()) - 1, 0), int(each.max()) + 2) for each in (rows, columns))
    rows, columns = rows - box[0].start, columns - box[1].start
    rendered, moved = vectors[box], settled[box].copy()
    moved[rows, columns] = motion
    low, high = (combine_3x3(moved, f, mode="edge") for f in (np.fmin, np.fmax))
    speed = float(np.median(np.linalg.norm(motion, axis=1)))
    tolerance = np.float32(max(TOLERANCE, RELATIVE_TOLERANCE * speed))
    known = np.isfinite(rendered).all(axis=-1)
    mixed = ((rendered >= low - tolerance) & (rendered <= high + tolerance)).all(axis=-1)
    counts = np.zeros_like(rendered)  # of pixels that move otherwise, and of all
    counts[rows, columns] = np.stack([known & ~mixed, known], axis=-1)[rows, columns]
    apart, total = counts.sum(axis=(0, 1))
    if apart > (1 - EXPLAINED) * total:
        return np.zeros(len(index), np.bool_)
    near = combine_3x3(counts, np.add)[rows, columns]
    return np.asarray(2 * near[:, 0] <= near[:, 1])


def _project(camera: F64, points: F64) -> tuple[F64, F64]:
    """Return the pixels of points, float64 [N, 2], and their depths [N], of float64 [N, 3]."""
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):  # of infinite points
        image = points @ camera[:, :3].T + camera[:, 3]
        return image[:, :2] / image[:, 2:], image[:, 2]
