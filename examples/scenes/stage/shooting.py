"""Rendering a scene into a data set: instants at 120 fps, and true 30 fps key frames.

A scene's folder gets `manifest.json`, `instants/NAME.####.exr` (colour and all G-buffers, vectors
over 1/120 s) and `keys/NAME.####.exr` (every fourth instant again, or every one in shots to train
with, vectors over 1/30 s). Benchmark scenes also get `floor/NAME.####.exr`: the first instant of
each block with other noise, to tell from how many dB on scores mean nothing. Instants and key
frames are rendered in turns, `BLOCK` instants at a time, so that the first intervals can be used
early. Frames that are there and whole are kept, so that a stopped run goes on where it was.
"""

from __future__ import annotations

import os
import shutil
import sys
import tempfile
import time
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

from stage import files, manifest, raster, render
from stage.blender import bpy
from stage.manifest import INSTANTS_PER_KEY, Manifest
from stage.motion import FPS
from stage.quality import HURRIED, HURRIED_RASTER, MOST_SEEDS, Quality, Raster

BYTES_PER_PIXEL = 26.0
"""Of a written frame; measured 21 to 29, more where there are leaves."""

KEY_SAMPLES = 6
"""Time that a key frame's vectors take, in times of a sample of an instant."""

KINDS = ("instants", "floor", "keys")

ENGINES = {"Cycles": render, "EEVEE": raster}
"""What renders, by the name in the manifest: a path tracer, and one that works as games do."""

BLOCK = 24
"""Instants that are rendered before the key frames among them."""

OTHER_NOISE = 500_000
"""What is added to the seed of the noise for the noise floor."""

