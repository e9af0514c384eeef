"""Still images other than EXR: PNG, JPEG, TIFF, DPX and whatever else OpenImageIO knows.

Codes are turned to scene-linear light and back by the curve that the file tells, else by that of
sRGB for integers and none for floats. A generated frame has the format, depth, channels and
metadata of its key frame. What it was made of stands in its attribute ``Software``, with a
checksum (in PNG a second one is renewed with it), where the format has room for it. DPX and TGA
keep only the program's name, so a resumed run makes their frames again; the others keep nothing, so
it refuses to replace them.
"""

from __future__ import annotations

import json
import struct
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import OpenImageIO as oiio

from exwarp_cli import __version__
from exwarp_cli.domain.colour import FILM, LINEAR, SRGB, TransferCurve
from exwarp_cli.domain.frame import Float32, Image, Window, require_size
from exwarp_cli.errors import DamagedFileError, InputError, LayoutError, UsageError
from exwarp_cli.io import checksum
from exwarp_cli.io.atomic import atomic_path, output_error
from exwarp_cli.io.exr.header import MAGIC, PNG
from exwarp_cli.io.exr.writer import Buffer
from exwarp_cli.io.reading_retry import with_retries
from exwarp_cli.runtime.read_registry import being_read

STILLS = (
    *(".png", ".jpg", ".jpeg", ".tif", ".tiff", ".dpx", ".cin", ".tga", ".bmp", ".webp"),
    *(".sgi", ".ppm", ".hdr"),
)
"""Suffixes of the sequences that are found beside EXR, in lower case."""

SEALED = (".png", ".jpg", ".jpeg", ".tif", ".tiff")
"""Suffixes of the formats that keep a text of any length."""

JPEG_QUALITY = 97
"""Of 100: from there on files grow much faster than errors fall."""

_DTYPES = {oiio.UINT8: np.uint8, oiio.UINT16: np.uint16, oiio.HALF: np.float16}
_FILM_TRANSFERS = ("Printing density", "Logarithmic")
# Structure, which the writer sets itself; and what belongs to the key frame's own pixels.
_NOT_CARRIED = ("oiio:", "compression", "smpte:", "dpx:TimeCode", "jpeg:Compression", "Software")
_DPX_NAME = 36
_DPX_TEXTS = ((36, 136), (136, 160), (160, 260), (260, 460), (460, 660))  # SMPTE 268M
_NO_DATE = "1970:01:01 00:00:00"


@dataclass(frozen=True)
class StillTemplate:
    """What a generated frame takes over from its key frame's file.

    Attributes
    ----------
    metadata
        Name, type and value of each attribute.
    dtype
        Of the code values in memory: uint8, uint16, float16 or float32.
    bits
        Of each value in the file, which may be fewer: 10 or 12 of 16.
    channels
        Of the file, 1 to 4: grey, grey and alpha, RGB, RGBA.
    curve
        Between code values and light.
    premultiplied
        Whether the file's codes are multiplied by alpha.
    """

    metadata: tuple[tuple[str, Any, Any], ...]
    dtype: np.dtype[Any]
    bits: int
    channels: int
    curve: TransferCurve
    premultiplied: bool

    @property
    def has_alpha(self) -> bool:
        """Whether there is an alpha channel."""
        return self.channels in (2, 4)

    @property
    def render(self) -> None:
        """How long the key frame took to render, as in `Template`: stills do not tell."""
        return None


def read_still(path: Path) -> tuple[Image, StillTemplate]:
    """Read an image.

    Returns
    -------
    image
        Scene-linear RGB, grey as three equal channels, with premultiplied alpha where there is
        alpha.
    template
        For frames made from it.

    Raises
    ------
    InputError
        When the file is missing.
    DamagedFileError
        When it cannot be read whole.
    LayoutError
        When it has other channels than grey or RGB, with or without alpha.
    UnreadableError
        When the system does not let it through.
    """
    return with_retries(path, partial(_read_still, path))


