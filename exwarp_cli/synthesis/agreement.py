"""How well one frame's glance agrees with another's along motion vectors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from exwarp_cli.domain.frame import Bool, Float32
from exwarp_cli.synthesis.glance import Glance

F64 = npt.NDArray[np.float64]
Index = npt.NDArray[np.intp]

BLOCK = 8
"""Cells along a block's side."""

LEAST_BLOCKS = 6
"""Blocks with structure below which a correlation says nothing."""

LEAST_LANDED = 0.05
"""Share of surface cells whose vectors end inside the other frame, below which they say no
more than that the camera has turned away."""

RETURNING = 0.1
"""Share of a vector by which the way back may miss, besides a cell: for what speeds up."""

CONTRAST = 0.02
"""Deviation within a block, in glances' light, from which it has structure."""


@dataclass(frozen=True)
class Way:
    """The way from one frame to its neighbour, along the one's vectors.

    Attributes
    ----------
    here, there
        The two frames.
    target
        float32 [h, w, 2]: where each cell is seen there, in cells; inside that frame, or 0.
    landed
        bool [h, w]: cells whose vectors are known and lead to a place inside. Where there are
        surfaces, background does not count: its vectors are often missing, or 0 whatever the
        camera does.
    trusted
        Share of them from where the other frame's vectors lead back, of all that are not known to
        leave the frame; 1 where the other has no vectors. The renderer's do so in neighbours (0.63
        of them at least), optical flow across a cut does not (0.39 at most).
    leads_away
        Whether hardly any vectors end inside.
    """

    here: Glance
    there: Glance
    target: Float32
    landed: Bool
    trusted: float
    leads_away: bool

    @classmethod
    def along(cls, here: Glance, there: Glance, vectors: Float32, back: Float32 | None) -> Way:
        """Follow vectors [h, w, 2], in cells, and those back."""
        height, width = here.light.shape
        counting = here.surface
        if np.count_nonzero(counting) < LEAST_LANDED * counting.size:
            counting = np.ones(counting.shape, np.bool_)
        known = np.asarray(np.isfinite(vectors).all(axis=-1))
        target = np.where(known[..., None], vectors, 0) + _places(height, width)
        within = (target >= 0) & (target <= (width - 1, height - 1))
        inside = np.asarray(within.all(axis=-1))
        landed = counting & known & inside
        target = np.where(landed[..., None], target, 0).astype(np.float32)
        trusted = 1.0
        if back is not None:
            x, y = _nearest(target)
            miss = np.linalg.norm(back[y, x] + vectors, axis=-1)
            with np.errstate(invalid="ignore"):
                returned = landed & (miss < 1 + RETURNING * np.linalg.norm(vectors, axis=-1))
            staying = int((counting & (inside | ~known)).sum())
            trusted = int(returned.sum()) / max(staying, 1)
        leads_away = int(landed.sum()) < LEAST_LANDED * int((counting & known).sum())
        return cls(here, there, target, landed, trusted, leads_away)

    def colour(self) -> float | None:
        """Return how well patterns of light agree; None without any."""
        found = _bilinear(self.there.light, self.target)
        return self._trusted(
            correlation(self.here.light[..., None], found[..., None], self.landed, CONTRAST)
        )

    def normals(self) -> float | None:
        """Return how well patterns of normals agree."""
        if self.here.normal is None or self.there.normal is None:
            return None
        x, y = _nearest(self.target)
        found = self._surfaces(
            correlation(self.here.normal, self.there.normal[y, x], self._both, 0.1)
        )
        return self._trusted(found)

    def depths(self) -> float | None:
        """Return how well inverse depth agrees, of which a plane is a plane in every view."""
        if self.here.depth is None or self.there.depth is None:
            return None
        x, y = _nearest(self.target)
        both = self._both
        mine, other = (
            np.divide(1, depth, out=np.zeros(both.shape), where=both & (depth != 0))[..., None]
            for depth in (self.here.depth, self.there.depth[y, x])
        )
        return self._trusted(self._surfaces(correlation(mine, other, both, 0.03, relative=True)))

    def positions(self) -> float | None:
        """Return the share of still cells that find their world position again, near the target.

        Every other cell of every other row is enough. What is known to move is left out; where
        nothing tells, a point may move as far in the world as it does on the screen.
        """
        here, there = self.here, self.there
        if here.position is None or there.position is None:
            return None
        size = _cell_size(here.position)
        allowed = 2 * size + np.abs(here.position).max(axis=-1) * 2.0**-9
        still = self.landed
        if here.stencil is None:
            moved = np.linalg.norm(self.target - _places(*still.shape), axis=-1)
            allowed = allowed + size * np.minimum(moved, 8)
        else:
            still = still & (here.stencil == 0)
        chosen = np.zeros_like(still)
        chosen[::2, ::2] = still[::2, ::2]
        if np.count_nonzero(chosen) < LEAST_LANDED * still.size / 4:
            return None
        x, y = _nearest(self.target[chosen])
        found = np.zeros(len(x), np.bool_)
        for dy, dx in np.ndindex(3, 3):
            row = np.clip(y + dy - 1, 0, still.shape[0] - 1)
            column = np.clip(x + dx - 1, 0, still.shape[1] - 1)
            gap = np.linalg.norm(there.position[row, column] - here.position[chosen], axis=-1)
            found |= there.surface[row, column] & (gap < allowed[chosen])
        return float(found.mean())

    @property
    def _both(self) -> Bool:
        """Cells that show a surface here and there."""
        x, y = _nearest(self.target)
        return self.landed & self.here.surface & self.there.surface[y, x]

    def _surfaces(self, found: float | None) -> float | None:
        """Count surfaces that lead to background as such that disagree."""
        landed = np.count_nonzero(self.landed & self.here.surface)
        if landed < LEAST_LANDED * self.landed.size:
            return None
        share = np.count_nonzero(self._both) / landed
        if found is None:
            return 0.0 if share < 0.1 else None
        return float(found * share)

    def _trusted(self, found: float | None) -> float | None:
        return None if found is None else found * self.trusted


