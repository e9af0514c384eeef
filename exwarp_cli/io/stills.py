"""Still images other than EXR: PNG, JPEG, TIFF, DPX and whatever else OpenImageIO knows.

Codes are turned to scene-linear light and back by the curve that the file names, else by that of
sRGB for integers and none for floats. A generated frame has the format, depth, channels and
metadata of its key frame. Its attribute ``Software`` says what it was made of, with a checksum (in
PNG a second one is renewed with it), where the format has room for it. DPX and TGA keep only the
program's name, so a resumed run makes their frames again; the others keep nothing, so it refuses
to replace them.
"""

from __future__ import annotations

import json
import struct
import zlib
from collections.abc import Mapping
from contextlib import closing, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import OpenImageIO as oiio

from exwarp_cli import __version__
from exwarp_cli.domain.colour import FILM, LINEAR, SRGB, TransferCurve
from exwarp_cli.domain.frame import Float32, Image, Window, require_size
from exwarp_cli.errors import DamagedFileError, InputError, LayoutError, UsageError
from exwarp_cli.io import files
from exwarp_cli.io.display_colour import HALF_MAX
from exwarp_cli.io.exr.header import MAGIC, PNG
from exwarp_cli.io.exr.writer import Buffer
from exwarp_cli.runtime.read_registry import report_reading

# Suffixes of the sequences that are found beside EXR, in lower case.
STILLS = (
    *(".png", ".jpg", ".jpeg", ".tif", ".tiff", ".dpx", ".cin", ".tga", ".bmp", ".webp"),
    *(".sgi", ".ppm", ".hdr"),
)
# Suffixes of the formats that keep a text of any length.
SEALED = (".png", ".jpg", ".jpeg", ".tif", ".tiff")

JPEG_QUALITY = 97  # of 100: from there on files grow much faster than errors fall

_DTYPES = {oiio.UINT8: np.uint8, oiio.UINT16: np.uint16, oiio.HALF: np.float16}
_OIIO_TYPES = {np.dtype(kind): base for base, kind in _DTYPES.items()}
_FILM_TRANSFERS = ("Printing density", "Logarithmic")
# Structure, which the writer sets itself; and what belongs to the key frame's own pixels.
_NOT_CARRIED = ("oiio:", "compression", "smpte:", "dpx:TimeCode", "jpeg:Compression", "Software")
_DPX_NAME = 36
_DPX_TEXTS = ((36, 136), (136, 160), (160, 260), (260, 460), (460, 660))  # SMPTE 268M
_NO_DATE = "1970:01:01 00:00:00"

_SEAL_MARK = f"exwarp:{files.CHECKSUM_NAME}=".encode()

_UPRIGHT = 1  # the EXIF orientation of pixels that are shown as they are stored
_RIFF_HEADER = 12  # bytes: "RIFF", the size of the rest, "WEBP"
_VP8X_ALPHA, _VP8X_EXIF = 0x10, 0x08
_ORIENTATION_TAG, _SHORT = 0x0112, 3


@dataclass(frozen=True)
class StillTemplate:
    """What a generated frame takes over from its key frame's file."""

    metadata: tuple[tuple[str, Any, Any], ...]  # Name, type and value of each attribute
    dtype: np.dtype[Any]  # of the code values in memory: uint8, uint16, float16 or float32
    bits: int  # of each value in the file, which may be fewer: 10 or 12 of 16
    channels: int  # of the file, 1 to 4: grey, grey and alpha, RGB, RGBA
    curve: TransferCurve  # between code values and light
    premultiplied: bool  # whether the file's codes are multiplied by alpha

    render: ClassVar[None] = None  # time of the key frame, as in `Template`: unknown in stills

    @property
    def has_alpha(self) -> bool:
        """Whether there is an alpha channel."""
        return self.channels in (2, 4)

    @property
    def is_divided(self) -> bool:
        """Whether colour is divided by alpha where the curve is applied."""
        return self.has_alpha and not (self.premultiplied and self.curve is LINEAR)


def read_still(path: Path) -> tuple[Image, StillTemplate]:
    """Read an image, and the template for frames that are made from it.

    The image is scene-linear RGB, grey as three equal channels, with premultiplied alpha where
    there is alpha.

    Raises InputError when the file is missing, DamagedFileError when it cannot be read whole, and
    LayoutError when it has other channels than grey or RGB, with or without alpha. Raises
    UnreadableError when the system does not let it through.
    """
    template, codes = files.with_retries(path, lambda: _read_file(path))
    window = Window(0, 0, codes.shape[1], codes.shape[0])
    return Image(_to_light(codes, template), window, window), template