NEXT_NOISE = 10_000
"""What is added to the seed of the noise for each further render of a frame."""


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
        How many the animation has.
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
    clean : Quality, Raster or None
        With which the noise floor is at least 38 dB; None where there is only the hurried look.
    span : tuple of int
        First and last number of the instants that are rendered clean.
    quality : Quality, Raster or None
        Of a script that is not rendered clean; None for the engine's hurried look.
    features : tuple of str
        What a training shot is to show that is hard to warp.
    packages : dict of str to str
        Packages of real things, and their versions.
    things : list of dict
        The real things in the scene; `build` fills it in.
    engine : str
        One of `ENGINES`.
    """

    name: str
    about: str
    build: Callable[[int, int], dict[int, str]]
    instants: int = 241
    seed: int = 1
    role: str = "benchmark"
    pace: float = 3.0
    key_step: int = INSTANTS_PER_KEY
    clean: Quality | Raster | None = None
    span: tuple[int, int] = (1, 61)
    quality: Quality | Raster | None = None
    features: tuple[str, ...] = ()
    packages: Mapping[str, str] = field(default_factory=dict)
    things: list[dict[str, str]] = field(default_factory=list)
    engine: str = "Cycles"


@dataclass(frozen=True)
class Order:
    """What is to be rendered of a scene, and where to.

    Attributes
    ----------
    data : Path
        Folder of all scenes.
    size : tuple of int
        Width and height.
    samples, seeds : int or None
        In place of the look's; see `Quality`.
    hurried : bool
        Whether a scene that is judged on is rendered as a hurried artist delivers it, in full
        length, into the folder "hurried".
    frames : frozenset of int
        Numbers of the instants that are wanted, from 1; empty for all.
    what : frozenset of str
        Which of `KINDS`.
    key_step : int or None
        In place of the script's.
    on_gpu : bool
        Whether Cycles renders on a GPU. EEVEE does where OpenGL does.
    """

    data: Path
    size: tuple[int, int]
    samples: int | None = None
    seeds: int | None = None
    hurried: bool = False
    frames: frozenset[int] = frozenset()
    what: frozenset[str] = frozenset(KINDS)
    key_step: int | None = None
    on_gpu: bool = False


@dataclass(frozen=True)
class Job:
    """A script and an order put together.

    Attributes
    ----------
    script : Script
        What is rendered, with the order's key step.
    order : Order
        What was asked for.
    quality : Quality or Raster
        How clean each frame gets.
    folder : Path
        The scene's.
    numbers : range
        Numbers of all instants that the folder is to hold.
    """

    script: Script
    order: Order
    quality: Quality | Raster
    folder: Path
    numbers: range

    @classmethod
    def plan(cls, script: Script, order: Order) -> Job:
        """Choose quality, folder and span for an order."""
        script = replace(script, key_step=order.key_step or script.key_step)
        folder, (first, last) = order.data, (1, script.instants)
        hurried = HURRIED if script.engine == "Cycles" else HURRIED_RASTER
        look: Quality | Raster = script.quality or hurried
        if script.clean is not None and order.hurried:
            folder = folder / "hurried"
        elif script.clean is not None:
            look, (first, last) = script.clean, script.span
        chosen = replace(look, samples=order.samples or look.samples)
        chosen = replace(chosen, seeds=order.seeds or look.seeds)
        if chosen.seeds > MOST_SEEDS:
            sys.exit(f"--renders: at most {MOST_SEEDS} renders of a frame, not {chosen.seeds}.")
        return cls(script, order, chosen, folder / script.name, range(first, last + 1))

    def describe(self, dynamic: dict[int, str]) -> Manifest:
        """Write down what the folder holds; `dynamic` is what each object id is."""
        script, order = self.script, self.order
        return Manifest(
            scene=script.name,
            role=script.role,
            about=script.about,
            first=self.numbers[0],
            instants=len(self.numbers),
            fps=FPS,
            key_fps=FPS // INSTANTS_PER_KEY,
            width=order.size[0],
            height=order.size[1],
            renderer=f"Blender {bpy.app.version_string} {script.engine}",
            samples=self.quality.samples,
            seeds=self.quality.seeds,
            denoiser=self.quality.denoiser,
            sampling=self.quality.sampling,
            seed=script.seed,
            motion=manifest.BLENDER_MOTION,
            key_step=script.key_step,
            dynamic={str(index): dynamic[index] for index in sorted(dynamic)},
            features=list(script.features),
            packages=dict(script.packages),
            things=list(script.things),
        )

    def path(self, what: str, instant: int) -> Path:
        """Path of a file; `instant` counts from 0."""
        number = instant // self.script.key_step if what == "keys" else instant
        return self.folder / what / f"{self.script.name}.{number + 1:04d}.exr"

    def is_whole(self, what: str, instant: int) -> bool:
        """Return True if a file is there and undamaged."""
        return files.is_whole(self.path(what, instant), self.order.size)


def shoot(script: Script, order: Order) -> None:
    """Render what is missing of a scene.

    Raises
    ------
    SystemExit
        With one sentence, when the folder holds another rendering, or the disk is too small.
    """
    job = Job.plan(script, order)
    _refuse_other(job.folder, job.describe({}), but=("dynamic", "things"))
    wanted = _wanted(job)
    missing = _missing(job, wanted)
    if not missing:
        if not (job.folder / manifest.NAME).is_file():
            manifest.write(job.folder, job.describe(_build(job)))
        say(f"{script.name}: all {len(wanted)} files are there and whole, in {job.folder}")
        return
    _say_plan(job, wanted, missing)
    progress = _Progress(
        script.name, missing, KEY_SAMPLES / (job.quality.samples * job.quality.seeds)
    )
    for part in _blocks(job, missing):
        engine = ENGINES[script.engine]
        for what, product in engine.products(job.quality.samples, INSTANTS_PER_KEY).items():
            if instants := [instant for kind, instant in part if kind == what]:
                _shoot_kind(job, what, product, instants, progress)
    progress.end()


def _shoot_kind(
    job: Job, what: str, product: render.Product, instants: list[int], progress: _Progress
) -> None:
    """Render files of one kind.

    The scene is built anew for it: Blender 5.0 crashed, or wrote wrong vectors, when passes changed
    on data kept from frame to frame.
    """
    description = job.describe(_build(job))
    _refuse_other(job.folder, description)
    manifest.write(job.folder, description)
    (job.folder / what).mkdir(exist_ok=True)
    ENGINES[job.script.engine].configure(product, FPS)
    for instant in instants:
        _make(job, what, instant, product)
        progress.step(what, instant)


def _build(job: Job) -> dict[int, str]:
    """Build the scene in an empty file and return what its object ids are."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    dynamic = job.script.build(job.script.seed, job.script.instants - 1)
    ENGINES[job.script.engine].settle(job.order.size, job.quality, job.order.on_gpu)
    return dynamic


