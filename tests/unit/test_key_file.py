"""A key frame's file with another frame rate: its header alone changes."""

from __future__ import annotations

import hashlib
import struct
from fractions import Fraction
from pathlib import Path

import numpy as np
import OpenEXR
import OpenImageIO as oiio
import pytest

from exwarp_cli.errors import DamagedFileError, InputError
from exwarp_cli.io.exr.header import MULTIPART, attributes_in
from exwarp_cli.io.exr.writer import COMPRESSIONS
from exwarp_cli.io.generated_frames import is_intact, read_fingerprint, seal
from exwarp_cli.io.key_file import plan_key_file

RATE = Fraction(96)


def planes(seed: int = 0) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(seed)
    half = {name: rng.random((40, 70)).astype(np.float16) for name in "RGBA"}
    return half | {"Z": rng.random((40, 70)).astype(np.float32)}


def header(rate: object = Fraction(24), **more: object) -> dict[str, object]:
    stated = {} if rate is None else {"framesPerSecond": rate}
    return {
        "type": OpenEXR.scanlineimage,
        "compression": OpenEXR.ZIP_COMPRESSION,
        "owner": "Ada",
        "shot:take": 3,
        "chromaticities": (0.64, 0.33, 0.3, 0.6, 0.15, 0.06, 0.3127, 0.329),
        **stated,
        **more,
    }


def write_multipart(path: Path) -> None:
    parts = [OpenEXR.Part(header(None), planes(1), "a"), OpenEXR.Part(header(25.0), planes(2), "b")]
    OpenEXR.File(parts).write(str(path))


def write_tiled(path: Path, mipmaps: bool = False) -> None:
    spec = oiio.ImageSpec(70, 40, 3, "half")
    spec.tile_width = spec.tile_height = 32
    spec.attribute("compression", "zip")
    image = oiio.ImageBuf(np.ascontiguousarray(np.stack([planes()[c] for c in "RGB"], -1)))
    if mipmaps:
        config = oiio.ImageSpec()
        config.attribute("compression", "zip")
        made = oiio.ImageBufAlgo.make_texture(oiio.MakeTxTexture, image, str(path), config)
        assert made, oiio.geterror()
        return
    output = oiio.ImageOutput.create(str(path))
    assert output.open(str(path), spec) and output.write_image(image.get_pixels("half"))
    output.close()


def write_deep(path: Path) -> None:
    spec = oiio.ImageSpec(9, 7, 2, "float")
    spec.channelnames, spec.deep = ("A", "Z"), True
    spec.channelformats = (oiio.FLOAT, oiio.FLOAT)
    deep = oiio.DeepData()
    deep.init(63, 2, ["float", "float"], ["A", "Z"])
    for pixel in range(63):
        deep.set_samples(pixel, pixel % 3)
        for sample in range(pixel % 3):
            deep.set_deep_value(pixel, 1, sample, float(pixel + sample))
    output = oiio.ImageOutput.create(str(path))
    assert output.open(str(path), spec), output.geterror()
    assert output.write_deep_image(deep), output.geterror()
    output.close()


KINDS = {
    **{
        name: lambda path, name=name: OpenEXR.File(
            header(compression=COMPRESSIONS[name]), planes()
        ).write(str(path))
        for name in COMPRESSIONS
    },
    "no rate": lambda path: OpenEXR.File(header(None), planes()).write(str(path)),
    "float": lambda path: OpenEXR.File(header(24.0), planes()).write(str(path)),
    "text": lambda path: OpenEXR.File(header("24000/1001"), planes()).write(str(path)),
    "wide header": lambda path: OpenEXR.File(header(None, note="x" * 200_000), planes()).write(
        str(path)
    ),
    "parts": write_multipart,
    "tiled": write_tiled,
    "mipmapped": lambda path: write_tiled(path, mipmaps=True),
    "deep": write_deep,
}


def layout(data: bytes) -> tuple[list[tuple[int, bytes, bytes, bytes]], list[int], bytes]:
    """Return a file's attributes, where its chunks lie from the first one on, and the chunks."""
    found = list(attributes_in(data))
    end = found[-1].end + 1 + bool(int.from_bytes(data[4:8], "little") & MULTIPART)
    table: list[int] = []
    while end + 8 * len(table) < min(table, default=len(data)):
        table += struct.unpack_from("<Q", data, end + 8 * len(table))
    first = end + 8 * len(table)
    listed = [(one.part, one.name, one.kind, data[one.begin : one.end]) for one in found]
    return listed, [place - first for place in table], data[first:]


def decoded(path: Path) -> list[np.ndarray]:
    """Return the pixels of every subimage as OpenImageIO has them."""
    found, image = [], oiio.ImageInput.open(str(path))
    part = 0
    while image.seek_subimage(part, 0):
        if image.spec().deep:
            deep = image.read_native_deep_image(part, 0)
            found.append(
                np.array(
                    [
                        deep.deep_value(p, 1, s)
                        for p in range(deep.pixels)
                        for s in range(deep.samples(p))
                    ]
                )
            )
        else:
            found.append(image.read_image(part, 0, 0, image.spec().nchannels, "float"))
        part += 1
    return found


