"""Samples of frames, by which the meaning of motion channels is measured.

A frame is reduced as soon as it is read: of six frames of a sequence 150 MB stay at 1080p and not
440, and its samples serve all its channels and both its neighbours. A probe looks sampled surface
points up in a neighbouring frame, which shows how well a displacement explains them.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from exwarp_cli.domain.frame import Bool, Float32, GBuffer
from exwarp_cli.domain.motion import STILL_MIDDLE, STILL_TOLERANCE, AxisMap
from exwarp_cli.kernels import gather
from exwarp_cli.synthesis.camera import F64, Index

# Pixels looked up of each frame, out of GRID times as many on a regular grid.
SAMPLES, GRID = 6000, 5

# A frame with fewer samples is not measured.
MIN_SAMPLES = 100

# Vectors up to this share of the frame's longest, or up to this value, count as no motion.
AT_REST, NOTHING = 0.01, 1e-6

# Share of moving pixels below which these are sampled more densely than the frame.
FEW_MOVE = 0.5

# Noise between two frames' colours above which they are smoothed, and how many pixels around.
MAX_NOISE, MAX_SMOOTHING = 0.05, 3

# Vectors that are kept of a frame between two key frames, on a coarser grid if needed.
MAX_VECTORS = 1 << 20

# Relative error of depth that counts as a miss, and distance of perceived colours that does.
DEPTH_TOLERANCE, COLOUR_TOLERANCE = 0.02, 0.15

# Pixels without vectors rest if their error in place is below this share of the movers'.
RESTS = 0.3

# Values distinguish points if they change over a distance of this share of the frame's width.
FAR = 40

# Fewer values of depth are surfaces that face the camera, and not steps of a coarse depth.
MIN_LEVELS = 16


@dataclass(frozen=True)
class MotionFrame:
    """A frame of a pair: geometry, raw motion channels, and colour if available."""

    number: int
    gbuffer: GBuffer
    motion: Float32
    colour: Float32 | None


@dataclass(frozen=True)
class FrameSamples:
    """A frame of a pair, reduced to what its vectors are measured by."""

    number: int
    y: Index  # [G]: pixels of a regular grid; where few move, further moving pixels as well
    x: Index
    motion: Float32  # [G, C]: the motion channels there
    usable: Bool  # [G]: pixels that show a surface, off the frame's rim
    regular: Bool  # [G]: pixels of the regular grid
    moving: Bool  # [G]: pixels whose vectors are not at rest
    still: Bool | None  # [G]: usable pixels that do not move by themselves; None if unknown
    # [H, W, ...]: what identifies a point. Where there are positions, they alone do.
    position: Float32 | None
    depth: Float32 | None
    perceived: Float32 | None
    noise: float  # how far two frames' colours are apart by noise alone
    size: tuple[int, int]  # width and height
    empty: bool  # the motion channels hold no number anywhere in the frame


def sample_frame(frame: MotionFrame) -> FrameSamples:
    """Reduce a frame."""
    height, width, _ = frame.motion.shape
    gbuffer = frame.gbuffer
    step = max(1, height * width // (GRID * SAMPLES))
    vectors = frame.motion.reshape(height * width, -1)
    grid = np.arange(0, len(vectors), step)
    moving = is_moving(vectors[grid])
    if step > 1 and np.mean(moving) < FEW_MOVE:
        # A mover of a thousandth of the frame has 30 pixels on the regular grid: too few.
        every = is_moving(vectors)
        movers = np.flatnonzero(every)
        grid = np.union1d(grid, movers[:: max(1, len(movers) // SAMPLES)])
        moving = every[grid]
    y, x = np.divmod(grid, width)
    motion = frame.motion[y, x]
    usable = (y > 0) & (y < height - 1) & (x > 0) & (x < width - 1)
    if gbuffer.depth is not None:
        usable &= np.isfinite(gbuffer.depth[y, x])
    if gbuffer.position is not None:
        usable &= np.isfinite(gbuffer.position[y, x]).all(axis=-1)
    still = None
    if gbuffer.stencil is not None and gbuffer.position is not None:
        # World positions of what moves are not found again. In leaves that move over half of the
        # frame no reading was better than none.
        still = usable & (gbuffer.stencil[y, x] == 0)
    perceived, noise = None, 0.0
    if gbuffer.position is None and frame.colour is not None:
        perceived, noise = _perceived(frame.colour)
    return FrameSamples(
        frame.number,
        y,
        x,
        motion,
        usable,
        grid % step == 0,
        moving,
        still,
        gbuffer.position,
        gbuffer.depth if gbuffer.position is None else None,
        perceived,
        noise,
        (width, height),
        not np.isfinite(motion).any() and not np.isfinite(frame.motion).any(),
    )


def is_moving(vectors: Float32) -> Bool:
    """Return which vectors [N, C] are not at rest, bool [N].

    Rest is 0, or about 0.5 if most vectors have just one such value. The last of an odd number of
    channels is not part of a vector.
    """
    used = vectors[:, : 2 * (vectors.shape[1] // 2)]
    if not used.size:
        return np.zeros(len(vectors), bool)
    samples = used[:: max(1, len(used) // SAMPLES)]
    usual = np.median(np.where(np.isfinite(samples), samples, 0), axis=0)
    middle = (np.abs(usual - STILL_MIDDLE) < STILL_TOLERANCE) & (
        np.mean(samples == usual, axis=0) > FEW_MOVE
    )
    distance = np.abs(used - np.where(middle, usual, 0).astype(np.float32))
    distance[~np.isfinite(distance)] = 0
    lengths = distance.max(axis=1)
    return np.asarray(lengths > max(AT_REST * lengths.max(), NOTHING))


@dataclass(frozen=True)
class KeyPair:
    """Two neighbouring key frames with colour, and the vectors of all frames on the way."""

    numbers: tuple[int, int]
    before: Float32  # their colours, [H, W, 3], as the eye sees them
    after: Float32
    noise: float  # how far these are apart by noise alone
    # Motion channels of the frames from the earlier key frame to the later one, both included,
    # [h, w, C]: of every `stride`-th pixel.
    vectors: tuple[Float32, ...]
    stride: int


def sample_key_pair(
    numbers: tuple[int, int], before: Float32, after: Float32, vectors: Iterable[Float32]
) -> KeyPair:
    """Reduce two key frames' colours and the vectors between them."""
    height, width, _ = before.shape
    stride = max(1, math.ceil(math.sqrt(height * width / MAX_VECTORS)))
    kept = tuple(np.ascontiguousarray(field[::stride, ::stride]) for field in vectors)
    (earlier, noise), (later, _) = _perceived(before), _perceived(after)
    return KeyPair(numbers, earlier, later, noise, kept, stride)


