"""Rendering a scene into a data set: instants at 120 fps, and true 30 fps key frames.

A scene's folder gets `manifest.json`, `instants/NAME.####.exr` (colour and all G-buffers, vectors
over 1/120 s) and `keys/NAME.####.exr` (every fourth instant again, or every one in shots to train
with, vectors over 1/30 s). Benchmark scenes also get `floor/NAME.####.exr`: three instants with
other noise, to tell from how many dB on scores mean nothing. Frames that are there and whole are
kept, so that a run that was stopped goes on where it was.
"""

from __future__ import annotations

import os
import shutil
import sys
import tempfile
import time
from collections.abc import Callable, Collection
from dataclasses import dataclass, replace
from pathlib import Path

from stage import files, manifest, render
from stage.blender import bpy
from stage.manifest import INSTANTS_PER_KEY, Manifest
from stage.motion import FPS

BYTES_PER_PIXEL = 26.0
"""Of a written frame; measured 21 to 29, more where there are leaves."""

KEY_SHARE = 0.35
"""Time that a key frame's vectors take, in times of an instant."""

KINDS = ("instants", "floor", "keys")

OTHER_NOISE = 500_000
"""What is added to the seed of the noise for the noise floor."""


@dataclass(frozen=True)
class Script:
    """A scene as its script describes it.

    Attributes
    ----------
    name : str
        Base name of its folder and files.
    about : str
        One sentence.
    build : callable
        Builds the scene, for instants 0 to `last`, in an empty Blender file; takes (seed, last)
        and returns what each object id is.
    instants : int
        How many.
    seed : int
        Of the scene's small random differences, and of the noise.
    role : str
        "benchmark" or "training".
    pace : float
        Core-seconds for a megapixel at one sample, as measured: for the estimate before the
        first frame.
    key_step : int
        How far apart the instants are that are also rendered as key frames: 1 lets a key frame
        begin anywhere.
    """

    name: str
    about: str
    build: Callable[[int, int], dict[int, str]]
    instants: int = 241
    seed: int = 1
    role: str = "benchmark"
    pace: float = 3.0
    key_step: int = INSTANTS_PER_KEY


@dataclass(frozen=True)
class Order:
    """What is to be rendered of a scene, and where to.

    Attributes
    ----------
    data : Path
        Folder of all scenes.
    size : tuple of int
        Width and height.
    samples : int
        Per pixel.
    frames : frozenset of int
        Numbers of the instants that are wanted, from 1; empty for all.
    what : frozenset of str
        Which of `KINDS`.
    key_step : int or None
        In place of the script's.
    """

    data: Path
    size: tuple[int, int]
    samples: int
    frames: frozenset[int] = frozenset()
    what: frozenset[str] = frozenset(KINDS)
    key_step: int | None = None


def shoot(script: Script, order: Order) -> None:
    """Render what is missing of a scene.

    Raises
    ------
    SystemExit
        With one sentence, when the folder holds another rendering, or the disk is too small.
    """
    script = replace(script, key_step=order.key_step or script.key_step)
    folder = order.data / script.name
    _refuse_other(folder, _describe(script, order, {}), but=("dynamic",))
    wanted = _wanted(script, order)
    missing = _missing(script, order, folder, wanted)
    if not missing:
        if not (folder / manifest.NAME).is_file():
            manifest.write(folder, _describe(script, order, _build(script, order)))
        say(f"{script.name}: all {len(wanted)} files are there and whole, in {folder}")
        return
    _say_plan(script, order, folder, wanted, missing)
    progress = _Progress(script.name, missing)
    for what, product in render.products(order.samples, INSTANTS_PER_KEY).items():
        instants = [instant for kind, instant in missing if kind == what]
        if not instants:
            continue
        # Anew for each kind: Blender 5.0 crashed, or wrote wrong vectors, when passes changed on
        # data kept from frame to frame.
        description = _describe(script, order, _build(script, order))
        _refuse_other(folder, description)
        manifest.write(folder, description)
        (folder / what).mkdir(exist_ok=True)
        render.configure(product, FPS)
        for instant in instants:
            _make(script, folder, what, instant, product)
            progress.step(what, instant)
    progress.end()


