"""Shots before a camera that rests: a small mover, or nothing that moves at all."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tests.blender_layers import HALF, Planes, layer
from tests.cli import shots

SIZE, SIDE, SPEED = (96, 160), 18, np.array([8.0, 3.0])
"""Height and width; the mover's side; and how far it goes in a frame, right and down."""

Encoded = Callable[[np.ndarray, np.ndarray], Planes]
"""Motion planes of vectors to the next frame, y down, and of which pixels move."""


def texture(height: int, width: int, seed: int) -> np.ndarray:
    """Smooth random colours, [H, W, 3]."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:height, :width]
    waves = rng.uniform(0.1, 0.6, (6, 2)) * rng.choice([-1, 1], (6, 2))
    phases = rng.uniform(0, 6, (6, 3))
    bases = zip(waves, phases, strict=True)
    parts = [np.sin(a * x[..., None] + b * y[..., None] + c) for (a, b), c in bases]
    return 0.5 + 0.8 * np.mean(parts, axis=0)


def frame(time: float, moves: bool = True) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return colour [H, W, 3], depth [H, W], and vectors to the next frame [H, W, 2]."""
    colour, depth = texture(*SIZE, seed=1), np.full(SIZE, 10.0)
    vectors = np.zeros((*SIZE, 2))
    left, top = np.rint([20, 20] + (time if moves else 0) * SPEED).astype(int)
    there = slice(top, top + SIDE), slice(left, left + SIDE)
    colour[there], depth[there] = texture(SIDE, SIDE, seed=2), 4.0
    if moves:
        vectors[there] = SPEED
    return colour, depth, vectors


def written(
    folder: Path, encoded: Encoded, count: int = 4, more: Planes | None = None, moves: bool = True
) -> Path:
    for number in range(count):
        colour, depth, vectors = frame(number, moves)
        planes = layer("", "RGB", colour, HALF) | layer("", "Z", depth) | (more or {})
        shots.write(folder / f"s.{number:04d}.exr", {"": planes | encoded(vectors, depth < 5)})
    return folder


def raw_arnold(vectors: np.ndarray, _there: np.ndarray) -> Planes:
    """Red and green are pixels, y up; blue is there, and 0."""
    planes = np.concatenate([vectors * [1, -1], np.zeros((*SIZE, 1))], -1)
    return layer("motionvector", "RGB", planes) | {"ID": np.ones(SIZE, np.float32)}


def directed_arnold(vectors: np.ndarray, _there: np.ndarray) -> Planes:
    """Red and green are a direction, y up; blue is the length."""
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    unit = vectors * [1, -1] / np.where(length > 0, length, 1)
    return layer("motionvector", "RGB", np.concatenate([unit, length], -1)) | {
        "ID": np.ones(SIZE, np.float32)
    }


def unknown(vectors: np.ndarray, _there: np.ndarray) -> Planes:
    """Components that no producer's name tells."""
    return layer("motionvector", "xy", vectors * [1, -1])


def read_as(exwarp, keys: Path, *options: object) -> dict:
    result = exwarp("inspect", keys, "--json", *options)
    assert result.code == 0, result.err
    return json.loads(result.out)["motion"]


def score(upsample, keys: Path, out: Path) -> float:
    """PSNR of the frames between the first two key frames, where the mover is on whole pixels."""
    upsample(keys, out, "-m", "softsplat")
    found = []
    for slot in (1, 2, 3):
        colour, depth, _ = frame(slot / 4)
        got = shots.colour_of(out / f"s.{slot:04d}.exr")
        found.append(shots.psnr(colour[depth < 5], got[depth < 5]))
    return float(np.mean(found))


