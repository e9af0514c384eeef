"""Several values at once: what is compiled gives the same as the text in Python."""

from __future__ import annotations

import numba
import numpy as np
import pytest

from exwarp_cli.kernels import _simd

WIDTH, HEIGHT, COUNT = 7, 5, 8


@numba.njit(error_model="numpy")
def mixed(pixels, steps, places, weights, first, out):
    return _simd.mix_four(pixels, steps, places, weights, first, out)


class TestMixFour:
    @staticmethod
    def four(channels, spoilt=None):
        """Return what four pixels, from the fifth on, are mixed from."""
        rng = np.random.default_rng(channels)
        pixels = rng.normal(0, 3, WIDTH * HEIGHT * channels).astype(np.float32)
        pixels[::5] = -0.0
        places = channels * (rng.integers(0, 3, COUNT) * WIDTH + rng.integers(0, 5, COUNT))
        weights = rng.random(2 * COUNT, np.float32)
        weights[8:11] = 0, 0, 0  # the fifth both, the sixth to the right
        if spoilt is not None:
            pixels[places[4] + channels] = spoilt  # of weight 0
        return pixels, (channels, WIDTH * channels), places.astype(np.int32), weights, 4

    @pytest.mark.parametrize("channels", [3, 4])
    def test_equals_the_text(self, channels):
        given = self.four(channels)
        out, expected = (np.full(COUNT * channels + 4, 7, np.float32) for _ in range(2))
        assert mixed(*given, out) == _simd.mix_four(*given, expected) == 0
        assert out.tobytes() == expected.tobytes()
        end = 8 * channels + (4 - channels)
        assert (out[: 4 * channels] == 7).all() and (out[end:] == 7).all()
        assert (out[4 * channels : end] != 7).all()

    @pytest.mark.parametrize("channels", [3, 4])
    def test_what_has_no_weight_is_left_out(self, channels):
        pixels, steps, places, weights, first = self.four(channels, np.nan)
        out = np.empty(COUNT * channels + 4, np.float32)
        mixed(pixels, steps, places, weights, first, out)
        begin = places[4]
        at = slice(4 * channels, 4 * channels + 3)
        assert out[at].tobytes() == pixels[begin : begin + 3].tobytes()

    @pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
    @pytest.mark.parametrize("number", range(4))
    def test_tells_what_is_not_finite(self, bad, number):
        pixels, steps, places, weights, first = self.four(4)
        places[4:], weights[8:] = 0, 0.5
        places[4 + number] = 60
        pixels[63] = bad
        assert mixed(pixels, steps, places, weights, first, np.empty(4 * COUNT, np.float32)) != 0