def _perceived(colour: Float32) -> tuple[Float32, float]:
    """Compress scene-linear RGB roughly as the eye does, and smooth it; return remaining noise.

    Noise is the standard deviation of two images' difference by noise, over all channels. By the
    median of what a mask leaves that ignores edges and slopes (Immerkær, "Fast Noise Variance
    Estimation", 1996); its coefficients' squares sum to 36.
    """
    codes = np.sqrt(np.maximum(np.nan_to_num(colour[..., :3], posinf=0, neginf=0), 0))
    (height, width, channels), noise = codes.shape, 0.0
    if min(height, width) >= 3:
        step = max(1, height * width // (GRID * SAMPLES))
        y, x = np.divmod(np.arange(0, (height - 2) * (width - 2), step), width - 2)
        mask = ((1, -2, 1), (-2, 4, -2), (1, -2, 1))
        remainder = np.zeros((len(y), channels), np.float32)
        for i, j in np.ndindex(3, 3):
            remainder += mask[i][j] * codes[y + i, x + j]
        per_channel = float(np.median(np.abs(remainder))) / 0.6745 / 6
        noise = per_channel * math.sqrt(2 * channels)
    # Noise that is as large as the tolerance makes every reading as bad as no motion.
    reach = min(math.ceil((noise / MAX_NOISE - 1) / 2), MAX_SMOOTHING)
    if reach <= 0:
        return codes, noise
    # The mean over squares; the rim is repeated outward.
    padded = np.pad(codes, ((reach, reach), (reach, reach), (0, 0)), "edge")
    size = 2 * reach + 1
    rows = np.zeros_like(padded[:height])
    smooth: Float32 = np.zeros_like(codes)
    for i in range(size):
        rows += padded[i : i + height]
    for j in range(size):
        smooth += rows[:, j : j + width]
    smooth /= np.float32(size * size)
    return smooth, noise / size


@dataclass(frozen=True)
class Observable:
    """Values of sampled pixels, to be found again in the neighbouring frame.

    Those of one component are depth, others are fixed to the surface point.
    """

    values: F64  # [N, C]
    image: Float32  # of the neighbour, [H, W, C]
    tolerance: F64  # [N]: the distance that is a miss
    weight: float  # how much its values distinguish points
    floor: float = 0.0  # its error by noise alone


@dataclass(frozen=True)
class Probe:
    """Sampled pixels of one frame, to be looked up in its neighbour."""

    xy: F64  # pixels [N, 2]
    raw: Float32  # the motion channels there [N, C]
    observables: tuple[Observable, ...]
    resting: bool = False  # the camera rests: depths need no correction for its movement

    @property
    def weight(self) -> float:
        """How much the probe distinguishes points."""
        return sum(each.weight for each in self.observables)

    @property
    def floor(self) -> float:
        """The mean error by noise alone."""
        return float(mean_by_weight([each.floor for each in self.observables], self.observables))

    def part(self, count: int | None) -> slice:
        """Return which samples stand for all where only about `count` are looked up."""
        return slice(None, None, 1 if count is None else max(1, len(self.xy) // count))

    def shifts(self, readings: Sequence[AxisMap], count: int | None = None) -> Float32:
        """Return the displacements of the samples by each reading, float32 [K, N, 2]."""
        raw = self.raw[self.part(count)]
        return np.stack([reading.apply(raw) for reading in readings])

    def errors(
        self,
        shifts: Float32,  # [K, N, 2]: K displacements of every sample that counts
        count: int | None = None,  # about how many do; see `part`
    ) -> F64:
        """Return the mean errors of displacements, [K]: 0 (all samples are found again) to 1."""
        part = self.part(count)
        xy = self.xy[part]
        places = (xy + shifts).reshape(-1, 2)
        losses: list[F64] = []
        for each in self.observables:
            wanted, tolerance = each.values[part], each.tolerance[part]
            channels = wanted.shape[1]
            samples = np.empty((len(shifts), len(xy), channels))
            gather.sample_points(each.image, places, samples.reshape(-1, channels))
            if channels == 1 and not self.resting:
                wanted = _depths_later(wanted[:, 0], samples[..., 0], xy, tolerance)[..., None]
            with np.errstate(invalid="ignore", divide="ignore"):
                samples -= wanted
                gaps = np.sqrt(np.square(samples, out=samples).sum(axis=2)) / tolerance
            losses.append(np.where(gaps < 1, gaps, 1.0).mean(axis=1))
        return mean_by_weight(losses, self.observables)


def mean_by_weight(
    values: Sequence[F64] | Sequence[float], origins: Sequence[Observable] | Sequence[Probe]
) -> F64:
    """Return the mean of values, each by how much its origin distinguishes points."""
    weights = [origin.weight for origin in origins]
    return np.asarray(np.average(np.stack(values), 0, weights if sum(weights) > 0 else None))


@dataclass(frozen=True)
class Trail(Probe):
    """Sampled pixels of a key frame, to be followed frame by frame to the next key frame."""

    # Motion channels of the frames on the way, the sampled one first, [h, w, C], and the distance
    # of their pixels.
    fields: tuple[Float32, ...] = ()
    stride: int = 1

    def shifts(self, readings: Sequence[AxisMap], count: int | None = None) -> Float32:
        """Return the displacements over all frames by each reading, float32 [K, N, 2].

        NaN for points that leave the frame on the way.
        """
        start = self.xy[self.part(count)].astype(np.float32)
        height, width, _ = self.fields[0].shape
        shifts = []
        for reading in readings:
            place = start
            for field in self.fields:
                finite = np.isfinite(place[:, 0]) & np.isfinite(place[:, 1])
                cell = np.rint(np.where(finite[:, None], place, 0) / self.stride)
                x = np.clip(cell[:, 0], 0, width - 1).astype(np.intp)
                y = np.clip(cell[:, 1], 0, height - 1).astype(np.intp)
                inside = finite & (cell[:, 0] == x) & (cell[:, 1] == y)
                place = np.where(inside[:, None], place + reading.apply(field[y, x]), np.nan)
            shifts.append(np.asarray(place, np.float32) - start)
        return np.stack(shifts)


def make_trail(pair: KeyPair, later: bool) -> Trail | None:
    """Sample pixels of a key frame, to follow them to the next one or the one before.

    With `later` they start from the earlier key frame. None where there are too few pixels.
    """
    frame, neighbour = (pair.before, pair.after) if later else (pair.after, pair.before)
    fields = pair.vectors[:-1] if later else pair.vectors[:0:-1]
    first = fields[0].reshape(-1, fields[0].shape[-1])
    usable, moving = np.isfinite(first).all(axis=1), is_moving(first)
    rows, columns = np.divmod(np.arange(len(first)), fields[0].shape[1])
    y, x = rows * pair.stride, columns * pair.stride
    height, width, _ = frame.shape
    usable &= (y > 0) & (y < height - 1) & (x > 0) & (x < width - 1)
    loss = np.linalg.norm(frame[y, x] - neighbour[y, x], axis=1) / COLOUR_TOLERANCE
    chosen, _ = _choose(usable, moving, usable, np.minimum(loss, 1).astype(np.float64))
    if len(chosen) < MIN_SAMPLES:
        return None
    y, x = y[chosen], x[chosen]
    xy = np.stack([x, y], axis=1).astype(np.float64)
    colour = _colour_observable(frame, neighbour, y, x, pair.noise)
    return Trail(xy, first[chosen], (colour,), fields=fields, stride=pair.stride)


def make_probe(
    frame: FrameSamples,
    neighbour: FrameSamples,
    usable: Bool,  # [G], of `frame`: where the motion channels hold values
) -> Probe | None:
    """Sample pixels of a frame, to look them up in its neighbour.

    None where there are too few pixels, or nothing distinguishes them.
    """
    if frame.still is not None:
        still = usable & frame.still
        usable = still if np.count_nonzero(still) >= MIN_SAMPLES else usable
    if np.count_nonzero(usable) < MIN_SAMPLES:
        return None
    resting = False
    chosen = _spread(usable & frame.regular)
    if frame.position is None:
        chosen, resting = _choose(usable, frame.moving, frame.regular, _changes(frame, neighbour))
    if len(chosen) < MIN_SAMPLES:
        return None
    y, x = frame.y[chosen], frame.x[chosen]
    observables = []  # what identifies surface points: their positions, else all the rest
    if frame.position is not None and neighbour.position is not None:
        values = frame.position[y, x].astype(np.float64)
        image, size = np.ascontiguousarray(neighbour.position), _pixel_size(frame.position, y, x)
        observables.append(Observable(values, image, size, 1.0))
    elif frame.depth is not None and neighbour.depth is not None:
        depth = frame.depth[y, x].astype(np.float64)
        every = frame.depth[frame.y, frame.x].astype(np.float64)
        tolerance = DEPTH_TOLERANCE * depth + _level_gaps(every, depth)
        weight = _distinction(frame.depth[..., None], y, x, tolerance)
        image = np.ascontiguousarray(neighbour.depth[..., None])
        observables.append(Observable(depth[:, None], image, tolerance, weight))
    if frame.perceived is not None and neighbour.perceived is not None:
        colours = frame.perceived, neighbour.perceived
        observables.append(_colour_observable(*colours, y, x, frame.noise))
    if not observables:
        return None
    xy = np.stack([x, y], axis=1).astype(np.float64)
    return Probe(xy, frame.motion[chosen], tuple(observables), resting)


def _spread(usable: Bool) -> Index:
    """Return the indices of about SAMPLES of the usable pixels, evenly spread."""
    chosen = np.flatnonzero(usable)
    return chosen[:: max(1, len(chosen) // SAMPLES)]


def _choose(
    # [G]; see `FrameSamples`.
    usable: Bool,
    moving: Bool,
    regular: Bool,
    change: F64,  # [G]: how far pixels change at their place, 0 to 1
) -> tuple[Index, bool]:
    """Choose the pixels to measure by: the moving ones alone if few move and all others rest.

    What rests by its vectors, and shows no change, decides nothing: of a hundred pixels of which
    one moves it is 99 % of every reading's success.

    Indices, and whether these are the moving pixels before a resting camera.
    """
    even = _spread(usable & regular)
    movers, resting = usable & moving, usable & regular & ~moving
    few = np.count_nonzero(movers & regular) < FEW_MOVE * np.count_nonzero(usable & regular)
    if not few or np.count_nonzero(movers) < MIN_SAMPLES or not resting.any():
        return even, False
    if float(np.mean(change[resting])) > RESTS * float(np.mean(change[movers])):
        return even, False
    return _spread(movers), True


def _changes(frame: FrameSamples, neighbour: FrameSamples) -> F64:
    """Return how far pixels of the grid change at their place, 0 to 1: by colour, else by depth."""
    y, x = frame.y, frame.x
    if frame.perceived is not None and neighbour.perceived is not None:
        apart = frame.perceived[y, x].astype(np.float64) - neighbour.perceived[y, x]
        gap = np.linalg.norm(apart, axis=1)
        return np.asarray(np.minimum(gap / COLOUR_TOLERANCE, 1), np.float64)
    if frame.depth is None or neighbour.depth is None:
        return np.zeros(len(y))
    depth = np.asarray(frame.depth[y, x], np.float64)
    tolerance = DEPTH_TOLERANCE * depth + _level_gaps(depth, depth)
    with np.errstate(invalid="ignore"):
        apart = np.abs(depth - neighbour.depth[y, x]) / tolerance
    return np.asarray(np.where(np.isfinite(apart), np.minimum(apart, 1), 1), np.float64)


def _colour_observable(
    frame: Float32, neighbour: Float32, y: Index, x: Index, noise: float
) -> Observable:
    tolerance = np.full(len(y), COLOUR_TOLERANCE)
    weight = _distinction(frame, y, x, tolerance)
    values = frame[y, x].astype(np.float64)
    floor = min(0.92 * noise / COLOUR_TOLERANCE, 1.0)  # of three channels, the mean of a distance
    return Observable(values, np.ascontiguousarray(neighbour), tolerance, weight, floor)


def _distinction(image: Float32, y: Index, x: Index, tolerance: F64) -> float:
    """Return how much an image's values distinguish points, 0 to 1.

    That is how much more they differ far away than beside a pixel. Constant values differ nowhere,
    coarse ones seldom, and noise differs everywhere alike.
    """
    height, width, channels = image.shape
    values = image[y, x].astype(np.float64).reshape(len(y), channels)
    differ = []
    for reach in (1, max(8, width // FAR)):
        each = []
        for dy, dx in ((0, reach), (reach, 0), (0, -reach), (-reach, 0)):
            place = np.clip(y + dy, 0, height - 1), np.clip(x + dx, 0, width - 1)
            with np.errstate(invalid="ignore"):
                gap = np.linalg.norm(image[place] - values, axis=1) / tolerance
            each.append(float(np.mean(np.where(np.isfinite(gap), np.minimum(gap, 1), 1))))
        differ.append(float(np.mean(each)))
    return max(differ[1] - differ[0], 0.0)


def _level_gaps(
    every: F64,  # depths of the frame's whole grid
    depth: F64,  # those whose distances are returned
) -> F64:
    """Return the distance to the next level where depth was rounded to levels; else 0."""
    levels = np.unique(every[np.isfinite(every)])
    if not MIN_LEVELS <= len(levels) <= len(every) // (2 * GRID):
        return np.zeros(len(depth))
    gaps = np.diff(levels)
    # Some levels are missing beside a pixel's own: the smaller gap is nearer to the step.
    least = np.minimum(np.append(gaps, np.inf), np.insert(gaps, 0, np.inf))
    return np.asarray(least[np.clip(np.searchsorted(levels, depth), 0, len(levels) - 1)])


def _depths_later(
    z: F64,  # [N], depths
    sampled: F64,  # [K, N], depths in the other frame, by K displacements
    xy: F64,  # [N, 2], places in pixels
    tolerance: F64,  # [N]
) -> F64:
    """Return the depths [K, N] that static points have in the other frame, as its camera moved.

    That is linear in a point's place (x z, y z, z): the four coefficients are fitted to the depths
    sampled there, robustly.
    """
    # Unfitted, a camera's way forward spoke for half the right vectors.
    valid = np.isfinite(sampled)
    x, y = (xy / xy.max() - 0.5).T
    terms = np.stack([x * z, y * z, z, np.ones_like(z)], axis=1) / tolerance[:, None]
    products = (terms[:, :, None] * terms[:, None]).reshape(-1, 16)
    values = np.where(valid, sampled, 0) / tolerance
    predicted = np.broadcast_to(z / tolerance, values.shape)
    for _ in range(4):
        weights = (valid / (1.0 + (values - predicted) ** 2))[:, None]
        # One product for each displacement: errors do not depend on what else is tried.
        normal = (weights @ products).reshape(-1, 4, 4)
        moments = (weights * values[:, None]) @ terms
        fitted = moments @ np.linalg.pinv(normal, hermitian=True)
        predicted = (fitted @ terms.T)[:, 0]
    enough = valid.sum(axis=1, keepdims=True) >= 50
    return np.where(enough, predicted * tolerance, z)


def _pixel_size(position: Float32, y: Index, x: Index) -> F64:
    """Return the world-space size of a pixel, plus the rounding of positions stored as half."""
    points = position[y, x].astype(np.float64)
    across, down = (
        np.minimum(
            np.linalg.norm(points - position[y - dy, x - dx], axis=1),
            np.linalg.norm(points - position[y + dy, x + dx], axis=1),
        )
        for dy, dx in ((0, 1), (1, 0))
    )
    largest = np.abs(points).max(axis=1)
    with np.errstate(over="ignore"):
        half = bool((position[y, x].astype(np.float16) == position[y, x]).all())
    size = np.maximum(across, down)
    return np.asarray(size + largest * (2.0**-10 if half else 2.0**-22) + 1e-12)
