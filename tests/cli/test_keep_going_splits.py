"""--keep-going in chunks: whatever is lost, any split makes the same frames."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.blender_layers import layer
from tests.cli import shots
from tests.cli.pictures import frame, stills
from tests.cli.shots import FORWARD, SMALL, VECTORS, contents, names
from tests.matrix import combinations, spread
from tests.stereo_shots import write_stereo

QUIET = ("--progress", "none", "--threads", 1, "--keep-going")


def truncate(path: Path, share: float = 0.6) -> None:
    path.write_bytes(path.read_bytes()[: int(path.stat().st_size * share)])


def path_of(folder: Path, number: int) -> Path:
    (found,) = folder.glob(f"*.{number:04d}.*")
    return found


@pytest.fixture
def split_alike(exwarp, tmp_path) -> Callable[..., set[int]]:
    """Make a shot as a whole and in chunks; return the numbers that both have."""

    def run(keys: Path, chunks: Sequence[object], *options: object) -> set[int]:
        whole, parts = tmp_path / "whole", tmp_path / "parts"
        result = exwarp("upsample", keys, "-o", whole, *QUIET, *options)
        assert result.code == 12, result.err
        for chunk in chunks:
            one = exwarp("upsample", keys, "-o", parts, *QUIET, *options, "--frames", chunk)
            assert one.code in (0, 12), one.err
        assert contents(parts) == contents(whole)
        return {int(name.split(".")[1]) for name in names(whole)}

    return run


def blender_with_surface(path: Path, street: Any, time: float) -> None:
    """Geometry in the first part, surface in the last."""
    passes = shots.blender_passes(street, time)
    passes += [layer(name, "RGB", street.colour(time)[..., :3]) for name in SURFACE]
    parts = {
        "main": {k: v for group in passes[:6] for k, v in group.items()},
        "surface": {k: v for group in passes[6:] for k, v in group.items()},
    }
    shots.write(path, {f"{name}": planes for name, planes in parts.items()})


SURFACE = ("Diffuse Color", "Glossy Color")


@pytest.mark.parametrize(
    ("method", "cuts"),
    combinations(("softsplat", "exwarp", "s6", "s3", "causal"), ("auto", "none", "3,6", "4,5")),
)
def test_several_lost_frames(split_alike, network, tmp_path, cuts, method):
    """Far enough apart that the history of one reaches to another, or not."""
    keys = shots.sequence(tmp_path / "keys", shots.plain, range(1, 10), SMALL)
    truncate(path_of(keys, 3))
    path_of(keys, 7).unlink()
    model = ("--extrapolator", network) if method in ("s3", "causal") else ()
    options = (*FORWARD, "-m", method, "--cuts", cuts, *model)
    made = split_alike(keys, ("8-9", "6-7", "4-5", "1-3"), *options)
    assert made == set(range(1, 37)) - set(range(9, 13)) - set(range(25, 29))


@pytest.mark.parametrize(
    ("cuts", "method"), combinations(("auto", "none"), ("exwarp", "s6", "s3", "causal"))
)
def test_slots(split_alike, network, tmp_path, cuts, method):
    keys = shots.sequence(tmp_path / "keys", shots.colour_only, range(1, 9), SMALL)
    slots = shots.sequence(tmp_path / "slots", shots.slot_gbuffer, range(1, 30), SMALL, step=0.25)
    truncate(path_of(slots, 8))
    truncate(path_of(slots, 17))
    path_of(keys, 7).unlink()
    model = ("--extrapolator", network) if method in ("s3", "causal") else ()
    options = ("--gbuffers", slots, *VECTORS, "-m", method, "--cuts", cuts, *model)
    made = split_alike(keys, (5, "1-2", "6-8", "3-4"), *options)
    assert made == set(range(1, 33)) - {6, 7, 8} - {17, 18, 19, 20} - {25, 26, 27, 28}


@pytest.mark.parametrize("method", ["softsplat", "causal"])
def test_every_layer(split_alike, network, tmp_path, method):
    keys = shots.sequence(tmp_path / "keys", shots.blender5, range(1, 7), SMALL)
    truncate(path_of(keys, 4), 0.9)
    model = ("--extrapolator", network) if method == "causal" else ()
    options = (*VECTORS, "-m", method, "--layers", "all", *model)
    made = split_alike(keys, ("4-6", 2, 1, 3), *options)
    assert made == set(range(1, 25)) - set(range(13, 17))


@pytest.mark.parametrize("method", spread(("exwarp", "softsplat", "s6", "s3"), 2))
def test_every_view(split_alike, network, tmp_path, method):
    """The right eye's parts come last, and are lost with the end of the file."""
    keys = write_stereo(tmp_path / "keys", "parts", range(1, 6))
    truncate(path_of(keys, 3), 0.97)
    model = ("--extrapolator", network) if method == "s3" else ()
    options = (*VECTORS, "-m", method, "--view", "all", *model)
    made = split_alike(keys, ("4-5", 2, 1, 3), *options)
    assert made == set(range(1, 21)) - set(range(9, 13))


