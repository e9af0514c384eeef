"""Rounding to halfs, by an instruction and by hand, against numpy: bit for bit."""

from __future__ import annotations

import os
import subprocess
import sys

import numpy as np
import pytest

from exwarp_cli.kernels.half import rounds_itself
from tests.unit.half_cases import by_numpy, edges_rounded, rounded, some_bits
from tests.unit.interpreted import ROOT, same_when_interpreted


@pytest.mark.parametrize("bounded", [False, True])
class TestRounding:
    def test_it_is_numpy_s(self, bounded):
        bits = some_bits()[None]
        np.testing.assert_array_equal(rounded(bits, bounded)[0], by_numpy(bits, bounded))

    def test_rows_without_nan(self, bounded):
        bits = some_bits()
        bits = bits[bits & 0x7FFFFFFF <= 0x7F800000][None]
        np.testing.assert_array_equal(rounded(bits, bounded)[0], by_numpy(bits, bounded))

    @pytest.mark.parametrize("channels", [1, 2, 3, 4, 5])
    def test_channels_are_taken_apart(self, bounded, channels):
        bits = some_bits()[: 3 * 37 * channels].reshape(3, -1)
        expected = by_numpy(bits, bounded).reshape(3, 37, channels).transpose(2, 0, 1)
        np.testing.assert_array_equal(rounded(bits, bounded, channels), expected)


class TestBuilds:
    def test_interpreted(self, tmp_path):
        found = edges_rounded()
        same_when_interpreted("tests.unit.half_cases", tmp_path / "x.npz", found, "RuntimeWarning")

    @pytest.mark.slow
    def test_a_processor_without_the_instruction(self, tmp_path):
        """LLVM would call a function that is not there, and end the process."""
        plain = {"NUMBA_CPU_NAME": "generic", "NUMBA_CPU_FEATURES": ""}
        subprocess.run(
            [sys.executable, "-m", "tests.unit.half_cases", str(tmp_path / "x.npz")],
            check=True,
            cwd=ROOT,
            env=os.environ | plain | {"NUMBA_CACHE_DIR": str(tmp_path / "cache")},
        )
        with np.load(tmp_path / "x.npz") as found:
            for name, expected in edges_rounded().items():
                np.testing.assert_array_equal(found[name], expected)

    @pytest.mark.parametrize(
        ("triple", "features", "has"),
        [
            ("x86_64-unknown-linux-gnu", "+avx,+f16c,+fma", True),
            ("x86_64-unknown-linux-gnu", "+avx,-f16c,+fma", False),
            ("x86_64-pc-windows-msvc", "", False),
            ("aarch64-unknown-linux-gnu", "", True),
            ("arm64-apple-darwin23.1.0", "+neon", True),
            ("armv7l-unknown-linux-gnueabihf", "+vfp3", False),
            ("powerpc64le-unknown-linux-gnu", "+vsx", False),
        ],
    )
    def test_which_processors_have_it(self, triple, features, has):
        assert rounds_itself(triple, features) is has
