"""The files of models: shipped ones and a user's, and what they declare.

A model's metadata may state `exwarp.interface`, the version of the inputs that it was made for, and
`exwarp.stride`, the number that the height and width of what it takes must be multiples of.
"""

from __future__ import annotations

import errno
import hashlib
import json
import os
import re
import stat
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from exwarp_cli.domain.network_api import TIME_INPUT, NetworkInterface
from exwarp_cli.errors import DamagedFileError, InputError, LayoutError

MOST_BYTES = 2**31 - 1
"""What a file in Protocol Buffers may have, and more than any other that is read whole."""


def read_whole(path: Path) -> bytes:
    """Read a file on a disk.

    Raises
    ------
    OSError
        When it cannot be read, is too large, or is a folder, a pipe or a device, some of which
        never end and others never begin.
    """
    # Without waiting: to open a pipe into which no process writes would never end.
    flags = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
    with open(path, "rb", opener=lambda name, _: os.open(name, flags)) as file:
        status = os.fstat(file.fileno())
        if not stat.S_ISREG(status.st_mode):
            raise OSError(errno.EINVAL, "it is a pipe or a device", str(path))
        if status.st_size > MOST_BYTES:
            raise OSError(errno.EFBIG, "it has more than 2 GiB", str(path))
        return file.read(MOST_BYTES)


CHECKSUMS = "checksums.json"
"""Beside the shipped models: SHA-256 by file name."""


def shipped_folder() -> Path:
    """Return where the models that come with ExWarp lie: in the package, or in a clone beside."""
    package = Path(__file__).resolve().parents[1]
    inside = package / "_models"
    return inside if inside.is_dir() else package.parent / "models"


def read_model(path: Path | None, shipped: str, option: str) -> tuple[Path, bytes]:
    """Read a model's file.

    Parameters
    ----------
    path
        What the user named; None for what comes with ExWarp, whose checksum is verified.
    shipped
        Name of the file that comes with ExWarp.
    option
        By which the user may name another.

    Returns
    -------
    Path and bytes
        Where it lies, and its content.

    Raises
    ------
    InputError
        When there is no such file, it cannot be read, or its checksum is missing or differs.
    """
    if path is not None:
        return path, _read(path)
    path = shipped_folder() / shipped
    return path, _read_shipped(path, option)


def _read(path: Path) -> bytes:
    try:
        return read_whole(path)
    except FileNotFoundError as error:
        raise InputError(f"there is no model {path}; check the path") from error
    except OSError as error:
        raise InputError(
            f"cannot read the model {path}: {error.strerror}; check the path and its rights"
        ) from error


def _read_shipped(path: Path, option: str) -> bytes:
    """Read a model that comes with ExWarp, and make sure that it is that one."""
    try:
        data = path.read_bytes()
        expected = json.loads((path.parent / CHECKSUMS).read_bytes())[path.name]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(
            f"the model {path}, which comes with ExWarp, is missing or has no checksum beside it; "
            f"install ExWarp again, or name a model with {option}"
        ) from error
    if hashlib.sha256(data).hexdigest() != expected:
        raise DamagedFileError(
            f"the model {path} is not the one that came with ExWarp, its checksum differs; install "
            f"ExWarp again, or name this model with {option}"
        )
    return data


STRIDE_KEY, INTERFACE_KEY = "exwarp.stride", "exwarp.interface"
DEFAULT_STRIDE, MOST_STRIDE = 8, 256

LONGEST_REASON = 240
_CODES = re.compile(r"\[ONNXRuntimeError\] : \d+ : \w+ : ")
_PLACE = re.compile(r"\S+\.(?:cc|h|cpp):\d+ ")


def require_interface(path: Path, metadata: Mapping[str, str], interface: NetworkInterface) -> None:
    """Refuse a network that states another interface than this one."""
    stated = metadata.get(INTERFACE_KEY, interface.version)
    if stated != interface.version:
        raise LayoutError(
            f"{path} was made for the interface {stated}, and this is {interface.version}; "
            "use a model for this version of ExWarp"
        )


