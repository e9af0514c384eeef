"""Headers and tables of chunks: what is plain about them is known, anything odd is left alone."""

from __future__ import annotations

import io
from contextlib import suppress

import numpy as np
import OpenEXR
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from exwarp_cli.io.exr_chunks import LINES, REQUIRED
from exwarp_cli.io.header_text import attributes_in
from tests.unit.exr_files import header, rgba, write_single
from tests.unit.exr_reading import agree, as_always, one_part_at_a_time, outcome, parts_of

SETTINGS = settings(derandomize=True, max_examples=80, deadline=None)


class TestOddHeaders:
    @SETTINGS
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
