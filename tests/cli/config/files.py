"""Config files where they are looked for."""

from __future__ import annotations

from pathlib import Path


def write(folder: Path, text: str, name: str = "exwarp.toml") -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    (folder / name).write_text(text)
    return folder / name


def users(project: Path, text: str) -> Path:
    return write(project.parent / "home" / "exwarp", text)