@pytest.mark.parametrize("kind", KINDS)
def test_chunks_are_copied_and_only_the_rate_changes(tmp_path, kind):
    source, target = tmp_path / "a.exr", tmp_path / "b.exr"
    KINDS[kind](source)
    file = plan_key_file(source, RATE)
    file.write(target)
    (before, places, chunks), (after, moved, copied) = map(
        layout, (source.read_bytes(), target.read_bytes())
    )
    assert (moved, copied) == (places, chunks)
    others = [[one for one in items if one[1] != b"framesPerSecond"] for items in (before, after)]
    assert others[0] == others[1]
    rates = [one for one in after if one[1] == b"framesPerSecond"]
    value = struct.pack("<ii", 96, 1)
    parts = {one[0] for one in before}
    assert rates == [(part, b"framesPerSecond", b"rational", value) for part in sorted(parts)]
    for one, other in zip(decoded(source), decoded(target), strict=True):
        assert one.size and np.array_equal(one, other)
    assert file.is_at(target) and not file.is_at(source)
    assert not file.is_at(tmp_path / "absent.exr") and not file.is_at(tmp_path)
    digest = hashlib.sha256(target.read_bytes()).digest()
    assert hashlib.sha256(b"".join(file.pieces())).digest() == digest


@pytest.mark.parametrize("rate", [Fraction(96), 96, 96.0, "96", Fraction(96_000_001, 1_000_000)])
def test_a_rate_that_does_not_contradict_is_left_as_it_is(tmp_path, rate):
    source = tmp_path / "a.exr"
    OpenEXR.File(header(rate), planes()).write(str(source))
    assert b"".join(plan_key_file(source, RATE).pieces()) == source.read_bytes()


def test_without_a_rate_the_bytes_are_copied(tmp_path):
    source, target = tmp_path / "a.exr", tmp_path / "b.exr"
    OpenEXR.File(header(), planes()).write(str(source))
    file = plan_key_file(source, None)
    file.write(target)
    assert target.read_bytes() == source.read_bytes() and file.is_at(target)


def test_a_key_frame_that_has_a_checksum_keeps_a_valid_one(tmp_path):
    source, target = tmp_path / "a.exr", tmp_path / "b.exr"
    OpenEXR.File(header(**{"exwarp:xxh128": "0" * 32}), planes()).write(str(source))
    (sealed,) = seal(bytearray(source.read_bytes()))
    for data, valid in ((bytes(sealed), True), (bytes(sealed)[:-1] + b"!", False)):
        source.write_bytes(data)
        plan_key_file(source, RATE).write(target)
        assert is_intact(source.read_bytes()) == is_intact(target.read_bytes()) == valid


MARKS: dict[str, str | int] = {"kind": "rendered", "slot": 2, "recipe": "ab12"}


@pytest.mark.parametrize("kind", KINDS)
def test_marks_and_a_checksum_join_the_first_header(tmp_path, kind):
    source, target = tmp_path / "a.exr", tmp_path / "b.exr"
    KINDS[kind](source)
    plan_key_file(source, RATE, MARKS).write(target)
    (before, places, chunks), (after, moved, copied) = map(
        layout, (source.read_bytes(), target.read_bytes())
    )
    assert (moved, copied) == (places, chunks)
    own = {name: value for part, name, _, value in after if name.startswith(b"exwarp:")}
    assert own[b"exwarp:kind"] == b"rendered" and own[b"exwarp:slot"] == struct.pack("<i", 2)
    assert {part for part, name, *_ in after if name in own} == {0}
    new = {b"framesPerSecond", *own}
    kept = [[one for one in items if one[1] not in new] for items in (before, after)]
    assert kept[0] == kept[1]
    assert is_intact(target.read_bytes()) and read_fingerprint(target) == "ab12"


def test_marks_take_the_place_of_earlier_ones(tmp_path):
    source, target = tmp_path / "a.exr", tmp_path / "b.exr"
    earlier = {"exwarp:kind": "generated", "exwarp:xxh128": "0" * 32, "exwarp:key": 1}
    parts = [OpenEXR.Part(header(**earlier), planes(), name) for name in "ab"]
    OpenEXR.File(parts).write(str(source))
    plan_key_file(source, None, MARKS).write(target)
    names = [one.name for one in attributes_in(target.read_bytes())]
    assert names.count(b"exwarp:kind") == 1 and b"exwarp:key" not in names
    assert is_intact(target.read_bytes())
    for one, other in zip(decoded(source), decoded(target), strict=True):
        assert np.array_equal(one, other)


def test_broken_files_are_refused_before_anything_is_written(tmp_path):
    source, target = tmp_path / "a.exr", tmp_path / "b.exr"
    OpenEXR.File(header(None), planes()).write(str(source))
    whole = source.read_bytes()
    table = list(attributes_in(whole))[-1].end + 1
    past = whole[:table] + b"\xff" * 8 + whole[table + 8 :]
    for data in (whole[:200], whole[: table + 5], past, b"no picture"):
        source.write_bytes(data)
        with pytest.raises(DamagedFileError, match=r"a\.exr"):
            plan_key_file(source, RATE)
    with pytest.raises(InputError, match="cannot read"):
        plan_key_file(tmp_path / "none.exr", RATE)
    assert not target.exists()
