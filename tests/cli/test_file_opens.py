"""How often the file of a key frame is opened in a run: a network share answers each time."""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from exwarp_cli.io.exr import header, reader
from exwarp_cli.io.exr.writer import COMPRESSIONS
from tests.cli import shots
from tests.cli.shots import FORWARD, SMALL

NUMBERS = range(1, 13)
MIDDLE = [f"shot.{number:04d}.exr" for number in (3, 4, 5, 8, 9, 10)]
"""Key frames by which neither the shot nor its vectors are recognised."""

_counts: list[Counter[str]] = []


def _audit(event: str, arguments: tuple[Any, ...]) -> None:
    if event == "open" and _counts and isinstance(arguments[0], (str, Path)):
        _counts[-1][str(arguments[0])] += 1


sys.addaudithook(_audit)  # there is no way to take it away


@pytest.fixture
def opens(monkeypatch) -> Iterator[Counter[str]]:
    """Count by path what Python opens to read, and what OpenImageIO and OpenEXR do."""
    counts: Counter[str] = Counter()
    open_image, exr_file = reader.open_image, header.OpenEXR.File

    def counted_image(path: Path) -> Any:
        counts[str(path)] += 1
        return open_image(path)

    def counted_file(source: Any, *rest: Any, **more: Any) -> Any:
        counts[str(source)] += 1
        return exr_file(source, *rest, **more)

    monkeypatch.setattr(reader, "open_image", counted_image)
    monkeypatch.setattr(header.OpenEXR, "File", counted_file)
    _counts.append(counts)
    yield counts
    _counts.pop()


def shot(folder: Path, compression: str) -> Path:
    more = shots.header(compression=COMPRESSIONS[compression])

    def frame(path: Path, street: Any, time: float) -> None:
        shots.write(path, {"": shots.plain_planes(street, time)}, more)

    return shots.sequence(folder, frame, NUMBERS, SMALL, step=0.25)


@pytest.mark.parametrize(
    ("compression", "method", "more", "most"),
    [
        # Its size before the run begins, its digest, its pixels, its copy.
        ("zip", "softsplat", (), 4),
        ("piz", "softsplat", (), 4),
        # The frame rate in its header changes.
        ("zip", "softsplat", ("--fps", "24"), 4),
        # The surface is read when the policy chooses extrapolation.
        ("zip", "causal", (), 5),
    ],
    ids=["zip", "piz", "another rate", "causal"],
)
def test_key_frames_are_opened_seldom(upsample, tmp_path, opens, compression, method, more, most):
    keys = shot(tmp_path / "keys", compression)
    opens.clear()
    upsample(keys, tmp_path / "out", *FORWARD, "--method", method, *more)
    counts = {name: opens[str(keys / name)] for name in MIDDLE}
    assert all(1 <= count <= most for count in counts.values()), counts
