"""Networks in ONNX files: finding one, and running it with onnxruntime."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Mapping
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from exwarp_cli.domain import cores
from exwarp_cli.domain.frame import Float32
from exwarp_cli.domain.network_api import (
    EXTRAPOLATOR_INTERFACE,
    TIME_INPUT,
    ExtrapolatorInputs,
    LazyInputs,
    NetworkInterface,
    NetworkPictures,
    NetworkTensors,
    Tile,
    TileSpan,
    cut_tiles,
)
from exwarp_cli.errors import InputError, LayoutError, MissingExtraError, OutOfMemoryError
from exwarp_cli.io.model_files import CHECKSUMS as CHECKSUMS
from exwarp_cli.io.model_files import (
    STRIDE_KEY,
    reason,
    require_interface,
    require_nodes,
    stated_stride,
    unusable,
    written_shape,
)
from exwarp_cli.io.model_files import read_model as read_model
from exwarp_cli.io.model_files import shipped_folder as shipped_folder
from exwarp_cli.io.model_weights import with_weights
from exwarp_cli.io.standard_streams import quiet_libraries
from exwarp_cli.runtime.frame_pool import pool
from exwarp_cli.runtime.read_registry import being_read

SHIPPED = "extrapolator.onnx"
"""Name of the network that comes with ExWarp."""

PIXELS_PER_THREAD = 256
"""Pixels of the coarsest scale that a thread must get. With 107 and less, onnxruntime was seen to
split the sums of a convolution elsewhere, so that the rounding went by the number of threads."""

MOST_PIXELS = 2**20
"""Of a picture that a network is given whole; a larger one is cut into tiles. The shipped network
takes 560 bytes a pixel while it runs."""

MOST_ENCODED = 80.0
"""Largest answer that is taken for colour: coded as log(1 + x), it is near float32's limit."""

CUDA = "CUDAExecutionProvider"


def load_extrapolator(path: Path | None, threads: int | None, device: str) -> OnnxExtrapolator:
    """Load a network and try it once.

    Parameters
    ----------
    path
        ONNX file; None for the network that comes with ExWarp.
    threads
        At most; None for as many as the command has cores.
    device
        "cpu" or "cuda".

    Raises
    ------
    InputError
        When there is no such file, it is damaged, or it does not have the inputs and the output of
        `exwarp_cli.domain.network_api`.
    MissingExtraError
        When the device is "cuda" and onnxruntime cannot use it.
    """
    path, data = read_model(path, SHIPPED, "--extrapolator")
    network = OnnxExtrapolator(path, data, threads or cores.count(), device)
    network.judge()
    return network


class OnnxNetwork:
    """A network that onnxruntime has opened.

    Parameters
    ----------
    path
        Where `data` came from.
    data
        The ONNX file's bytes.
    threads
        At most.
    device
        "cpu" or "cuda".

    Attributes
    ----------
    inputs, outputs
        By name, each with `name`, `type` and `shape` as onnxruntime tells them.
    """

    def __init__(self, path: Path, data: bytes, threads: int, device: str) -> None:
        self.path, self.device = path, device
        self._data, self._threads = with_weights(path, data), threads
        self._checksum = hashlib.sha256(self._data).hexdigest()
        self._sessions: dict[int, Any] = {}
        session = self._session(1)
        self.inputs: dict[str, Any] = {node.name: node for node in session.get_inputs()}
        self.outputs: dict[str, Any] = {node.name: node for node in session.get_outputs()}
        self._metadata: dict[str, str] = session.get_modelmeta().custom_metadata_map

    @property
    def checksum(self) -> str:
        """SHA-256 of the model's file, with all its weights in it, in hexadecimal digits."""
        return self._checksum

    def _answer(
        self,
        output: str,
        feeds: dict[str, Any],
        size: tuple[int, int],
        stride: int,
        advice: str,
        last: bool = False,
    ) -> Any:
        """Run the network.

        Parameters
        ----------
        output
            Name of the output.
        feeds
            Arrays by input.
        size
            Height and width of the pictures, multiples of `stride`.
        stride
            Pixels of the frame in one of the coarsest scale, which bounds the threads.
        advice
            What to do where it fails.
        last
            Whether nothing is asked for a while: memory that is kept for the next time is given
            back then, which takes an eighth of the time of running it.

        Returns
        -------
        numpy.ndarray
            As the network gives it.
        """
        height, width = size
        most = height * width // (stride**2 * PIXELS_PER_THREAD)
        session = self._session(max(1, min(self._threads, most)) if self.device == "cpu" else 1)
        try:
            with being_read(self.path, required=True):
                (out,) = session.run([output], feeds, self._giving_back if last else None)
        except _failures() as error:
            if isinstance(error, MemoryError) or "alloc" in str(error):
                raise OutOfMemoryError(
                    f"{self.path} needs more memory than there is for {width}x{height} pixels; "
                    "close other programs, use fewer threads, or another model"
                ) from error
            raise LayoutError(
                f"{self.path} fails on {width}x{height} pixels ({reason(error)}); {advice}"
            ) from error
        return out

    @cached_property
    def _giving_back(self) -> Any:
        """Options of a run after which memory is given back."""
        options = _runtime().RunOptions()
        if self.device == "cpu":
            options.add_run_config_entry("memory.enable_memory_arena_shrinkage", "cpu:0")
        return options

    def _session(self, threads: int) -> Any:
        """Return onnxruntime's session for so many threads; made once."""
        if threads not in self._sessions:
            self._sessions[threads] = open_session(self.path, self._data, threads, self.device)
        return self._sessions[threads]


