"""Arrays in one file: .npz archives whose bytes depend on nothing but the arrays."""

from __future__ import annotations

import io
import struct
import zipfile
import zlib
from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[Any]

MOST_BYTES = 1 << 26
"""Of one array."""

MOST_OF_ALL = 1 << 28
"""Bytes of all arrays of an archive: each may claim much in little."""

_UNREADABLE = (
    *(zipfile.BadZipFile, zlib.error, ValueError, OSError, EOFError, MemoryError, struct.error),
    *(NotImplementedError, RuntimeError, KeyError, SyntaxError, OverflowError, TypeError),
)
"""What zipfile and numpy raise on bytes that are no such archive."""


class ArchiveError(ValueError):
    """Bytes that are no archive of arrays; its reader names the file."""


def pack(arrays: Mapping[str, Array], compressed: bool = False) -> bytes:
    """Pack arrays; nothing of the clock or the machine gets in, uncompressed nothing of zlib."""
    whole = io.BytesIO()
    method = zipfile.ZIP_DEFLATED if compressed else zipfile.ZIP_STORED
    with zipfile.ZipFile(whole, "w") as archive:
        for name, array in arrays.items():
            entry = zipfile.ZipInfo(f"{name}.npy", (1980, 1, 1, 0, 0, 0))
            entry.create_system, entry.external_attr = 3, 0o644 << 16
            data = io.BytesIO()
            plain = np.ascontiguousarray(array, array.dtype.newbyteorder("<"))
            np.lib.format.write_array(data, plain, (1, 0), allow_pickle=False)
            archive.writestr(entry, data.getvalue(), method)
    return whole.getvalue()


def unpack(data: bytes) -> dict[str, Array]:
    """Unpack an archive by its arrays' names.

    Raises
    ------
    ArchiveError
        When it is damaged, none at all, or holds anything but arrays of a sane size.
    """
    try:
        return _arrays(data)
    except _UNREADABLE as error:
        reason = (str(error) or type(error).__name__).splitlines()[0]
        raise ArchiveError(reason) from error


def _arrays(data: bytes) -> dict[str, Array]:
    arrays = {}
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        entries = archive.infolist()
        for entry in entries:
            if entry.file_size > MOST_BYTES:
                raise ValueError(f"{entry.filename} is too large")
        if sum(entry.file_size for entry in entries) > MOST_OF_ALL:
            raise ValueError("it is too large")
        for entry in entries:
            member = io.BytesIO(archive.read(entry))
            array = np.lib.format.read_array(member, allow_pickle=False)
            arrays[entry.filename.removesuffix(".npy")] = array
    return arrays
