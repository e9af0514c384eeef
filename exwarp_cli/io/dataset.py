"""Folders of rendered scenes: each with its manifest, instants and key frames.

::

    DATA/lab/manifest.json
    DATA/lab/instants/lab.0001.exr …    colour and G-buffers at the output rate
    DATA/lab/keys/lab.0001.exr …        true key frames: vectors reach from key frame to key frame
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from functools import cached_property
from pathlib import Path
from typing import Any

from exwarp_cli.domain.timeline import ranges
from exwarp_cli.errors import DamagedFileError, InputError, LayoutError, MissingFrameError
from exwarp_cli.io.frame_names import NamePattern
from exwarp_cli.io.shot import Shot, open_shot

# Roles of scenes: judged on (and trained on only if another one is judged), and never judged on.
BENCHMARK, TRAINING = "benchmark", "training"
ROLES = (BENCHMARK, TRAINING)

MANIFEST = "manifest.json"
SCHEMA = "exwarp.scene/1"

# One scene in so many is left out of training, to validate on.
VALIDATION_STEP = 12


@dataclass(frozen=True)
class FrameSet:
    """Numbered frames of one rate; `pattern` is relative to the scene's folder, with ``#``."""

    pattern: str
    first: int
    count: int
    step: int = 1  # distance in instants; numbers are in steps of one

    @property
    def numbers(self) -> range:
        """All frame numbers."""
        return range(self.first, self.first + self.count)


@dataclass(frozen=True)
class SceneManifest:
    """What one folder of a data set holds."""

    scene: str  # its name, unique in a data set
    role: str
    about: str  # one sentence
    width: int
    height: int
    # Rates of the instants and of the key frames.
    fps: int
    key_fps: int
    # Colour and G-buffers of every instant; motion vectors reach to the neighbouring instants.
    instants: FrameSet
    # Every `keys.step`-th instant again, as a key frame: motion vectors reach over 1 / `key_fps`.
    keys: FrameSet
    renderer: str  # program, version and engine
    samples: int  # per pixel
    denoiser: str  # "" without
    seed: int  # of the scene and of the noise
    motion: str  # what the motion channels mean, as --motion takes it
    dynamic: Mapping[int, str]  # what the object ids stand for, without 0, all that stands still

    @property
    def size(self) -> str:
        """Width and height as text, "427x240"."""
        return f"{self.width}x{self.height}"

    def has_key(self, index: int) -> bool:
        """Return True if an instant, counted from 0, was also rendered as a key frame."""
        key, remainder = divmod(index, self.keys.step)
        return remainder == 0 and 0 <= key < self.keys.count


@dataclass(frozen=True)
class RenderedScene:
    """One scene of a data set; the manifest says what it holds once it is rendered in full."""

    folder: Path
    manifest: SceneManifest

    @property
    def name(self) -> str:
        """The scene's name."""
        return self.manifest.scene

    def path(self, frames: FrameSet, number: int) -> Path:
        """Return the path of one frame of `manifest.instants` or `manifest.keys`."""
        pattern = NamePattern.parse(frames.pattern)
        assert pattern is not None  # a manifest with another one is refused
        return self.folder / pattern.name(number)

    def missing(self, frames: FrameSet) -> tuple[int, ...]:
        """Return the numbers of frames that are not rendered yet."""
        return tuple(n for n in frames.numbers if not self.path(frames, n).is_file())

    def require_complete(self) -> None:
        """Refuse a scene that is not rendered in full; MissingFrameError."""
        for frames in (self.manifest.instants, self.manifest.keys):
            if absent := self.missing(frames):
                raise MissingFrameError(
                    f"{self.folder} lacks frames {ranges(list(absent))} of {frames.pattern}; "
                    "finish rendering it, which goes on where it stopped"
                )

    def as_far_as_rendered(self) -> RenderedScene:
        """Return the scene of the first unbroken run of rendered key frames alone.

        Instants after the last key frame of a scene that is complete belong to it.

        Raises MissingFrameError if fewer than two successive key frames, with the instants between,
        are there.
        """
        manifest = self.manifest
        step, first = manifest.keys.step, manifest.instants.first
        absent_instants = self.missing(manifest.instants)
        absent_keys = self.missing(manifest.keys)
        if not absent_instants and not absent_keys:
            return self
        instants = set(manifest.instants.numbers).difference(absent_instants)
        keys = set(manifest.keys.numbers).difference(absent_keys)
        run: list[int] = []
        for index in range(manifest.keys.count):
            interval = range(first + step * (index - 1), first + step * index + 1)
            has_key = manifest.keys.first + index in keys
            if has_key and instants.issuperset(interval):
                run.append(index)
            elif len(run) > 1:
                break
            else:
                run = [index] if has_key else []
        if len(run) < 2:
            raise MissingFrameError(
                f"{self.folder} has no two successive key frames with all instants between; "
                "render some, as with --frames 1-9"
            )
        rendered = replace(
            manifest,
            instants=replace(
                manifest.instants, first=first + step * run[0], count=step * (len(run) - 1) + 1
            ),
            keys=replace(manifest.keys, first=manifest.keys.first + run[0], count=len(run)),
        )
        return replace(self, manifest=rendered)

    @cached_property
    def instants(self) -> Shot:
        """The instants as a shot."""
        return self._open(self.manifest.instants)

    @cached_property
    def keys(self) -> Shot:
        """The key frames as a shot."""
        return self._open(self.manifest.keys)

    def _open(self, frames: FrameSet) -> Shot:
        shot = open_shot(str(self.folder / frames.pattern))
        width, height = self.manifest.width, self.manifest.height
        if (shot.display.width, shot.display.height) != (width, height):
            raise LayoutError(
                f"{shot.sequence.pattern} is {shot.display.width}x{shot.display.height} and "
                f"{self.folder / MANIFEST} says {width}x{height}; render the scene again"
            )
        return shot


