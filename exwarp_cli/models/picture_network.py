"""Run networks that take and give planes of a slot, tile by tile: E and the look-ahead network."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from fractions import Fraction
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from exwarp_cli.domain import network_api
from exwarp_cli.domain.decision import LOOKAHEAD
from exwarp_cli.domain.frame import Float32
from exwarp_cli.errors import InputError, LayoutError
from exwarp_cli.models.model_file import INTERFACE_KEY, STRIDE_KEY, read_model, shape_text
from exwarp_cli.models.session import OnnxNetwork
from exwarp_cli.runtime import cores
from exwarp_cli.runtime.frame_pool import pool

SHIPPED_EXTRAPOLATOR = "extrapolator.onnx"
SHIPPED_LOOKAHEAD = "lookahead.onnx"

DEFAULT_STRIDE, MAX_STRIDE = 8, 256

# Pixels of a picture that a network gets whole; a larger one is cut into tiles. The shipped
# extrapolator takes 560 bytes a pixel while it runs.
MAX_PIXELS = 2**20

MAX_ENCODED = 80.0  # largest colour of an answer: coded as log(1 + x), it is near float32's limit
WEIGHT_TOLERANCE = 1e-3  # by which the sum of weights may miss 1, and a weight 0

# Sides in pixels of the pictures on which the reach is measured. The shipped extrapolator sees 96
# pixels far. A network that sees farther than half of the second picture is not worth cutting up.
REACH_SIDES = (384, 1024)
MIN_REACH_CELLS = 7

ROUNDING = 1e-5  # largest difference between a picture and a part of it that is rounding


def load_extrapolator(path: Path | None, threads: int | None, device: str) -> OnnxExtrapolator:
    """Load an extrapolator, the shipped one if `path` is None, and run it once as a check.

    `threads` is a maximum, None for the command's cores; `device` is "cpu" or "cuda".

    Raises InputError if the file is missing, damaged, or does not have the inputs and the output
    of `exwarp_cli.domain.network_api`; MissingExtraError if onnxruntime has no CUDA.
    """
    path, data = read_model(path, SHIPPED_EXTRAPOLATOR, "--extrapolator")
    return OnnxExtrapolator(path, data, threads or cores.count(), device)


def load_lookahead(path: Path | None, threads: int | None, device: str) -> OnnxLookAhead:
    """Load a look-ahead network as `load_extrapolator` does."""
    path, data = read_model(path, SHIPPED_LOOKAHEAD, "--interpolator")
    return OnnxLookAhead(path, data, threads or cores.count(), device)


class PictureNetwork(OnnxNetwork):
    """A network with a `NetworkInterface`, run on tiles of a picture; parameters as its base."""

    _interface: network_api.NetworkInterface

    def __init__(self, path: Path, data: bytes, threads: int, device: str) -> None:
        super().__init__(path, data, threads, device)
        stride = self._metadata.get(STRIDE_KEY, str(DEFAULT_STRIDE))
        if not stride.isdecimal() or not 1 <= int(stride) <= MAX_STRIDE:
            raise LayoutError(
                f"{path} states {STRIDE_KEY} = {stride!r} in its metadata; state a whole number "
                f"from 1 to {MAX_STRIDE}"
            )
        # The number that the height and width of its inputs are multiples of.
        self.stride = int(stride)
        self._buffer: Float32 | None = None
        # A network that does not fit is refused by what it declares, then by a run.
        interface = self._interface
        stated = self._metadata.get(INTERFACE_KEY, interface.version)
        if stated != interface.version:
            raise LayoutError(
                f"{self.path} was made for the interface {stated}, and this is "
                f"{interface.version}; use a model for this version of ExWarp"
            )
        names = (*interface.inputs, network_api.TIME_INPUT)
        if foreign := [name for name in self.inputs if name not in names]:
            raise LayoutError(
                f"{self.path} has the input {foreign[0]!r}, which ExWarp does not give; export it "
                f"with inputs out of {', '.join(names)}"
            )
        if missing := [name for name in interface.required if name not in self.inputs]:
            raise LayoutError(
                f"{self.path} lacks the input {missing[0]!r}; export it with inputs out of "
                f"{', '.join(names)}"
            )
        if list(self.outputs) != [interface.output]:
            raise LayoutError(
                f"{self.path} has the output {', '.join(self.outputs) or 'none'}; export it with "
                f"one output, named {interface.output}"
            )
        for name, node in self.inputs.items():
            channels = interface.inputs.get(name)  # None for the time
            shape = (1,) if channels is None else (1, channels, None, None)
            self._require_shape(node, "input", shape)
        output = self.outputs[interface.output]
        self._require_shape(output, "output", (1, interface.made, None, None))
        # Odd multiples, so that a network which needs more than it states fails here.
        sides = (5 * self.stride, 7 * self.stride)
        planes = {name: np.zeros((n, *sides), np.float32) for name, n in interface.inputs.items()}
        for _ in self.answers(network_api.NetworkPictures(planes, 0.5)):
            pass

    def answers(
        self, inputs: network_api.LazyInputs
    ) -> Iterator[tuple[network_api.KeptPart, Float32]]:
        """Yield the part of the picture that each tile makes, and its planes, float32 [C, h, w]."""
        height, width = inputs.shape
        rows, columns = (-(-pixels // self.stride) * self.stride for pixels in inputs.shape)
        row, column = slice(0, rows), slice(0, columns)
        tiles: tuple[network_api.Tile, ...] = (
            (network_api.TileSpan(row, row), network_api.TileSpan(column, column)),
        )
        if rows * columns > MAX_PIXELS and self._reach is not None:
            tiles = network_api.cut_tiles((rows, columns), self.stride, self._reach, MAX_PIXELS)
        for number, (down, across) in enumerate(tiles, start=1):
            sides = (span.seen.stop - span.seen.start for span in (down, across))
            shape = (self._interface.channels, *sides)
            # One buffer serves all tiles of a size. When it went back to the pool in between, it
            # swapped memory with frames' arrays: to map and clear pages took three times as long
            # as writing the planes.
            buffer, self._buffer = self._buffer, None
            if buffer is None or buffer.shape != shape:
                buffer = pool.empty(shape, np.float32)
            part = inputs.part(down.seen, across.seen, buffer)
            pictures = part.pictures
            seen = next(iter(pictures.values())).shape[1:]
            below, right = (-size % self.stride for size in seen)
            if below or right:
                padding = ((0, 0), (0, below), (0, right))
                pictures = {name: np.pad(p, padding, mode="edge") for name, p in pictures.items()}
            is_last = 1 < number == len(tiles)
            answer = self._run(pictures, part.time, is_last)
            size = (seen[0] + below, seen[1] + right)
            pixels, expected = f"{size[1]}x{size[0]} pixels", (1, self._interface.made, *size)
            if answer.shape != expected:
                raise LayoutError(
                    f"{self.path} gives {shape_text(answer.shape)} for {pixels}; export it so that "
                    f"it gives {shape_text(expected)}"
                )
            self._require_values(answer, pixels)
            self._buffer = None if is_last else buffer
            inside = [
                slice(span.kept.start - span.seen.start, span.kept.stop - span.seen.start)
                for span in (down, across)
            ]
            kept = answer[0, :, inside[0], inside[1]]
            # The last tiles reach beyond a picture whose size is no multiple of the stride.
            kept = kept[:, : height - down.kept.start, : width - across.kept.start]
            yield (down.kept, across.kept), kept

    def _require_shape(self, node: Any, kind: str, shape: tuple[int | None, ...]) -> None:
        """Refuse a node of onnxruntime's with another shape; None is a size that is left free."""
        fits = len(node.shape) == len(shape)
        for axis, (size, wanted) in enumerate(zip(node.shape, shape, strict=False)):
            if isinstance(size, int):
                fits = fits and size == wanted
            elif wanted is not None:
                # The network's first run shows the size of an output or a batch that is left free.
                fits = fits and (kind == "output" or axis == 0)
        if node.type != "tensor(float)" or not fits:
            raise LayoutError(
                f"{self.path} has the {kind} {node.name!r} as {node.type} {shape_text(node.shape)} "
                f"where ExWarp needs tensor(float) {shape_text(shape)} with any height and width; "
                "export it so"
            )

    def _require_values(self, answer: Float32, pixels: str) -> None:
        """Refuse impossible values in an answer [1, C, H, W] for so many `pixels`."""
        raise NotImplementedError

    @cached_property
    def _reach(self) -> int | None:
        """How far away one input pixel may change the answer, a multiple of the stride, in pixels.

        None where the network sees too far, all of the picture (global pools, normalisation by the
        picture's own mean), or the place in the picture.

        The network is run. NaN that is put in comes out wherever it is seen, as convolutions,
        pools, gates and sums propagate it. Where NaN is swallowed (some maxima) or the place
        counts, a picture and a part of it differ, which is tried as well.
        """
        stride = self.stride
        for most in REACH_SIDES:
            cells = max(MIN_REACH_CELLS, most // stride) // 2 * 2 + 1
            side, middle = cells * stride, cells // 2
            rng = np.random.default_rng(side)
            pictures = {
                name: rng.random((count, side, side), dtype=np.float32)
                for name, count in self._interface.inputs.items()
            }
            cell = slice(middle * stride, (middle + 1) * stride)
            spoilt = {name: planes.copy() for name, planes in pictures.items()}
            for planes in spoilt.values():
                planes[:, cell, cell] = np.nan
            reached = np.isnan(self._run(spoilt, 0.5)[0]).any(axis=0)
            margin = int(np.abs(np.argwhere(reached) // stride - middle).max(initial=0))
            if margin >= middle:
                continue
            # A part of the picture has to give what the picture gives there, but for the margin.
            part = slice(stride, side - stride)
            parts = {name: planes[:, part, part] for name, planes in pictures.items()}
            inner = slice((1 + margin) * stride, side - (1 + margin) * stride)
            expected = self._run(pictures, 0.5)[0][:, inner, inner]
            answer = self._run(parts, 0.5)[0]
            kept = slice(margin * stride, answer.shape[-1] - margin * stride)
            if np.abs(answer[:, kept, kept] - expected).max() <= ROUNDING:
                return margin * stride
        return None

    def _run(self, pictures: Mapping[str, Float32], time: float, is_last: bool = False) -> Float32:
        """Run the network on pictures [C, H, W] by input, H and W multiples of its stride."""
        height, width = next(iter(pictures.values())).shape[1:]
        feeds = {
            name: np.ascontiguousarray(planes)[None]
            for name, planes in pictures.items()
            if name in self.inputs
        }
        if network_api.TIME_INPUT in self.inputs:
            feeds[network_api.TIME_INPUT] = np.array([time], np.float32)
        advice = (
            f"export it with any height and width that are multiples of {self.stride}, or state "
            f"another {STRIDE_KEY} in its metadata"
        )
        output = self._interface.output
        answer = self._answer(output, feeds, (height, width), self.stride, advice, is_last)
        return np.asarray(answer)


class OnnxExtrapolator(PictureNetwork):
    """An extrapolator that is ready to run; parameters as for `OnnxNetwork`."""

    _interface = network_api.EXTRAPOLATOR_INTERFACE

    def __call__(self, inputs: network_api.LazyInputs) -> Float32:
        """Return the slot's colour, float32 [3, H, W], encoded as the inputs are; any H and W."""
        colour = np.empty((3, *inputs.shape), np.float32)
        for (rows, columns), answer in self.answers(inputs):
            colour[:, rows, columns] = answer
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

    _interface = network_api.LOOKAHEAD_INTERFACE
    name = LOOKAHEAD
    card_checksum: str | None = None  # it has no card

    def reaches(self, time: float | Fraction) -> bool:
        """Return True: it makes a frame at any time."""
        return True

    # Yields the weights of each tile of a slot: float32 [CANDIDATES, h, w].
    weigh = PictureNetwork.answers

    def _require_values(self, answer: Float32, pixels: str) -> None:
        sums = answer.sum(axis=1)
        if not (answer.min() >= -WEIGHT_TOLERANCE and np.abs(sums - 1).max() <= WEIGHT_TOLERANCE):
            raise InputError(
                f"{self.path} gives weights for {pixels} that are NaN, negative or do not add up "
                "to 1; use another model"
            )