def _wanted(job: Job) -> list[tuple[str, int]]:
    """List (kind, instant from 0) of all that the order asks for."""
    numbers, script = job.order.frames or frozenset(job.numbers), job.script
    if beyond := sorted(number for number in numbers if number not in job.numbers):
        first, last = job.numbers[0], job.numbers[-1]
        sys.exit(f"--frames: {script.name} has frames {first} to {last}, not {beyond[0]}.")
    instants = sorted(number - 1 for number in numbers)
    keys = [instant for instant in instants if instant % script.key_step == 0]
    # A scene of which only the first blocks are rendered has a floor too.
    starts = job.numbers[:-1:BLOCK] if script.role == "benchmark" else range(0)
    floor = {number - 1 for number in starts}
    of = {"instants": instants, "floor": sorted(floor.intersection(instants)), "keys": keys}
    return [(what, instant) for what in KINDS if what in job.order.what for instant in of[what]]


def _missing(job: Job, wanted: list[tuple[str, int]]) -> list[tuple[str, int]]:
    """List what is not there, or damaged; a key frame also needs its instant."""
    missing = [one for one in wanted if not job.is_whole(*one)]
    sources = [("instants", instant) for what, instant in missing if what == "keys"]
    unasked = [source for source in sources if source not in wanted]
    return missing + [source for source in unasked if not job.is_whole(*source)]


def _blocks(job: Job, missing: Iterable[tuple[str, int]]) -> list[list[tuple[str, int]]]:
    """Split files into blocks, each of which ends with the instant of a key frame."""
    blocks: dict[int, list[tuple[str, int]]] = {}
    for what, instant in missing:
        gone = instant + 1 - job.numbers[0]
        blocks.setdefault(max(gone - 1, 0) // BLOCK, []).append((what, instant))
    return [blocks[number] for number in sorted(blocks)]


def _say_plan(
    job: Job, wanted: Collection[tuple[str, int]], missing: Collection[tuple[str, int]]
) -> None:
    """Say how much there is to do, how long that takes and how large it gets."""
    width, height = job.order.size
    pixels, quality = width * height, job.quality
    keys = sum(what == "keys" for what, _ in missing)
    # A key frame's vectors are rendered once, with few samples.
    samples = (len(missing) - keys) * quality.total + keys * KEY_SAMPLES
    cores = _cores()
    seconds = samples * job.script.pace * pixels / 1e6 / cores
    size = len(missing) * BYTES_PER_PIXEL * pixels
    times = f" {quality.seeds} times" if quality.seeds > 1 else ""
    say(
        f"{job.script.name}: {len(missing)} of {len(wanted)} files to render at {width}x{height} "
        f"with {quality.samples} samples{times}, about {_span(seconds)} on {cores} cores and "
        f"{_amount(size)}, to {job.folder}"
    )
    job.folder.mkdir(parents=True, exist_ok=True)
    free = shutil.disk_usage(job.folder).free
    if size > free:
        sys.exit(
            f"{job.folder} has room for {_amount(free)}; name another folder with --data, "
            "or less with --frames or --resolution."
        )


def _cores() -> int:
    """Return how many cores this process may use."""
    allowed = getattr(os, "sched_getaffinity", None)
    return len(allowed(0)) if allowed else os.cpu_count() or 1


def _refuse_other(folder: Path, description: Manifest, but: Collection[str] = ()) -> None:
    """Refuse to mix two renderings in one folder."""
    if found := manifest.differences(folder, description, but):
        sys.exit(
            f"{folder} holds another rendering ({found[0]}); remove it, or name another folder "
            "with --data."
        )


def _make(job: Job, what: str, instant: int, product: render.Product) -> None:
    """Render one file. A key frame is its instant with vectors that span a key interval."""
    target, noise = job.path(what, instant), job.script.seed * 1000
    engine = ENGINES[job.script.engine]
    with tempfile.TemporaryDirectory(dir=target.parent, prefix=".part-") as apart:
        if what == "keys":
            vectors = Path(apart, "vectors.exr")
            engine.render(instant, product, vectors, noise)
            files.join_key(job.path("instants", instant), vectors, target)
            return
        if what == "floor":
            noise += OTHER_NOISE
        sources = [Path(apart, f"{number}.exr") for number in range(job.quality.seeds)]
        for number, source in enumerate(sources):
            engine.render(instant, product, source, noise + number * NEXT_NOISE)
        if len(sources) > 1:
            files.join_mean(sources, target)
        else:
            sources[0].replace(target)


class _Progress:
    """Says after each frame how many are done and how long the rest takes."""

    def __init__(self, name: str, missing: Collection[tuple[str, int]], key_share: float) -> None:
        self._name, self._key_share = name, key_share
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
        pace["keys"] = pace["keys"] or self._key_share * pace["instants"]
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
