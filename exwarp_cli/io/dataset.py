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

BENCHMARK, TRAINING = "benchmark", "training"
ROLES = (BENCHMARK, TRAINING)


@dataclass(frozen=True)
class FrameSet:
    """Numbered frames of one rate.

    Attributes
    ----------
    pattern
        Path relative to the scene's folder, with ``#`` for digits.
    first, count
        Number of the first frame, and how many there are; numbered in steps of one.
    step
        How far apart they are, in instants.
    """

    pattern: str
    first: int
    count: int
    step: int = 1

    @property
    def numbers(self) -> range:
        """All frame numbers."""
        return range(self.first, self.first + self.count)


@dataclass(frozen=True)
class SceneManifest:
    """What one folder of a data set holds.

    Attributes
    ----------
    scene
        Name, unique in a data set.
    role
        "benchmark" (judged on, and only ever trained on when another one is judged) or
        "training" (never judged on).
    about
        One sentence.
    width, height
        Pixels.
    fps, key_fps
        Rate of the instants, and of the key frames.
    instants
        Colour and G-buffers of every instant; motion vectors reach to the neighbouring instants.
    keys
        Every `keys.step`-th instant again, as a key frame: motion vectors reach over 1/`key_fps`.
    renderer
        Program, version and engine.
    samples, denoiser
        Per pixel; and the denoiser's name, or "".
    seed
        Of the scene and of the noise.
    motion
        What the motion channels mean, in the notation of ``--motion``.
    dynamic
        What the object ids stand for; 0, all that stands still, is not listed.
    """

    scene: str
    role: str
    about: str
    width: int
    height: int
    fps: int
    key_fps: int
    instants: FrameSet
    keys: FrameSet
    renderer: str
    samples: int
    denoiser: str
    seed: int
    motion: str
    dynamic: Mapping[int, str]

    @property
    def size(self) -> str:
        """Width and height as text, "427x240"."""
        return f"{self.width}x{self.height}"

    def has_key(self, index: int) -> bool:
        """Whether an instant, counted from 0, was also rendered as a key frame."""
        whole, beyond = divmod(index, self.keys.step)
        return beyond == 0 and 0 <= whole < self.keys.count


MANIFEST = "manifest.json"
SCHEMA = "exwarp.scene/1"