def read_still_header(path: Path) -> tuple[StillTemplate, Window]:
    """Read the template and the window of an image alone; raises what `read_still` does."""
    template, codes = files.with_retries(path, lambda: _read_file(path, pixels=False))
    return template, Window(0, 0, codes.shape[1], codes.shape[0])


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


def quantise_still(pixels: Float32, template: StillTemplate) -> Float32:
    """Round pixels to the codes of the file, so that scores hold for the written frame."""
    template = _widen_grey(pixels, template)
    return _to_light(_to_codes(pixels, template), template)


def write_still(
    path: Path, image: Image, template: StillTemplate, attributes: Mapping[str, Any]
) -> list[Buffer]:
    """Write a generated frame, whole or not at all; return its bytes.

    The suffix names the format, the image is scene-linear [H, W, 3 or 4], and the folder exists.
    `attributes` say what the frame was made of, its fingerprint among it; they are kept with the
    checksum. Raises OutputError when it cannot be written. Raises UsageError when OpenImageIO
    cannot write the format.
    """
    writer = require_writer(path)
    suffix = path.suffix.lower()
    template = _widen_grey(image.pixels, template)
    codes = _to_codes(image.pixels, template)
    height, width, channels = codes.shape
    spec = oiio.ImageSpec(width, height, channels, _OIIO_TYPES.get(template.dtype, oiio.FLOAT))
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
    software = f"ExWarp {__version__}"
    if suffix in SEALED:  # other formats cut such texts off
        facts = json.dumps(dict(attributes), sort_keys=True, ensure_ascii=True)
        software = f"{software} {_SEAL_MARK.decode()}{files.CHECKSUM_ZEROS} {facts}"
    spec.attribute("Software", software)
    with files.atomic_path(path) as temporary:
        temporary.touch()  # a bad folder shows here, with its reason
        is_written = writer.open(str(temporary), spec) and writer.write_image(codes)
        if not (is_written and writer.close()):
            raise OSError(writer.geterror().strip() or "the format refuses it")
        orientation = spec.get_int_attribute("Orientation", _UPRIGHT)
        sealed = seal_still(_mend_header(temporary.read_bytes(), path.name, orientation))
        temporary.write_bytes(sealed)
    return [sealed]


def _read_file(path: Path, pixels: bool = True) -> tuple[StillTemplate, np.ndarray]:
    """Read the template of an image, and its codes [H, W, C], alpha as the file has it.

    Without `pixels`, the codes are [H, W, 0].
    """
    if not path.is_file():
        raise InputError(f"there is no image {path}; check the path")
    head = b""
    with suppress(OSError), path.open("rb") as file:
        head = file.read(len(PNG))
    if head.startswith(MAGIC):  # as a still it would lose windows, layers and attributes
        raise InputError(f"{path} is an OpenEXR file by its content; name it .exr")
    if head.startswith(PNG):
        with path.open("rb") as file:
            file.seek(len(PNG))
            while len(chunk := file.read(8)) == 8 and chunk[4:] != b"IEND":
                file.seek(int.from_bytes(chunk[:4], "big") + 4, 1)
        if len(chunk) < 8:
            raise _damaged_error(path, "")  # its decoder would print that too
    hint = oiio.ImageSpec()
    hint.attribute("oiio:UnassociatedAlpha", 1)
    with report_reading(path):
        image = oiio.ImageInput.open(str(path), hint)
        if image is None:
            raise _damaged_error(path, oiio.geterror())
        with closing(image):
            spec = image.spec()
            require_size(path, spec.height, spec.width)
            template = _read_template(path, spec)
            if not pixels:
                return template, np.empty((spec.height, spec.width, 0))
            kind = _OIIO_TYPES.get(template.dtype, oiio.FLOAT)
            codes = image.read_image(0, 0, 0, spec.nchannels, kind)
            if (problem := image.geterror()) or codes is None:
                raise _damaged_error(path, problem)
            return template, np.asarray(codes)


def _damaged_error(path: Path, problem: str) -> DamagedFileError:
    reason = " ".join(problem.split()).rstrip(".") or "it ends early"
    return DamagedFileError(f"cannot read the image {path}: {reason}; write it again")