def _read_still(path: Path) -> tuple[Image, StillTemplate]:
    """Read an image, once."""
    with _opened(path) as file:
        template = _template(path, file.spec())
        codes = file.read_image(0, 0, 0, file.spec().nchannels, _type_of(template.dtype))
        why = file.geterror()
    if codes is None or why:
        raise _damaged(path, why)
    height, width = codes.shape[:2]
    window = Window(0, 0, width, height)
    return Image(_to_light(np.asarray(codes), template), window, window), template


def read_still_template(path: Path) -> StillTemplate:
    """Read the header of an image alone; raises what `read_still` does."""

    def read() -> StillTemplate:
        with _opened(path) as file:
            return _template(path, file.spec())

    return with_retries(path, read)


def still_size(path: Path) -> tuple[int, int]:
    """Return width and height of an image; raises what `read_still` does."""

    def read() -> tuple[int, int]:
        with _opened(path) as file:
            return file.spec().width, file.spec().height

    return with_retries(path, read)


def require_writer(path: Path) -> Any:
    """Return OpenImageIO's writer for a file name; raises UsageError where there is none."""
    writer = oiio.ImageOutput.create(path.suffix.lstrip("."))
    if writer is None:
        oiio.geterror()  # else it is printed at the end
        raise UsageError(
            f"frames cannot be written as {path.suffix}; name another output, such as "
            f"{path.stem}.####.png"
        )
    return writer


def has_room_for_alpha(suffix: str) -> bool:
    """Whether a format that is written keeps alpha."""
    writer = oiio.ImageOutput.create(suffix.lstrip("."))
    return writer is not None and bool(writer.supports("alpha"))


def quantise_still(pixels: Float32, template: StillTemplate) -> Float32:
    """Round pixels to the codes that the file will have, so that what is scored is what is kept."""
    template = _wide_enough(pixels, template)
    return _to_light(_to_codes(pixels, template), template)


def write_still(
    path: Path, image: Image, template: StillTemplate, attributes: Mapping[str, Any]
) -> list[Buffer]:
    """Write a generated frame, whole or not at all; return its bytes.

    Parameters
    ----------
    path
        Target; its folder exists. The suffix says the format.
    image
        Scene-linear [H, W, 3 or 4].
    template
        From the key frame's file.
    attributes
        What the frame was made of, its recipe among it; see `still_seal`.

    Raises
    ------
    OutputError
        When it cannot be written.
    UsageError
        When OpenImageIO cannot write the format.
    """
    file = require_writer(path)
    template = _wide_enough(image.pixels, template)
    codes = _to_codes(image.pixels, template)
    spec = _spec(codes, template, path.suffix.lower())
    keeps = path.suffix.lower() in SEALED
    spec.attribute("Software", software(attributes if keeps else None))
    with atomic_path(path) as temporary:
        temporary.touch()  # a bad folder shows here, with its reason
        written = file.open(str(temporary), spec) and file.write_image(codes)
        if not (written and file.close()):
            raise output_error(path, OSError(file.geterror().strip() or "the format refuses it"))
        data = _settled_header(temporary.read_bytes(), path.name)
        if path.suffix.lower() == ".webp":  # OpenImageIO reads its EXIF, but writes none
            data = with_orientation(data, spec.get_int_attribute("Orientation", 1))
        sealed = seal_still(data)
        temporary.write_bytes(sealed)
    return [sealed]


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    """Open an image, its alpha as the file has it."""
    if not path.is_file():
        raise InputError(f"there is no image {path}; check the path")
    head = b""
    with suppress(OSError), path.open("rb") as opened:
        head = opened.read(len(PNG))
    if head.startswith(MAGIC):  # as a still it would lose windows, layers and attributes
        raise InputError(f"{path} is an OpenEXR file by its content; name it .exr")
    if head.startswith(PNG) and not _ends(path):
        raise _damaged(path, "")  # its decoder would print that too
    hint = oiio.ImageSpec()
    hint.attribute("oiio:UnassociatedAlpha", 1)
    with being_read(path):
        file = oiio.ImageInput.open(str(path), hint)
        if file is None:
            raise _damaged(path, oiio.geterror())
        try:
            require_size(path, file.spec().height, file.spec().width)
            yield file
        finally:
            file.close()


