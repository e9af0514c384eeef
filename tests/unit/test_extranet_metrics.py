"""ExtraNet's published PSNR and SSIM, against scikit-image."""

from __future__ import annotations

import numpy as np
import pytest

from exwarp_cli.domain.colour import round_display
from exwarp_cli.io.display_colour import to_display
from exwarp_cli.metrics.registry import score_like_extranet
from tests.reference import quality, scikit


def pair(size: tuple[int, int], noise: float = 0.05) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(3)
    reference = rng.random((*size, 3)) * 1.4 - 0.1
    test = reference + rng.normal(0, noise, reference.shape)
    return reference.astype(np.float32), test.astype(np.float32)


@pytest.mark.parametrize("size", [(7, 7), (33, 41), (60, 80)])
def test_it_is_scikit_image_on_the_png(size: tuple[int, int]) -> None:
    reference, test = pair(size)
    shown, judged = to_display(reference), to_display(test)
    found = score_like_extranet(reference, test)
    assert found.ssim == pytest.approx(scikit.uniform_ssim(shown, judged), abs=1e-12)
    assert found.psnr_db == pytest.approx(quality.psnr_db(shown, judged), abs=1e-9)
    assert (found.flip, found.vmaf) == (None, None)


def test_errors_below_half_a_step_are_lost_in_the_png() -> None:
    """Which is the difference to the tool's own metrics."""
    grey = to_display(np.full((16, 16, 3), 0.2, np.float32))
    level = np.float32(((float(grey[0, 0, 0]) / 255 + 0.055) / 1.055) ** 2.4)
    reference = np.full((16, 16, 3), level, np.float32)
    same = score_like_extranet(reference, reference * np.float32(1.001))
    assert (same.psnr_db, same.ssim) == (100, 1)


def test_a_frame_smaller_than_the_window_has_no_ssim() -> None:
    reference, test = pair((6, 30))
    found = score_like_extranet(reference, test)
    assert found.ssim is None
    assert found.psnr_db is not None


def test_ssim_ends() -> None:
    black = np.zeros((12, 12, 3), np.float32)
    assert score_like_extranet(black, black).ssim == 1
    assert score_like_extranet(black, black + 1).ssim == pytest.approx(
        6.5025 / (255**2 + 6.5025), rel=1e-9
    )


def test_rounded_is_what_the_videos_show() -> None:
    pixels, _ = pair((40, 40))
    pixels[0, 0] = np.nan
    np.testing.assert_array_equal(round_display(pixels), to_display(pixels))
