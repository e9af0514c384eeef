"""Kernels that sort files' bytes, against numpy: bit for bit."""

from __future__ import annotations

import numpy as np
import pytest

from exwarp_cli.kernels.exr_lines import floats24, halfs24, halves, uints24


class TestLines:
    @pytest.mark.parametrize(("size", "chunk"), [(2, 2), (2, 64), (96, 32), (100, 32), (34, 32)])
    def test_zip_s_halves(self, size, chunk):
        lines = np.random.default_rng(0).integers(0, 256, size, np.uint8)
        out = np.empty_like(lines)
        halves(lines.view(np.uint16), chunk // 2, out)
        for start in range(0, size, chunk):
            one = lines[start : start + chunk]
            expected = np.diff(np.concatenate([one[::2], one[1::2]]).astype(int), prepend=0) + 128
            expected[0] -= 128
            np.testing.assert_array_equal(out[start : start + chunk], expected % 256)

    @pytest.mark.parametrize(
        ("kernel", "dtype", "size"), [(halfs24, np.uint16, 2), (uints24, np.uint32, 4)]
    )
    def test_pxr24_s_rises(self, kernel, dtype, size):
        """Between other channels' bytes, which stay."""
        bits = np.random.default_rng(0).integers(0, np.iinfo(dtype).max, (6, 9), dtype)
        out = np.full((6, 9 * size + 7), 255, np.uint8)
        kernel(bits, 5, out)
        rises = np.diff(bits.astype(np.int64), axis=1, prepend=0)
        shifts = [8 * k for k in reversed(range(size))]
        expected = np.concatenate([rises >> shift & 255 for shift in shifts], axis=1)
        np.testing.assert_array_equal(out[:, 5:-2], expected)
        assert (out[:, :5] == 255).all() and (out[:, -2:] == 255).all()

    def test_pxr24_s_floats(self):
        """Of each float's bits the lowest 8 go: 1 is 0x3F800000, and so on."""
        bits = np.array([[0x3F800000, 0x3F80007F, 0x3F800080, 0x3F8000FF]], np.uint32)
        out = np.empty((1, 12), np.uint8)
        floats24(bits, 0, out)
        assert out.tolist() == [[0x3F, 0, 0, 0, 0x80, 0, 0, 0, 0x00, 0, 1, 0]]

    def test_pxr24_s_floats_that_are_none(self):
        """Infinity and NaN stay what they are, and what would become infinite is cut."""
        bits = np.array([0x7F800000, 0xFF800001, 0x7FC12345, 0x7F7FFFFF, 0xFF7FFF7F], np.uint32)
        kept = np.array([0x7F8000, 0xFF8001, 0x7FC123, 0x7F7FFF, 0xFF7FFF], np.int64)
        out = np.empty((5, 3), np.uint8)
        floats24(bits[:, None], 0, out)
        np.testing.assert_array_equal(out @ [65536, 256, 1], kept)
