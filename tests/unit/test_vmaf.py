"""VMAF: its ends, its neighbourhood, and one sentence for what fails."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from exwarp_cli.errors import InputError, LayoutError
from exwarp_cli.io.ffmpeg import MIN_VMAF_SIZE, VmafStream, compute_vmaf

INTERVALS = 3


def smooth(seed: int, size: tuple[int, int]) -> np.ndarray:
    """Soft noise, uint8 [H, W, 3]."""
    image = np.random.default_rng(seed).random((*size, 3))
    for _ in range(6):
        for axis in (0, 1):
            image = (np.roll(image, 1, axis) + image + np.roll(image, -1, axis)) / 3
    image = (image - image.min()) / np.ptp(image)
    return (255 * image).astype(np.uint8)


def panned(count: int, size: tuple[int, int] = (48, 64)) -> list[np.ndarray]:
    """A view that moves over a picture, faster and faster."""
    wide = smooth(1, (size[0], size[1] + count * count))
    return [np.ascontiguousarray(wide[:, i * i : i * i + size[1]]) for i in range(count)]


def noisy(frames: list[np.ndarray], sigma: float = 12, seed: int = 2) -> list[np.ndarray]:
    rng = np.random.default_rng(seed)
    return [np.clip(f + rng.normal(0, sigma, f.shape), 0, 255).astype(np.uint8) for f in frames]


def test_worse_frames_score_less() -> None:
    frames = panned(4)
    same, little, much = (compute_vmaf(frames, noisy(frames, sigma)) for sigma in (0, 6, 40))
    assert len(same) == 4
    assert min(same[1:]) > 99
    assert all(0 <= c < b - 5 < a for a, b, c in zip(same[1:], little[1:], much[1:], strict=True))


@pytest.mark.parametrize("size", [(MIN_VMAF_SIZE, 40), (35, MIN_VMAF_SIZE), (31, 45)])
def test_the_two_frames_are_cut_apart_where_they_meet(size: tuple[int, int]) -> None:
    """Equal frames are only equal if neither holds a row of the other; odd sizes too."""
    frames = panned(3, size)
    same = compute_vmaf(frames, frames)
    assert same[0] > 97, "as much as equal frames have without motion"
    assert min(same[1:]) > 99
    spoilt = [np.concatenate([f[:-1], 255 - f[-1:]]) for f in frames]
    assert compute_vmaf(frames, spoilt)[0] < same[0] - 0.01


def test_an_interval_alone_has_the_scores_of_the_whole_sequence() -> None:
    """What lets a sequence be scored in chunks: rendered frames around, nothing else matters."""
    truth = panned(4 * INTERVALS + 1)
    test = [
        t if i % 4 == 0 else n for i, (t, n) in enumerate(zip(truth, noisy(truth), strict=True))
    ]
    whole = compute_vmaf(truth, test)
    for k in range(INTERVALS):
        part = slice(4 * k, 4 * k + 5)
        assert compute_vmaf(truth[part], test[part])[1:4] == whole[4 * k + 1 : 4 * k + 4]
    # At the end there is no next frame, in either.
    assert compute_vmaf(truth[4:7], test[4:7])[1:] == compute_vmaf(truth[:7], test[:7])[5:]
    alone = compute_vmaf(truth[5:8], test[5:8])
    assert alone[0] != whole[5], "the frame before matters, so the test can fail"


def test_the_published_procedure_is_of_encoded_videos() -> None:
    truth = panned(6, (33, 47))
    test = noisy(truth, 25)
    with VmafStream(is_encoded=True) as stream:
        for pair in zip(truth, test, strict=True):
            stream.write(*pair)
        found = stream.close()
    assert len(found) == 6
    plain = compute_vmaf(truth, test)
    assert found != plain
    assert np.mean(found) == pytest.approx(np.mean(plain), abs=25)
    with VmafStream(is_encoded=True) as stream:
        for frame in truth:
            stream.write(frame, frame)
        assert min(stream.close()[1:]) > 99


def test_no_frames_no_scores() -> None:
    assert compute_vmaf([], []) == []
    with VmafStream(is_encoded=True) as stream:
        assert stream.close() == []


@pytest.mark.parametrize("size", [(MIN_VMAF_SIZE - 1, 64), (64, MIN_VMAF_SIZE - 1)])
def test_frames_that_libvmaf_crashes_on_are_refused(size: tuple[int, int]) -> None:
    frames = [np.zeros((*size, 3), np.uint8)]
    with pytest.raises(LayoutError, match="17 pixels each way"):
        compute_vmaf(frames, frames)


def test_a_missing_ffmpeg(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("IMAGEIO_FFMPEG_EXE", str(tmp_path / "none"))
    with pytest.raises(InputError, match="ffmpeg does not start"):
        compute_vmaf(panned(1), panned(1))


@pytest.mark.parametrize("is_encoded", [False, True])
@pytest.mark.parametrize("frames", [1, 60])
def test_a_failing_ffmpeg_is_quoted(
    tmp_path: Path, monkeypatch, is_encoded: bool, frames: int
) -> None:
    fake = tmp_path / "ffmpeg"
    fake.write_text("#!/bin/sh\necho '[libvmaf @ 0x1] could not load the model' >&2\nexit 1\n")
    fake.chmod(0o755)
    monkeypatch.setenv("IMAGEIO_FFMPEG_EXE", str(fake))
    temporary = tmp_path / "tmp"
    temporary.mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(temporary))
    frame = np.zeros((64, 64, 3), np.uint8)
    message = "ffmpeg says 'could not load the model'"
    with pytest.raises(InputError, match=message), VmafStream(is_encoded) as run:
        for _ in range(frames):
            run.write(frame, frame)
        run.close()
    assert list(temporary.iterdir()) == []