def _ends(path: Path) -> bool:
    """Whether the chunks of a PNG go on to its end."""
    with path.open("rb") as file:
        file.seek(len(PNG))
        while len(head := file.read(8)) == 8:
            if head[4:] == b"IEND":
                return True
            file.seek(int.from_bytes(head[:4], "big") + 4, 1)
    return False


def _damaged(path: Path, why: str) -> DamagedFileError:
    said = " ".join(why.split()).rstrip(".") or "it ends early"
    return DamagedFileError(f"cannot read the image {path}: {said}; write it again")


def _template(path: Path, spec: Any) -> StillTemplate:
    names = tuple(spec.channelnames)
    if not 1 <= spec.nchannels <= 4 or (spec.nchannels in (2, 4) and spec.alpha_channel < 0):
        raise LayoutError(
            f"{path} has the channels {', '.join(names)}, and only grey or RGB is read, with or "
            "without alpha; write such images"
        )
    dtype = np.dtype(_DTYPES.get(spec.format.basetype, np.float32))
    bits = spec.get_int_attribute("oiio:BitsPerSample", 0)
    if (path.suffix.lower(), bits, spec.nchannels) == (".dpx", 10, 4):
        raise LayoutError(
            f"{path} is a DPX of 10 bits with alpha, whose pixels OpenImageIO does not read right; "
            "write it with 16 bits"
        )
    kept = tuple(
        (item.name, item.type, item.value)
        for item in spec.extra_attribs
        if not item.name.startswith(_NOT_CARRIED)
    )
    whole = 8 * dtype.itemsize
    return StillTemplate(
        kept,
        dtype,
        bits if dtype == np.uint16 and 8 < bits < whole else whole,
        spec.nchannels,
        _curve(spec, dtype),
        not spec.get_int_attribute("oiio:UnassociatedAlpha", 0),
    )


def _curve(spec: Any, dtype: np.dtype[Any]) -> TransferCurve:
    """Return the curve that the file tells, else the usual one."""
    transfer = spec.get_string_attribute("dpx:Transfer")
    space = spec.get_string_attribute("oiio:ColorSpace").lower()
    if transfer in _FILM_TRANSFERS or "log" in space:
        return FILM
    if space.startswith(("lin", "scene_linear", "acescg")) or dtype.kind == "f":
        return LINEAR
    return SRGB


def _to_light(codes: np.ndarray, template: StillTemplate) -> Float32:
    """Turn code values [H, W, 1 to 4] into scene-linear RGB with premultiplied alpha."""
    values = codes.astype(np.float32)
    if codes.dtype.kind == "u":
        values /= np.float32(np.iinfo(codes.dtype).max)
    if not template.has_alpha:
        light = template.curve.to_linear(values)
        return np.ascontiguousarray(np.broadcast_to(light, (*codes.shape[:2], 3)))
    colour, alpha = values[..., :-1], values[..., -1:]
    if template.premultiplied and template.curve is not LINEAR:
        colour = _divided(colour, alpha)
    light = template.curve.to_linear(colour)
    if not (template.premultiplied and template.curve is LINEAR):
        light = light * alpha
    light = np.broadcast_to(light, (*codes.shape[:2], 3))
    return np.concatenate([light, alpha], axis=-1)


def _wide_enough(pixels: Float32, template: StillTemplate) -> StillTemplate:
    """Return a template that holds the colour of a frame, whose key frame may be a grey file.

    Many programs write a frame without colour as a grey file, for example the start of a fade.
    """
    colour = pixels[..., :3]
    # The channels of a grey frame differ by rounding alone, if at all.
    grey = template.channels < 3 and np.allclose(
        colour, colour[..., :1], rtol=1e-5, atol=1e-6, equal_nan=True
    )
    if template.channels > 2 or grey:
        return template
    # A profile of a grey file is not valid for RGB.
    kept = tuple(item for item in template.metadata if not item[0].startswith("ICCProfile"))
    return replace(template, channels=template.channels + 2, metadata=kept)


