"""ffmpeg's interpolation of one key interval, and how its failures are reported."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from exwarp_cli.domain.colour import encode_display
from exwarp_cli.domain.frame import Float32
from exwarp_cli.errors import OutputError
from exwarp_cli.io import ffmpeg as module
from exwarp_cli.io.ffmpeg import minterpolate

STEP = 8
"""Pixels that the picture moves in a key interval."""


def picture(time: float, height: int = 64, width: int = 96) -> Float32:
    """Smooth blobs that move to the right; scene-linear."""
    rng = np.random.default_rng(5)
    y, x = np.mgrid[0:height, 0:width].astype(np.float64)
    out = np.full((height, width, 3), 0.1)
    for _ in range(40):
        top, left = rng.uniform(0, height), rng.uniform(-20, width)
        colour, size = rng.uniform(0, 0.8, 3), rng.uniform(2, 5)
        gap = (x - left - STEP * time) ** 2 + (y - top) ** 2
        out += colour * np.exp(-gap / (2 * size**2))[..., None]
    return np.clip(out, 0, 1).astype(np.float32)


def error(found: Float32, time: float) -> float:
    """Mean error of the display values, away from the borders where the picture comes in."""
    gap = np.abs(encode_display(found) - encode_display(picture(time)))
    return float(gap[8:-8, 16:-16].mean())


@pytest.mark.parametrize("older", [False, True])
def test_it_follows_the_motion(older):
    past = picture(-1) if older else None
    before, after = picture(0), picture(1)
    found = minterpolate(past, before, after)
    assert len(found) == 3
    for slot, frame in enumerate(found, start=1):
        assert frame.shape == before.shape and frame.dtype == np.float32
        assert frame.min() >= 0 and frame.max() <= 1
        faded = before + np.float32(slot / 4) * (after - before)
        assert error(frame, slot / 4) < 0.5 * error(faded, slot / 4)


@pytest.mark.parametrize("size", [(1, 1), (5, 3), (16, 16), (17, 40)])
def test_any_size_and_a_still_picture_stays(size):
    frame = np.random.default_rng(1).random((*size, 4), dtype=np.float32)
    for found in minterpolate(None, frame, frame):
        assert found.shape == (*size, 3)
        assert (
            np.abs(encode_display(found) - encode_display(frame)).max() < 5
        )  # 8 bits, through YUV


def test_what_8_bits_cannot_hold_is_cut():
    frame = np.full((16, 16, 3), 40, np.float32)
    frame[8:] = -1
    for found in minterpolate(frame, frame, frame):
        assert found.max() == 1 and found.min() == 0


def test_the_past_is_used():
    """ffmpeg begins its search with the vectors of the interval before."""
    rng = np.random.default_rng(3)
    older, before, after = (rng.random((32, 48, 3), dtype=np.float32) for _ in range(3))
    with_past, without = minterpolate(older, before, after), minterpolate(None, before, after)
    assert any((a != b).any() for a, b in zip(with_past, without, strict=True))
    still = minterpolate(before, before, after)
    np.testing.assert_array_equal(without, still)


def test_a_missing_ffmpeg(tmp_path, monkeypatch):
    monkeypatch.setenv("IMAGEIO_FFMPEG_EXE", str(tmp_path / "none"))
    with pytest.raises(OutputError, match=r"ffmpeg does not start \(.*\); reinstall"):
        minterpolate(None, picture(0), picture(1))


@pytest.mark.parametrize(
    ("script", "said"),
    [
        ("cat > /dev/null; echo '[x @ 0x1] No such filter' >&2; exit 1", "says 'No such filter'"),
        ("exit 3", "ends with status 3"),
        ("cat > /dev/null", "not at the instants"),
    ],
)
def test_a_failing_ffmpeg_is_quoted(tmp_path: Path, monkeypatch, script, said):
    fake = tmp_path / "ffmpeg"
    fake.write_text(f"#!/bin/sh\n{script}\n")
    fake.chmod(0o755)
    monkeypatch.setenv("IMAGEIO_FFMPEG_EXE", str(fake))
    with pytest.raises(OutputError, match=said):
        minterpolate(None, picture(0), picture(1))


def test_frames_at_other_instants_are_noticed(monkeypatch):
    true = module.run_ffmpeg

    def without_the_first(options, data):
        made, info = true(options, data)
        return made[picture(0)[..., :3].size :], info

    monkeypatch.setattr(module, "run_ffmpeg", without_the_first)
    with pytest.raises(OutputError, match="not at the instants"):
        minterpolate(None, picture(0), picture(1))
