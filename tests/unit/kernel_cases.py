"""Seeded inputs of kernels, and a case for nearly each, run in whatever build is asked for."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from tests.unit import kernel_calls as calls

SHAPE = (37, 15)  # more rows than one band of the splat
NOTHING = (
    np.zeros((0, 0, 2), np.float32),
    *(np.zeros((0, 0), np.float32),) * 2,
    *(np.zeros((0, 0), np.bool_),) * 2,
)
"""What `seen_by` has, where there is no key frame."""


def field(seed: int, spread: float = 2.0) -> np.ndarray:
    """Smooth motion with a block that moves apart, noise, and unknown pixels."""
    rng = np.random.default_rng(seed)
    rows, columns = np.mgrid[0 : SHAPE[0], 0 : SHAPE[1]]
    out = np.stack([np.sin(rows / 5) + columns / 9, np.cos(columns / 4)], axis=-1) * spread
    out += rng.normal(0, 0.05, out.shape)
    out[8:20, 4:9] += 5
    out[rng.random(SHAPE) < 0.05] = np.nan
    return out.astype(np.float32)


def blocks(values: np.ndarray) -> np.ndarray:
    """Repeat values to patches of 5x5 pixels over the frame."""
    return np.ascontiguousarray(values.repeat(5, 0).repeat(5, 1)[: SHAPE[0], : SHAPE[1]])


def depth(seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return blocks(rng.choice([2.0, 2.05, 6.0, np.inf], SHAPE)).astype(np.float32)


def vectors(seed: int, spread: float, base: tuple[float, ...] = (0, 0, 1)) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return (np.array(base) + rng.normal(0, spread, (*SHAPE, 3))).astype(np.float32)


def image(seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    out = rng.lognormal(0, 2, (*SHAPE, 4)) * rng.choice([-1, 1], (*SHAPE, 4))
    out[rng.random(SHAPE) < 0.03] = np.nan
    return out.astype(np.float32)


def ids(seed: int) -> np.ndarray:
    return blocks(np.random.default_rng(seed).integers(-1, 2, SHAPE)).astype(np.int32)


def wide(values: np.ndarray) -> np.ndarray:
    """Stretch rows, so that neighbouring positions lie apart like the pixels of a surface."""
    rows, columns = np.mgrid[0 : SHAPE[0], 0 : SHAPE[1]]
    values[..., 0] += columns
    values[..., 1] += rows
    return values


def mark(serial: bool) -> calls.Arrays:
    """All tests at once, and depth alone."""
    depths = (depth(5), depth(5))
    positions = (wide(vectors(6, 0.1)), wide(vectors(7, 0.8)))
    full = calls.marked(
        field(4, 0.3),
        depths,
        (ids(8), ids(9)),
        positions,
        (vectors(10, 0.1), vectors(11, 0.1)),
        serial=serial,
    )
    return full + calls.marked(field(4, 0.3), depths, serial=serial, steps=(0.1, 0.01, 0))


def fill(serial: bool) -> calls.Arrays:
    hole = np.random.default_rng(12).random(SHAPE) < 0.3
    hole[10:20, 3:9] = True
    pixels = np.clip(np.nan_to_num(image(13)), -3, 3)
    known = np.where(np.random.default_rng(25).random(SHAPE) < 0.5, depth(14), np.nan)
    distances = np.where(hole, known, depth(14)).astype(np.float32)
    return calls.filled(pixels, distances, hole, 12.0, 9, serial)


def side(seed: int) -> calls.Side:
    rng = np.random.default_rng(seed)
    distance = depth(seed)
    distance[rng.random(SHAPE) < 0.1] = np.nan
    masks = [rng.random(SHAPE) < share for share in (0.2, 0.1)]
    return np.nan_to_num(image(seed)), distance, masks[0], masks[1]


def mix_candidates(serial: bool) -> calls.Arrays:
    """Five candidates of each pixel, and weights that add up to one."""
    weights = np.random.default_rng(73).random((5, *SHAPE), np.float32)
    pictures = [np.nan_to_num(image(seed)) for seed in range(74, 79)]
    return calls.candidates_mixed(pictures, weights / weights.sum(0), serial)


def mix(serial: bool) -> calls.Arrays:
    """With weights that are nothing or all among others, and of pixels that have one channel."""
    shares = np.random.default_rng(72).choice([0, 0.25, 0.5, 1], SHAPE).astype(np.float32)
    before, after = side(20)[0], side(21)[0]
    one = (np.ascontiguousarray(pixels[..., :1]) for pixels in (before, after))
    return calls.mixed(before, after, shares, serial) + calls.mixed(*one, shares, serial)


def project(serial: bool) -> calls.Arrays:
    """With positions, and by depth alone."""
    rng = np.random.default_rng(22)
    camera = np.eye(3, 4) + rng.normal(0, 0.02, (3, 4))
    at_infinity = np.eye(3) + rng.normal(0, 0.01, (3, 3))
    places = wide(vectors(23, 0.3))
    placed = calls.projected(places, depth(24), camera, at_infinity, serial)
    return placed + calls.projected(None, depth(24), camera, at_infinity, serial)


def settle(serial: bool) -> calls.Arrays:
    """With positions and ids, and by depth alone."""
    rng = np.random.default_rng(23)
    cameras = np.eye(3, 4) + rng.normal(0, 0.02, (2, 2, 3, 4))
    cameras[:, 1, :, 3] = 1
    fields, places = (field(16), field(17, 0.05)), wide(vectors(23, 0.3))
    known = calls.settled(fields, places, depth(15), cameras, ids(15), serial)
    return known + calls.settled(fields, None, depth(15), cameras, serial=serial)


def follow(serial: bool) -> calls.Arrays:
    """With ids, with depths, with vectors back, and without."""
    fields = field(29), field(30), field(31)
    back = calls.followed(*fields, (ids(32), ids(33)), serial, back=(field(39), field(40)))
    known = calls.followed(*fields, (ids(32), ids(33)), serial)
    depths = (depth(37), depth(38))
    deep = calls.followed(*fields, serial=serial, depths=depths, rounded=(0.5, 0.01))
    return known + deep + back + calls.followed(*fields, serial=serial)


def shown(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).random(SHAPE) < 0.9


def count(serial: bool) -> calls.Arrays:
    """Values on the bins' edges among others, and a channel that is constant."""
    values = np.nan_to_num(image(36))
    values[..., 1] = np.round(values[..., 1])
    values[..., 2] = 0.5
    values[3, 4:8] = np.nan, np.inf, -np.inf, 0
    ends = calls.extended(values, shown(37), serial)[0]
    low, high = ends[..., 0].min(axis=0), ends[..., 1].max(axis=0)
    return calls.counted(values, shown(37), np.stack([low, high], -1).astype(np.float64), serial)


