"""Whether a cut lies between two neighbouring key frames: geometry and colour disagree throughout.

A frame continues the one before when the motion vectors of either lead to what they promise:
geometry to the same surfaces, colour to the same patterns. One of the two is enough, in one of the
two directions: a light that is switched on changes the colour alone, and what comes to fill the
frame hides the older frame from the newer, not the other way round.

Both are compared on thumbnails of 128 cells a row, in blocks of 8x8 cells. Colour and normals count
by their correlation inside a block, so exposure, fades and flashes do not matter, and what scenes
have in common (bright above, level ground below) does not either. The limits were found on 303
pairs of neighbouring key frames of 70 rendered shots, many of them fast, and on 246 pairs of frames
across a cut: from two shots, or a second apart in one::

                                     neighbours, lowest    across a cut, highest    limit
    colour along rendered vectors                 0.238                    0.066     0.15
    colour along optical flow                     0.112                    0.116     0.15
    world positions found again                   0.705                    0.323     0.5
    normals                                       0.231                    0.044     0.15
    depth                                         0.124                    0.408     0.45

All but one in a hundred neighbours have 0.33 and more along optical flow. Geometry is only compared
where colour disagrees: a high limit costs alarms where a lamp is switched on, a low one costs cuts.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from exwarp_cli.domain.frame import Bool, Float32, Int32, KeyFrame, Window
from exwarp_cli.synthesis.camera import F64, Index
from exwarp_cli.synthesis.warp import sample_bilinear

# Cells along a frame's longer side.
CELLS = 128

# Pixels along a cell's side whose colour is averaged: noise of path tracing falls to a quarter.
POINTS = 4

# Cells along a block's side.
BLOCK = 8

# Fewer blocks with structure make no correlation.
MIN_BLOCKS = 6

# Share of surface cells whose vectors end inside the other frame; with fewer, the camera has turned
# away, and nothing more can be said.
MIN_LANDED = 0.05

# Share of a vector by which the way back may miss, besides a cell: for what speeds up.
RETURNING = 0.1

# Deviation within a block, in thumbnails' light, from which it has structure.
CONTRAST = 0.02

# Colour below this disagrees. Optical flow, which makes the best even of a cut, needs it so high:
# one pair of 303 falls below, and that one has moved by 0.5 frames.
COLOUR_LIMIT = 0.15

# Geometry below these disagrees, by what is compared, the best first: positions, normals, depths.
GEOMETRY_LIMITS = (0.5, 0.15, 0.45)

# A gain of shifts from here on speaks against a cut whatever the vectors say: where they are wrong
# throughout, every pair would be a cut. Across a cut it was 0.12 at most, and 0.25 in toy scenes of
# even areas; of neighbours eight in ten have more.
SURE_SHIFT = 0.3

# From here on it does, too, where tones are no further apart. Of 200 shots four had vectors that
# missed the motion, and ten pairs of neighbours below the other limit. Seven of them had a gain of
# 0.24 and more and tones 0.04 apart at most; the other three, at 0.16, are too near cuts to tell.
ALIKE_SHIFT, ALIKE_TONES = 0.2, 0.05

# Without vectors: a smaller gain of shifts, and tones further apart, are a cut. 2 of the 303
# neighbours are taken for one, and no cut between shots was missed, but 14 of 56 within a place.
LIKELY_SHIFT, TONES_LIMIT = 0.12, 0.1

# Mean light up to which a frame is black, and from which on the change to black is no fade.
BLACK, LIT = 0.02, 0.1

RED, GREEN, BLUE = np.float32(0.2126), np.float32(0.7152), np.float32(0.0722)
MAX_LUMINANCE = np.float32(1e4)

# Displacements of the whole frame that are tried where there are no vectors, besides none.
SHIFTS = 4


@dataclass(frozen=True)
class Thumbnail:
    """A frame reduced to h times w cells over its display window.

    Geometry is that of the pixel in a cell's middle; arrays are [h, w, ...], as in `GBuffer`, but
    vectors are counted in cells.
    """

    number: int  # of the frame in the input sequence
    # Mean of the square root of scene-linear luminance; 0 for black, about 1 for white, finite.
    light: Float32
    surface: Bool  # cells that show a surface, not background; all of them if that is unknown
    depth: Float32 | None = None
    normal: Float32 | None = None
    position: Float32 | None = None
    stencil: Int32 | None = None
    to_previous: Float32 | None = None
    to_next: Float32 | None = None


def make_thumbnail(frame: KeyFrame) -> Thumbnail:
    """Reduce a frame: it reads one pixel in ten of a 1080p frame, and keeps 0.5 MB."""
    display = frame.image.display_window
    size = max(1, round(max(display.shape) / CELLS))
    # Of each cell the mean square root of luminance: bright fireflies do not dominate.
    offsets = np.array(sorted({(2 * i + 1) * size // (2 * POINTS) for i in range(POINTS)}))
    rows, columns = _cell_pixels(frame.image.data_window, display, size, offsets)
    light = mean_light(frame.image.pixels, rows, columns, len(offsets))
    gbuffer = frame.gbuffer
    if gbuffer is None:
        return Thumbnail(frame.number, light, np.ones(light.shape, np.bool_))
    middle = np.array([size // 2])
    rows, columns = _cell_pixels(gbuffer.window, display, size, middle)
    is_outside = (rows < 0)[:, None] | (columns < 0)

    def pick(array: np.ndarray | None, fill: float = 0.0) -> np.ndarray | None:
        if array is None:
            return None
        picked = array[rows[:, None], columns]
        picked[is_outside] = fill
        return picked

    to_previous, to_next = (
        None if picked is None else np.asarray(picked / np.float32(size), np.float32)
        for picked in (pick(gbuffer.to_previous, np.nan), pick(gbuffer.to_next, np.nan))
    )
    depth = pick(gbuffer.depth, np.inf)
    normal, position = pick(gbuffer.normal), pick(gbuffer.position)
    surface = np.ones(light.shape, np.bool_)
    if depth is not None:
        surface = np.isfinite(depth)
    elif (geometry := normal if position is None else position) is not None:
        surface = np.any(np.not_equal(geometry, 0), axis=-1)
    return Thumbnail(
        frame.number,
        light,
        surface,
        depth,
        normal,
        position,
        pick(gbuffer.stencil),
        to_previous,
        to_next,
    )


def mean_light(pixels: Float32, rows: Index, columns: Index, points: int) -> Float32:
    """Return mean square roots of luminance, float32 [h, w], of `points` squared pixels of a cell.

    `pixels` are scene-linear [H, W, 3 or more], `rows` [h points] and `columns` [w points] theirs,
    cell by cell. What lies outside (-1), NaN and negative luminance count as black.
    """
    red, green, blue = np.moveaxis(pixels[rows[:, None], columns, :3], -1, 0)
    with np.errstate(invalid="ignore", over="ignore"):
        light = RED * red + GREEN * green + BLUE * blue
    light = np.where(light > 0, np.minimum(light, MAX_LUMINANCE), np.float32(0))
    light[(rows < 0)[:, None] | (columns < 0)] = 0
    total = np.zeros((len(rows) // points, len(columns) // points), np.float32)
    for i, j in np.ndindex(points, points):
        total += np.sqrt(light[i::points, j::points])
    return total / np.float32(points * points)


def _cell_pixels(window: Window, display: Window, size: int, offsets: Index) -> tuple[Index, Index]:
    """Return rows and columns, in an array on `window`, of the pixels at offsets in each cell.

    -1 for those outside the array.
    """
    out = []
    for length, first, end in (
        (display.height, display.y - window.y, window.height),
        (display.width, display.x - window.x, window.width),
    ):
        starts = size * np.arange(max(1, length // size))
        places = np.add.outer(starts, offsets + first).ravel()
        out.append(np.where((places >= 0) & (places < end), places, -1))
    return out[0], out[1]


@dataclass(frozen=True)
class CutEvidence:
    """Whether there is a cut, and why."""

    found: bool  # whether it is one
    # How well colour agrees along the vectors, about 0 (by chance) to 1; None where nothing can be
    # said, as between even areas.
    colour: float | None = None
    # How well geometry does. None also where colour agrees, so that geometry is not compared.
    geometry: float | None = None
    # How much better shifts of the whole frame explain the colour than others do; None where
    # nothing can be said, and where it was not measured.
    shifted: float | None = None


def compare_thumbnails(
    # Of neighbouring key frames with one display window, as they were read. Vectors reach over a
    # key interval; they may be those of optical flow.
    before: Thumbnail,
    after: Thumbnail,
) -> CutEvidence:
    """Judge whether a cut lies between two frames, by nothing but the two."""
    dark, bright = sorted((float(before.light.mean()), float(after.light.mean())))
    to_black = dark <= BLACK and bright >= LIT
    if dark <= BLACK and not to_black:
        return CutEvidence(False)
    ways: list[Alignment] = []
    colours: list[float | None] = []
    geometry = None
    for frame, neighbour, vectors, back in (
        (before, after, before.to_next, after.to_previous),
        (after, before, after.to_previous, before.to_next),
    ):
        if vectors is None:
            continue
        way = Alignment.along(frame, neighbour, vectors, back)
        if way.leads_away:
            # A pan that leaves nothing in view, or something from outside that hides all.
            return CutEvidence(False)
        agreement = way.colour()
        if agreement is not None and agreement >= COLOUR_LIMIT:
            # Nearly always so: the other way need not be compared, which is half of the time.
            return CutEvidence(False, agreement)
        ways.append(way)
        colours.append(agreement)
    colour = max((each for each in colours if each is not None), default=None)
    measures = Alignment.positions, Alignment.normals, Alignment.depths
    for measure, limit in zip(measures, GEOMETRY_LIMITS, strict=True):
        geometry = max((each for each in map(measure, ways) if each is not None), default=None)
        if geometry is not None:
            if geometry >= limit:
                return CutEvidence(False, colour, geometry)
            break
    if to_black:
        return CutEvidence(True, colour, geometry)
    shifted, found = _gain_of_shifts(before.light, after.light), False
    if shifted is not None:
        a, b = (np.sort(thumbnail.light, axis=None) for thumbnail in (before, after))
        tones = float(2 * np.abs(a - b).mean() / (a.std() + b.std() + 1e-6))
        if ways:
            found = shifted < (ALIKE_SHIFT if tones <= ALIKE_TONES else SURE_SHIFT)
        else:
            found = shifted < LIKELY_SHIFT and tones >= TONES_LIMIT
    return CutEvidence(found, colour, geometry, shifted)


@dataclass(frozen=True)
class Alignment:
    """One frame aligned with its neighbour, along its vectors."""

    frame: Thumbnail
    neighbour: Thumbnail
    # [h, w, 2], cells: to the place of each cell in the other frame; to the first cell where it has
    # none inside.
    field: Float32
    nearest: tuple[Index, Index]  # [h, w]: row and column of the cell nearest to that place
    # [h, w]: cells whose vectors are known and lead to a place inside. Where there are surfaces,
    # background does not count: its vectors are often missing, or 0 whatever the camera does.
    landed: Bool
    both: Bool  # [h, w]: those of them that show a surface in both frames
    # Share of them from where the other frame's vectors lead back, of all that are not known to
    # leave the frame; 1 where the other has no vectors. The renderer's do so in neighbours (0.63 of
    # them at least), optical flow across a cut does not (0.39 at most).
    trusted: float
    leads_away: bool  # hardly any vectors end inside

    @classmethod
    def along(
        cls, frame: Thumbnail, neighbour: Thumbnail, vectors: Float32, back: Float32 | None
    ) -> Alignment:
        """Follow vectors [h, w, 2], in cells, and compare them with those back."""
        height, width = frame.light.shape
        counting = frame.surface
        if np.count_nonzero(counting) < MIN_LANDED * counting.size:
            counting = np.ones(counting.shape, np.bool_)
        finite = np.asarray(np.isfinite(vectors).all(axis=-1))
        grid = np.meshgrid(np.arange(width), np.arange(height))
        places = np.stack(grid, axis=-1).astype(np.float32)
        target = np.where(finite[..., None], vectors, 0) + places
        inside = ((target >= 0) & (target <= (width - 1, height - 1))).all(axis=-1)
        landed = np.asarray(counting & finite & inside)
        target = np.where(landed[..., None], target, 0).astype(np.float32)
        column, row = np.moveaxis(np.rint(target).astype(np.intp), -1, 0)
        both = landed & frame.surface & neighbour.surface[row, column]
        trusted = 1.0
        if back is not None:
            miss = np.linalg.norm(back[row, column] + vectors, axis=-1)
            with np.errstate(invalid="ignore"):
                returned = landed & (miss < 1 + RETURNING * np.linalg.norm(vectors, axis=-1))
            staying = int((counting & (inside | ~finite)).sum())
            trusted = int(returned.sum()) / max(staying, 1)
        leads_away = int(landed.sum()) < MIN_LANDED * int((counting & finite).sum())
        field, nearest = target - places, (row, column)
        return cls(frame, neighbour, field, nearest, landed, both, trusted, leads_away)

    def colour(self) -> float | None:
        """Return how well patterns of light agree; None without any."""
        sampled, _ = sample_bilinear(self.neighbour.light[..., None], self.field)
        agreement = correlation(self.frame.light[..., None], sampled, self.landed, CONTRAST)
        return None if agreement is None else agreement * self.trusted

    def normals(self) -> float | None:
        """Return how well patterns of normals agree."""
        if self.frame.normal is None or self.neighbour.normal is None:
            return None
        there = self.neighbour.normal[self.nearest]
        return self._weigh_surfaces(correlation(self.frame.normal, there, self.both, 0.1))

    def depths(self) -> float | None:
        """Return how well inverse depth agrees, of which a plane is a plane in every view."""
        if self.frame.depth is None or self.neighbour.depth is None:
            return None
        both = self.both
        a, b = (
            np.divide(1, depth, out=np.zeros(both.shape), where=both & (depth != 0))[..., None]
            for depth in (self.frame.depth, self.neighbour.depth[self.nearest])
        )
        return self._weigh_surfaces(correlation(a, b, both, 0.03, relative=True))

    def positions(self) -> float | None:
        """Return the share of still cells that find their world position again, near the target."""
        frame, neighbour = self.frame, self.neighbour
        if frame.position is None or neighbour.position is None:
            return None
        # How far apart neighbouring cells' world positions are, along a surface.
        places = frame.position.astype(np.float64)
        rows, columns = (np.linalg.norm(np.diff(places, axis=axis), axis=-1) for axis in (0, 1))
        rows = np.pad(rows, ((1, 1), (0, 0)), constant_values=np.inf)
        columns = np.pad(columns, ((0, 0), (1, 1)), constant_values=np.inf)
        size = np.maximum(
            np.minimum(rows[1:], rows[:-1]), np.minimum(columns[:, 1:], columns[:, :-1])
        )
        allowed = 2 * size + np.abs(frame.position).max(axis=-1) * 2.0**-9
        still = self.landed
        if frame.stencil is None:  # a point may move as far in the world as it does on the screen
            allowed = allowed + size * np.minimum(np.linalg.norm(self.field, axis=-1), 8)
        else:
            still = still & (frame.stencil == 0)
        chosen = np.zeros_like(still)
        chosen[::2, ::2] = still[::2, ::2]  # enough
        if np.count_nonzero(chosen) < MIN_LANDED * still.size / 4:
            return None
        y, x = (cells[chosen] for cells in self.nearest)
        is_found = np.zeros(len(y), np.bool_)
        for dy, dx in np.ndindex(3, 3):
            row = np.clip(y + dy - 1, 0, still.shape[0] - 1)
            column = np.clip(x + dx - 1, 0, still.shape[1] - 1)
            gap = np.linalg.norm(neighbour.position[row, column] - frame.position[chosen], axis=-1)
            is_found |= neighbour.surface[row, column] & (gap < allowed[chosen])
        return float(is_found.mean())

    def _weigh_surfaces(self, agreement: float | None) -> float | None:
        """Count surfaces that lead to background as such that disagree."""
        landed = np.count_nonzero(self.landed & self.frame.surface)
        if landed < MIN_LANDED * self.landed.size:
            return None
        share = np.count_nonzero(self.both) / landed
        if agreement is None:
            return 0.0 if share < 0.1 else None
        return float(agreement * share) * self.trusted


def correlation(
    frame: np.ndarray, neighbour: np.ndarray, valid: Bool, contrast: float, relative: bool = False
) -> float | None:
    """Return the mean of :func:`correlations`; None with too few blocks that have structure."""
    each = correlations(frame, neighbour, valid, contrast, relative)
    finite = np.isfinite(each)
    return float(each[finite].mean()) if np.count_nonzero(finite) >= MIN_BLOCKS else None


def correlations(
    # [h, w, C]: values of the cells, and of their places in the other frame.
    frame: np.ndarray,
    neighbour: np.ndarray,
    valid: Bool,  # [h, w]: cells that count. A block counts with half of its cells.
    contrast: float,  # deviation of `frame` within a block from which it counts
    # Count values in those of the block's mean `frame`; for C = 1 and values not below 0.
    relative: bool = False,
) -> F64:
    """Return the correlation within each block, [N]; NaN in those without structure."""
    mask = _blocks(valid[..., None])
    count = mask.sum(axis=1, keepdims=True)
    a, b = (np.where(mask, _blocks(values), 0).astype(np.float64) for values in (frame, neighbour))
    if relative:
        level = np.maximum(a.sum(axis=1, keepdims=True) / np.maximum(count, 1), 1e-30)
        a, b = a / level, b / level
    # The gradients of skies and of level ground are much alike in all scenes: from each block, the
    # plane that fits best is subtracted.
    y, x = (np.mgrid[:BLOCK, :BLOCK] - (BLOCK - 1) / 2).reshape(2, -1)
    terms = np.stack([x, y, np.ones_like(x)], axis=1)
    products = (terms[:, :, None] * terms[:, None, :]).reshape(len(terms), 9)
    normal = (mask[..., 0] @ products).reshape(-1, 3, 3) + 1e-6 * np.eye(3)
    a, b = (
        np.where(mask, values - terms @ np.linalg.solve(normal, terms.T @ values), 0)
        for values in (a, b)
    )
    power_a, power_b, shared = ((u * v).sum(axis=(1, 2)) for u, v in ((a, a), (b, b), (a, b)))
    cell_count = count[:, 0, 0]
    counts = (2 * cell_count >= BLOCK * BLOCK) & (power_a > contrast**2 * cell_count)
    scale = np.sqrt(power_a * np.maximum(power_b, 1e-12))
    return np.asarray(np.divide(shared, scale, out=np.full(len(counts), np.nan), where=counts))


def _blocks(values: np.ndarray) -> np.ndarray:
    """Return [h, w, C] as blocks [N, cells, C]; an incomplete last row or column is left out."""
    rows, columns = values.shape[0] // BLOCK, values.shape[1] // BLOCK
    complete = values[: rows * BLOCK, : columns * BLOCK]
    split = complete.reshape(rows, BLOCK, columns, BLOCK, values.shape[2]).swapaxes(1, 2)
    return split.reshape(rows * columns, BLOCK * BLOCK, values.shape[2])


def _gain_of_shifts(before: Float32, after: Float32) -> float | None:
    """Return how much better shifts of the whole frame explain a pair than others do.

    For each block the best of the few shifts counts that phase correlation finds (Kuglin and Hines
    1975), less the best of as many far shifts.
    """
    height, width = before.shape
    window = np.outer(np.hanning(height), np.hanning(width))
    a, b = (np.fft.rfft2((light - light.mean()) * window) for light in (before, after))
    cross = a.conj() * b
    cross /= np.abs(cross) + 1e-9 * np.abs(cross).max() + 1e-30
    rate = np.fft.fftfreq(height)[:, None] ** 2 + np.fft.rfftfreq(width) ** 2
    # Frequencies above a sixth of a cell's hold more noise than motion.
    peaks = np.fft.irfft2(cross * np.exp(-rate / (2 * 0.15**2)), (height, width))
    shifts = [(0, 0)]  # (x, y) in cells, + right and down
    for _ in range(SHIFTS):
        y, x = divmod(int(np.argmax(peaks)), width)
        around = np.ix_(np.arange(y - 2, y + 3) % height, np.arange(x - 2, x + 3) % width)
        peaks[around] = -np.inf
        shifts.append((x - width if x > width // 2 else x, y - height if y > height // 2 else y))
    likely = _best_of(shifts, before, after)
    far = ((17, 10), (-17, 13), (12, -12), (-10, -18), (20, 3))
    unlikely = [
        _best_of([(sign * x * width // 100, y * width // 100) for x, y in far], before, after)
        for sign in (1, -1)
    ]
    if likely is None or None in unlikely:
        return None
    return likely - float(np.mean([each for each in unlikely if each is not None]))


def _best_of(shifts: list[tuple[int, int]], before: Float32, after: Float32) -> float | None:
    """Return the mean over blocks of the best correlation that one of the shifts gives."""
    height, width = before.shape
    each = []
    for x, y in shifts:
        columns, rows = np.arange(width) + x, np.arange(height) + y
        inside = ((rows >= 0) & (rows < height))[:, None] & (columns >= 0) & (columns < width)
        moved = np.roll(after, (-y, -x), axis=(0, 1))
        each.append(correlations(before[..., None], moved[..., None], inside, CONTRAST))
    measured = np.isfinite(each).any(axis=0)
    if np.count_nonzero(measured) < MIN_BLOCKS:
        return None
    return float(np.nanmax(np.stack(each)[:, measured], axis=0).mean())
