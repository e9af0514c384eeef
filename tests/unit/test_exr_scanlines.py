"""EXR files that are decoded here: what OpenImageIO makes of them, bit for bit, or its own word."""

from __future__ import annotations

import io
import struct
import zlib
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
import pytest
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st

from exwarp_cli.io.exr import scanlines
from exwarp_cli.io.exr.header import Channel, attributes_in
from exwarp_cli.io.exr.reader import ExrFile
from exwarp_cli.io.exr.scanlines import LINES, REQUIRED
from exwarp_cli.io.frames import join_planes
from exwarp_cli.runtime import cores
from tests.matrix import FULL
from tests.unit.exr_files import (
    any_bits,
    box,
    deep_part,
    flat_part,
    header,
    plane,
    rgba,
    write_parts,
    write_single,
    write_subsampled,
    write_tiled,
)
from tests.unit.exr_reading import (
    agree,
    as_always,
    every,
    here,
    left,
    named,
    one_part_at_a_time,
    outcome,
    parts_of,
)

COMPRESSIONS = ["ZIPS", "ZIP"]
"""What is decoded here, in OpenEXR's spelling."""


def compression(name: str) -> Any:
    return getattr(OpenEXR, f"{name}_COMPRESSION")


SETTINGS = settings(
    derandomize=True,
    max_examples=80,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
SIZES = st.one_of(st.integers(1, 5), st.integers(1, 70))
ORIGINS = st.tuples(st.integers(-50, 50), st.integers(-50, 50))
KINDS = st.dictionaries(
    st.sampled_from(["R", "G", "A", "b", "A.Z", "Z", "Y", "RY", "é"]),
    st.sampled_from(["f2", "f4", "u4"]),
    min_size=1,
)
PARTS = st.lists(
    st.tuples(st.sampled_from(COMPRESSIONS), SIZES, SIZES, ORIGINS, KINDS), min_size=1, max_size=3
)


def write(path: Path, parts: list[tuple[Any, ...]], rng: np.random.Generator) -> Path:
    made = []
    for i, (name, height, width, origin, kinds) in enumerate(parts):
        planes = {n: any_bits(rng, k, (height, width)) for n, k in kinds.items()}
        window = {"dataWindow": box(*origin, width, height), "displayWindow": box(0, 0, 9, 9)}
        made.append(flat_part(planes, f"p{i}", compression=compression(name), **window))
    OpenEXR.File(made).write(str(path))
    return path


class TestAgainstOpenImageIO:
    @SETTINGS
    @given(PARTS, st.integers(1, 3), st.integers(0, 2**32 - 1))
    def test_any_windows_and_channels(self, tmp_path, parts, threads, seed):
        cores.set_count(threads, 8)
        agree(write(tmp_path / "a.exr", parts, np.random.default_rng(seed)))

    @SETTINGS
    @given(PARTS, st.integers(0, 2**32 - 1))
    def test_any_choice_of_channels(self, tmp_path, parts, seed):
        """In groups of any order, of which some have a channel of another."""
        rng = np.random.default_rng(seed)
        path = write(tmp_path / "a.exr", parts, rng)

        def choose(file: ExrFile) -> list[list[Channel]]:
            channels = every(file)
            mixed = [channels[i] for i in rng.permutation(len(channels))]
            return [mixed[: len(mixed) // 2 + 1], mixed[len(mixed) // 2 :][:2]]

        agree(path, choose)

    @pytest.mark.parametrize("name", COMPRESSIONS)
    def test_every_half_and_the_ends_of_floats(self, tmp_path, name):
        halves = np.arange(2**16, dtype=np.uint16).reshape(256, 256)
        ends = np.array([0, 1, 0x7F800000, 0x7F800001, 0x7FC00001, 0x007FFFFF], np.uint32)
        floats = np.resize(np.concatenate([ends, ends | 0x80000000]), (256, 256))
        planes = {"h": halves.view(np.float16), "f": floats.view(np.float32), "u": floats}
        agree(write_single(tmp_path / "a.exr", planes, compression=compression(name)))

    @pytest.mark.parametrize("name", COMPRESSIONS)
    def test_lines_from_below(self, tmp_path, name):
        more = {"compression": compression(name), "lineOrder": OpenEXR.DECREASING_Y}
        agree(write_single(tmp_path / "a.exr", rgba(50, 9), **more))

    @pytest.mark.parametrize("name", COMPRESSIONS)
    def test_what_did_not_become_smaller(self, tmp_path, name):
        noise = np.random.default_rng(0).integers(0, 2**32, (40, 64), np.uint32)
        path = write_single(tmp_path / "a.exr", {"id": noise}, compression=compression(name))
        assert noise[:1].tobytes() in path.read_bytes(), "stored as it is"
        agree(path)

    def test_more_chunks_than_a_thread_takes_at_a_time(self, tmp_path, monkeypatch):
        monkeypatch.setattr(scanlines, "RUN_BYTES", 10_000)
        path = write_single(
            tmp_path / "a.exr", rgba(300, 60) | {"id": plane(300, 60, 7, np.uint32)}
        )
        found = []
        for threads in (1, 2, 5):
            cores.set_count(threads, 8)
            found.append({n: a.tobytes() for n, a in agree(path).items()})
        assert found[0] == found[1] == found[2]

    def test_no_thread_can_be_started(self, tmp_path, monkeypatch):
        def refuse(*_: object) -> None:
            raise RuntimeError("can't start new thread")

        monkeypatch.setattr(scanlines, "RUN_BYTES", 10_000)
        monkeypatch.setattr(scanlines.ThreadPoolExecutor, "submit", refuse)
        cores.set_count(4, 8)
        agree(write_single(tmp_path / "a.exr", rgba(300, 60)))


class TestWhatIsRead:
    def test_parts_that_are_not_wanted_stay_on_disk(self, tmp_path, monkeypatch):
        noise = rgba(200, 300, np.float32)
        path = write_parts(
            tmp_path / "a.exr",
            {"a": (noise, {}), "z": ({"Z": plane(200, 300, 1)}, {}), "b": (noise, {})},
        )
        taken = []
        plain = scanlines.FileBytes.read_padded

        def counted(self: Any, start: int, size: int) -> np.ndarray:
            taken.append((start, size))
            return plain(self, start, size)

        monkeypatch.setattr(scanlines.FileBytes, "read_padded", counted)
        found = here(path, lambda file: [list(file.parts[1].channels)])
        assert (found[1, "Z"] == 1).all()
        z = parts_of(path.read_bytes())[1]
        assert z is not None
        pixels = [(start, size) for start, size in taken if start >= z.starts.min()]
        assert sum(size for _, size in pixels) == (z.ends - z.starts).sum()

    def test_a_share_that_fails_is_not_read_on(self, tmp_path, monkeypatch):
        """Each read of it may take a minute."""
        monkeypatch.setattr(scanlines, "RUN_BYTES", 10_000)
        path, tries = write_single(tmp_path / "a.exr", rgba(300, 60)), []

        def fail(_: object, start: int, size: int) -> np.ndarray:
            tries.append(start)
            raise TimeoutError

        monkeypatch.setattr(scanlines.FileBytes, "read_padded", fail)
        cores.set_count(1, 8)
        with ExrFile(path) as file, path.open("rb", buffering=0) as opened:
            request = file.header.layouts[0], list(file.parts[0].channels)
            assert scanlines.read_blocks(opened, [request]) == [None]
        assert len(tries) == 1

    def test_groups_are_joined_without_a_copy(self, tmp_path):
        path = write_single(tmp_path / "a.exr", rgba(5, 6) | {c: plane(5, 6, 1) for c in "XYZ"})

        def by_role(file: ExrFile) -> list[list[Channel]]:
            known = {c.raw_name: c for c in file.parts[0].channels}
            return [[known[c] for c in "RGBA"], [known[c] for c in "ZYX"]]

        found = here(path, by_role)
        for names in ("RGBA", "ZYX"):
            planes = [found[0, name] for name in names]
            assert np.shares_memory(join_planes(planes), planes[0])

    def test_a_file_is_read_on_after_its_name_is_gone(self, tmp_path):
        path = write_single(tmp_path / "a.exr", rgba(5, 6))
        with ExrFile(path) as file:
            first = named(file.read(every(file)))
            path.unlink()
            second = named(file.read(every(file)))
        assert all((first[name] == second[name]).all() for name in first)


class TestWhatIsLeftToOpenImageIO:
    @pytest.mark.parametrize(
        "name", ["NO", "RLE", "PIZ", "PXR24", "B44", "B44A", "DWAA", "DWAB", "HTJ2K32"]
    )
    def test_other_compressions(self, tmp_path, name):
        if not hasattr(OpenEXR, f"{name}_COMPRESSION"):
            pytest.skip("this OpenEXR does not have it")
        path = write_single(tmp_path / "a.exr", rgba(40, 50), compression=compression(name))
        assert left(path)
        with ExrFile(path) as file, ExrFile(path, by_openimageio=True) as other:
            assert file.parts == other.parts
        assert not left(write_single(tmp_path / "b.exr", rgba(40, 50)))

    def test_tiles_subsampled_and_deep_pixels(self, tmp_path):
        assert left(write_tiled(tmp_path / "a.exr", rgba(37, 70)))
        assert parts_of(write_subsampled(tmp_path / "b.exr").read_bytes()) == [None]
        OpenEXR.File([deep_part(9, 9, "d"), flat_part(rgba(9, 9), "f")]).write(
            str(tmp_path / "c.exr")
        )
        found = parts_of((tmp_path / "c.exr").read_bytes())
        assert found[0] is None and found[1] is not None
        with ExrFile(tmp_path / "c.exr") as file:
            assert (named(file.read(file.parts[1].channels))[1, "R"] == rgba(9, 9)["R"]).all()

    def test_each_part_by_itself(self, tmp_path):
        piz = {"compression": OpenEXR.PIZ_COMPRESSION}
        path = write_parts(
            tmp_path / "a.exr", {"a": (rgba(40, 50), piz), "z": ({"Z": plane(40, 50, 1)}, {})}
        )
        found = here(path, lambda file: [list(file.parts[1].channels)])
        assert (found[1, "Z"] == 1).all() and left(path)
        with ExrFile(path) as file:
            both = named(file.read(every(file)))
        assert all((both[0, c] == rgba(40, 50)[c]).all() for c in "RGBA")


class TestDamage:
    """Whatever is wrong with a file: OpenImageIO's pixels, or its error in the same words."""

    @settings(SETTINGS, max_examples=300 if FULL else 80)
    @given(PARTS, st.integers(0, 2**32 - 1))
    def test_flipped_bytes(self, tmp_path, parts, seed):
        rng = np.random.default_rng(seed)
        path = write(tmp_path / "a.exr", parts, rng)
        data = bytearray(path.read_bytes())
        begin = [*attributes_in(data)][-1].end if rng.random() < 0.8 else 0
        for at in rng.integers(begin, len(data), rng.integers(1, 4)):
            data[at] = rng.integers(256)
        path.write_bytes(data)
        assert outcome(lambda: as_always(path)) == outcome(lambda: one_part_at_a_time(path))

    @SETTINGS
    @given(PARTS, st.integers(0, 2**32 - 1))
    def test_truncated(self, tmp_path, parts, seed):
        rng = np.random.default_rng(seed)
        path = write(tmp_path / "a.exr", parts, rng)
        data = path.read_bytes()
        path.write_bytes(data[: rng.integers(1, len(data))])
        assert outcome(lambda: as_always(path)) == outcome(lambda: one_part_at_a_time(path))


def repacked(path: Path, change: Callable[[bytes], bytes]) -> Path:
    """Change what is stored of a chunk of a ZIP file of one chunk."""
    data = path.read_bytes()
    at = [*attributes_in(data)][-1].end + 1
    (start,) = struct.unpack_from("<Q", data, at)
    line, size = struct.unpack_from("<2i", data, start)
    packed = change(data[start + 8 : start + 8 + size])
    path.write_bytes(data[:start] + struct.pack("<2i", line, len(packed)) + packed)
    return path


class TestOddChunks:
    @pytest.fixture
    def path(self, tmp_path) -> Path:
        return write_single(tmp_path / "a.exr", {"Y": plane(10, 20, 1)})

    def same(self, path: Path) -> None:
        assert outcome(lambda: as_always(path)) == outcome(lambda: one_part_at_a_time(path))

    def test_the_tool_of_these_tests(self, path):
        repacked(path, lambda packed: zlib.compress(zlib.decompress(packed), 9))
        agree(path)

    @pytest.mark.parametrize(
        "change",
        [
            lambda packed: packed + b"\0",
            lambda packed: packed[:-4] + bytes(4),
            lambda packed: zlib.compress(zlib.decompress(packed)[:-1]),
            lambda packed: zlib.compress(zlib.decompress(packed) + b"\0"),
            lambda packed: zlib.compress(bytes(10**6)),
            lambda packed: b"",
            lambda packed: bytes(799),
        ],
        ids=["more", "checksum", "too short", "too long", "far too long", "nothing", "no stream"],
    )
    def test_not_what_they_should_be(self, path, change):
        assert left(repacked(path, change))
        self.same(path)

    def test_a_table_with_zeros_is_left(self, path):
        """So is what a renderer leaves that was stopped; OpenEXR looks for the chunks."""
        data = bytearray(path.read_bytes())
        at = [*attributes_in(data)][-1].end + 1
        data[at : at + 8] = bytes(8)
        path.write_bytes(data)
        assert left(path)
        self.same(path)

    def test_chunks_in_each_other_s_place(self, tmp_path):
        path = write_single(tmp_path / "a.exr", rgba(40, 20))
        data = bytearray(path.read_bytes())
        at = [*attributes_in(data)][-1].end + 1
        data[at : at + 8], data[at + 8 : at + 16] = data[at + 8 : at + 16], data[at : at + 8]
        path.write_bytes(data)
        assert left(path)
        self.same(path)

    def test_a_gap_between_them(self, tmp_path):
        path = write_single(tmp_path / "a.exr", rgba(40, 20))
        data = path.read_bytes()
        at = [*attributes_in(data)][-1].end + 1
        starts = [*struct.unpack_from("<3Q", data, at)]
        gap = bytes(100_000)
        moved = struct.pack("<3Q", starts[0], starts[1], starts[2] + len(gap))
        path.write_bytes(data[:at] + moved + data[at + 24 : starts[2]] + gap + data[starts[2] :])
        agree(path)

    def test_a_claim_that_no_file_of_this_size_can_keep(self, path):
        data = bytearray(path.read_bytes())
        (window,) = (a for a in attributes_in(data) if a.name == b"dataWindow")
        data[window.begin : window.end] = struct.pack("<4i", 0, 0, 10**6, 10**6)
        assert parts_of(bytes(data) + bytes(10**6)) == [None]


class TestOddHeaders:
    @settings(SETTINGS, max_examples=80)
    @given(st.integers(0, 2**32 - 1))
    def test_no_header_breaks_the_reading(self, seed):
        rng = np.random.default_rng(seed)
        data = bytearray(HEADER)
        for at in rng.integers(0, len(data), rng.integers(1, 9)):
            data[at] = rng.choice([0, 1, 2, 127, 255, rng.integers(256)])
        data = data[: rng.integers(1, len(data) + 1)] if rng.random() < 0.3 else data
        try:
            found = parts_of(bytes(data))
        except ValueError:
            return
        assume(any(found))
        for part in found:
            if part is not None:
                assert (part.starts < part.ends).all() and (part.ends <= len(data)).all()
                assert len(part.starts) == -(-part.window.height // LINES[part.compression])

    @pytest.mark.parametrize("name", REQUIRED)
    @pytest.mark.parametrize("spoilt", ["name", "type"])
    def test_something_that_every_header_has_is_missing(self, tmp_path, name, spoilt):
        """OpenEXR opens such a file, and mostly reads no pixels from it."""
        path = write_single(tmp_path / "a.exr", rgba(20, 20))
        data = bytearray(path.read_bytes())
        (one,) = (a for a in attributes_in(data) if a.name == name)
        at = one.at + (len(name) + 1 if spoilt == "type" else 0)
        data[at : at + 1] = b"X"
        path.write_bytes(data)
        assert parts_of(bytes(data)) == [None]
        assert outcome(lambda: as_always(path)) == outcome(lambda: one_part_at_a_time(path))

    @pytest.mark.parametrize(
        "change",
        [
            lambda data: data.replace(b"R\0", b"A\0", 1),
            lambda data: data.replace(b"lineOrder\0\1\0\0\0\0", b"lineOrder\0\1\0\0\0\2"),
            lambda data: data.replace(b"screenWindowWidth\0", b"screenWindowWidtX\0"),
            lambda data: data[:5] + b"\2" + data[6:],
        ],
        ids=["two channels of a name", "lines in any order", "no width", "tiles by the version"],
    )
    def test_other_odd_headers_are_left(self, tmp_path, change):
        path = write_single(tmp_path / "a.exr", rgba(20, 20))
        data = path.read_bytes()
        path.write_bytes(change(data))
        assert path.read_bytes() != data
        with suppress(ValueError):
            assert parts_of(path.read_bytes()) == [None]
        assert outcome(lambda: as_always(path)) == outcome(lambda: one_part_at_a_time(path))

    def test_a_long_one(self, tmp_path):
        path = write_single(tmp_path / "a.exr", rgba(40, 20), manifest="x" * 700_000)
        agree(path)


def _header() -> bytes:
    buffer = io.BytesIO()
    parts = [OpenEXR.Part(header(), rgba(20, 20), "a"), OpenEXR.Part(header(), rgba(20, 20), "b")]
    OpenEXR.File(parts).write(buffer)
    return buffer.getvalue()


HEADER = _header()