def stated_stride(path: Path, metadata: Mapping[str, str]) -> int:
    """Return what height and width have to be multiples of; LayoutError for no such number."""
    text = metadata.get(STRIDE_KEY, str(DEFAULT_STRIDE))
    if not text.isdecimal() or not 1 <= int(text) <= MOST_STRIDE:
        raise LayoutError(
            f"{path} states {STRIDE_KEY} = {text!r} in its metadata; state a whole number "
            f"from 1 to {MOST_STRIDE}"
        )
    return int(text)


def require_nodes(
    path: Path,
    inputs: Mapping[str, Any],
    outputs: Mapping[str, Any],
    interface: NetworkInterface,
) -> None:
    """Refuse a network whose inputs and outputs are not those of an interface.

    Parameters
    ----------
    path
        Of the file.
    inputs, outputs
        By name, each with `name`, `type` and `shape` as onnxruntime tells them.
    interface
        What they must be.

    Raises
    ------
    LayoutError
        Which tells the first thing that does not fit.
    """
    _require_names(path, inputs, outputs, interface)
    for name, node in inputs.items():
        shape = (1,) if name == TIME_INPUT else (1, interface.inputs[name], None, None)
        _require_shape(path, node, "input", shape)
    _require_shape(path, outputs[interface.output], "output", (1, interface.made, None, None))


def written_shape(shape: Sequence[Any]) -> str:
    """Write a shape; free sizes by their name or as ``?``."""
    return f"[{', '.join('?' if size is None else str(size) for size in shape)}]"


def unusable(path: Path, error: Exception) -> InputError:
    """Say why a file is no model that runs."""
    return DamagedFileError(
        f"{path} is no ONNX model that onnxruntime can run ({reason(error)}); check the path, or "
        "export it again"
    )


def reason(error: Exception) -> str:
    """First line of what onnxruntime says, without its codes and the places in its own text."""
    line = str(error).strip().splitlines()[0] if str(error).strip() else type(error).__name__
    text = _signed(_CODES.split(line)[-1]).strip().rstrip(".")
    half = LONGEST_REASON // 2
    return text if len(text) <= LONGEST_REASON else f"{text[:half]} … {text[-half:]}"


def _signed(text: str) -> str:
    """Leave out ``FILE.cc:LINE FUNCTION`` before what is said: a name, or the whole signature."""
    place = _PLACE.search(text)
    if place is None:
        return text
    rest = text[place.end() :]
    if not place[0].startswith("/"):
        return rest.partition(" ")[2] or text
    depth = 0
    for at, character in enumerate(rest):
        depth += (character == "(") - (character == ")")
        if character == ")" and depth == 0:
            return rest[at + 1 :].removeprefix(" const") or text
    return text


def _require_names(
    path: Path,
    inputs: Mapping[str, Any],
    outputs: Mapping[str, Any],
    interface: NetworkInterface,
) -> None:
    known = (*interface.inputs, TIME_INPUT)
    if foreign := [name for name in inputs if name not in known]:
        raise LayoutError(
            f"{path} has the input {foreign[0]!r}, which ExWarp does not give; export it "
            f"with inputs out of {', '.join(known)}"
        )
    if missing := [name for name in interface.required if name not in inputs]:
        raise LayoutError(
            f"{path} lacks the input {missing[0]!r}; export it with inputs out of "
            f"{', '.join(known)}"
        )
    if list(outputs) != [interface.output]:
        raise LayoutError(
            f"{path} has the output {', '.join(outputs) or 'none'}; export it with one output, "
            f"named {interface.output}"
        )


def _require_shape(path: Path, node: Any, what: str, shape: tuple[int | None, ...]) -> None:
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
            f"{path} has the {what} {node.name!r} as {node.type} {written_shape(found)} where "
            f"ExWarp needs tensor(float) {written_shape(shape)} with any height and width; "
            "export it so"
        )


def _size(value: object) -> int | None:
    """Return a declared size; None for a free one."""
    return value if isinstance(value, int) else None
