"""Networks in ONNX files: finding one, judging whether it fits, and running it with onnxruntime.

A model's metadata may state `exwarp.interface`, the version of the inputs that it was made for, and
`exwarp.stride`, the number that the height and width of what it takes must be multiples of.
"""

from __future__ import annotations

import hashlib
import json
import os
from pathlib import Path
from typing import Any

import numpy as np

from exwarp_cli.domain.extrapolator import INPUTS, INTERFACE, OUTPUT, TIME, NetworkInputs
from exwarp_cli.domain.frame import Float32
from exwarp_cli.errors import DamagedFileError, InputError, LayoutError, MissingExtraError

SHIPPED = "extrapolator.onnx"
"""Name of the network that comes with ExWarp."""

CHECKSUMS = "checksums.json"
"""Beside the shipped models: SHA-256 by file name."""

STRIDE, INTERFACE_KEY = "exwarp.stride", "exwarp.interface"
DEFAULT_STRIDE, MOST_STRIDE = 8, 256

REQUIRED = ("warped", "mask")
"""Inputs that a network must have; it may do without the others."""

PIXELS_PER_THREAD = 256
"""Pixels of the coarsest scale that a thread must get. With 107 and less, onnxruntime was seen to
split the sums of a convolution elsewhere, so that the rounding went by the number of threads."""

HIGHEST = 80.0
"""Largest answer that is taken for colour: coded as log(1 + x), it is near float32's limit."""

CUDA = "CUDAExecutionProvider"

_ELSEWHERE = b"\n\x08location\x12"
"""How ONNX files write the key under which they name the file of weights that are kept apart."""


def load_extrapolator(path: Path | None, threads: int | None, device: str) -> OnnxExtrapolator:
    """Load a network and try it once.

    Parameters
    ----------
    path
        ONNX file; None for the network that comes with ExWarp.
    threads
        None for all cores.
    device
        "cpu" or "cuda".

    Raises
    ------
    InputError
        When there is no such file, it is damaged, or it does not have the inputs and the output of
        `exwarp_cli.domain.extrapolator`.
    MissingExtraError
        When the device is "cuda" and onnxruntime cannot use it.
    """
    if path is None:
        path = shipped_folder() / SHIPPED
        data = _read_shipped(path)
    else:
        data = _read(path)
    network = OnnxExtrapolator(path, data, threads or os.cpu_count() or 1, device)
    network.judge()
    return network


def shipped_folder() -> Path:
    """Return where the models that come with ExWarp lie: in the package, or in a clone beside."""
    package = Path(__file__).resolve().parents[1]
    inside = package / "_models"
    return inside if inside.is_dir() else package.parent / "models"