class PictureNetwork(OnnxNetwork):
    """A network that is given planes of a slot and answers with planes, tile by tile.

    Parameters
    ----------
    path, data, threads, device
        As for `OnnxNetwork`.
    interface
        What it takes and gives.
    """

    def __init__(
        self, path: Path, data: bytes, threads: int, device: str, interface: NetworkInterface
    ) -> None:
        super().__init__(path, data, threads, device)
        self._interface = interface
        self._stride = stated_stride(self.path, self._metadata)
        self._room: Float32 | None = None

    def answers(self, inputs: LazyInputs) -> Iterator[tuple[Tile, Float32]]:
        """Yield the network's answer to each tile of the inputs, of any size.

        Yields
        ------
        Tile
            Which part of the picture.
        float32 [C, h, w]
            What is kept of it; inside the picture.
        """
        height, width = inputs.shape
        tiles = self._tiles(_up(height, self._stride), _up(width, self._stride))
        for count, (rows, columns) in enumerate(tiles, start=1):
            room = self._taken_room((rows.end - rows.begin, columns.end - columns.begin))
            part = inputs.part(rows.seen, columns.seen, room)
            last = 1 < count == len(tiles)
            answer = self._made_of(part, last)
            self._room = None if last else room
            kept = answer[:, rows.inside, columns.inside]
            # The last tiles reach beyond a picture whose size is no multiple of the stride.
            yield (rows, columns), kept[:, : height - rows.first, : width - columns.first]

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

    def _require_values(self, out: Float32, pixels: str) -> None:
        """Refuse an answer [1, C, H, W] that means nothing; `pixels` says of how many."""
        raise NotImplementedError

    def _taken_room(self, size: tuple[int, int]) -> Float32:
        """Return room for the planes of a part; that of the last one where it is as large.

        The room does not go back to the pool in between. When it did, frames' arrays took its
        memory and it took theirs: to map and clear it again took three times as long as writing the
        planes.
        """
        shape = self._interface.channels, *size
        room, self._room = self._room, None
        return room if room is not None and room.shape == shape else pool.empty(shape, np.float32)

    def _tiles(self, height: int, width: int) -> tuple[Tile, ...]:
        """Return what of a picture the network is given at a time; all of a small one."""
        if height * width > MOST_PIXELS and self._reach is not None:
            return cut_tiles((height, width), self._stride, self._reach, MOST_PIXELS)
        return ((TileSpan(0, height, 0, height), TileSpan(0, width, 0, width)),)

    @cached_property
    def _reach(self) -> int | None:
        """How far the network sees, pixels; None for what takes pictures whole."""
        inputs = self._interface.inputs
        return reach_of(lambda pictures: self._raw(pictures, 0.5)[0], self._stride, inputs)

    def _made_of(self, part: NetworkTensors, last: bool) -> Float32:
        """Return the network's answer to a part of the inputs, as they are in both directions."""
        height, width = part.shape
        down, right = -height % self._stride, -width % self._stride
        pictures = part.pictures
        if down or right:
            around = ((0, 0), (0, down), (0, right))
            pictures = {name: np.pad(p, around, mode="edge") for name, p in pictures.items()}
        out = self._raw(pictures, part.time, last)
        self._require_answer(out, height + down, width + right)
        return np.asarray(out[0])

    def _raw(self, pictures: Mapping[str, Float32], time: float, last: bool = False) -> Float32:
        """Run the network on pictures of a size that is a multiple of its stride."""
        height, width = next(iter(pictures.values())).shape[1:]
        given = {name: np.ascontiguousarray(planes) for name, planes in pictures.items()}
        feeds = {name: planes[None] for name, planes in given.items() if name in self.inputs}
        if TIME_INPUT in self.inputs:
            feeds[TIME_INPUT] = np.array([time], np.float32)
        advice = (
            f"export it with any height and width that are multiples of {self._stride}, or state "
            f"another {STRIDE_KEY} in its metadata"
        )
        output = self._interface.output
        out = self._answer(output, feeds, (height, width), self._stride, advice, last)
        return np.asarray(out)

    def _require_answer(self, out: Float32, height: int, width: int) -> None:
        """Refuse an answer of another size, or that means nothing."""
        made = self._interface.made
        if out.shape != (1, made, height, width):
            raise LayoutError(
                f"{self.path} gives {written_shape(list(out.shape))} for {width}x{height} pixels; "
                f"export it so that it gives {written_shape([1, made, height, width])}"
            )
        self._require_values(out, f"{width}x{height} pixels")