def _build(script: Script, order: Order) -> dict[int, str]:
    """Build the scene in an empty file and return what its object ids are."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    dynamic = script.build(script.seed, script.instants - 1)
    render.settle(order.size)
    return dynamic


def _wanted(script: Script, order: Order) -> list[tuple[str, int]]:
    """List (kind, instant from 0) of all that the order asks for, in the order of rendering."""
    numbers = order.frames or frozenset(range(1, script.instants + 1))
    if beyond := sorted(number for number in numbers if number > script.instants):
        sys.exit(f"--frames: {script.name} has frames 1 to {script.instants}, not {beyond[0]}.")
    instants = sorted(number - 1 for number in numbers)
    keys = [instant for instant in instants if instant % script.key_step == 0]
    floor = {0, script.instants // 2, script.instants - 1} if script.role == "benchmark" else set()
    of = {"instants": instants, "floor": sorted(floor.intersection(instants)), "keys": keys}
    return [(what, instant) for what in KINDS if what in order.what for instant in of[what]]


def _path(script: Script, folder: Path, what: str, instant: int) -> Path:
    number = instant // script.key_step if what == "keys" else instant
    return folder / what / f"{script.name}.{number + 1:04d}.exr"


def _missing(
    script: Script, order: Order, folder: Path, wanted: list[tuple[str, int]]
) -> list[tuple[str, int]]:
    """List what is not there, or damaged; a key frame also needs its instant."""
    missing = [
        (what, instant)
        for what, instant in wanted
        if not files.is_whole(_path(script, folder, what, instant), order.size)
    ]
    sources = [("instants", instant) for what, instant in missing if what == "keys"]
    unasked = [source for source in sources if source not in wanted]
    return missing + [
        source
        for source in unasked
        if not files.is_whole(_path(script, folder, *source), order.size)
    ]


def _say_plan(
    script: Script,
    order: Order,
    folder: Path,
    wanted: Collection[tuple[str, int]],
    missing: Collection[tuple[str, int]],
) -> None:
    """Say how much there is to do, how long that takes and how large it gets."""
    width, height = order.size
    share = sum(KEY_SHARE if what == "keys" else 1.0 for what, _ in missing)
    cores = os.cpu_count() or 1
    seconds = share * script.pace * width * height / 1e6 * order.samples / cores
    size = len(missing) * BYTES_PER_PIXEL * width * height
    say(
        f"{script.name}: {len(missing)} of {len(wanted)} files to render at {width}x{height} with "
        f"{order.samples} samples, about {_span(seconds)} on {cores} cores and "
        f"{_amount(size)}, to {folder}"
    )
    folder.mkdir(parents=True, exist_ok=True)
    free = shutil.disk_usage(folder).free
    if size > free:
        sys.exit(
            f"{folder} has room for {_amount(free)}; name another folder with --data, "
            "or less with --frames or --resolution."
        )


def _describe(script: Script, order: Order, dynamic: dict[int, str]) -> Manifest:
    return Manifest(
        scene=script.name,
        role=script.role,
        about=script.about,
        instants=script.instants,
        fps=FPS,
        key_fps=FPS // INSTANTS_PER_KEY,
        width=order.size[0],
        height=order.size[1],
        renderer=f"Blender {bpy.app.version_string} Cycles",
        samples=order.samples,
        denoiser="OpenImageDenoise",
        seed=script.seed,
        motion=manifest.BLENDER_MOTION,
        key_step=script.key_step,
        dynamic={str(index): dynamic[index] for index in sorted(dynamic)},
    )


def _refuse_other(folder: Path, description: Manifest, but: Collection[str] = ()) -> None:
    """Refuse to mix two renderings in one folder."""
    if found := manifest.differences(folder, description, but):
        sys.exit(
            f"{folder} holds another rendering ({found[0]}); remove it, or name another folder "
            "with --data."
        )


def _make(script: Script, folder: Path, what: str, instant: int, product: render.Product) -> None:
    """Render one file. A key frame is its instant with vectors that span a key interval."""
    target, noise = _path(script, folder, what, instant), script.seed * 1000
    if what != "keys":
        other = OTHER_NOISE if what == "floor" else 0
        render.render(instant, product, target, noise + other)
        return
    with tempfile.TemporaryDirectory(dir=target.parent, prefix=".part-") as apart:
        vectors = Path(apart, "vectors.exr")
        render.render(instant, product, vectors, noise)
        files.join_key(_path(script, folder, "instants", instant), vectors, target)


class _Progress:
    """Says after each frame how many are done and how long the rest takes."""

    def __init__(self, name: str, missing: Collection[tuple[str, int]]) -> None:
        self._name = name
        self._left = dict.fromkeys(KINDS, 0)
        for what, _ in missing:
            self._left[what] += 1
        self._all = len(missing)
        self._started = self._last = time.monotonic()
        self._spent: dict[str, list[float]] = {kind: [] for kind in KINDS}

    def step(self, what: str, instant: int) -> None:
        """Count a frame."""
        now = time.monotonic()
        self._spent[what].append(now - self._last)
        self._last = now
        self._left[what] -= 1
        done = self._all - sum(self._left.values())
        say(
            f"{self._name}: {what} {instant + 1}, {done} of {self._all}, "
            f"{self._spent[what][-1]:.1f} s, {_span(self._rest())} left"
        )

    def _rest(self) -> float:
        pace = {kind: self._mean(kind) for kind in self._spent}
        pace["floor"] = pace["floor"] or pace["instants"]
        pace["keys"] = pace["keys"] or KEY_SHARE * pace["instants"]
        return sum(pace[kind] * self._left[kind] for kind in pace)

    def _mean(self, kind: str) -> float:
        """Mean of the last frames, without the first one, which also loads the scene."""
        spent = self._spent[kind]
        recent = spent[1:][-20:] or spent
        return sum(recent) / len(recent) if recent else 0.0

    def end(self) -> None:
        """Say how long it took."""
        say(
            f"{self._name}: done in {_span(time.monotonic() - self._started)}, "
            f"{self._mean('instants'):.2f} s an instant, {self._mean('keys'):.2f} s a key frame"
        )


def _span(seconds: float) -> str:
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"


def _amount(size: float) -> str:
    return f"{size / 1e9:.1f} GB" if size >= 1e9 else f"{size / 1e6:.0f} MB"


def say(text: str) -> None:
    """Print a line at once, also into a log file."""
    sys.stdout.write(text + "\n")
    sys.stdout.flush()