def find_scenes(
    data: str | Path, role: str | None = None, names: Iterable[str] = ()
) -> tuple[RenderedScene, ...]:
    """Find the scenes of a data set: a folder whose subfolders are scenes, or one scene's folder.

    `role` None is for both roles. `names` are kept in their order; empty for all, ascending.

    Raises InputError if there is no scene, or not every named one.
    """
    root = Path(os.path.expanduser(data))  # noqa: PTH111  # which raises without a home folder
    if not root.is_dir():
        raise InputError(f"the data set {root} is no folder; render scenes first or mend the path")
    folders = [root] if (root / MANIFEST).is_file() else sorted(root.iterdir())
    every = [open_scene(folder) for folder in folders if (folder / MANIFEST).is_file()]
    scenes = {s.name: s for s in every if role is None or s.manifest.role == role}
    if not scenes:
        kind = "scene" if role is None else f"{role} scene"
        raise InputError(f"{root} holds no {kind} (a folder with {MANIFEST}); render one first")
    wanted = tuple(names) or tuple(sorted(scenes))
    for name in wanted:
        if name not in scenes:
            raise InputError(f"{root} holds no scene {name!r}, but {', '.join(sorted(scenes))}")
    return tuple(scenes[name] for name in wanted)


def open_scene(folder: str | Path) -> RenderedScene:
    """Read one scene's manifest.

    Raises InputError if there is none, DamagedFileError if it is broken, LayoutError if it is of
    another version of the schema.
    """
    path = Path(folder) / MANIFEST
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        raise InputError(f"{path} is missing; render the scene, which writes it") from error
    except (OSError, ValueError, RecursionError) as error:
        raise DamagedFileError(
            f"{path} cannot be read ({error}); render the scene again"
        ) from error
    if not isinstance(content, dict) or content.get("schema") != SCHEMA:
        raise LayoutError(f"{path} is not of schema {SCHEMA}; render the scene again")
    texts = ("scene", "role", "about", "renderer", "denoiser", "motion")
    counts = ("width", "height", "fps", "key_fps", "samples")
    try:
        values: dict[str, Any] = {name: _typed(content, name, str) for name in texts}
        if values["role"] not in ROLES:
            raise ValueError(f"role {values['role']!r}")
        values |= {name: _typed(content, name, int, least=1) for name in counts}
        values["seed"] = _typed(content, "seed", int)
        for name in ("instants", "keys"):
            frames = _typed(content, name, dict)
            pattern = _typed(frames, "pattern", str)
            digits = pattern.count("#")
            is_inside = not Path(pattern).is_absolute() and ".." not in Path(pattern).parts
            if not (digits and "#" * digits in pattern and is_inside):
                raise ValueError(f"pattern {pattern!r}")
            step = _typed(frames, "step", int, least=1) if "step" in frames else 1
            first, count = _typed(frames, "first", int), _typed(frames, "count", int, least=1)
            values[name] = FrameSet(pattern, first, count, step)
        dynamic = _typed(content, "dynamic", dict)
        values["dynamic"] = {int(index): str(name) for index, name in dynamic.items()}
        return RenderedScene(Path(folder), SceneManifest(**values))
    except (KeyError, TypeError, ValueError) as error:
        raise DamagedFileError(
            f"{path} lacks or misstates {error}; render the scene again"
        ) from error


def _typed(content: dict[str, Any], name: str, kind: type, least: int | None = None) -> Any:
    value = content[name]
    is_typed = isinstance(value, kind) and not isinstance(value, bool)
    if not is_typed or (least is not None and value < least):
        raise ValueError(f"{name} {value!r}")
    return value


def select_scenes(
    data: Path, wanted: Sequence[str], unwanted: Sequence[str], say: Callable[[str], None]
) -> list[RenderedScene]:
    """Return the scenes of a folder to train on, by glob patterns of names.

    Without `wanted` ones, all whose role is training. `say` receives a message for every scene that
    is left out because it is not rendered to the end.

    Raises InputError if none is left.
    """
    scenes = []
    for scene in find_scenes(data):
        is_wanted = scene.manifest.role == TRAINING
        if wanted:
            is_wanted = any(fnmatchcase(scene.name, pattern) for pattern in wanted)
        if not is_wanted or any(fnmatchcase(scene.name, pattern) for pattern in unwanted):
            continue
        try:
            scene.require_complete()
        except MissingFrameError:
            say(f"{scene.name} is not rendered to the end and left out")
            continue
        scenes.append(scene)
    if not scenes:
        raise InputError(
            f"{data} has no scene to learn from; render some with examples/scenes/variety.py, or "
            "choose others with --scenes"
        )
    return scenes


def split_scenes(
    scenes: Sequence[RenderedScene],
) -> tuple[list[RenderedScene], list[RenderedScene]]:
    """Return scenes to train on and to validate on: every twelfth by name, at least one."""
    ordered = sorted(scenes, key=lambda s: s.name)
    if len(ordered) < 2:
        raise InputError(
            f"there is {len(ordered)} scene to train on, and one more is needed to validate on; "
            "render more with examples/scenes/variety.py"
        )
    held_out = ordered[VALIDATION_STEP // 2 :: VALIDATION_STEP] or ordered[-1:]
    return [s for s in ordered if s not in held_out], held_out
