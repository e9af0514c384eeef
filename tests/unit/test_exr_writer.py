"""EXR files whose chunks are compressed here: what OpenEXR writes, but for the compressed bytes."""

from __future__ import annotations

import io
import shutil
import struct
import subprocess
import threading
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
import OpenImageIO as oiio
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from isal import isal_zlib

from exwarp_cli.io.exr.header import attributes_in
from exwarp_cli.io.exr.writer import (
    LEVEL,
    LINES,
    OpenExrCompression,
    OutputPart,
    PendingHalf,
    deflate_stream,
    encode,
    encode_by_openexr,
    is_encoded_here,
)
from tests.unit.exr_files import any_bits, box

HERE = list(LINES)
LONG = "a.name.of.more.than.thirty-one.letters.Z"
EVERY_KIND: dict[str, Any] = {
    "owner": "Zoë",
    "take": 3,
    "exposure": 0.25,
    "screenWindowCenter": np.array([0.5, -0.5], np.float32),
    "gate": np.array([36, 24], np.int32),
    "offset": np.array([1.5, 2.5]),
    "up": np.array([0, 0, 1], np.float32),
    "axes": np.eye(3, dtype=np.float32),
    "camera": np.arange(16, dtype=np.float64).reshape(4, 4),
    "area": (np.array([0, 1], np.float32), np.array([2, 3], np.float32)),
    "chromaticities": (0.64, 0.33, 0.3, 0.6, 0.15, 0.06, 0.3127, 0.329),
    "framesPerSecond": Fraction(24000, 1001),
    "wrapmodes": "clamp",
    "keywords": ["one", "two"],
    "weights": [0.5, 0.25],
    "timeCode": OpenEXR.TimeCode(1, 2, 3, 4, *[0] * 14),
    "keyCode": OpenEXR.KeyCode(1, 2, 3, 4, 5, 4, 64),
    "envmap": OpenEXR.ENVMAP_LATLONG,
    LONG: 1,
}


def header(compression: Any, data: tuple[int, int, int, int], **more: Any) -> dict[str, Any]:
    return {
        "compression": compression,
        "type": OpenEXR.scanlineimage,
        "dataWindow": box(*data),
        "displayWindow": box(-3, 5, 40, 30),
        **more,
    }


def channel(rng: np.random.Generator, kind: str, shape: tuple[int, int]) -> np.ndarray:
    """Any bits that are no NaN, smooth ones, or few values."""
    out = any_bits(rng, kind, shape)
    return np.where(np.isnan(out), out.dtype.type(1), out)


def whole(parts: list[OutputPart]) -> bytes:
    return b"".join(encode(parts))


def decoded(data: bytes) -> list[dict[str, np.ndarray]]:
    with OpenEXR.File(io.BytesIO(bytes(data)), separate_channels=True) as file:
        return [{n: c.pixels for n, c in part.channels.items()} for part in file.parts]


def attributes(data: bytes) -> list[tuple[int, bytes, bytes, bytes]]:
    data = bytes(data)
    return [(a.part, a.name, a.kind, data[a.begin : a.end]) for a in attributes_in(data)]


def agree(parts: list[OutputPart]) -> bytes:
    """See that a file is encoded here, and is OpenEXR's in every attribute and bit."""
    assert all(is_encoded_here(*part) for part in parts)
    ours, theirs = whole(parts), bytes(encode_by_openexr(parts))
    assert ours[:8] == theirs[:8]
    assert attributes(ours) == attributes(theirs)
    for mine, expected in zip(decoded(ours), decoded(theirs), strict=True):
        assert mine.keys() == expected.keys()
        for name, plane in mine.items():
            assert plane.dtype == expected[name].dtype
            assert plane.tobytes() == expected[name].tobytes(), name
    return ours


def by_openimageio(path: Path, part: int = 0) -> dict[str, np.ndarray]:
    """Every channel in its own type, as the other reader has it."""
    source = oiio.ImageInput.open(str(path))
    spec = source.spec(part, 0)
    planes = {
        name: source.read_image(part, 0, c, c + 1, spec.channelformat(c))[..., 0]
        for c, name in enumerate(spec.channelnames)
    }
    assert not source.geterror()
    source.close()
    return planes


