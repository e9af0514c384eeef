"""The kernels called with fresh outputs, as their wrappers call them, in either build."""

from __future__ import annotations

from collections.abc import Callable
from types import ModuleType

import numpy as np

from exwarp_cli.kernels import (
    blend,
    connected_components,
    frame_statistics,
    gather,
    holes,
    picture_errors,
    point_motion,
    raw_channels,
    resample,
    silhouettes,
    splat,
)
from exwarp_cli.kernels._row_bands import set_threads

Arrays = tuple[np.ndarray, ...]
Pair = tuple[np.ndarray, np.ndarray]
Side = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]
Seen = tuple[np.ndarray, np.ndarray, np.ndarray]

NO_IDS = np.zeros((0, 0), np.int32)
NO_DEPTH = np.zeros((0, 0), np.float32)
NO_MASK = np.zeros((0, 0), np.bool_)
NO_VECTORS = np.zeros((0, 0, 3), np.float32)
NO_MOTION = np.zeros((0, 0, 2), np.float32)


def build(module: ModuleType, name: str, serial: bool) -> Callable[..., None]:
    kernel = getattr(module, name)

    def on_one_thread(*arguments: object) -> None:
        set_threads(1)
        try:
            kernel(*arguments)
        finally:
            set_threads(None)

    return on_one_thread if serial else kernel


def gathered(image: np.ndarray, field: np.ndarray, serial: bool = False) -> Arrays:
    shape = field.shape[:2]
    out = np.full((*shape, image.shape[2]), np.nan, np.float32)
    hole = np.zeros(shape, np.bool_)
    build(gather, "gather_bilinear", serial)(image, field, out, hole)
    return out, hole


def resampled(image: np.ndarray, field: np.ndarray, serial: bool = False) -> Arrays:
    out = np.full((*field.shape[:2], image.shape[2]), np.nan, np.float32)
    hole = np.zeros(field.shape[:2], np.bool_)
    table = resample.lanczos_weights()
    build(resample, "resample", serial)(image, field, table, out, hole)
    return out, hole


def resampled_alike(
    image: np.ndarray, field: np.ndarray, limit: np.ndarray | None = None, serial: bool = False
) -> Arrays:
    out = np.full((*field.shape[:2], image.shape[2]), np.nan, np.float32)
    hole = np.zeros(field.shape[:2], np.bool_)
    leads = limit is None
    limit = np.full(field.shape[:2], np.nan, np.float32) if limit is None else limit
    table = resample.lanczos_weights()
    build(resample, "resample_alike", serial)(image, field, table, limit, leads, out, hole)
    return out, hole, limit


def as_shown(pixels: np.ndarray, serial: bool = False) -> Arrays:
    out = np.full_like(pixels, np.nan)
    build(resample, "encode_srgb", serial)(pixels, out)
    return (out,)


def as_light(codes: np.ndarray, serial: bool = False) -> Arrays:
    out = np.full_like(codes, np.nan)
    build(resample, "decode_srgb", serial)(codes, out)
    return (out,)


def followed(
    step: np.ndarray,
    expected: np.ndarray,
    moved: np.ndarray,
    stencils: Pair | None = None,
    serial: bool = False,
    depths: Pair | None = None,
    rounded: tuple[float, float] = (0, 0),
    back: Pair | None = None,
) -> Arrays:
    out = moved.copy()
    build(point_motion, "follow_points", serial)(
        (step, NO_MOTION if back is None else back[0]),
        stencils or (NO_IDS, NO_IDS),
        depths or (NO_DEPTH, NO_DEPTH),
        (np.float32(rounded[0]), np.float32(rounded[1])),
        np.float32(0.02),
        (expected, expected if back is None else back[1]),
        out,
    )
    return (out,)


