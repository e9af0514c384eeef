"""What a job on a cluster comes to, and a job in one process."""

from __future__ import annotations

from pathlib import Path

from exwarp_cli.io.files import TEMPORARY_SUFFIX
from tests.cli import shots
from tests.cli.reports import album, rows, unmeasured

KEYS = 4
"""Key frames of the shot."""


def agree(one: Path, other: Path) -> None:
    """Judge that two folders hold the same frames, masks, videos and reports."""
    assert shots.names(one) == shots.names(other)
    for name in ("frames", "holes"):
        assert shots.contents(one / name) == shots.contents(other / name)
        assert not [n for n in shots.names(other / name) if TEMPORARY_SUFFIX in n]
    if (one / "a.mp4").exists():
        assert (one / "a.mp4").read_bytes() == (other / "a.mp4").read_bytes()
    if (one / "report").exists():
        for read in (unmeasured, rows, album):
            assert read(one / "report") == read(other / "report")
