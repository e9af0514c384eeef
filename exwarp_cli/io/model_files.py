"""The files of models: those that come with ExWarp, and those that the user names."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

from exwarp_cli.errors import DamagedFileError, InputError
from exwarp_cli.io.whole_file import read_whole

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
