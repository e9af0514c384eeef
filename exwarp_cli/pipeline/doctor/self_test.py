"""A tiny shot, upsampled by the real pipeline, of which every pixel is known beforehand.

A textured plane before a camera that moves along it: what it shows moves by whole pixels from slot
to slot, so that warping and splatting copy pixels and must get them right in every bit.
"""

from __future__ import annotations

import io
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from exwarp_cli.domain.frame import Float32
from exwarp_cli.domain.results import RunSummary
from exwarp_cli.domain.settings import SourceSettings, UpsampleSettings
from exwarp_cli.domain.timeline import FACTOR
from exwarp_cli.domain.wording import enumerated, pluralise
from exwarp_cli.errors import ExwarpError
from exwarp_cli.pipeline.doctor.codecs import read_exr, write_exr
from exwarp_cli.pipeline.doctor.examine import Check, Remark, failure
from exwarp_cli.pipeline.progress import NoProgress
from exwarp_cli.pipeline.run import upsample
from exwarp_cli.runtime.compilation import compilation
from exwarp_cli.runtime.stop import scratch_folder

HEIGHT, WIDTH, KEYS = 48, 80, 3
RIGHT, DOWN = 2, -1
"""Pixels from slot to slot."""

DEPTH, FOCAL = 5.0, 80.0

MARGIN = FACTOR * max(abs(RIGHT), abs(DOWN)) + 4
"""Pixels along the rim that are not judged: what comes into the picture is not known."""

EXTRAPOLATED = 0.05
"""Most that a network may be off by there, scene-linear; it was 0.006."""

EXACT = ("s6", "softsplat")
"""Methods that move pixels and compute none."""

CONVENTION = "previous=X,-Y next=-Z,W"
"""Of the vectors as they are written here, Blender's; measuring must find it."""

ADVICE = (
    "install ExWarp and its packages again, and delete the folder of compiled kernels; if that "
    "does not help, report it with what 'exwarp doctor --json' prints"
)

Planes = dict[str, np.ndarray]


class Trial(NamedTuple):
    """One run of the pipeline: what is wrong with its frames, if anything."""

    problem: str | None
    seconds: float
    frames: int


def check_self_test() -> Check:
    """Upsample the shot by four methods, and in chunks."""
    begin, compiled = time.perf_counter(), compilation.compiled
    with scratch_folder() as folder:
        write_shot(folder / "keys")
        trials = {
            "s6": _trial(lambda: _whole(folder, "s6", None)),
            "softsplat": _trial(lambda: _whole(folder, "softsplat", CONVENTION)),
            "exwarp": _trial(lambda: _whole(folder, "exwarp", CONVENTION)),
            "causal": _trial(lambda: _whole(folder, "causal", CONVENTION)),
            "chunks": _trial(lambda: _chunks(folder, "causal")),
        }
    seconds, compiled = time.perf_counter() - begin, compilation.compiled - compiled
    remarks = tuple(_remark(name, t.problem) for name, t in trials.items() if t.problem is not None)
    good = [name for name, trial in trials.items() if trial.problem is None]
    facts = {
        "seconds": round(seconds, 3),
        "compiled": compiled,
        "runs": {
            name: {"ok": t.problem is None, "seconds": round(t.seconds, 3), "frames": t.frames}
            for name, t in trials.items()
        },
    }
    many = "is" if len(good) == 1 else "are"
    found = f"{enumerated(good)} {many} right" if good else "nothing is right"
    found += f"; {seconds:.1f} s"
    if compiled:
        found += f", {pluralise(compiled, 'kernel')} compiled"
    lines = tuple(
        f"{n}: {pluralise(t.frames, 'frame')}, {t.seconds:.2f} s" for n, t in trials.items()
    )
    return Check(found, remarks, facts, lines)


def write_shot(folder: Path) -> None:
    """Write the key frames, in Blender's names."""
    folder.mkdir()
    for key in range(KEYS):
        channels = {**colour(key * FACTOR), **_geometry(key * FACTOR)}
        write_exr(folder / f"shot.{key + 1:04d}.exr", channels, "zip")


def colour(slot: int) -> Planes:
    """R, G, B, A of a slot, half [H, W]; values beyond 1 among them."""
    u, v = _surface(slot)
    waves = (
        np.sin(0.31 * u + 0.17 * v) + np.cos(0.11 * u - 0.43 * v),
        np.sin(0.23 * u - 0.29 * v + 1) + np.cos(0.09 * u + 0.19 * v),
        np.cos(0.37 * u + 0.05 * v) + np.sin(0.13 * v + 0.5),
    )
    rgb = {name: 1.2 + 0.5 * wave for name, wave in zip("RGB", waves, strict=True)}
    return {name: np.asarray(p, np.float16) for name, p in {**rgb, "A": np.ones_like(u)}.items()}