class TestSmallMover:
    @pytest.mark.parametrize(
        ("encoded", "expected", "source"),
        [
            (raw_arnold, "next=R,-G", "corrected"),
            (directed_arnold, "next=R*B,-G*B", "calibrated"),
        ],
    )
    def test_a_reading_that_makes_all_motion_vanish_gives_way(
        self, exwarp, upsample, tmp_path, encoded, expected, source
    ):
        keys = written(tmp_path / "keys", encoded)
        found = read_as(exwarp, keys)
        assert (found["convention"], found["source"]) == (expected, source)
        assert found["error"] < 0.1 and found["still_error"] > 0.5
        # A mover that stands still for three frames scores 12 dB.
        assert score(upsample, keys, tmp_path / "out") > 22

    def test_names_that_say_nothing_are_measured_on_the_mover(self, exwarp, upsample, tmp_path):
        keys = written(tmp_path / "keys", unknown)
        found = read_as(exwarp, keys)
        # At an even speed, both are right.
        assert found["convention"] in ("previous=-x,y", "next=x,-y")
        assert found["source"] == "calibrated"
        assert score(upsample, keys, tmp_path / "out") > 22

    def test_world_positions_do_not_hide_it(self, exwarp, tmp_path):
        """They tell nothing of what moves by itself, and all else rests."""
        y, x = np.mgrid[: SIZE[0], : SIZE[1]].astype(np.float32)
        position = layer("P", "XYZ", np.stack([x, y, np.full_like(x, 10)], -1))
        keys = written(tmp_path / "keys", raw_arnold, more=position)
        assert read_as(exwarp, keys)["convention"] == "next=R,-G"

    def test_a_mover_in_one_part_of_the_shot_alone_is_sought(self, exwarp, tmp_path):
        """The first, middle and last pair of frames are at rest."""
        keys = tmp_path / "keys"
        for number in range(17):
            moves = 4 <= number <= 6
            colour, depth, vectors = frame(np.clip(number, 4, 7) - 4)
            planes = layer("", "RGB", colour, HALF) | layer("", "Z", depth)
            encoded = raw_arnold(vectors * moves, depth < 5)
            shots.write(keys / f"s.{number:04d}.exr", {"": planes | encoded})
        found = read_as(exwarp, keys)
        assert (found["convention"], found["source"]) == ("next=R,-G", "corrected")

    def test_vectors_without_motion_under_a_mover_are_an_error(self, exwarp, tmp_path):
        keys = tmp_path / "keys"
        for number in range(4):
            colour, depth, _ = frame(number)
            colour, depth = np.roll(colour, 9 * number, 1), np.roll(depth, 9 * number, 1)
            planes = layer("", "RGB", colour, HALF) | layer("", "Z", depth)
            planes |= unknown(np.zeros((*SIZE, 2)), depth < 5)
            shots.write(keys / f"s.{number:04d}.exr", {"": planes})
        result = exwarp("upsample", keys, "-o", tmp_path / "out", "-m", "s6")
        result.refused(4, "are 0 throughout", "motion blur", "render the motion pass again")


class TestNothingMoves:
    @pytest.mark.parametrize("still", [0.0, 0.5])
    def test_unknown_names_run_and_it_is_said(self, exwarp, tmp_path, still):
        def resting(vectors: np.ndarray, _there: np.ndarray) -> Planes:
            return layer("motionvector", "XY", vectors + still)

        keys = written(tmp_path / "keys", resting, moves=False)
        for method in ("s6", "softsplat"):
            out = tmp_path / method
            result = exwarp("upsample", keys, "-o", out, "-m", method)
            assert result.code == 0, result.err
            assert "nothing moves" in result.err
            for number in range(16):
                got = shots.colour_of(out / f"s.{number:04d}.exr")
                assert shots.psnr(frame(0, False)[0], got) > 60


class TestGivenByHand:
    def test_what_contradicts_the_frames_is_said_and_used(self, exwarp, tmp_path):
        keys = written(tmp_path / "keys", unknown)
        out, report = tmp_path / "out", tmp_path / "report"
        options = ("-o", out, "-m", "s6", "--motion", "next=x,y", "--report", report)
        result = exwarp("upsample", keys, *options)
        assert result.code == 0
        line = next(line for line in result.err.splitlines() if "motion given" in line)
        assert "next=x,y given by --motion, but the frames contradict it" in line
        motion = json.loads((report / "report.json").read_text())["input"]["motion"]
        assert motion["source"] == "given" and motion["evidence"] in line

    def test_what_agrees_is_not_doubted(self, exwarp, tmp_path):
        keys = written(tmp_path / "keys", unknown)
        found = read_as(exwarp, keys, "--motion", "next=x,-y")
        assert found["evidence"] == "next=x,-y given by --motion"
        assert found["convention"] == "next=x,-y"
