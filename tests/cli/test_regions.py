"""Data windows smaller than the display window: regions of a picture, and cropped objects."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tests.cli import shots
from tests.cli.street import Street

STREET = Street(72, 44, speed=2)
DISPLAY = (0, 0, 72, 44)
REGION = (12, 6, 48, 30)
OPAQUE = "RGBA"

Box = tuple[int, int, int, int]


def write_shot(
    folder: Path,
    window: Callable[[int], Box],
    channels: str = OPAQUE,
    display: Box | None = DISPLAY,
    alpha: Callable[[np.ndarray], np.ndarray] | None = None,
    count: int = 3,
) -> Path:
    """Write key frames of which frame i holds `window(i)`; without `display` it is that, too."""

    def frame(path: Path, street: Street, time: float) -> None:
        x, y, width, height = window(int(time))
        planes = {}
        for passes in shots.blender_passes(street, time):
            for name, plane in passes.items():
                values = plane.copy()
                if alpha is not None and "Combined" in name:
                    values[alpha(street.geometry(time)["id"]) == 0] = 0
                if name != "Combined.A" or "A" in channels:
                    planes[name] = np.ascontiguousarray(values[y : y + height, x : x + width])
        head = shots.header(
            dataWindow=shots.window(x, y, width, height),
            displayWindow=shots.window(*(display or (x, y, width, height))),
        )
        shots.write(path, {"": planes}, head)

    return shots.sequence(folder, frame, range(1, count + 1), STREET)


def windows(folder: Path) -> list[Box]:
    """Data windows of all frames, in order."""
    found = []
    for name in shots.names(folder):
        header, _ = shots.read(folder / name)
        (x0, y0), (x1, y1) = header["dataWindow"]
        found.append((int(x0), int(y0), int(x1 - x0 + 1), int(y1 - y0 + 1)))
    return found


def pixels(folder: Path) -> list[np.ndarray]:
    return [shots.colour_of(folder / name) for name in shots.names(folder)]


@pytest.mark.parametrize(
    ("region", "channels", "method"),
    [
        (REGION, OPAQUE, "s6"),
        (REGION, OPAQUE, "softsplat"),
        ((0, 6, 72, 32), "RGB", "s6"),
        ((-4, 10, 60, 30), OPAQUE, "s6"),
    ],
    ids=["region", "of two key frames", "letterbox without alpha", "partly outside"],
)
def test_a_region_is_made_as_the_same_pixels_alone(upsample, tmp_path, region, channels, method):
    x, y, width, height = region
    kept = (max(x, 0), y, width + min(x, 0), height)
    display = (x + 8, y, 64, 40) if x < 0 else DISPLAY
    keys = write_shot(tmp_path / "keys", lambda _: kept, channels, display)
    alone = write_shot(tmp_path / "alone", lambda _: kept, channels, None)
    messages = upsample(keys, tmp_path / "out", "-m", method).err
    assert messages.count("is a region of the picture") == 1
    upsample(alone, tmp_path / "right", "-m", method)
    assert set(windows(tmp_path / "out")) == {kept}
    for found, expected in zip(pixels(tmp_path / "out"), pixels(tmp_path / "right"), strict=True):
        np.testing.assert_array_equal(found, expected)
    x, y, width, height = kept
    for order in (1, 2, 3, 5, 6, 7):
        truth = STREET.colour(order / 4)[y : y + height, x : x + width]
        made = shots.colour_of(tmp_path / "out" / f"shot.{1 + order:04d}.exr")
        assert shots.psnr(truth, made) > 22
        assert made[..., :3].max(axis=-1).min() > 0.02  # nothing black comes in over the edge


@pytest.mark.parametrize("steady", [True, False])
def test_a_cropped_object_moves_out_of_its_window(upsample, tmp_path, steady):
    """Of transparent pixels nothing is around, though windows may stay."""

    def window(i: int) -> Box:
        return (12, 10, 40, 26) if steady else (12 + 2 * i, 10, 40, 26)

    keys = write_shot(tmp_path / "keys", window, alpha=lambda ids: ids)
    upsample(keys, tmp_path / "out", "-m", "s6")
    for order in (1, 2, 3, 5, 6, 7):
        x, y, width, height = windows(tmp_path / "out")[order]
        shown = np.zeros((44, 72, 4))
        made = shots.colour_of(tmp_path / "out" / f"shot.{1 + order:04d}.exr")
        shown[y : y + height, x : x + width] = made
        truth = STREET.colour(order / 4) * (STREET.geometry(order / 4)["id"] > 0)[..., None]
        assert shots.psnr(truth, shown) > 22


def test_an_opaque_window_that_moves_is_an_objects(upsample, tmp_path):
    keys = write_shot(tmp_path / "keys", lambda i: (12 + 3 * i, 6, 40, 30))
    messages = upsample(keys, tmp_path / "out", "-m", "s6").err
    assert messages.count("taken for a cropped object") == 1
    assert len(set(windows(tmp_path / "out"))) > 3


def test_a_region_that_changes_stays_until_it_does(upsample, tmp_path):
    """As where a letterbox of another shot begins; any chunk finds the same."""

    def window(i: int) -> Box:
        return REGION if i < 2 else (4, 2, 60, 38)

    keys = write_shot(tmp_path / "keys", window, count=4)
    upsample(keys, tmp_path / "whole", "-m", "s6")
    assert windows(tmp_path / "whole") == 8 * [REGION] + 8 * [(4, 2, 60, 38)]
    for chunk in ("3", "1", "4", "2"):
        upsample(keys, tmp_path / "parts", "-m", "s6", "--frames", chunk)
    assert shots.contents(tmp_path / "parts") == shots.contents(tmp_path / "whole")


def test_frames_are_made_again_where_a_neighbours_window_changes(upsample, tmp_path):
    """Neighbouring key frames decide on a region, even where the slots have no colour from them."""
    keys = write_shot(tmp_path / "keys", lambda _: REGION, count=2)
    upsample(keys, tmp_path / "out", "-m", "s6")
    write_shot(tmp_path / "others", lambda i: (REGION[0] + 2 * i, *REGION[1:]), count=2)
    (tmp_path / "others" / "shot.0002.exr").replace(keys / "shot.0002.exr")
    upsample(keys, tmp_path / "out", "-m", "s6", "--skip-existing")
    upsample(keys, tmp_path / "fresh", "-m", "s6")
    assert shots.contents(tmp_path / "out") == shots.contents(tmp_path / "fresh")