def _to_codes(pixels: Float32, template: StillTemplate) -> np.ndarray:
    """Invert `_to_light`, rounding half up."""
    finite = np.nan_to_num(pixels, nan=0.0, posinf=65504.0, neginf=0.0)
    colour: Float32 = finite[..., : 3 if template.channels > 2 else 1]
    if template.has_alpha:
        alpha = finite[..., 3:4] if pixels.shape[-1] > 3 else np.ones_like(finite[..., :1])
        keep = template.premultiplied and template.curve is LINEAR
        colour = template.curve.to_code(colour if keep else _divided(colour, alpha))
        if template.premultiplied and not keep:
            colour = colour * alpha
        values = np.concatenate([colour, alpha], axis=-1)
    else:
        values = template.curve.to_code(colour)
    if template.dtype.kind == "f":
        largest = np.finfo(template.dtype).max
        bounded: np.ndarray = np.clip(values, -largest, largest).astype(template.dtype)
        return bounded
    return _rounded(values, template)


def _rounded(values: Float32, template: StillTemplate) -> np.ndarray:
    """Round 0 to 1 to codes of so many bits, spread over the type as OpenImageIO does."""
    top, whole = (1 << template.bits) - 1, 8 * template.dtype.itemsize
    steps = np.floor(np.clip(values, 0, 1).astype(np.float64) * top + 0.5).astype(np.uint32)
    if template.bits < whole:
        spare = whole - template.bits
        steps = (steps << np.uint32(spare)) | (steps >> np.uint32(template.bits - spare))
    return steps.astype(template.dtype)


def _divided(colour: Float32, alpha: Float32) -> Float32:
    """Undo the multiplication by alpha; where that is 0, nothing is left to undo."""
    return np.divide(colour, alpha, out=np.zeros_like(colour), where=alpha > 0)


def _spec(codes: np.ndarray, template: StillTemplate, suffix: str) -> Any:
    height, width, channels = codes.shape
    spec = oiio.ImageSpec(width, height, channels, _type_of(template.dtype))
    for name, kind, value in template.metadata:
        spec.attribute(name, kind, value)
        # OpenImageIO's Python drops other integers than those of 32 bits, EXIF's orientation too.
        if spec.getattribute(name) is None and isinstance(value, int) and abs(value) < 1 << 31:
            spec.attribute(name, value)
    if template.has_alpha:
        spec.alpha_channel = channels - 1
        spec.attribute("oiio:UnassociatedAlpha", int(not template.premultiplied))
    if template.bits < 8 * template.dtype.itemsize:
        spec.attribute("oiio:BitsPerSample", template.bits)
    if not spec.get_string_attribute("DateTime"):
        spec.attribute("DateTime", _NO_DATE)  # else the writer's clock, and no two runs alike
    if suffix == ".webp":
        spec.attribute("Compression", "lossless:100")
    if suffix in (".jpg", ".jpeg"):
        spec.attribute("Compression", f"jpeg:{JPEG_QUALITY}")
    return spec


def _settled_header(data: bytes, name: str) -> bytes:
    """Return a file with what its writer left to chance settled; only in DPX there is something.

    Its header has fields of text that are not cleared behind their end, and the temporary's name.
    """
    if data[:4] not in (b"SDPX", b"XPDS"):
        return data
    clean = bytearray(data)
    for begin, end in _DPX_TEXTS:
        text = clean[begin:end].partition(b"\0")[0]
        if begin == _DPX_NAME:
            text = bytearray(name.encode()[: end - begin - 1])
        clean[begin:end] = text.ljust(end - begin, b"\0")
    return bytes(clean)


def _type_of(dtype: np.dtype[Any]) -> Any:
    """Return OpenImageIO's name of a type."""
    names = {np.dtype(kind): base for base, kind in _DTYPES.items()}
    return names.get(dtype, oiio.FLOAT)


UPRIGHT = 1
"""The orientation of pixels that are shown as they are stored."""

_HEADER = 12  # "RIFF", the size of the rest, "WEBP"
_ALPHA, _EXIF = 0x10, 0x08  # flags of the chunk VP8X
_TAG, _SHORT = 0x0112, 3


def with_orientation(data: bytes, orientation: int) -> bytes:
    """Add an EXIF orientation to a lossless WebP file without metadata.

    https://developers.google.com/speed/webp/docs/container_specification

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