class OnnxExtrapolator(PictureNetwork):
    """An extrapolation network that is ready to run; parameters as for `OnnxNetwork`."""

    def __init__(self, path: Path, data: bytes, threads: int, device: str) -> None:
        super().__init__(path, data, threads, device, EXTRAPOLATOR_INTERFACE)

    def __call__(self, inputs: ExtrapolatorInputs) -> Float32:
        """Return the slot's colour, float32 [3, H, W], encoded as the inputs are; any H and W."""
        out = np.empty((3, *inputs.shape), np.float32)
        for (rows, columns), answer in self.answers(inputs):
            out[:, rows.kept, columns.kept] = answer
        return out

    def _require_values(self, out: Float32, pixels: str) -> None:
        # The ends alone: the largest magnitude of all took a copy of the picture.
        if not (out.max() <= MOST_ENCODED and out.min() >= -MOST_ENCODED):
            raise InputError(
                f"{self.path} gives NaN, infinite or far too bright colour for {pixels}; use "
                "another model"
            )


def _up(pixels: int, stride: int) -> int:
    """Return the next multiple of a stride."""
    return -(-pixels // stride) * stride


def open_session(path: Path, data: bytes, threads: int, device: str) -> Any:
    """Make onnxruntime's session from a file's bytes: so other files can have no part in it.

    Parameters are those of `OnnxNetwork`; operators run one after the other, each with all threads.
    """
    runtime = _runtime()
    if device == "cuda" and CUDA not in runtime.get_available_providers():
        raise MissingExtraError(
            "--device cuda needs onnxruntime with CUDA, and what is installed has none; run "
            "'pip uninstall onnxruntime' and 'pip install onnxruntime-gpu', or use --device cpu"
        )
    options = runtime.SessionOptions()
    options.log_severity_level = 4
    options.intra_op_num_threads, options.inter_op_num_threads = threads, 1
    options.execution_mode = runtime.ExecutionMode.ORT_SEQUENTIAL
    options.use_deterministic_compute = True
    # Planned as one block, what is computed on the way took twice the memory, and no less time.
    options.enable_mem_pattern = False
    # Threads that wait in a loop took a third more of the processor, and were no faster.
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    # A search by time may choose other algorithms, and round otherwise, in every run.
    cuda = (CUDA, {"cudnn_conv_algo_search": "HEURISTIC", "use_tf32": "0"})
    providers = [cuda] if device == "cuda" else []
    try:
        with being_read(path, required=True), quiet_libraries():
            session = runtime.InferenceSession(
                data, options, providers=[*providers, "CPUExecutionProvider"], enable_fallback=False
            )
    except _failures() as error:
        if isinstance(error, MemoryError):
            raise OutOfMemoryError(
                f"{path} needs more memory than there is to be opened; close other programs, or "
                "use another model"
            ) from error
        raise unusable(path, error) from error
    if device == "cuda" and CUDA not in session.get_providers():
        raise MissingExtraError(
            "--device cuda was asked for, but onnxruntime cannot start CUDA here; check the "
            "driver and the CUDA and cuDNN libraries that onnxruntime-gpu needs, or use "
            "--device cpu"
        )
    return session


def runtime_version() -> str:
    """Return the version of onnxruntime; MissingExtraError without it."""
    return str(_runtime().__version__)


def providers() -> tuple[str, ...]:
    """Return what onnxruntime could run networks on, by its names; MissingExtraError without it."""
    return tuple(_runtime().get_available_providers())


def _runtime() -> Any:
    """Import onnxruntime, which takes 0.3 s, and keep it from writing to stderr."""
    try:
        # As it is imported it looks for devices, and writes to the terminal what it misses.
        with quiet_libraries():
            import onnxruntime
    except ImportError as error:
        raise MissingExtraError(
            f"onnxruntime cannot be loaded ({error}); run 'pip install onnxruntime'"
        ) from error
    onnxruntime.set_default_logger_severity(4)
    # The variable in `exwarp_cli` does not reach the tracing of builds for Windows, nor a process
    # that imported onnxruntime before ExWarp.
    onnxruntime.disable_telemetry_events()
    return onnxruntime


def _failures() -> tuple[type[Exception], ...]:
    """Return what onnxruntime raises when a model cannot be loaded or run."""
    from onnxruntime.capi import onnxruntime_pybind11_state as state

    kinds = [kind for kind in vars(state).values() if isinstance(kind, type)]
    own = [kind for kind in kinds if issubclass(kind, Exception)]
    return (*own, RuntimeError, ValueError, MemoryError)


Run = Callable[[Mapping[str, Float32]], Float32]
"""Runs a network on pictures float32 [C, H, W] by input; gives planes [C, H, W]."""

SIDES = (384, 1024)
"""Pixels of the pictures that are tried. The shipped network sees 96 pixels far; what sees farther
than half of the second picture is not worth cutting up."""

LEAST_CELLS = 7
SAME = 1e-5
"""Largest difference between a picture and a part of it that is rounding."""


def reach_of(
    run: Run, stride: int, inputs: Mapping[str, int] = EXTRAPOLATOR_INTERFACE.inputs
) -> int | None:
    """Return how many pixels away from one that it is given a network's answer may change.

    The network is run. NaN that is put in comes out wherever it is seen, as convolutions, pools,
    gates and sums hand it on. Where NaN is swallowed (some maxima) or the place in the picture
    counts, a picture and a part of it differ, which is tried as well.

    Parameters
    ----------
    run
        The network.
    stride
        What height and width have to be multiples of.
    inputs
        Channels by picture input.

    Returns
    -------
    int or None
        A multiple of the stride; None where the network sees too far, all of the picture (global
        pools, normalisation by the picture's own mean), or where in the picture it is.
    """
    for side in SIDES:
        cells = max(LEAST_CELLS, side // stride) // 2 * 2 + 1
        picture = _noise(cells * stride, inputs)
        margin = _seen(run, picture, stride, cells)
        if margin is not None and _is_part(run, picture, stride, margin):
            return margin * stride
    return None


def _noise(side: int, inputs: Mapping[str, int]) -> dict[str, Float32]:
    rng = np.random.default_rng(side)
    shapes = {name: (count, side, side) for name, count in inputs.items()}
    return {name: rng.random(shape, dtype=np.float32) for name, shape in shapes.items()}


def _seen(run: Run, picture: dict[str, Float32], stride: int, cells: int) -> int | None:
    """Return how many strides NaN in the middle one spreads; None when it comes near the border."""
    middle = cells // 2
    cell = slice(middle * stride, (middle + 1) * stride)
    spoilt = {name: planes.copy() for name, planes in picture.items()}
    for planes in spoilt.values():
        planes[:, cell, cell] = np.nan
    reached = np.isnan(run(spoilt)).any(axis=0)
    away = np.abs(np.argwhere(reached) // stride - middle)
    margin = int(away.max(initial=0))
    return margin if margin < middle else None


def _is_part(run: Run, picture: dict[str, Float32], stride: int, margin: int) -> bool:
    """Whether a part of a picture, but for its margin, becomes what the whole does there."""
    side = next(iter(picture.values())).shape[-1]
    part = slice(stride, side - stride)
    inner = slice((1 + margin) * stride, side - (1 + margin) * stride)
    whole = run(picture)[:, inner, inner]
    found = run({name: np.ascontiguousarray(p[:, part, part]) for name, p in picture.items()})
    kept = slice(margin * stride, found.shape[-1] - margin * stride)
    return bool(np.abs(found[:, kept, kept] - whole).max() <= SAME)
