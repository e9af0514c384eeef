"""The checksum that generated files carry: of the whole file, with its own digits as zeros.

It is XXH128, which shows whatever disks and networks do to a file; who wants to deceive is not kept
out, nor would be by another that stands in the file itself. A frame of 1920x1080 takes 0.2 ms; with
SHA-256 it took 4.7.
"""

from __future__ import annotations

from collections.abc import Iterable

import xxhash

NAME = "xxh128"
DIGITS = 32
ZEROS = "0" * DIGITS

new = xxhash.xxh3_128
"""Makes an object that digests, as those of hashlib do."""


def digits_of(pieces: Iterable[bytes | bytearray | memoryview]) -> str:
    """Return the checksum of bytes given piece by piece, hexadecimal."""
    digest = new()
    for piece in pieces:
        digest.update(piece)
    return digest.hexdigest()
