"""What may have happened to a frame's file."""

from __future__ import annotations

from pathlib import Path


def remove(path: Path) -> None:
    """Lose it."""
    path.unlink()


def truncate(path: Path) -> None:
    """Lose its last third."""
    path.write_bytes(path.read_bytes()[: path.stat().st_size * 2 // 3])


def scribble(path: Path) -> None:
    """Have something else in its place."""
    path.write_bytes(b"this is no image")
