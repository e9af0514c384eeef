"""What a file is by its first bytes. Libraries that guess it print what they think of the rest."""

from __future__ import annotations

from pathlib import Path

EXR = b"\x76\x2f\x31\x01"
PNG = b"\x89PNG\r\n\x1a\n"

_KINDS = (
    (EXR, "openexr"),
    (PNG, "png"),
    (b"\xff\xd8\xff", "jpeg"),
    (b"II*\0", "tiff"),
    (b"MM\0*", "tiff"),
    (b"SDPX", "dpx"),
    (b"XPDS", "dpx"),
    (b"#?R", "hdr"),
    (b"BM", "bmp"),
    (b"GIF8", "gif"),
    (b"8BPS", "psd"),
    (b"RIFF", "riff"),
    (b"\xff\x0a", "jpeg xl"),
    (b"\0\0\0\x0cjP", "jpeg 2000"),
    (b"\0\0\0\x0cJXL", "jpeg xl"),
)
_LONGEST = max(len(head) for head, _ in _KINDS)


def head_of(path: Path) -> bytes | None:
    """Return the first bytes of a file; None where it cannot be read, which its reader tells."""
    try:
        with path.open("rb") as file:
            return file.read(_LONGEST)
    except OSError:
        return None


def kind_of(head: bytes) -> str:
    """Return what begins so, in a few words."""
    if not head:
        return "nothing"
    return next((name for magic, name in _KINDS if head.startswith(magic)), "something else")