SETTINGS = settings(
    derandomize=True,
    max_examples=60,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
SIZES = st.one_of(st.integers(1, 5), st.integers(1, 70))
KINDS = st.sampled_from(["f2", "f4", "u4"])


class TestAgainstOpenEXR:
    @SETTINGS
    @given(
        st.sampled_from(HERE),
        SIZES,
        SIZES,
        st.tuples(st.integers(-50, 50), st.integers(-50, 50)),
        st.dictionaries(st.sampled_from(["R", "b", "A.Z", "Z", "é", LONG]), KINDS, min_size=1),
        st.integers(0, 2**32 - 1),
    )
    def test_any_window_and_channels(self, compression, height, width, origin, kinds, seed):
        rng = np.random.default_rng(seed)
        planes = {n: channel(rng, k, (height, width)) for n, k in kinds.items()}
        agree([(header(compression, (*origin, width, height)), planes)])

    @pytest.mark.parametrize("compression", HERE)
    def test_every_attribute(self, compression):
        planes = {"Y": np.ones((3, 4), np.float16)}
        data = agree([(header(compression, (2, -1, 4, 3), **EVERY_KIND), planes)])
        assert EVERY_KIND.keys() <= {name.decode() for _, name, _, _ in attributes(data)}

    @pytest.mark.parametrize("compression", HERE)
    def test_parts(self, compression, tmp_path):
        rng = np.random.default_rng(0)
        parts = [
            (header(compression, (0, 0, 33, 40), name="one"), {"R": channel(rng, "f2", (40, 33))}),
            (
                header(OpenEXR.ZIPS_COMPRESSION, (-9, 3, 5, 18), name="two", view="left"),
                {"Z": channel(rng, "f4", (18, 5)), "id": channel(rng, "u4", (18, 5))},
            ),
        ]
        (tmp_path / "a.exr").write_bytes(agree(parts))
        for i, (_, planes) in enumerate(parts):
            found = by_openimageio(tmp_path / "a.exr", i)
            assert {n: p.tobytes() for n, p in found.items()} == {
                n: p.tobytes() for n, p in planes.items()
            }


class TestSameBytes:
    @pytest.mark.parametrize("compression", [*HERE, OpenEXR.PIZ_COMPRESSION])
    @pytest.mark.parametrize("size", [(1, 1), (37, 50)])
    def test_of_halfs_and_of_floats_that_become_them(self, compression, size):
        """Of channels one by one, of all those of pixels, and of some; beside others."""
        rng = np.random.default_rng(0)
        pixels = rng.normal(0, 3, (*size, 4)).astype(np.float32)
        other = rng.normal(0, 3e4, (*size, 3)).astype(np.float32)
        floats = {c: PendingHalf(pixels[..., i], True) for i, c in enumerate("RGBA")}
        floats |= {c: PendingHalf(other[..., i], False) for i, c in enumerate("xy")}
        floats["mist"] = PendingHalf(np.ascontiguousarray(pixels[..., 0]), False)
        beside = {"id": np.arange(size[0] * size[1], dtype=np.uint32).reshape(size)}
        halfs = {c: plane.rounded() for c, plane in floats.items()}
        head = header(compression, (0, 0, size[1], size[0]))
        assert whole([(head, floats | beside)]) == whole([(head, halfs | beside)])

    def test_the_head_can_be_changed(self):
        part = header(OpenEXR.ZIP_COMPRESSION, (0, 0, 4, 3)), {"Y": np.ones((3, 4), np.float16)}
        for compression in (OpenEXR.ZIP_COMPRESSION, OpenEXR.PIZ_COMPRESSION):
            part[0]["compression"] = compression
            head = memoryview(encode([part])[0])
            assert not head.readonly
            assert [one.name for one in attributes_in(head)][:2] == [b"channels", b"compression"]

    def test_wherever_the_compressor_keeps_its_state(self):
        """ISA-L hashes an address of its own; with one-shot calls, 1 of 430 streams differed."""
        flat = np.zeros((1, 48), np.float16)
        part = header(OpenEXR.ZIPS_COMPRESSION, (0, 0, 48, 1)), {"Y": flat}
        done, found = threading.Event(), set()

        def encode() -> None:
            found.add(whole([part]))
            done.wait()

        usual = threading.stack_size(256 * 1024)
        threads = [threading.Thread(target=encode) for _ in range(1000)]
        try:
            for thread in threads:
                thread.start()
        finally:
            done.set()
            threading.stack_size(usual)
        for thread in threads:
            thread.join()
        assert len(found) == 1

    def test_at_thousands_of_addresses(self):
        """A byte flushed alone was not enough: of 24,000 streams of a row some 5 differed."""
        row = np.tile(np.random.default_rng(0).integers(0, 256, 500, np.uint8), 2).data
        found = set()
        for _ in range(3):
            held = []
            for _ in range(8000):
                found.add(b"".join(deflate_stream(row)))
                held.append(isal_zlib.compressobj(LEVEL))
        assert len(found) == 1


class TestReaders:
    @pytest.fixture(params=HERE, ids=lambda c: c.name)
    def file(self, request, tmp_path) -> tuple[Path, dict[str, np.ndarray]]:
        rng = np.random.default_rng(0)
        smooth = np.linspace(0, 1, 90 * 300).reshape(90, 300)
        planes = {
            "R": smooth.astype(np.float16),
            "G": rng.random((90, 300)).astype(np.float16),
            "B": np.zeros((90, 300), np.float16),
            "id": np.arange(90 * 300, dtype=np.uint32).reshape(90, 300) // 100,
        }
        path = tmp_path / "frame.exr"
        path.write_bytes(whole([(header(request.param, (-7, -9, 300, 90)), planes)]))
        return path, planes

    def test_openimageio(self, file):
        path, planes = file
        found = by_openimageio(path)
        for name, plane in planes.items():
            np.testing.assert_array_equal(found[name], plane)

    @pytest.mark.skipif(shutil.which("exrinfo") is None, reason="wants OpenEXR's exrinfo")
    def test_openexr_s_own_tools(self, file):
        """A third reader, of a distribution's version: its strict mode checks header and chunks."""
        done = subprocess.run(
            ["exrinfo", "-s", str(file[0])], capture_output=True, text=True, timeout=60
        )
        assert done.returncode == 0, done.stderr
        assert "error" not in (done.stdout + done.stderr).lower()

    def test_chunks_lie_where_the_table_says(self, file):
        path, _ = file
        data = path.read_bytes()
        at = list(attributes_in(data))[-1].end + 1
        step = {"ZIPS": 1}.get(oiio_compression(path), 16)
        starts = np.frombuffer(data, "<u8", -(-90 // step), at).tolist()
        at += 8 * len(starts)
        for i, start in enumerate(starts):
            line, size = struct.unpack_from("<ii", data, start)
            assert (start, line) == (at, -9 + i * step)
            at += 8 + size
        assert at == len(data)


def oiio_compression(path: Path) -> str:
    source = oiio.ImageInput.open(str(path))
    return str(source.spec().getattribute("compression")).upper()


class TestWhatIsLeftToOpenEXR:
    @pytest.mark.parametrize(
        ("changed", "planes"),
        [
            ({"compression": OpenEXR.PIZ_COMPRESSION}, {"Y": np.ones((3, 4), np.float16)}),
            (
                {"compression": OpenExrCompression(OpenEXR.ZIP_COMPRESSION)},
                {"Y": np.ones((3, 4), np.float16)},
            ),
            ({"lineOrder": OpenEXR.DECREASING_Y}, {"Y": np.ones((3, 4), np.float16)}),
            ({"compression": OpenEXR.PXR24_COMPRESSION}, {"Y": np.full((3, 4), 0.1, np.float32)}),
            ({"compression": OpenEXR.NO_COMPRESSION}, {"Y": np.ones((3, 4), np.float16)}),
        ],
        ids=["piz", "smaller", "lines from below", "pxr24", "none"],
    )
    def test_it_is_written_by_it(self, changed, planes):
        part = {**header(OpenEXR.ZIP_COMPRESSION, (0, 0, 4, 3)), **changed}, planes
        assert not is_encoded_here(*part)
        assert whole([part]) == bytes(encode_by_openexr([part]))

    def test_smaller_is_smaller(self):
        planes = {"Z": np.sqrt(np.arange(60000, dtype=np.float32) // 7).reshape(200, 300)}
        window = (0, 0, 300, 200)
        fast = whole([(header(OpenEXR.ZIP_COMPRESSION, window), planes)])
        small = whole([(header(OpenExrCompression(OpenEXR.ZIP_COMPRESSION), window), planes)])
        assert len(small) < len(fast) < planes["Z"].nbytes
        assert attributes(small) == attributes(fast)

    def test_noise_is_stored_as_it_is(self):
        noise = np.random.default_rng(0).integers(0, 2**32, (40, 64), np.uint32)
        data = whole([(header(OpenEXR.ZIP_COMPRESSION, (0, 0, 64, 40)), {"id": noise})])
        assert noise[:16].tobytes() in data

    def test_what_openexr_refuses_is_refused(self):
        bad = header(OpenEXR.ZIP_COMPRESSION, (0, 0, 4, 3), pixelAspectRatio=-1.0)
        with pytest.raises((RuntimeError, ValueError)):
            encode([(bad, {"Y": np.ones((3, 4), np.float16)})])
