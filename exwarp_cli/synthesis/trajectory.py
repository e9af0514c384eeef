"""Where the points of one instant are at others: parabolas, arcs of rigid objects, chains of slots.

Renderers filter vectors like colour. Of thin things, such as the spokes of a wheel, few pixels have
the surface's own vector. World positions and ids are those of the pixel's centre, so the motion of
a rigid object has six unknowns, a rotation and a translation in the world, that many pixels
determine. On the scene market `softsplat` gained 0.5 dB by it, and wheels keep their spokes. What
turns goes on an arc from frame to frame, which was worth 0.2 dB more.

About a third of an object's vectors must be its own, or nearly: spokes 1.5 pixels wide are moved
to 0.2 pixels, of spokes one pixel wide the motion is not always recovered.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from exwarp_cli.domain.frame import Bool, Float32, GBuffer, Int32, combine_3x3
from exwarp_cli.kernels import splat
from exwarp_cli.kernels.point_motion import CLOSE_DEPTH, follow_points
from exwarp_cli.runtime.frame_pool import pool
from exwarp_cli.synthesis.camera import (
    F64,
    Index,
    Scene,
    camera_after,
    pixels_at,
    scene_of,
    seen_by,
)
from exwarp_cli.synthesis.gbuffer_values import EXACT, coarser, depth_step

# Pixels that an object must show, and how many of them a fit uses.
MIN_OBJECT_PIXELS, MAX_SAMPLES = 48, 1000

# Pixels, or share of the object's motion across the picture, that a vector may be off.
TOLERANCE, RELATIVE_TOLERANCE = 0.1, 0.03

# Share of an object's known vectors that must be mixtures of the rigid motion and of what is beside
# the pixel. Of rigid objects on market all were, also of wheels with thin spokes of which 30 % had
# the rigid motion itself. Limbs of a running character are not.
EXPLAINED = 0.95

# Steps of the fit, and how many of them count all pixels alike.
ROUNDS, PLAIN_ROUNDS = 20, 6

# Pixels: a step that moves no point as far is the last one.
SETTLED = 1e-4

# Pixels: with a smaller median error there are no outliers, because half-float vectors are rounded.
MIN_ERROR = 0.02

# Radians that one step of the fit may turn.
MAX_TURN = 0.5

# Radians a frame from which on an object goes on an arc: 50 pixels from its middle the arc is 0.06
# pixels beside a straight line.
MIN_TURN = 0.1


def stencil_of(gbuffer: GBuffer) -> Int32:
    """Return the ids, int32 [H, W], or [0, 0] when unknown."""
    return gbuffer.stencil if gbuffer.stencil is not None else np.zeros((0, 0), np.int32)


def displacement(
    gbuffer: GBuffer,  # with settled motion
    time: float,  # in steps of the vectors (key intervals, or slots); negative is earlier
) -> Float32:
    """Return where points of a frame are at another time, minus where they are.

    Returns float32 [H, W, 2] in pixels. With n the displacement to the next frame and p to the
    previous one, the parabola through both, t (n - p) / 2 + t² (n + p) / 2; else t n, or -t p,
    constant velocity. Rigid objects that turn go on arcs.
    """
    t = np.float32(time)
    after, before = gbuffer.to_next, gbuffer.to_previous
    if after is not None and before is not None:
        out: Float32 = pool.empty(after.shape, np.float32)
        before, after = np.ascontiguousarray(before), np.ascontiguousarray(after)
        splat.quadratic_displacement(before, after, t, out)
    elif after is not None:
        out = t * after
    else:
        assert before is not None
        out = -t * before
    index = gbuffer.turning
    if len(index) and 0 < abs(time) < 1:
        # At the neighbouring frames, and halfway to them, points are where the rigid motion has
        # them. Between, they are on the polynomials of time through these places: quartic with
        # vectors both ways, else quadratic.
        assert gbuffer.bend is not None
        earlier, later = (half.reshape(-1, 2)[index] for half in gbuffer.bend)
        arc = _by_vectors(gbuffer, index, time)
        if after is None or before is None:
            arc = arc + 4 * abs(t) * (1 - abs(t)) * (later if time > 0 else earlier)
        else:
            odd = t * (1 - t * t) / np.float32(0.75)
            even = t * t * (1 - t * t) / np.float32(0.375)
            arc = arc + (even + odd) * later + (even - odd) * earlier
        out.reshape(-1, 2)[index] = arc
    return out


def _by_vectors(gbuffer: GBuffer, index: Index, time: float) -> Float32:
    """Return where vectors alone lead points, float32 [N, 2]: parabolas, or constant velocity."""
    t, half = np.float32(time), np.float32(0.5)
    before, after = gbuffer.to_previous, gbuffer.to_next
    if before is None or after is None:
        vectors, share = (before, -t) if after is None else (after, t)
        assert vectors is not None
        out: Float32 = share * vectors.reshape(-1, 2)[index]
        return out
    p, n = before.reshape(-1, 2)[index], after.reshape(-1, 2)[index]
    out = half * t * (n - p) + half * t * t * (n + p)
    return out


def trace_points(
    start: GBuffer,  # with settled motion
    # The instants after it if `way` is 1, before it if -1, the nearest first; with settled motion
    # that way.
    others: Sequence[GBuffer],
    way: int,
) -> Float32:
    """Follow the points of one instant through others, one step beyond the last of them.

    Returns float32 [H, W, 2]: displacement in pixels over one step more than there are others.
    Where another surface hides a point on its way, by its id or its depth, it continues by its own
    vectors.
    """
    step = start.to_next if way > 0 else start.to_previous
    assert step is not None
    moved = step.copy()
    before = displacement(start, way) if others else moved
    origin = -step  # from where a point is to where it was one step before
    nothing = np.zeros((0, 0), np.float32)
    depth = nothing if start.depth is None else start.depth
    rounding = depth_step(depth) if others else EXACT
    for count, other in enumerate(others, start=2):
        after = displacement(start, way * count)
        step, back = (other.to_next, other.to_previous)[::way]
        assert step is not None
        vectors = step, np.zeros((0, 0, 2), np.float32) if back is None else back
        ids = stencil_of(other), stencil_of(start)
        depths = nothing if other.depth is None else other.depth, depth
        steps = coarser(rounding, depth_step(depths[0]))
        close = np.float32(CLOSE_DEPTH * (count - 1))
        expected, origin = (after - before, origin), moved.copy()
        follow_points(vectors, ids, depths, steps, close, expected, moved)
        before, origin = after, origin - moved
    return moved


def span_motion(
    # At least two, in the order in which the motion runs, with settled motion to the instant that
    # comes next; the last needs none.
    steps: Sequence[GBuffer],
    way: int,  # 1 if that is forward in time, -1 if back
) -> Float32:
    """Return the motion from the first of successive instants to the last, float32 [H, W, 2] px.

    What stands still follows the recovered cameras, what moves is followed from instant to instant.
    """
    start, *others = steps[:-1]
    moved = trace_points(start, others, way)
    scene, end_scene = scene_of(start), scene_of(steps[-1])
    if scene is None or end_scene is None or end_scene.camera is None or start.stencil is None:
        return moved
    still = start.stencil == 0
    return np.where(still[..., None], seen_by(scene, end_scene.camera), moved)


@dataclass(frozen=True)
class Pose:
    """A rigid motion in the world."""

    centre: F64  # [3]: the point that the object turns about
    turn: F64  # [3]: axis of the rotation, as long as its angle in radians
    shift: F64  # [3]: where the centre goes, minus where it is

    def place(self, points: F64) -> F64:
        """Return where points, float64 [N, 3], go."""
        with np.errstate(invalid="ignore", over="ignore"):  # of infinite points
            return (points - self.centre) @ _rotation(self.turn).T + self.centre + self.shift


# How an object moves to the previous and to the next frame; None where that is not known.
Poses = tuple[Pose | None, Pose | None]


def move_rigidly(
    gbuffer: GBuffer,  # as rendered; without ids nothing is done
    scene: Scene | None,  # the frame's points; without world positions nothing is done
    cameras: F64,  # [2, 2, 3, 4], as `silhouettes.clean_vectors` takes them
    # Motion to the previous and to the next frame, float32 [H, 2 W] each, changed; empty where
    # there is none.
    settled: tuple[Float32, ...],
) -> Float32 | None:
    """Give all pixels of each rigid object the object's own motion.

    Returns the `bend` of :class:`exwarp_cli.domain.frame.GBuffer`, if any object turns.
    """
    if scene is None or scene.camera is None or gbuffer.stencil is None:
        return None
    turning: list[tuple[Index, Poses]] = []
    stencil = gbuffer.stencil.ravel()
    moving = np.flatnonzero(stencil > 0)
    order = moving[np.argsort(stencil[moving], kind="stable")]
    ids = stencil[order]
    for index in np.split(order, np.flatnonzero(ids[1:] != ids[:-1]) + 1):
        if len(index) < MIN_OBJECT_PIXELS:
            continue
        points, pixels = scene.points(index)[:, :3], pixels_at(index, gbuffer.window.width)
        poses: list[Pose | None] = [None, None]
        rigid = np.ones(len(index), np.bool_)  # pixels that move rigidly both ways
        for way, vectors in enumerate((gbuffer.to_previous, gbuffer.to_next)):
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
                off = along & ~(gap <= MIN_ERROR)
                moved.reshape(-1, 2)[index[off]] = motion[off]
                poses[way], rigid = pose, rigid & along
        if any(pose is not None and np.linalg.norm(pose.turn) > MIN_TURN for pose in poses):
            turning.append((index[rigid], (poses[0], poses[1])))
    if not turning:
        return None
    shape = *gbuffer.window.shape, 2
    before, after = (each.reshape(shape) if each.size else None for each in settled)
    return _bend(replace(gbuffer, to_previous=before, to_next=after), scene, turning)


def _bend(gbuffer: GBuffer, scene: Scene, turning: list[tuple[Index, Poses]]) -> Float32 | None:
    """Return how far objects that turn are beside their vectors half a frame before and after."""
    bend = np.zeros((2, *gbuffer.window.shape, 2), np.float32)
    for way, time in enumerate((-0.5, 0.5)):
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
            on_arc, _ = _project(camera, pose.place(scene.points(index)[:, :3]))
            straight = pixels_at(index, gbuffer.window.width) + _by_vectors(gbuffer, index, time)
            bend[way].reshape(-1, 2)[index] = np.nan_to_num(on_arc - straight)
    return bend


def _pose_at(poses: Poses, time: float) -> Pose | None:
    """Return the pose at a time between those of the frames before and after, -1 < time < 1."""
    before, after = poses
    # Turn and shift go on parabolas, or steadily where one pose alone is known. Then a box that
    # turns by 60 degrees a frame is up to 1.2 pixels off: the middle of what is visible of it goes
    # straight.
    if before is None or after is None:
        pose, share = (before, -time) if after is None else (after, time)
        return None if pose is None else Pose(pose.centre, share * pose.turn, share * pose.shift)
    # About the visible middle, which goes on an arc itself, that box was 0.9 pixels off. So objects
    # turn about the point whose path through both poses is straight and steady: of the points on
    # the axis, the one nearest to the centre of the poses.
    matrix = _rotation(before.turn) + _rotation(after.turn) - 2 * np.eye(3)
    arm = np.linalg.lstsq(matrix, -(before.shift + after.shift), rcond=0.1)[0]
    centre: F64 = after.centre + arm
    shift = _between(before.place(centre) - centre, after.place(centre) - centre, time)
    return Pose(centre, _between(before.turn, after.turn, time), shift)


def _between(before: F64, after: F64, time: float) -> F64:
    """Interpolate displacements to the frames before and after, -1 < time < 1.

    Acceleration is limited as in :func:`exwarp_cli.kernels.splat.quadratic_displacement`.
    """
    nearer, acceleration = after if time > 0 else before, before + after
    bound, size = 2 * float(np.linalg.norm(nearer)), float(np.linalg.norm(acceleration))
    limit = (bound / size) ** 2 if size > bound else 1.0
    out: F64 = abs(time) * nearer + limit * (time * time - abs(time)) / 2 * acceleration
    return out


def fit_pose(
    points: F64,  # [N, 3], world
    ends: F64,  # [N, 2], pixels; not finite where unknown
    camera: F64,  # [3, 4], world to pixels of the other frame
) -> Pose | None:
    """Fit the rigid motion after which points appear at pixels, most of which match.

    None with too few points, or if one of them comes to lie behind the camera.

    Notes
    -----
    Gauss and Newton's method on the distances in pixels, from standing still; after a few rounds
    weighted by Geman and McClure's function.
    """
    finite = np.isfinite(points).all(axis=1)
    if finite.sum() < MIN_OBJECT_PIXELS:
        return None
    centre = points[finite].mean(axis=0)  # the same one for both frames
    finite &= np.isfinite(ends).all(axis=1)
    if finite.sum() < MIN_OBJECT_PIXELS:
        return None
    stride = max(1, int(finite.sum()) // MAX_SAMPLES)
    arms, ends = points[finite][::stride] - centre, ends[finite][::stride]
    rotation, shift, weights = np.eye(3), np.zeros(3), np.ones(len(ends))
    for count in range(ROUNDS):
        turned = arms @ rotation.T
        image, depth = _project(camera, turned + centre + shift)
        if not (depth > 0).all():
            return None
        errors = ends - image
        if count >= PLAIN_ROUNDS:
            distance = np.linalg.norm(errors, axis=1)
            scale = 1.5 * max(float(np.median(distance)), MIN_ERROR)
            weights = (1 + (distance / scale) ** 2) ** -2
        # How the pixels [N, 2] change with a turn and with a shift: [6, 2 N].
        by_shift = (camera[:2, :3].T[:, None] - image * camera[2, :3, None, None]) / depth[:, None]
        (x, y, z), (u, v, w) = turned.T[..., None], by_shift
        by_turn = (y * w - z * v, z * u - x * w, x * v - y * u)
        slopes = np.stack([*by_turn, *by_shift]).reshape(6, -1)
        weighted = slopes * np.repeat(weights, 2)
        matrix = np.einsum("jn,kn->jk", weighted, slopes)  # no BLAS, whose threads change sums
        # A flat or distant object hardly determines some directions: there it is not moved.
        matrix += 1e-6 * np.diag(np.diag(matrix)) + 1e-12 * np.trace(matrix) * np.eye(6)
        step: F64 = np.linalg.solve(matrix, np.einsum("jn,n->j", weighted, errors.reshape(-1)))
        angle = float(np.linalg.norm(step[:3]))
        step = step * (min(1.0, MAX_TURN / angle) if angle > 0 else 1.0)
        rotation, shift = _rotation(step[:3]) @ rotation, shift + step[3:]
        if count >= PLAIN_ROUNDS and np.abs(step @ slopes).max() < SETTLED:
            break
    skew = rotation - rotation.T
    twice_sine = np.array([skew[2, 1], skew[0, 2], skew[1, 0]])
    angle = float(np.arctan2(np.linalg.norm(twice_sine), np.trace(rotation) - 1))
    return Pose(centre, twice_sine / (2 * _sinc(angle)), shift)


def _rotation(turn: F64) -> F64:
    """Return the rotation about an axis by its length in radians (Rodrigues)."""
    angle = math.hypot(*turn)
    x, y, z = turn
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    first, second = _sinc(angle), _sinc(angle / 2) ** 2 / 2
    rotation: F64 = np.eye(3) + first * cross + second * cross @ cross
    return rotation


def _sinc(x: float) -> float:
    return math.sin(x) / x if x else 1.0


def _moves_along(
    # [N, 2], the rigid motion of the object's pixels, whose flat indices are `index`.
    motion: Float32,
    index: Index,
    # [H, W, 2], as rendered, and settled without this object.
    vectors: Float32,
    settled: Float32,
) -> Bool:
    """Return which pixels of an object move rigidly, bool [N]; none where the object does not.

    Those whose vector is the rigid motion, or a mixture with what is beside the pixel. Single
    pixels among them belong to them; parts that move otherwise, such as a mouth, do not.
    """
    y, x = np.divmod(index, vectors.shape[1])
    box = tuple(slice(max(int(each.min()) - 1, 0), int(each.max()) + 2) for each in (y, x))
    y, x = y - box[0].start, x - box[1].start
    rendered, moved = vectors[box], settled[box].copy()
    moved[y, x] = motion
    low, high = (combine_3x3(moved, extreme, mode="edge") for extreme in (np.fmin, np.fmax))
    speed = float(np.median(np.linalg.norm(motion, axis=1)))
    tolerance = np.float32(max(TOLERANCE, RELATIVE_TOLERANCE * speed))
    finite = np.isfinite(rendered).all(axis=-1)
    mixed = ((rendered >= low - tolerance) & (rendered <= high + tolerance)).all(axis=-1)
    counts = np.zeros_like(rendered)  # of pixels that move otherwise, and of all
    counts[y, x] = np.stack([finite & ~mixed, finite], axis=-1)[y, x]
    apart, total = counts.sum(axis=(0, 1))
    if apart > (1 - EXPLAINED) * total:
        return np.zeros(len(index), np.bool_)
    near = combine_3x3(counts, np.add)[y, x]
    return np.asarray(2 * near[:, 0] <= near[:, 1])


def _project(camera: F64, points: F64) -> tuple[F64, F64]:
    """Return the pixels [N, 2] of world points [N, 3], and their depths [N]."""
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):  # of infinite points
        image = points @ camera[:, :3].T + camera[:, 3]
        return image[:, :2] / image[:, 2:], image[:, 2]