def test_a_surface_that_is_read_late(split_alike, network, tmp_path):
    """The policy decides without it: where it extrapolates, the frames are left out."""
    keys = shots.sequence(tmp_path / "keys", blender_with_surface, range(1, 7), SMALL)
    truncate(path_of(keys, 3), 0.95)
    options = (*VECTORS, "-m", "causal", "--extrapolator", network)
    made = split_alike(keys, ("4-6", 2, 3, 1), *options)
    assert made >= {1, 5, 9, 13, 17, 21}


@pytest.mark.parametrize("cuts", ["auto", "none"])
def test_motion_that_is_estimated(split_alike, tmp_path, cuts):
    pytest.importorskip("cv2")
    keys = stills(tmp_path / "keys", map(frame, range(7)))
    truncate(path_of(keys, 4))
    path_of(keys, 2).unlink()
    made = split_alike(keys, (6, "1-3", 7, 5, 4), "--cuts", cuts)
    assert made == set(range(1, 29)) - set(range(5, 9)) - set(range(13, 17))


def test_a_factor_that_shows_few_key_frames(split_alike, tmp_path):
    keys = shots.sequence(tmp_path / "keys", shots.plain, range(1, 7), SMALL)
    truncate(path_of(keys, 4))
    split_alike(keys, ("5-6", 2, 3, 1, 4), *FORWARD, "-m", "softsplat", "--to-fps", 75)


def test_colour_that_is_mostly_no_number(split_alike, tmp_path):
    keys = shots.sequence(tmp_path / "keys", shots.plain, range(1, 5), SMALL)
    planes = shots.plain_planes(SMALL, 1.0)
    planes |= {name: np.full_like(planes[name], np.nan) for name in "RGB"}
    shots.write(path_of(keys, 2), {"": planes})
    made = split_alike(keys, ("3-4", 2, 1), *FORWARD, "-m", "softsplat")
    assert made == set(range(1, 17)) - set(range(5, 9))


def test_a_lost_frame_that_is_restored_changes_what_met_it(exwarp, upsample, tmp_path):
    """Of stills, whose motion reaches two key frames far."""
    pytest.importorskip("cv2")
    keys = stills(tmp_path / "keys", map(frame, range(6)))
    upsample(keys, tmp_path / "expected")
    copy = Path(shutil.copytree(keys, tmp_path / "copy"))
    truncate(path_of(copy, 3))
    assert exwarp("upsample", copy, "-o", tmp_path / "out", *QUIET).code == 12
    shutil.copy(path_of(keys, 3), path_of(copy, 3))
    upsample(copy, tmp_path / "out", "--skip-existing")
    assert contents(tmp_path / "out") == contents(tmp_path / "expected")
