"""Kernels that make files' bytes, against numpy: bit for bit."""

from __future__ import annotations

import numpy as np
import pytest

from exwarp_cli.kernels.exr_lines import floats24, halfs24, halves, uints24
from exwarp_cli.kernels.half import to_half

HALF_MAX = 65504.0
EDGES = np.array(
    [
        *(0x00000000, 0x80000000, 0x00000001, 0x807FFFFF),  # zeros, and what is far below halfs
        *(0x32FFFFFF, 0x33000000, 0x33000001, 0x33800000, 0x33C00000),  # about their smallest
        *(0x387FDFFF, 0x387FE000, 0x387FF000, 0x387FFFFF, 0x38800000),  # about their first full one
        *(0x3F801000, 0x3F803000, 0x3F801001, 0x3F802FFF),  # halfway between two, and beside
        *(0x477FE000, 0x477FEFFF, 0x477FF000, 0x47800000, 0x7F7FFFFF),  # about their largest
        *(0x7F800000, 0xFF800000, 0x7F800001, 0x7FC00000, 0xFFFFFFFF),  # infinity and NaN
    ],
    np.uint32,
)


def some_bits() -> np.ndarray:
    """The edges, and 4 in every 65,536 of all floats."""
    rng = np.random.default_rng(0)
    every = (np.arange(2**16, dtype=np.uint32)[:, None] << 16) + rng.integers(
        0, 2**16, 4, np.uint32
    )
    return np.concatenate([EDGES, every.reshape(-1)])[None]


class TestHalf:
    @pytest.mark.parametrize("bounded", [False, True])
    def test_it_is_numpy_s(self, bounded):
        bits = some_bits()
        out = np.empty(bits.shape, np.uint16)
        to_half(bits, bounded, out)
        floats = bits.view(np.float32)
        with np.errstate(all="ignore"):
            expected = np.clip(floats, -HALF_MAX, HALF_MAX) if bounded else floats
            expected = expected.astype(np.float16)
        np.testing.assert_array_equal(out, expected.view(np.uint16))

    def test_a_channel_among_others(self):
        pixels = np.random.default_rng(0).normal(0, 3, (5, 7, 4)).astype(np.float32)
        out = np.empty((5, 7), np.uint16)
        to_half(pixels[..., 2].view(np.uint32), False, out)
        np.testing.assert_array_equal(out.view(np.float16), pixels[..., 2].astype(np.float16))


class TestLines:
    @pytest.mark.parametrize(("size", "chunk"), [(2, 2), (2, 64), (96, 32), (100, 32), (34, 32)])
    def test_zip_s_halves(self, size, chunk):
        lines = np.random.default_rng(0).integers(0, 256, size, np.uint8)
        out = np.empty_like(lines)
        halves(lines, chunk, out)
        for start in range(0, size, chunk):
            one = lines[start : start + chunk]
            expected = np.diff(np.concatenate([one[::2], one[1::2]]).astype(int), prepend=0) + 128
            expected[0] -= 128
            np.testing.assert_array_equal(out[start : start + chunk], expected % 256)

    @pytest.mark.parametrize(
        ("kernel", "dtype", "size"), [(halfs24, np.uint16, 2), (uints24, np.uint32, 4)]
    )
    def test_pxr24_s_rises(self, kernel, dtype, size):
        bits = np.random.default_rng(0).integers(0, np.iinfo(dtype).max, (6, 9), dtype)
        out = np.full((6, 9 * size), 255, np.uint8)
        kernel(bits, out)
        rises = np.diff(bits.astype(np.int64), axis=1, prepend=0)
        shifts = [8 * k for k in reversed(range(size))]
        expected = np.concatenate([rises >> shift & 255 for shift in shifts], axis=1)
        np.testing.assert_array_equal(out, expected)

    def test_pxr24_s_floats(self):
        """Of each float's bits the lowest 8 go: 1 is 0x3F800000, and so on."""
        bits = np.array([[0x3F800000, 0x3F80007F, 0x3F800080, 0x3F8000FF]], np.uint32)
        out = np.empty((1, 12), np.uint8)
        floats24(bits, out)
        assert out.tolist() == [[0x3F, 0, 0, 0, 0x80, 0, 0, 0, 0x00, 0, 1, 0]]
