"""Run networks in ONNX files with onnxruntime."""

from __future__ import annotations

import hashlib
import re
from pathlib import Path
from typing import Any

from exwarp_cli.errors import DamagedFileError, LayoutError, MissingExtraError, OutOfMemoryError
from exwarp_cli.models.model_file import embed_weights
from exwarp_cli.runtime.read_registry import report_reading
from exwarp_cli.standard_streams import silence_libraries

CUDA = "CUDAExecutionProvider"

# Pixels of the coarsest scale that a thread must get. With 107 and less, onnxruntime was seen to
# split the sums of a convolution elsewhere, so that the rounding went by the number of threads.
PIXELS_PER_THREAD = 256

LONGEST_REASON = 240
_CODES = re.compile(r"\[ONNXRuntimeError\] : \d+ : \w+ : ")
_SOURCE_LINE = re.compile(r"\S+\.(?:cc|h|cpp):\d+ ")


class OnnxNetwork:
    """A network that onnxruntime has opened; `device` is "cpu" or "cuda".

    `inputs` and `outputs` hold onnxruntime's nodes by name, with `name`, `type` and `shape`.
    """

    def __init__(self, path: Path, data: bytes, threads: int, device: str) -> None:
        self.path, self.device, self._threads = path, device, threads
        self._data, _ = embed_weights(path, data)
        # SHA-256 of the model's file with all its weights in it, hexadecimal.
        self.checksum = hashlib.sha256(self._data).hexdigest()
        session = open_session(path, self._data, 1, device)
        self._sessions: dict[int, Any] = {1: session}  # by threads
        self.inputs: dict[str, Any] = {node.name: node for node in session.get_inputs()}
        self.outputs: dict[str, Any] = {node.name: node for node in session.get_outputs()}
        self._metadata: dict[str, str] = session.get_modelmeta().custom_metadata_map

    def _answer(
        self,
        output: str,
        feeds: dict[str, Any],
        size: tuple[int, int],
        stride: int,
        advice: str,
        last: bool = False,
    ) -> Any:
        """Run the network and return one of its outputs.

        `size` is the pictures' height and width, multiples of `stride`, the frame's pixels in one
        of the coarsest scale. `advice` ends the message of a failure. `last` frees the memory that
        onnxruntime keeps for the next run.
        """
        height, width = size
        most = height * width // (stride**2 * PIXELS_PER_THREAD)
        threads = max(1, min(self._threads, most)) if self.device == "cpu" else 1
        if threads not in self._sessions:
            self._sessions[threads] = open_session(self.path, self._data, threads, self.device)
        session = self._sessions[threads]
        options = None
        if last:
            options = load_runtime().RunOptions()
            if self.device == "cpu":  # takes an eighth of the time of a run
                options.add_run_config_entry("memory.enable_memory_arena_shrinkage", "cpu:0")
        with report_reading(self.path, required=True):
            try:
                (answer,) = session.run([output], feeds, options)
            except Exception as error:  # onnxruntime's own have no common base
                if isinstance(error, MemoryError) or "alloc" in str(error):
                    raise OutOfMemoryError(
                        f"{self.path} needs more memory than there is for {width}x{height} pixels; "
                        "close other programs, use fewer threads, or another model"
                    ) from error
                raise LayoutError(
                    f"{self.path} fails on {width}x{height} pixels ({_reason(error)}); {advice}"
                ) from error
        return answer


def open_session(path: Path, data: bytes, threads: int, device: str) -> Any:
    """Open onnxruntime's session on a model's bytes, so that no other file can have a part in it.

    Operators run one after the other, each on all threads.

    Raises DamagedFileError if the bytes are no model, MissingExtraError if there is no CUDA for
    the device "cuda".
    """
    runtime = load_runtime()
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
    # Planned as one block, intermediate results took twice the memory, and no less time.
    options.enable_mem_pattern = False
    # Threads that wait in a loop took a third more of the processor, and were no faster.
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    # A search by time may choose other algorithms, and round otherwise, in every run.
    cuda = (CUDA, {"cudnn_conv_algo_search": "HEURISTIC", "use_tf32": "0"})
    providers = [cuda] if device == "cuda" else []
    with report_reading(path, required=True), silence_libraries():
        try:
            session = runtime.InferenceSession(
                data, options, providers=[*providers, "CPUExecutionProvider"], enable_fallback=False
            )
        except MemoryError as error:
            raise OutOfMemoryError(
                f"{path} needs more memory than there is to be opened; close other programs, or "
                "use another model"
            ) from error
        except Exception as error:  # onnxruntime's own have no common base
            raise DamagedFileError(
                f"{path} is no ONNX model that onnxruntime can run ({_reason(error)}); check the "
                "path, or export it again"
            ) from error
    if device == "cuda" and CUDA not in session.get_providers():
        raise MissingExtraError(
            "--device cuda was asked for, but onnxruntime cannot start CUDA here; check the "
            "driver and the CUDA and cuDNN libraries that onnxruntime-gpu needs, or use "
            "--device cpu"
        )
    return session


def load_runtime() -> Any:
    """Return the module onnxruntime; MissingExtraError without it."""
    # The import takes 0.3 s. It looks for devices, and writes to the terminal which it misses.
    try:
        with silence_libraries():
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


def _reason(error: Exception) -> str:
    """Return the first line of onnxruntime's message, without its codes and source lines."""
    line = str(error).strip().splitlines()[0] if str(error).strip() else type(error).__name__
    text = _CODES.split(line)[-1]
    if match := _SOURCE_LINE.search(text):
        # The function after it is a name or, behind an absolute path, a signature.
        function_and_message = text[match.end() :]
        message = function_and_message.partition(" ")[2]
        if match[0].startswith("/"):
            message, depth = "", 0
            for index, character in enumerate(function_and_message):
                depth += (character == "(") - (character == ")")
                if character == ")" and depth == 0:
                    message = function_and_message[index + 1 :].removeprefix(" const")
                    break
        text = message or text
    text = text.strip().rstrip(".")
    half = LONGEST_REASON // 2
    return text if len(text) <= LONGEST_REASON else f"{text[:half]} … {text[-half:]}"
