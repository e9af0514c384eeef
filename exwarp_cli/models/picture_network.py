"""Run networks that take and give planes of a slot, tile by tile: E and the look-ahead network."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from fractions import Fraction
from functools import cached_property
from pathlib import Path

import numpy as np

from exwarp_cli.domain.decision import LOOKAHEAD
from exwarp_cli.domain.frame import Float32
from exwarp_cli.domain.network_api import (
    EXTRAPOLATOR_INTERFACE,
    LOOKAHEAD_INTERFACE,
    TIME_INPUT,
    LazyInputs,
    NetworkInterface,
    NetworkPictures,
    Tile,
    TileSpan,
    cut_tiles,
)
from exwarp_cli.errors import InputError, LayoutError
from exwarp_cli.models.model_file import (
    STRIDE_KEY,
    read_model,
    require_interface,
    require_nodes,
    shape_text,
    stated_stride,
)
from exwarp_cli.models.session import OnnxNetwork
from exwarp_cli.runtime import cores
from exwarp_cli.runtime.frame_pool import pool

SHIPPED_EXTRAPOLATOR = "extrapolator.onnx"
SHIPPED_LOOKAHEAD = "lookahead.onnx"

# Pixels of a picture that a network gets whole; a larger one is cut into tiles. The shipped
# extrapolator takes 560 bytes a pixel while it runs.
MAX_PIXELS = 2**20

# Largest colour of an answer: coded as log(1 + x), it is near float32's limit.
MAX_ENCODED = 80.0

# By which the sum of weights may miss 1, and a weight 0.
WEIGHT_TOLERANCE = 1e-3

# Sides in pixels of the pictures on which the reach is measured. The shipped extrapolator sees 96
# pixels far. A network that sees farther than half of the second picture is not worth cutting up.
REACH_SIDES = (384, 1024)
MIN_REACH_CELLS = 7

# Largest difference between a picture and a part of it that is rounding.
ROUNDING = 1e-5

Run = Callable[[Mapping[str, Float32]], Float32]


def load_extrapolator(path: Path | None, threads: int | None, device: str) -> OnnxExtrapolator:
    """Load an extrapolator, the shipped one if `path` is None, and run it once as a check.

    `threads` is a maximum, None for the command's cores; `device` is "cpu" or "cuda".

    Raises InputError if the file is missing, damaged, or does not have the inputs and the output
    of `exwarp_cli.domain.network_api`; MissingExtraError if onnxruntime has no CUDA.
    """
    path, data = read_model(path, SHIPPED_EXTRAPOLATOR, "--extrapolator")
    network = OnnxExtrapolator(path, data, threads or cores.count(), device)
    network.judge()
    return network


def load_lookahead(path: Path | None, threads: int | None, device: str) -> OnnxLookAhead:
    """Load a look-ahead network as `load_extrapolator` does."""
    path, data = read_model(path, SHIPPED_LOOKAHEAD, "--interpolator")
    network = OnnxLookAhead(path, data, threads or cores.count(), device)
    network.judge()
    return network


class PictureNetwork(OnnxNetwork):
    """A network with a `NetworkInterface`, run on tiles of a picture."""

    def __init__(
        self, path: Path, data: bytes, threads: int, device: str, interface: NetworkInterface
    ) -> None:
        super().__init__(path, data, threads, device)
        self._interface = interface
        self._stride = stated_stride(self.path, self._metadata)
        self._buffer: Float32 | None = None

    def answers(self, inputs: LazyInputs) -> Iterator[tuple[Tile, Float32]]:
        """Yield each tile and the planes that are kept of its answer, float32 [C, h, w]."""
        height, width = inputs.shape
        rows, columns = (-(-pixels // self._stride) * self._stride for pixels in inputs.shape)
        tiles: tuple[Tile, ...] = ((TileSpan(0, rows, 0, rows), TileSpan(0, columns, 0, columns)),)
        if rows * columns > MAX_PIXELS and self._reach is not None:
            tiles = cut_tiles((rows, columns), self._stride, self._reach, MAX_PIXELS)
        for number, (down, across) in enumerate(tiles, start=1):
            shape = (self._interface.channels, down.end - down.begin, across.end - across.begin)
            # One buffer serves all tiles of a size. When it went back to the pool in between, it
            # swapped memory with frames' arrays: to map and clear pages took three times as long
            # as writing the planes.
            buffer, self._buffer = self._buffer, None
            if buffer is None or buffer.shape != shape:
                buffer = pool.empty(shape, np.float32)
            part = inputs.part(down.seen, across.seen, buffer)
            is_last = 1 < number == len(tiles)
            answer = self._run_padded(part.pictures, part.time, is_last)
            self._buffer = None if is_last else buffer
            kept = answer[:, down.inside, across.inside]
            # The last tiles reach beyond a picture whose size is no multiple of the stride.
            yield (down, across), kept[:, : height - down.first, : width - across.first]

    def judge(self) -> None:
        """Refuse a network that does not fit, by what it declares and by running it once."""
        interface = self._interface
        require_interface(self.path, self._metadata, interface)
        require_nodes(self.path, self.inputs, self.outputs, interface)
        # Odd multiples, so that a network which needs more than it states fails here.
        shape = (5 * self._stride, 7 * self._stride)
        planes = {name: np.zeros((n, *shape), np.float32) for name, n in interface.inputs.items()}
        for _ in self.answers(NetworkPictures(planes, 0.5)):
            pass

    def _require_values(self, answer: Float32, pixels: str) -> None:
        """Refuse impossible values in an answer [1, C, H, W] for so many `pixels`."""
        raise NotImplementedError

    @cached_property
    def _reach(self) -> int | None:
        return _measure_reach(
            lambda pictures: self._run(pictures, 0.5)[0], self._stride, self._interface.inputs
        )

    def _run_padded(self, pictures: Mapping[str, Float32], time: float, is_last: bool) -> Float32:
        """Run the network on pictures of any size, padded to its stride; return [C, H, W]."""
        height, width = next(iter(pictures.values())).shape[1:]
        below, right = -height % self._stride, -width % self._stride
        if below or right:
            padding = ((0, 0), (0, below), (0, right))
            pictures = {name: np.pad(p, padding, mode="edge") for name, p in pictures.items()}
        answer = self._run(pictures, time, is_last)
        height, width = height + below, width + right
        expected = (1, self._interface.made, height, width)
        if answer.shape != expected:
            raise LayoutError(
                f"{self.path} gives {shape_text(answer.shape)} for {width}x{height} pixels; "
                f"export it so that it gives {shape_text(expected)}"
            )
        self._require_values(answer, f"{width}x{height} pixels")
        return np.asarray(answer[0])

    def _run(self, pictures: Mapping[str, Float32], time: float, is_last: bool = False) -> Float32:
        """Run the network on pictures [C, H, W] by input, H and W multiples of its stride."""
        height, width = next(iter(pictures.values())).shape[1:]
        feeds = {
            name: np.ascontiguousarray(planes)[None]
            for name, planes in pictures.items()
            if name in self.inputs
        }
        if TIME_INPUT in self.inputs:
            feeds[TIME_INPUT] = np.array([time], np.float32)
        advice = (
            f"export it with any height and width that are multiples of {self._stride}, or state "
            f"another {STRIDE_KEY} in its metadata"
        )
        output = self._interface.output
        answer = self._answer(output, feeds, (height, width), self._stride, advice, is_last)
        return np.asarray(answer)


class OnnxExtrapolator(PictureNetwork):
    """An extrapolator that is ready to run; parameters as for `OnnxNetwork`."""

    def __init__(self, path: Path, data: bytes, threads: int, device: str) -> None:
        super().__init__(path, data, threads, device, EXTRAPOLATOR_INTERFACE)

    def __call__(self, inputs: LazyInputs) -> Float32:
        """Return the slot's colour, float32 [3, H, W], encoded as the inputs are; any H and W."""
        colour = np.empty((3, *inputs.shape), np.float32)
        for (rows, columns), answer in self.answers(inputs):
            colour[:, rows.kept, columns.kept] = answer
        return colour

    def _require_values(self, answer: Float32, pixels: str) -> None:
        # Both ends, not the largest magnitude, which took a copy of the picture.
        if not (answer.max() <= MAX_ENCODED and answer.min() >= -MAX_ENCODED):
            raise InputError(
                f"{self.path} gives NaN, infinite or far too bright colour for {pixels}; use "
                "another model"
            )


