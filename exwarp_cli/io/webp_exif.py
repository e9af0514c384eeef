"""The EXIF orientation of a WebP file, by the container specification of WebP.

https://developers.google.com/speed/webp/docs/container_specification
"""

from __future__ import annotations

import struct

UPRIGHT = 1
"""The orientation of pixels that are shown as they are stored."""

_HEADER = 12  # "RIFF", the size of the rest, "WEBP"
_ALPHA, _EXIF = 0x10, 0x08  # flags of the chunk VP8X
_TAG, _SHORT = 0x0112, 3


def with_orientation(data: bytes, orientation: int) -> bytes:
    """Add an EXIF orientation to a lossless WebP file without metadata.

    Parameters
    ----------
    data
        The file: one chunk ``VP8L``, as encoders write it.
    orientation
        1 to 8 as in EXIF; with 1 the file stays as it is.
    """
    if orientation == UPRIGHT or data[_HEADER : _HEADER + 4] != b"VP8L":
        return data
    # A signature byte, then width - 1 and height - 1 in 14 bits each, then the bit for alpha.
    (bits,) = struct.unpack_from("<I", data, _HEADER + 9)
    width, height = bits & 0x3FFF, bits >> 14 & 0x3FFF
    flags = _EXIF | (_ALPHA if bits >> 28 & 1 else 0)
    extended = struct.pack("<I", flags) + width.to_bytes(3, "little") + height.to_bytes(3, "little")
    # A TIFF header, and a directory of this one tag.
    exif = struct.pack("<2sHIHHHIHHI", b"II", 42, 8, 1, _TAG, _SHORT, 1, orientation, 0, 0)
    body = b"WEBP" + _chunk(b"VP8X", extended) + data[_HEADER:] + _chunk(b"EXIF", exif)
    return b"RIFF" + struct.pack("<I", len(body)) + body


def _chunk(name: bytes, content: bytes) -> bytes:
    return name + struct.pack("<I", len(content)) + content + b"\0" * (len(content) % 2)
