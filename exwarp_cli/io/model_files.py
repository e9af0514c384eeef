"""The files of models: those that come with ExWarp, and those that the user names."""

from __future__ import annotations

import errno
import hashlib
import json
import os
import stat
from pathlib import Path

from exwarp_cli.errors import DamagedFileError, InputError

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
    # Without waiting, as a pipe into which nobody writes would keep whoever opens it.
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