def _read_template(path: Path, spec: Any) -> StillTemplate:
    if not 1 <= spec.nchannels <= 4 or (spec.nchannels in (2, 4) and spec.alpha_channel < 0):
        raise LayoutError(
            f"{path} has the channels {', '.join(spec.channelnames)}, and only grey or RGB is "
            "read, with or without alpha; write such images"
        )
    dtype = np.dtype(_DTYPES.get(spec.format.basetype, np.float32))
    bits = spec.get_int_attribute("oiio:BitsPerSample", 0)
    if (path.suffix.lower(), bits, spec.nchannels) == (".dpx", 10, 4):
        raise LayoutError(
            f"{path} is a DPX of 10 bits with alpha, whose pixels OpenImageIO does not read right; "
            "write it with 16 bits"
        )
    metadata = tuple(
        (item.name, item.type, item.value)
        for item in spec.extra_attribs
        if not item.name.startswith(_NOT_CARRIED)
    )
    full_bits = 8 * dtype.itemsize
    # The curve that the file names, else the usual one of its type.
    curve, space = SRGB, spec.get_string_attribute("oiio:ColorSpace").lower()
    if spec.get_string_attribute("dpx:Transfer") in _FILM_TRANSFERS or "log" in space:
        curve = FILM
    elif space.startswith(("lin", "scene_linear", "acescg")) or dtype.kind == "f":
        curve = LINEAR
    return StillTemplate(
        metadata,
        dtype,
        bits if dtype == np.uint16 and 8 < bits < full_bits else full_bits,
        spec.nchannels,
        curve,
        not spec.get_int_attribute("oiio:UnassociatedAlpha", 0),
    )


def _to_light(codes: np.ndarray, template: StillTemplate) -> Float32:
    """Turn code values [H, W, 1 to 4] into scene-linear RGB with premultiplied alpha."""
    values = codes.astype(np.float32)
    if codes.dtype.kind == "u":
        values /= np.float32(np.iinfo(codes.dtype).max)
    colour, alpha = np.split(values, [values.shape[-1] - template.has_alpha], axis=-1)
    if template.is_divided and template.premultiplied:
        colour = np.divide(colour, alpha, out=np.zeros_like(colour), where=alpha > 0)
    light = template.curve.to_linear(colour)
    if template.is_divided:
        light = light * alpha
    return np.concatenate([np.broadcast_to(light, (*codes.shape[:2], 3)), alpha], axis=-1)


def _widen_grey(pixels: Float32, template: StillTemplate) -> StillTemplate:
    """Return a template of RGB where the key frame's file is grey and the frame is not.

    Many programs write a frame without colour as a grey file, for example the start of a fade.
    """
    if template.channels > 2:
        return template
    colour = pixels[..., :3]
    # The channels of a grey frame differ by rounding alone, if at all.
    if np.allclose(colour, colour[..., :1], rtol=1e-5, atol=1e-6, equal_nan=True):
        return template
    # A profile of a grey file is not valid for RGB.
    metadata = tuple(item for item in template.metadata if not item[0].startswith("ICCProfile"))
    return replace(template, channels=template.channels + 2, metadata=metadata)


def _to_codes(pixels: Float32, template: StillTemplate) -> np.ndarray:
    """Invert `_to_light`, rounding half up."""
    finite = np.nan_to_num(pixels, nan=0.0, posinf=HALF_MAX, neginf=0.0)
    colour: Float32 = finite[..., : 3 if template.channels > 2 else 1]
    alpha = finite[..., 3:4] if pixels.shape[-1] > 3 else np.ones_like(finite[..., :1])
    if template.is_divided:
        colour = np.divide(colour, alpha, out=np.zeros_like(colour), where=alpha > 0)
    values = template.curve.to_code(colour)
    if template.is_divided and template.premultiplied:
        values = values * alpha
    if template.has_alpha:
        values = np.concatenate([values, alpha], axis=-1)
    if template.dtype.kind == "f":
        largest = np.finfo(template.dtype).max
        return np.asarray(np.clip(values, -largest, largest), template.dtype)
    # Codes of fewer bits are spread over the type, as OpenImageIO does.
    top, spare = (1 << template.bits) - 1, 8 * template.dtype.itemsize - template.bits
    codes = np.floor(np.clip(values, 0, 1).astype(np.float64) * top + 0.5).astype(np.uint32)
    if spare:
        codes = (codes << np.uint32(spare)) | (codes >> np.uint32(template.bits - spare))
    return codes.astype(template.dtype)