class OnnxLookAhead(PictureNetwork):
    """A network that weighs candidates for each pixel; parameters as for `OnnxNetwork`."""

    name = LOOKAHEAD
    card_checksum: str | None = None  # it has no card

    def __init__(self, path: Path, data: bytes, threads: int, device: str) -> None:
        super().__init__(path, data, threads, device, LOOKAHEAD_INTERFACE)

    def reaches(self, time: float | Fraction) -> bool:
        """Return True: it makes a frame at any time."""
        return True

    def weigh(self, inputs: LazyInputs) -> Iterator[tuple[Tile, Float32]]:
        """Yield the weights of each tile of a slot: float32 [CANDIDATES, h, w]."""
        return self.answers(inputs)

    def _require_values(self, answer: Float32, pixels: str) -> None:
        sums = answer.sum(axis=1)
        if not (answer.min() >= -WEIGHT_TOLERANCE and np.abs(sums - 1).max() <= WEIGHT_TOLERANCE):
            raise InputError(
                f"{self.path} gives weights for {pixels} that are NaN, negative or do not add up "
                "to 1; use another model"
            )


def _measure_reach(run: Run, stride: int, channels: Mapping[str, int]) -> int | None:
    """Return the reach of a network, pixels: how far away one input pixel may change its answer.

    A multiple of `stride`. None where the network sees too far, all of the picture (global pools,
    normalisation by the picture's own mean), or the place in the picture.

    The network is run. NaN that is put in comes out wherever it is seen, as convolutions, pools,
    gates and sums propagate it. Where NaN is swallowed (some maxima) or the place counts, a picture
    and a part of it differ, which is tried as well.
    """
    for side in REACH_SIDES:
        cells = max(MIN_REACH_CELLS, side // stride) // 2 * 2 + 1
        side = cells * stride
        rng = np.random.default_rng(side)
        pictures = {
            name: rng.random((count, side, side), dtype=np.float32)
            for name, count in channels.items()
        }
        middle = cells // 2
        cell = slice(middle * stride, (middle + 1) * stride)
        spoilt = {name: planes.copy() for name, planes in pictures.items()}
        for planes in spoilt.values():
            planes[:, cell, cell] = np.nan
        reached = np.isnan(run(spoilt)).any(axis=0)
        margin = int(np.abs(np.argwhere(reached) // stride - middle).max(initial=0))
        if margin < middle and _is_local(run, pictures, stride, margin):
            return margin * stride
    return None


def _is_local(run: Run, pictures: Mapping[str, Float32], stride: int, margin: int) -> bool:
    """True if a part of a picture gives what the picture gives there, but for a margin."""
    side = next(iter(pictures.values())).shape[-1]
    part = slice(stride, side - stride)
    inner = slice((1 + margin) * stride, side - (1 + margin) * stride)
    expected = run(pictures)[:, inner, inner]
    answer = run({name: np.ascontiguousarray(p[:, part, part]) for name, p in pictures.items()})
    kept = slice(margin * stride, answer.shape[-1] - margin * stride)
    return bool(np.abs(answer[:, kept, kept] - expected).max() <= ROUNDING)