def reached(displacement: np.ndarray, serial: bool = False) -> Arrays:
    height, width, _ = displacement.shape
    found = np.zeros((height, -(-width // splat.REACH_SPAN) + 1, 2), np.float32)
    build(splat, "splat_row_extents", serial)(displacement, found)
    return (found,)


def splatted(displacement: np.ndarray, depth: np.ndarray, serial: bool = False) -> Arrays:
    field, near = np.zeros_like(displacement), np.zeros_like(depth)
    (rows,) = reached(displacement, serial)
    build(splat, "splat", serial)(displacement, depth, rows, field, near)
    return field, near


def marked(
    field: np.ndarray,
    depths: Pair,
    stencils: Pair | None = None,
    positions: Pair | None = None,
    normals: Pair | None = None,
    least_cosine: float = 0.98,
    serial: bool = False,
    steps: tuple[float, float, float] = (0, 0, 0),
) -> Arrays:
    hole = np.zeros(field.shape[:2], np.bool_)
    build(holes, "mark_holes", serial)(
        field,
        depths,
        stencils or (NO_IDS, NO_IDS),
        positions or (NO_VECTORS, NO_VECTORS),
        normals or (NO_VECTORS, NO_VECTORS),
        tuple(np.float32(limit) for limit in (least_cosine, *steps)),
        hole,
    )
    return (hole,)


def listed(hole: np.ndarray) -> Arrays:
    """Where each row's holes begin in the list, and their columns."""
    rows, columns = np.nonzero(hole)
    first = np.searchsorted(rows, np.arange(len(hole) + 1))
    return first.astype(np.int32), columns.astype(np.int32)


def seen(hole: np.ndarray, reach: int, serial: bool = False) -> Arrays:
    """The steps from each hole, [8, N]."""
    first, column = listed(hole)
    steps = np.full((8, len(column)), -1, np.int16)
    build(holes, "ray_march_visible", serial)(hole, first, column, reach, steps)
    return (steps,)


def filled(
    image: np.ndarray,
    depth: np.ndarray,
    hole: np.ndarray,
    cap: float,
    reach: int,
    serial: bool = False,
) -> Arrays:
    out = image.copy()
    (steps,) = seen(hole, reach, serial)
    build(holes, "fill_holes", serial)(out, depth, *listed(hole), np.float32(cap), steps)
    return (out,)


def displaced(before: np.ndarray, after: np.ndarray, time: float, serial: bool = False) -> Arrays:
    out = np.zeros_like(after)
    build(splat, "quadratic_displacement", serial)(before, after, np.float32(time), out)
    return (out,)


def edges_found(depth: np.ndarray, stencil: np.ndarray = NO_IDS, serial: bool = False) -> Arrays:
    edge = np.zeros(depth.shape, np.bool_)
    build(silhouettes, "find_edges", serial)(depth, stencil, edge)
    return (edge,)


def settled(
    vectors: tuple[np.ndarray | None, np.ndarray | None],
    places: np.ndarray | None,
    depth: np.ndarray,
    cameras: np.ndarray,
    stencil: np.ndarray = NO_IDS,
    serial: bool = False,
) -> Arrays:
    """Vectors to the frames before and after, [H, W, 2]; [0, 0] where none are given."""
    nothing = np.zeros((0, 0), np.float32)

    def flat(array: np.ndarray | None) -> np.ndarray:
        return nothing if array is None else array.reshape(len(array), -1)

    given = tuple(map(flat, vectors))
    out = tuple(np.full(way.shape, np.nan, np.float32) for way in given)
    positions = NO_VECTORS if places is None else places
    surfaces = positions, depth, stencil, edges_found(depth, stencil, serial)[0]
    build(silhouettes, "clean_vectors", serial)(given, surfaces, cameras, np.float32(0.25), out)
    return tuple(way.reshape(*depth.shape, 2) if way.size else way for way in out)


def fringe_found(
    field: np.ndarray, near: np.ndarray, depth: np.ndarray, serial: bool = False
) -> Arrays:
    fringe = np.zeros(depth.shape, np.bool_)
    build(silhouettes, "find_ghosts", serial)(field, near, depth, fringe)
    return (fringe,)


def moving_edges_found(
    depth: np.ndarray, field: np.ndarray, fringe: np.ndarray, serial: bool = False
) -> Arrays:
    found = np.zeros(depth.shape, np.bool_)
    build(silhouettes, "find_moving_edges", serial)(depth, field, fringe, found)
    return (found,)


def blended(before: Side, after: Side, time: float, serial: bool = False) -> Arrays:
    """Pixels, depth, hole and ghost of either side, blended as the synthesis does."""
    later, depth, hole = weighed(before[1:], after[1:], time, serial)
    return (*mixed(before[0], after[0], later, serial), depth, hole)


def weighed(before: Seen, after: Seen, time: float, serial: bool = False) -> Arrays:
    later, depth = (np.full(before[0].shape, -9, np.float32) for _ in range(2))
    hole = np.zeros(depth.shape, np.bool_)
    build(blend, "write_later_weights", serial)(before, after, np.float32(time), later, depth, hole)
    return later, depth, hole


def mixed(before: np.ndarray, after: np.ndarray, later: np.ndarray, serial: bool = False) -> Arrays:
    out = np.full_like(before, np.nan)
    build(blend, "mix_frames", serial)(before, after, later, out)
    return (out,)


def candidates_mixed(pictures: list[np.ndarray], weights: np.ndarray, serial: bool) -> Arrays:
    mixed, *sides = pictures
    out = np.full_like(mixed, np.nan)
    build(blend, "mix_candidates", serial)(mixed, tuple(sides), weights, (0, 0), out)
    return (out,)


def projected(
    position: np.ndarray | None,
    depth: np.ndarray,
    camera: np.ndarray,
    at_infinity: np.ndarray,
    serial: bool = False,
    still: np.ndarray = NO_MASK,
    kept: bool = False,
) -> Arrays:
    out = np.full((*depth.shape, 2), 7, np.float32)
    places = NO_VECTORS if position is None else position
    build(point_motion, "write_rigid_motion", serial)(
        places, depth, camera, at_infinity, still, kept, out
    )
    return (out,)


def averaged(
    motion: np.ndarray, size: int, shown: np.ndarray = NO_MASK, serial: bool = False
) -> Arrays:
    height, width = motion.shape[:2]
    out = np.zeros((-(-height // size), -(-width // size), 2))
    build(frame_statistics, "block_means", serial)(motion, shown, size, out)
    return (out,)


def extended(values: np.ndarray, shown: np.ndarray, serial: bool = False) -> Arrays:
    bands = -(-values.shape[0] // frame_statistics.ROWS_PER_STRIP)
    ends = np.zeros((bands, values.shape[2], 2), np.float32)
    build(frame_statistics, "write_ranges", serial)(values, shown, ends)
    return (ends,)


def counted(
    values: np.ndarray, shown: np.ndarray, ranges: np.ndarray, serial: bool = False
) -> Arrays:
    bands = -(-values.shape[0] // frame_statistics.ROWS_PER_STRIP)
    counts = np.full((bands, values.shape[2], frame_statistics.BINS), -1, np.int64)
    build(frame_statistics, "count_histograms", serial)(values, shown, ranges, counts)
    return (counts,)


def areas_measured(stencil: np.ndarray) -> Arrays:
    areas = np.full(stencil.size + 1, -1, np.int64)
    return (areas[: connected_components.measure_component_areas(stencil, areas)],)


def rounded(values: np.ndarray) -> Arrays:
    out = np.full(values.shape, -9, np.int32)
    raw_channels.round_ids(values, out)
    return (out,)


def looked_up(image: np.ndarray, target: np.ndarray) -> Arrays:
    found = np.full((len(target), image.shape[2]), -1.0)
    gather.sample_points(image, target, found)
    return (found,)


def opponent_written(image: np.ndarray, gain: float = 0, serial: bool = False) -> Arrays:
    planes = np.full((picture_errors.OPPONENT_PLANES, *image.shape[:2]), np.nan, np.float32)
    build(picture_errors, "write_opponent", serial)(image, np.float32(gain), planes)
    return (planes,)


def perceived(planes: np.ndarray, serial: bool = False) -> Arrays:
    seen = np.full((picture_errors.PERCEIVED_PLANES, *planes.shape[1:]), np.nan, np.float32)
    build(picture_errors, "write_perceived", serial)(planes, seen)
    return (seen,)


def differing(reference: np.ndarray, test: np.ndarray, serial: bool = False) -> Arrays:
    error = np.full(reference.shape[1:], 0.25, np.float32)
    build(picture_errors, "raise_flip_error", serial)(reference, test, error)
    return (error,)


def chosen(
    before: tuple[np.ndarray, ...],
    after: tuple[np.ndarray, ...],
    time: float,
    serial: bool = False,
) -> Arrays:
    """Sides are field, depth at the slot, depth of the key frame, hole and fringe."""
    shape = before[1].shape
    pixel, later = np.full(shape, -9, np.int32), np.zeros(shape, np.bool_)
    depth, hole = np.zeros(shape, np.float32), np.zeros(shape, np.bool_)
    call = build(blend, "choose_sources", serial)
    call(before, after, np.float32(time), pixel, later, depth, hole)
    return pixel, later, depth, hole


def adopted(
    pixel: np.ndarray,
    later: np.ndarray,
    depth: np.ndarray,
    hole: np.ndarray,
    limits: tuple[float, int],
    serial: bool = False,
) -> Arrays:
    """`limits` are cap and reach."""
    cap, reach = limits
    (steps,) = seen(hole, reach, serial)
    out, side = pixel.copy(), later.copy()
    build(blend, "adopt_sources", serial)(out, side, depth, *listed(hole), np.float32(cap), steps)
    return out, side


def surface_sampled(
    image: np.ndarray, depth: np.ndarray, field: np.ndarray, serial: bool = False
) -> Arrays:
    out = np.zeros_like(image)
    build(blend, "sample_surface", serial)(image, depth, field, out)
    return (out,)
