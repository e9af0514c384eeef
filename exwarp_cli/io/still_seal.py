"""What a generated still image says of itself, and a checksum that shows any damage.

Both stand in the one text that most formats keep: the name of the software that wrote the file. The
checksum is that of EXR frames. In PNG the text has a checksum of its own, which is renewed along
with the digits.
"""

from __future__ import annotations

import json
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from exwarp_cli import __version__
from exwarp_cli.errors import InputError
from exwarp_cli.io import checksum
from exwarp_cli.io.reading_retry import with_retries

_MARK = f"exwarp:{checksum.NAME}=".encode()
_ZEROS = checksum.ZEROS.encode()
_PNG = b"\x89PNG\r\n\x1a\n"


def software(attributes: Mapping[str, Any] | None) -> str:
    """Return the text that says what a frame was made of, with room for the checksum.

    None is for formats that cut such texts off: they get the program's name alone.
    """
    if attributes is None:
        return f"ExWarp {__version__}"
    facts = json.dumps(dict(attributes), sort_keys=True, ensure_ascii=True)
    return f"ExWarp {__version__} {_MARK.decode()}{_ZEROS.decode()} {facts}"


def seal_still(data: bytes) -> bytes:
    """Put the checksum into an encoded file; as it is where the format dropped the text."""
    blank = _with_digits(data, _ZEROS)
    if blank is None:
        return data
    sealed = _with_digits(blank, checksum.digits_of([blank]).encode())
    assert sealed is not None
    return sealed


def still_facts(path: Path) -> dict[str, Any] | None:
    """Return what an undamaged generated image was made of; None for anything else.

    Raises
    ------
    UnreadableError
        When the system does not let the file through.
    InputError
        When the file is there and cannot be read.
    """
    try:
        data = with_retries(path, path.read_bytes)
    except FileNotFoundError:
        return None
    except OSError as error:
        raise InputError(
            f"cannot read {path}: {error.strerror or error}; check the path and its rights"
        ) from error
    return facts_in_bytes(data)


def has_seal(data: bytes) -> bool:
    """Whether a file has a place for the checksum, whatever stands there."""
    return _MARK in data


def facts_in_bytes(data: bytes) -> dict[str, Any] | None:
    """Return what an undamaged generated image was made of, from its file's bytes."""
    blank, at = _with_digits(data, _ZEROS), data.find(_MARK) + len(_MARK)
    end = at + checksum.DIGITS
    if blank is None or checksum.digits_of([blank]).encode() != data[at:end]:
        return None
    text = data[end:].decode("latin-1").lstrip()
    try:
        facts, _ = json.JSONDecoder().raw_decode(text)
    except ValueError:
        return None
    return facts if isinstance(facts, dict) else None


def _with_digits(data: bytes, digits: bytes) -> bytes | None:
    """Return the file with other digits for its checksum; None where it has no place for them."""
    at = data.find(_MARK)
    if at < 0 or at + len(_MARK) + checksum.DIGITS > len(data):
        return None
    at += len(_MARK)
    changed = bytearray(data)
    changed[at : at + checksum.DIGITS] = digits
    if data.startswith(_PNG):
        _renew_chunk(changed, at)
    return bytes(changed)


def _renew_chunk(data: bytearray, inside: int) -> None:
    """Write the CRC of the PNG chunk that an offset lies in anew."""
    begin = len(_PNG)
    while begin + 12 <= len(data):
        size = int.from_bytes(data[begin : begin + 4], "big")
        end = begin + 8 + size
        if begin <= inside < end <= len(data) - 4:
            crc = zlib.crc32(data[begin + 4 : end])
            data[end : end + 4] = crc.to_bytes(4, "big")
            return
        begin = end + 4
