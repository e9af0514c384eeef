"""Choosing the scenes to learn from."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from fnmatch import fnmatchcase
from pathlib import Path

from exwarp_cli.errors import InputError, MissingFrameError
from exwarp_cli.io.dataset import TRAINING, RenderedScene, find_scenes

EVERY = 12
"""One scene in so many is left out of training, to validate on."""


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


def split(scenes: Sequence[RenderedScene]) -> tuple[list[RenderedScene], list[RenderedScene]]:
    """Return scenes to train on and to validate on: every twelfth by name, at least one."""
    ordered = sorted(scenes, key=lambda s: s.name)
    if len(ordered) < 2:
        raise InputError(
            f"there is {len(ordered)} scene to train on, and one more is needed to validate on; "
            "render more with examples/scenes/variety.py"
        )
    held = ordered[EVERY // 2 :: EVERY] or ordered[-1:]
    return [s for s in ordered if s not in held], held
