"""Choosing the scenes to learn from."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from fnmatch import fnmatchcase
from pathlib import Path

from exwarp_cli.domain.dataset import TRAINING
from exwarp_cli.errors import InputError, MissingFrameError
from exwarp_cli.io.dataset import RenderedScene, find_scenes


def select(
    data: Path, wanted: Sequence[str], unwanted: Sequence[str], say: Callable[[str], None]
) -> list[RenderedScene]:
    """Return a folder's scenes by name.

    Parameters
    ----------
    data
        Folder of rendered scenes.
    wanted
        Glob patterns of names; empty for all whose role is training.
    unwanted
        Glob patterns of names to leave out.
    say
        Told of scenes that are left out because they are not rendered to the end.

    Raises
    ------
    InputError
        When none is left.
    """
    found = []
    for scene in find_scenes(data):
        name = scene.name
        asked = _matches(name, wanted) if wanted else scene.manifest.role == TRAINING
        if not asked or _matches(name, unwanted):
            continue
        try:
            scene.require_complete()
        except MissingFrameError:
            say(f"{name} is not rendered to the end and left out")
            continue
        found.append(scene)
    if not found:
        raise InputError(
            f"{data} has no scene to learn from; render some with examples/scenes/variety.py, or "
            "choose others with --scenes"
        )
    return found


def _matches(name: str, patterns: Sequence[str]) -> bool:
    return any(fnmatchcase(name, pattern) for pattern in patterns)
