"""The manifest of a rendered scene, and where scenes lie; this module does without Blender."""

from __future__ import annotations

import json
import os
from collections.abc import Collection
from dataclasses import asdict, dataclass, field
from pathlib import Path

NAME = "manifest.json"
SCHEMA = "exwarp.scene/1"
INSTANTS_PER_KEY = 4
FLOOR = "noise_floor_psnr_db"
"""Key of what is measured on the finished frames; it does not tell renderings apart."""

BLENDER_MOTION = "previous=X,-Y next=-Z,W"
"""Blender's Vector pass: previous minus current in X and Y, current minus next in Z and W, in
pixels, rows counted upwards."""


@dataclass(frozen=True)
class Manifest:
    """What was, or is being, rendered into one folder.

    Attributes
    ----------
    scene : str
        Name; also the base name of the files.
    role : str
        "benchmark" scenes are judged on; "training" shots never are.
    about : str
        One sentence.
    first, instants : int
        Number of the first instant, and how many there are, 1/fps apart.
    fps, key_fps : int
        Rates of instants and of key frames.
    width, height : int
        Pixels.
    renderer : str
        Name, version and engine.
    samples : int
        Per pixel of each render.
    seeds : int
        Renders with other noise, each denoised, whose mean a frame is.
    denoiser : str
        Name, or "" for none.
    sampling : str
        What differs from the quick way of sampling, or "".
    seed : int
        Of the scene and of the noise.
    motion : str
        What the channels of the vectors mean, in the notation of `exwarp --motion`.
    key_step : int
        How far apart the instants are that were also rendered as key frames.
    dynamic : dict of str to str
        Object ids (as text, as JSON wants it) of what moves, and what each is.
    features : list of str
        What a training shot is to show that is hard to warp.
    packages : dict of str to str
        Debian's packages of real things that the shot was built with, and their versions.
    things : list of dict
        The real things in the shot: name, title, author, licence and package of each.
    """

    scene: str
    role: str
    about: str
    first: int
    instants: int
    fps: int
    key_fps: int
    width: int
    height: int
    renderer: str
    samples: int
    seeds: int
    denoiser: str
    sampling: str
    seed: int
    motion: str
    key_step: int
    dynamic: dict[str, str]
    features: list[str] = field(default_factory=list)
    packages: dict[str, str] = field(default_factory=dict)
    things: list[dict[str, str]] = field(default_factory=list)

    @property
    def keys(self) -> int:
        """How many instants were also rendered as key frames."""
        return (self.instants - 1) // self.key_step + 1

    def content(self) -> dict[str, object]:
        """Return what the file says, with the sequences named."""
        content: dict[str, object] = {"schema": SCHEMA} | asdict(self)
        for key in ("features", "packages", "things"):
            if not content[key]:
                del content[key]
        content["instants"] = {
            "pattern": f"instants/{self.scene}.####.exr",
            "first": content.pop("first"),
            "count": self.instants,
        }
        content["keys"] = {
            "pattern": f"keys/{self.scene}.####.exr",
            "first": (self.first - 1) // self.key_step + 1,
            "count": self.keys,
            "step": content.pop("key_step"),
        }
        return content


def default_data() -> Path:
    """Return where rendered scenes go by default: the user's cache folder."""
    cache = os.environ.get("XDG_CACHE_HOME") or "~/.cache"
    return Path(cache).expanduser() / "exwarp" / "scenes"


def differences(folder: Path, manifest: Manifest, but: Collection[str] = ()) -> list[str]:
    """Say how a folder's manifest differs from another one; nothing if it has none.

    Parameters
    ----------
    folder : Path
        A scene's folder.
    manifest : Manifest
        What it should hold.
    but : collection of str
        Keys that are not compared.
    """
    path = folder / NAME
    if not path.is_file():
        return []
    try:
        there = json.loads(path.read_text(encoding="utf-8"))
    except ValueError:
        return ["it is no JSON"]
    wanted = manifest.content()
    there = {"seeds": 1, "sampling": ""} | there  # as in older manifests
    keys = sorted((wanted.keys() | there.keys()) - {FLOOR, *but})
    return [
        f"{key} is {there.get(key)!r}, not {wanted.get(key)!r}"
        for key in keys
        if there.get(key) != wanted.get(key)
    ]


def write(folder: Path, manifest: Manifest) -> None:
    """Write a folder's manifest, whole or not at all."""
    _write(folder, manifest.content())


def write_floor(folder: Path, psnr_db: float | None) -> None:
    """Add the measured noise floor to a folder's manifest; None takes it out."""
    content = json.loads((folder / NAME).read_text(encoding="utf-8"))
    content.pop(FLOOR, None)
    if psnr_db is not None:
        content[FLOOR] = psnr_db
    _write(folder, content)


def _write(folder: Path, content: dict[str, object]) -> None:
    part = folder / f".{NAME}.part"
    text = json.dumps(content, indent=2, ensure_ascii=False) + "\n"
    part.write_text(text, encoding="utf-8")
    part.replace(folder / NAME)