def seen_by(seed: int) -> calls.Arrays:
    """A key frame as a slot sees it: field, depth at the slot, its own depth, hole and fringe."""
    rng = np.random.default_rng(seed)
    at_slot = np.where(rng.random(SHAPE) < 0.1, np.float32(np.nan), depth(seed))
    return field(seed), at_slot, depth(seed + 1), rng.random(SHAPE) < 0.3, rng.random(SHAPE) < 0.2


def choose(serial: bool) -> calls.Arrays:
    """With two key frames, and with one."""
    both = calls.chosen(seen_by(50), seen_by(52), 0.5, serial)
    return both + calls.chosen(seen_by(54), NOTHING, 0.0, serial)


def adopt(serial: bool) -> calls.Arrays:
    """From what was chosen, with depths that are not known in some of the holes."""
    pixel, later, known, hole = calls.chosen(seen_by(50), seen_by(52), 0.5, serial=True)
    return calls.adopted(pixel, later, known, hole, (12.0, 9), serial)


def encoded(seed: int) -> np.ndarray:
    """Display-encoded values with some that are outside, and exact black and white."""
    values = np.random.default_rng(seed).integers(-10, 270, (*SHAPE, 3))
    return (values * np.float32(0.99)).astype(np.float32)


def unbounded(seed: int) -> np.ndarray:
    """Scene-linear values, 0 or more."""
    return np.maximum(np.nan_to_num(image(seed)), 0)


def opponents(seed: int) -> np.ndarray:
    return calls.opponent_written(encoded(seed), serial=True)[0]


def write_opponent(serial: bool) -> calls.Arrays:
    """Of a display-encoded image, and of a scene-linear one at an exposure."""
    decoded = calls.opponent_written(encoded(40), 0, serial)
    return decoded + calls.opponent_written(unbounded(41), 3.5, serial)


def differ(serial: bool) -> calls.Arrays:
    views = (calls.perceived(opponents(seed), serial=True)[0] for seed in (43, 44))
    return calls.differing(*views, serial)


def scattered(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-3, 40, (50, 2))


CASES: dict[str, Callable[[bool], calls.Arrays]] = {
    "gather_bilinear": lambda serial: calls.gathered(image(1), field(1), serial),
    "resample": lambda serial: calls.resampled(image(1), field(1), serial),
    "resample_alike": lambda serial: calls.resampled_alike(image(1), field(1), None, serial),
    "encode_srgb": lambda serial: calls.as_shown(image(1), serial),
    "decode_srgb": lambda serial: calls.as_light(image(1), serial),
    "follow_points": follow,
    "splat_row_extents": lambda serial: calls.reached(field(2), serial),
    "splat": lambda serial: calls.splatted(field(2), depth(2), serial),
    "mark_holes": mark,
    "fill_holes": fill,
    "quadratic_displacement": lambda serial: calls.displaced(field(27), field(28), 0.75, serial),
    "ray_march_visible": lambda serial: calls.seen(ids(26) > 0, 9, serial),
    "find_edges": lambda serial: calls.edges_found(depth(15), ids(15), serial),
    "clean_vectors": settle,
    "blend": lambda serial: calls.blended(side(20), side(21), 0.25, serial),
    "write_later_weights": lambda serial: calls.weighed(side(20)[1:], side(21)[1:], 0.25, serial),
    "mix_frames": mix,
    "mix_candidates": mix_candidates,
    "write_rigid_motion": project,
    "find_moving_edges": lambda serial: calls.moving_edges_found(
        depth(18), field(18), ids(26) > 0, serial
    ),
    "find_fringe": lambda serial: calls.fringe_found(field(18), depth(18), depth(19), serial),
    "block_means": lambda serial: calls.averaged(field(34), 8, shown(35), serial),
    "write_ranges": lambda serial: calls.extended(image(36), shown(37), serial),
    "count_histograms": count,
    "write_opponent": write_opponent,
    "write_perceived": lambda serial: calls.perceived(opponents(42), serial),
    "raise_flip_error": differ,
    "choose_sources": choose,
    "adopt_sources": adopt,
    "sample_surface": lambda serial: calls.surface_sampled(image(56), depth(56), field(57), serial),
}

ONE_BUILD: dict[str, Callable[[], calls.Arrays]] = {
    "whole_ids": lambda: calls.rounded(image(64).reshape(-1).round(1)),
    "look_up": lambda: calls.looked_up(image(58), scattered(59)),
    "label": lambda: calls.areas_measured(ids(38) * ids(39)),
}
"""Kernels that are only serial: compiled and interpreted."""