def correlation(
    here: np.ndarray, there: np.ndarray, known: Bool, contrast: float, relative: bool = False
) -> float | None:
    """Return the mean of :func:`correlations`; None with too few blocks that have structure."""
    found = correlations(here, there, known, contrast, relative)
    finite = np.isfinite(found)
    return float(found[finite].mean()) if np.count_nonzero(finite) >= LEAST_BLOCKS else None


def correlations(
    here: np.ndarray, there: np.ndarray, known: Bool, contrast: float, relative: bool = False
) -> F64:
    """Return the correlation within each block, [N]; NaN in those without structure.

    Parameters
    ----------
    here, there
        [h, w, C]: values of the cells, and of where they are seen in the other frame.
    known
        bool [h, w]: cells that count. A block counts with half of its cells.
    contrast
        Deviation of `here` within a block from which it counts.
    relative
        Count values in those of the block's mean `here`; for C = 1 and values not below 0.

    Notes
    -----
    The plane that fits a block best is taken away first: the gradients of skies and of level ground
    are much alike in all scenes.
    """
    mask = _blocks(known[..., None])
    count = mask.sum(axis=1, keepdims=True)
    a, b = (np.where(mask, _blocks(values), 0).astype(np.float64) for values in (here, there))
    if relative:
        level = np.maximum(a.sum(axis=1, keepdims=True) / np.maximum(count, 1), 1e-30)
        a, b = a / level, b / level
    a, b = (_without_plane(values, mask) for values in (a, b))
    power_a, power_b, shared = ((u * v).sum(axis=(1, 2)) for u, v in ((a, a), (b, b), (a, b)))
    cells = count[:, 0, 0]
    counts = (2 * cells >= BLOCK * BLOCK) & (power_a > contrast**2 * cells)
    scale = np.sqrt(power_a * np.maximum(power_b, 1e-12))
    return np.asarray(np.divide(shared, scale, out=np.full(len(cells), np.nan), where=counts))


def _blocks(values: np.ndarray) -> np.ndarray:
    """Return [h, w, C] as blocks [N, cells, C]; an incomplete last row or column is left out."""
    rows, columns = values.shape[0] // BLOCK, values.shape[1] // BLOCK
    whole = values[: rows * BLOCK, : columns * BLOCK]
    split = whole.reshape(rows, BLOCK, columns, BLOCK, values.shape[2]).swapaxes(1, 2)
    return split.reshape(rows * columns, BLOCK * BLOCK, values.shape[2])


def _without_plane(values: F64, mask: np.ndarray) -> F64:
    """Return blocks [N, cells, C] less the plane that fits each best."""
    y, x = (np.mgrid[:BLOCK, :BLOCK] - (BLOCK - 1) / 2).reshape(2, -1)
    terms = np.stack([x, y, np.ones_like(x)], axis=1)
    products = (terms[:, :, None] * terms[:, None, :]).reshape(len(terms), 9)
    normal = (mask[..., 0] @ products).reshape(-1, 3, 3) + 1e-6 * np.eye(3)
    right = terms.T @ values
    return np.asarray(np.where(mask, values - terms @ np.linalg.solve(normal, right), 0))


def _cell_size(position: Float32) -> F64:
    """Return how far apart neighbouring cells' world positions are, [h, w], along a surface."""
    sizes = []
    for axis in (0, 1):
        steps = np.linalg.norm(np.diff(position.astype(np.float64), axis=axis), axis=-1)
        edge = [(1, 0) if i == axis else (0, 0) for i in (0, 1)]
        before = np.pad(steps, edge, constant_values=np.inf)
        sizes.append(
            np.minimum(before, np.pad(steps, [e[::-1] for e in edge], constant_values=np.inf))
        )
    return np.asarray(np.maximum(*sizes))


def _places(height: int, width: int) -> Float32:
    """Return each cell's own place (x, y), [h, w, 2]."""
    return np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=-1).astype(np.float32)


def _nearest(target: Float32) -> tuple[Index, Index]:
    """Return column and row of the cells nearest to places [..., 2]."""
    cells = np.rint(target).astype(np.intp)
    return cells[..., 0], cells[..., 1]


def _bilinear(image: Float32, target: Float32) -> Float32:
    """Sample [h, w] at places [h, w, 2] inside it."""
    height, width = image.shape
    x0 = np.minimum(target[..., 0].astype(np.intp), max(width - 2, 0))
    y0 = np.minimum(target[..., 1].astype(np.intp), max(height - 2, 0))
    x1, y1 = np.minimum(x0 + 1, width - 1), np.minimum(y0 + 1, height - 1)
    fx, fy = target[..., 0] - x0, target[..., 1] - y0
    upper = image[y0, x0] * (1 - fx) + image[y0, x1] * fx
    lower = image[y1, x0] * (1 - fx) + image[y1, x1] * fx
    return np.asarray(upper * (1 - fy) + lower * fy, np.float32)