def _mend_header(data: bytes, name: str, orientation: int) -> bytes:
    """Write what OpenImageIO does not: clean text in DPX, the orientation, 1 to 8, in WebP."""
    if data[:4] in (b"SDPX", b"XPDS"):
        # Behind the ends of texts is what the memory held, and the name is that of the temporary.
        clean = bytearray(data)
        for begin, end in _DPX_TEXTS:
            text = clean[begin:end].partition(b"\0")[0]
            if begin == _DPX_NAME:
                text = bytearray(name.encode()[: end - begin - 1])
            clean[begin:end] = text.ljust(end - begin, b"\0")
        return bytes(clean)
    # OpenImageIO reads WebP's EXIF, but writes none. The file has one chunk, as it is lossless:
    # https://developers.google.com/speed/webp/docs/container_specification
    if orientation == _UPRIGHT or data[_RIFF_HEADER - 4 : _RIFF_HEADER + 4] != b"WEBPVP8L":
        return data
    # A signature byte, then width - 1 and height - 1 in 14 bits each, then the bit for alpha.
    (bits,) = struct.unpack_from("<I", data, _RIFF_HEADER + 9)
    width, height = bits & 0x3FFF, bits >> 14 & 0x3FFF
    flags = _VP8X_EXIF | (_VP8X_ALPHA if bits >> 28 & 1 else 0)
    extended = struct.pack("<I", flags) + width.to_bytes(3, "little") + height.to_bytes(3, "little")
    # A TIFF header, and a directory of this one tag.
    exif = struct.pack(
        "<2sHIHHHIHHI", b"II", 42, 8, 1, _ORIENTATION_TAG, _SHORT, 1, orientation, 0, 0
    )
    # Both chunks are of an even size, so they need no byte that fills them up.
    front = b"WEBP" + struct.pack("<4sI", b"VP8X", len(extended)) + extended
    body: bytes = front + data[_RIFF_HEADER:] + struct.pack("<4sI", b"EXIF", len(exif)) + exif
    return struct.pack("<4sI", b"RIFF", len(body)) + body


def seal_still(data: bytes) -> bytes:
    """Put the checksum into an encoded file; unchanged where the format dropped its place."""
    start = data.find(_SEAL_MARK) + len(_SEAL_MARK)
    end = start + files.CHECKSUM_DIGITS
    if _SEAL_MARK not in data or end > len(data):
        return data
    # The chunk of a PNG that holds the checksum has a CRC behind it; other formats have none.
    chunk, begin = slice(0), len(PNG)
    while data.startswith(PNG) and begin + 12 <= len(data) and not chunk.stop:
        stop = begin + 8 + int.from_bytes(data[begin : begin + 4], "big")
        if begin <= start < stop <= len(data) - 4:
            chunk = slice(begin + 4, stop)
        begin = stop + 4
    sealed = bytearray(data)
    for is_complete in (False, True):
        digits = files.compute_checksum([sealed]) if is_complete else files.CHECKSUM_ZEROS
        sealed[start:end] = digits.encode()
        if chunk.stop:
            crc = zlib.crc32(sealed[chunk])
            sealed[chunk.stop : chunk.stop + 4] = crc.to_bytes(4, "big")
    return bytes(sealed)


def still_facts(path: Path) -> dict[str, Any] | None:
    """Return what an undamaged generated image was made of; None for anything else.

    Raises UnreadableError when the system does not let the file through. Raises InputError when the
    file is there and cannot be read.
    """
    try:
        data = files.with_retries(path, path.read_bytes)
    except FileNotFoundError:
        return None
    except OSError as error:
        raise InputError(
            f"cannot read {path}: {error.strerror or error}; check the path and its rights"
        ) from error
    is_authentic, facts = parse_still_facts(data)
    return facts if is_authentic else None


def parse_still_facts(data: bytes) -> tuple[bool, dict[str, Any] | None]:
    """Return whether an image's bytes are as ExWarp wrote them, and what it was made of.

    The facts are None for a file without a checksum, and {} for one that was changed.
    """
    if _SEAL_MARK not in data:
        return False, None
    facts = None
    if seal_still(data) == data:
        end = data.find(_SEAL_MARK) + len(_SEAL_MARK) + files.CHECKSUM_DIGITS
        with suppress(ValueError):  # there is no text, or it is cut off
            facts, _ = json.JSONDecoder().raw_decode(data[end:].decode("latin-1").lstrip())
    return (True, facts) if isinstance(facts, dict) else (False, {})