@dataclass(frozen=True)
class RenderedScene:
    """One scene of a data set.

    Attributes
    ----------
    folder
        Where it lies.
    manifest
        What it holds once it is rendered in full.
    """

    folder: Path
    manifest: SceneManifest

    @property
    def name(self) -> str:
        """The scene's name."""
        return self.manifest.scene

    def path(self, frames: FrameSet, number: int) -> Path:
        """Path of one frame of `manifest.instants` or `manifest.keys`."""
        pattern = NamePattern.parse(frames.pattern)
        assert pattern is not None  # a manifest with another one is refused
        return self.folder / pattern.name(number)

    def missing(self, frames: FrameSet) -> tuple[int, ...]:
        """Numbers of frames that are not there (yet)."""
        return tuple(n for n in frames.numbers if not self.path(frames, n).is_file())

    def require_complete(self) -> None:
        """Refuse a scene that is not rendered in full.

        Raises
        ------
        MissingFrameError
            When a frame is missing.
        """
        for frames in (self.manifest.instants, self.manifest.keys):
            if absent := self.missing(frames):
                raise MissingFrameError(
                    f"{self.folder} lacks frames {ranges(list(absent))} of {frames.pattern}; "
                    "finish rendering it, which goes on where it stopped"
                )

    def as_far_as_rendered(self) -> RenderedScene:
        """Return the scene as if only its first unbroken run of rendered key frames were meant.

        Instants after the last key frame of a scene that is whole belong to it.

        Raises
        ------
        MissingFrameError
            When fewer than two successive key frames, with the instants between, are there.
        """
        manifest = self.manifest
        step, first = manifest.keys.step, manifest.instants.first
        absent = set(self.missing(manifest.instants)), set(self.missing(manifest.keys))
        if not any(absent):
            return self
        there = set(manifest.instants.numbers) - absent[0]
        keys = set(manifest.keys.numbers) - absent[1]
        run: list[int] = []
        for index in range(manifest.keys.count):
            span = range(first + step * (index - 1), first + step * index + 1)
            if manifest.keys.first + index in keys and there.issuperset(span):
                run.append(index)
            elif len(run) > 1:
                break
            else:
                run = [index] if manifest.keys.first + index in keys else []
        if len(run) < 2:
            raise MissingFrameError(
                f"{self.folder} has no two successive key frames with all instants between; "
                "render some, as with --frames 1-9"
            )
        instants = replace(
            manifest.instants, first=first + step * run[0], count=step * (len(run) - 1) + 1
        )
        chosen = replace(manifest.keys, first=manifest.keys.first + run[0], count=len(run))
        return replace(self, manifest=replace(manifest, instants=instants, keys=chosen))

    @cached_property
    def instants(self) -> Shot:
        """The instants as a sequence."""
        return self._open(self.manifest.instants)

    @cached_property
    def keys(self) -> Shot:
        """The key frames as a sequence."""
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
    """Find the scenes of a data set, by name.

    Parameters
    ----------
    data
        Folder whose subfolders are scenes; or one scene's folder.
    role
        "benchmark" or "training"; None for both.
    names
        Only these, in this order; empty for all, ascending.

    Raises
    ------
    InputError
        When there is none, or one that is named is not there.
    """
    root = Path(os.path.expanduser(data))  # noqa: PTH111  # which raises without a home folder
    if not root.is_dir():
        raise InputError(f"the data set {root} is no folder; render scenes first or mend the path")
    folders = [root] if (root / MANIFEST).is_file() else sorted(root.iterdir())
    found = [open_scene(folder) for folder in folders if (folder / MANIFEST).is_file()]
    scenes = {s.name: s for s in found if role is None or s.manifest.role == role}
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

    Raises
    ------
    InputError
        When there is none.
    DamagedFileError
        When it is not what a manifest has to be.
    LayoutError
        When it is of another version of the layout.
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
    try:
        return RenderedScene(Path(folder), _parse(content))
    except (KeyError, TypeError, ValueError) as error:
        raise DamagedFileError(
            f"{path} lacks or misstates {error}; render the scene again"
        ) from error


def _parse(content: dict[str, Any]) -> SceneManifest:
    texts = {
        name: _of(content, name, str)
        for name in ("scene", "role", "about", "renderer", "denoiser", "motion")
    }
    if texts["role"] not in ROLES:
        raise ValueError(f"role {texts['role']!r}")
    return SceneManifest(
        **texts,
        width=_positive(content, "width"),
        height=_positive(content, "height"),
        fps=_positive(content, "fps"),
        key_fps=_positive(content, "key_fps"),
        samples=_positive(content, "samples"),
        seed=_of(content, "seed", int),
        instants=_frames(content, "instants"),
        keys=_frames(content, "keys"),
        dynamic={int(index): str(what) for index, what in _of(content, "dynamic", dict).items()},
    )


def _frames(content: dict[str, Any], name: str) -> FrameSet:
    inner = _of(content, name, dict)
    pattern = _of(inner, "pattern", str)
    digits = pattern.count("#")
    inside = not Path(pattern).is_absolute() and ".." not in Path(pattern).parts
    if not (digits and "#" * digits in pattern and inside):
        raise ValueError(f"pattern {pattern!r}")
    step = _positive(inner, "step") if "step" in inner else 1
    return FrameSet(pattern, _of(inner, "first", int), _positive(inner, "count"), step)


def _positive(content: dict[str, Any], name: str) -> int:
    value: int = _of(content, name, int)
    if value < 1:
        raise ValueError(f"{name} {value}")
    return value


def _of(content: dict[str, Any], name: str, kind: type) -> Any:
    value = content[name]
    if not isinstance(value, kind) or isinstance(value, bool):
        raise ValueError(f"{name} {value!r}")
    return value


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
        Receives every scene that is left out because it is not rendered to the end.

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