class OnnxExtrapolator:
    """An extrapolation network that is ready to run.

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
    """

    def __init__(self, path: Path, data: bytes, threads: int, device: str) -> None:
        self.path, self.device = path, device
        self._data, self._threads = data, threads
        self._checksum = hashlib.sha256(data).hexdigest()
        self._sessions: dict[int, Any] = {}
        session = self._session(1)
        self._inputs: dict[str, Any] = {node.name: node for node in session.get_inputs()}
        self._outputs: dict[str, Any] = {node.name: node for node in session.get_outputs()}
        self._metadata: dict[str, str] = session.get_modelmeta().custom_metadata_map
        self._stride = self._stated_stride()

    @property
    def checksum(self) -> str:
        """SHA-256 of the model's file, in hexadecimal digits."""
        return self._checksum

    def __call__(self, inputs: NetworkInputs) -> Float32:
        """Return the slot's colour, float32 [3, H, W], encoded as the inputs are; any H and W."""
        height, width = inputs.mask.shape[1:]
        down, right = -height % self._stride, -width % self._stride
        feeds = {
            name: np.pad(planes, ((0, 0), (0, down), (0, right)), mode="edge")[None]
            for name, planes in inputs.pictures.items()
            if name in self._inputs
        }
        if TIME in self._inputs:
            feeds[TIME] = np.array([inputs.time], np.float32)
        out = self._run(feeds, height + down, width + right)
        return np.ascontiguousarray(out[0, :, :height, :width])

    def judge(self) -> None:
        """Refuse a network that does not fit, by what it declares and by running it once."""
        stated = self._metadata.get(INTERFACE_KEY, INTERFACE)
        if stated != INTERFACE:
            raise LayoutError(
                f"{self.path} was made for the interface {stated}, and this is {INTERFACE}; "
                "use a model for this version of ExWarp"
            )
        self._judge_names()
        for name, node in self._inputs.items():
            if name == TIME:
                self._judge_node(node, "input", (1,))
            else:
                self._judge_node(node, "input", (1, INPUTS[name], None, None))
        self._judge_node(self._outputs[OUTPUT], "output", (1, 3, None, None))
        # Odd multiples, so that a network which needs more than it states fails here.
        shape = (5 * self._stride, 7 * self._stride)
        blank = {name: np.zeros((count, *shape), np.float32) for name, count in INPUTS.items()}
        self(NetworkInputs(**blank, time=0.5))

    def _judge_names(self) -> None:
        known = (*INPUTS, TIME)
        if foreign := [name for name in self._inputs if name not in known]:
            raise LayoutError(
                f"{self.path} has the input {foreign[0]!r}, which ExWarp does not give; export it "
                f"with inputs out of {', '.join(known)}"
            )
        if missing := [name for name in REQUIRED if name not in self._inputs]:
            raise LayoutError(
                f"{self.path} lacks the input {missing[0]!r}; export it with inputs out of "
                f"{', '.join(known)}"
            )
        if list(self._outputs) != [OUTPUT]:
            raise LayoutError(
                f"{self.path} has the output {', '.join(self._outputs)}; export it with one "
                f"output named {OUTPUT}"
            )

    def _judge_node(self, node: Any, what: str, shape: tuple[int | None, ...]) -> None:
        """Compare an input or output with a shape, in which None is a size that must be free.

        An output's sizes and a batch may be left open: running the network shows what they are.
        """
        found = list(node.shape)
        open_sizes = [what == "output" or axis == 0 for axis in range(len(shape))]
        fits = len(found) == len(shape) and all(
            not isinstance(have, int) if want is None else have == want or (free and have is None)
            for have, want, free in zip(map(_size, found), shape, open_sizes, strict=True)
        )
        if node.type != "tensor(float)" or not fits:
            raise LayoutError(
                f"{self.path} has the {what} {node.name!r} as {node.type} {_written(found)} where "
                f"ExWarp needs tensor(float) {_written(list(shape))} with any height and width; "
                "export it so"
            )

    def _stated_stride(self) -> int:
        text = self._metadata.get(STRIDE, str(DEFAULT_STRIDE))
        if not text.isdecimal() or not 1 <= int(text) <= MOST_STRIDE:
            raise LayoutError(
                f"{self.path} states {STRIDE} = {text!r} in its metadata; state a whole number "
                f"from 1 to {MOST_STRIDE}"
            )
        return int(text)

    def _run(self, feeds: dict[str, Float32], height: int, width: int) -> Float32:
        """Run the network on pictures of a size that is a multiple of its stride."""
        most = height * width // (self._stride**2 * PIXELS_PER_THREAD)
        session = self._session(max(1, min(self._threads, most)) if self.device == "cpu" else 1)
        try:
            (out,) = session.run([OUTPUT], feeds)
        except _failures() as error:
            if "alloc" in str(error):
                raise MemoryError from error
            raise LayoutError(
                f"{self.path} fails on {width}x{height} pixels ({_reason(error)}); export it with "
                f"any height and width that are multiples of {self._stride}, or state another "
                f"{STRIDE} in its metadata"
            ) from error
        if out.shape != (1, 3, height, width):
            raise LayoutError(
                f"{self.path} gives {_written(list(out.shape))} for {width}x{height} pixels; "
                f"export it so that it gives {_written([1, 3, height, width])}"
            )
        if not np.abs(out).max() <= HIGHEST:
            raise InputError(
                f"{self.path} gives NaN, infinite or far too bright colour for {width}x{height} "
                "pixels; use another model"
            )
        return np.asarray(out)

    def _session(self, threads: int) -> Any:
        """Return onnxruntime's session for so many threads; made once."""
        if threads not in self._sessions:
            self._sessions[threads] = _open(self.path, self._data, threads, self.device)
        return self._sessions[threads]