def _geometry(slot: int) -> Planes:
    u, v = _surface(slot)
    right, up = FACTOR * RIGHT, -FACTOR * DOWN
    values: Mapping[str, float | npt.NDArray[np.float64]] = {
        "Depth.Z": DEPTH,
        "IndexOB.X": 1.0,
        # To where it was, from where it will be: the frame before minus this, this minus the next.
        **dict(zip(("Vector.X", "Vector.Y"), (-right, -up), strict=True)),
        **dict(zip(("Vector.Z", "Vector.W"), (-right, -up), strict=True)),
        **dict(zip(("Normal.X", "Normal.Y", "Normal.Z"), (0.0, 0.0, 1.0), strict=True)),
        "Position.X": u * DEPTH / FOCAL,
        "Position.Y": -v * DEPTH / FOCAL,
        "Position.Z": DEPTH,
    }
    return {name: np.full((HEIGHT, WIDTH), value, np.float32) for name, value in values.items()}


def _surface(slot: int) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Return which point of the plane each pixel shows."""
    y, x = np.mgrid[:HEIGHT, :WIDTH].astype(np.float64)
    return x - RIGHT * slot, y - DOWN * slot


def _trial(run: Callable[[], tuple[str | None, int]]) -> Trial:
    """Time a run; what it cannot do is its problem."""
    begin = time.perf_counter()
    try:
        problem, frames = run()
    except ExwarpError as error:
        problem, frames = str(error), 0
    return Trial(problem, time.perf_counter() - begin, frames)


def _whole(folder: Path, method: str, motion: str | None) -> tuple[str | None, int]:
    """Upsample the whole shot and judge every frame; without a convention measure it."""
    summary = _upsample(folder, method, method, motion)
    evidence = summary.input.motion_evidence or ""
    if evidence.startswith(CONVENTION):
        return _wrong_frames(folder, method), len(summary.frames)
    read = f"the vectors were read as {evidence or 'nothing'!r}, and they are {CONVENTION!r}"
    return read, len(summary.frames)


def _chunks(folder: Path, method: str) -> tuple[str | None, int]:
    """Upsample the shot in two pieces, which must equal the whole that is there already."""
    found: dict[str, bytes] = {}
    for number, piece in enumerate(("1", f"2-{KEYS}")):
        _upsample(folder, f"chunk{number}", method, CONVENTION, piece)
        found |= _contents(folder / f"chunk{number}")
    expected = _contents(folder / method)
    names = sorted(found.keys() | expected.keys())
    differ = [name for name in names if found.get(name) != expected.get(name)]
    return f"{enumerated(differ)} differ from those of the whole" if differ else None, len(found)


def _contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def _upsample(
    folder: Path, output: str, method: str, motion: str | None, frames: str | None = None
) -> RunSummary:
    source = SourceSettings(str(folder / "keys"), motion=motion)
    settings = UpsampleSettings(source, str(folder / output), method=method, threads=1)
    return upsample(replace(settings, frames=frames), NoProgress(io.StringIO()))


def _wrong_frames(folder: Path, method: str) -> str | None:
    """Say which frames are not what they must be."""
    wrong = []
    for slot in range(KEYS * FACTOR):
        name = f"shot.{slot + 1:04d}.exr"
        found, truth = _inner(read_exr(folder / method / name)), _inner(colour(slot))
        allowed = 0.0 if method in EXACT or slot % FACTOR == 0 else EXTRAPOLATED
        if not np.abs(found - truth).max() <= allowed:
            wrong.append(name)
    if not wrong:
        return None
    return (
        f"{pluralise(len(wrong), 'frame')} of {KEYS * FACTOR} have wrong pixels, {wrong[0]} first"
    )


def _inner(planes: Mapping[str, np.ndarray]) -> Float32:
    """Stack R, G, B, A without the rim."""
    image = np.stack([planes[name] for name in "RGBA"], axis=-1).astype(np.float32)
    return image[MARGIN:-MARGIN, MARGIN:-MARGIN]


def _remark(name: str, problem: str) -> Remark:
    what = "upsampling in chunks" if name == "chunks" else f"upsampling by {name}"
    return failure(f"{what} goes wrong: {problem.rstrip('.')}; {ADVICE}")