def _read(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except FileNotFoundError as error:
        raise InputError(f"there is no model {path}; check the path") from error
    except OSError as error:
        raise InputError(
            f"cannot read the model {path}: {error.strerror}; check the path and its rights"
        ) from error


def _read_shipped(path: Path) -> bytes:
    """Read a model that comes with ExWarp, and make sure that it is that one."""
    try:
        data = path.read_bytes()
        expected = json.loads((path.parent / CHECKSUMS).read_bytes())[path.name]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(
            f"the model {path}, which comes with ExWarp, is missing or has no checksum beside it; "
            "install ExWarp again, or name a model with --extrapolator"
        ) from error
    if hashlib.sha256(data).hexdigest() != expected:
        raise DamagedFileError(
            f"the model {path} is not the one that came with ExWarp, its checksum differs; install "
            "ExWarp again, or name this model with --extrapolator"
        )
    return data


def _open(path: Path, data: bytes, threads: int, device: str) -> Any:
    """Make a session from a file's bytes: so other files can have no part in it."""
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
    # Threads that wait in a loop took a third more of the processor, and were no faster.
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    # A search by time may choose other algorithms, and round otherwise, in every run.
    cuda = (CUDA, {"cudnn_conv_algo_search": "HEURISTIC", "use_tf32": "0"})
    providers = [cuda] if device == "cuda" else []
    try:
        session = runtime.InferenceSession(
            data, options, providers=[*providers, "CPUExecutionProvider"], enable_fallback=False
        )
    except _failures() as error:
        raise _unusable(path, data, error) from error
    if device == "cuda" and CUDA not in session.get_providers():
        raise MissingExtraError(
            "--device cuda was asked for, but onnxruntime cannot start CUDA here; check the "
            "driver and the CUDA and cuDNN libraries that onnxruntime-gpu needs, or use "
            "--device cpu"
        )
    return session


def _unusable(path: Path, data: bytes, error: Exception) -> InputError:
    """Say why a file is no model that runs."""
    if _ELSEWHERE in data:
        return LayoutError(
            f"{path} keeps weights in other files, and one file is read only; save it with its "
            "weights inside"
        )
    return DamagedFileError(
        f"{path} is no ONNX model that onnxruntime can run ({_reason(error)}); check the path, or "
        "export it again"
    )


def _runtime() -> Any:
    """Import onnxruntime, which takes 0.3 s, and keep it from writing to stderr."""
    try:
        import onnxruntime
    except ImportError as error:
        raise MissingExtraError(
            f"onnxruntime cannot be loaded ({error}); run 'pip install onnxruntime'"
        ) from error
    onnxruntime.set_default_logger_severity(4)
    return onnxruntime


def _failures() -> tuple[type[Exception], ...]:
    """Return what onnxruntime raises when a model cannot be loaded or run."""
    from onnxruntime.capi import onnxruntime_pybind11_state as state

    kinds = [kind for kind in vars(state).values() if isinstance(kind, type)]
    own = [kind for kind in kinds if issubclass(kind, Exception)]
    return (*own, RuntimeError, ValueError)


def _reason(error: Exception) -> str:
    """First line of what onnxruntime says, without its codes."""
    line = str(error).strip().splitlines()[0] if str(error).strip() else type(error).__name__
    text = line.rsplit(" : ", 1)[-1].strip().rstrip(".")
    return text if len(text) <= 160 else text[:157] + "..."


def _size(value: object) -> int | None:
    """Return a declared size; None for a free one."""
    return value if isinstance(value, int) else None


def _written(shape: list[Any]) -> str:
    """Write a shape; free sizes by their name or as ``?``."""
    return f"[{', '.join('?' if size is None else str(size) for size in shape)}]"
