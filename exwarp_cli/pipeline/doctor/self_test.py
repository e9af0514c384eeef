"""A tiny shot, upsampled by the real pipeline, of which every pixel is known.

A camera moves along a textured plane. The picture moves by whole pixels from slot to slot, so
warping and splatting copy pixels and must get every bit right.
"""

from __future__ import annotations

import time
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from exwarp_cli.domain.frame import Window
from exwarp_cli.domain.results import RunSummary
from exwarp_cli.domain.settings import SourceSettings, UpsampleSettings
from exwarp_cli.domain.timeline import FACTOR
from exwarp_cli.domain.wording import enumerated, pluralise
from exwarp_cli.errors import ExwarpError
from exwarp_cli.io.exr.reader import ExrFile
from exwarp_cli.io.exr.writer import COMPRESSIONS, encode_by_openexr, scanline_attributes
from exwarp_cli.pipeline.doctor.checkup import CheckResult, failure
from exwarp_cli.pipeline.progress import Silence
from exwarp_cli.pipeline.run import upsample
from exwarp_cli.runtime.compilation import compilation
from exwarp_cli.runtime.stop import scratch_folder

HEIGHT, WIDTH, KEYS = 48, 80, 3
RIGHT, DOWN = 2, -1  # pixels from slot to slot
DEPTH, FOCAL = 5.0, 80.0

# Pixels along the rim that are not compared: what enters the picture is not known.
MARGIN = FACTOR * max(abs(RIGHT), abs(DOWN)) + 4

EXACT = ("s6", "softsplat")  # methods that move pixels and compute none
MOST_ERROR = 0.05  # of a network, scene-linear; 0.006 was measured

# Of the vectors as they are written here, Blender's. Measuring them must give it.
CONVENTION = "previous=X,-Y next=-Z,W"

# The methods that are tried, and the convention that is given to each; None has it measured. The
# last one is also tried in chunks.
METHODS = {"s6": None, "softsplat": CONVENTION, "exwarp": CONVENTION, "causal": CONVENTION}

ADVICE = (
    "install ExWarp and its packages again, and delete the folder of compiled kernels; if that "
    "does not help, report it with what 'exwarp doctor --json' prints"
)


def check_self_test() -> CheckResult:
    """Upsample the shot by four methods, and in chunks."""
    begin, compiled = time.perf_counter(), compilation.compiled
    runs, good, remarks, lines = {}, [], [], []
    with scratch_folder() as folder:
        # The key frames, with Blender's channel names.
        keys, window = folder / "keys", Window(0, 0, WIDTH, HEIGHT)
        keys.mkdir()
        header: dict[str, Any] = {
            **scanline_attributes(window, window),
            "compression": COMPRESSIONS["zip"],
            "framesPerSecond": Fraction(24),
        }
        for key in range(KEYS):
            data = encode_by_openexr([(header, render(key * FACTOR))])
            (keys / f"shot.{key + 1:04d}.exr").write_bytes(data)
        for name in (*METHODS, "chunks"):
            start = time.perf_counter()
            try:
                if name == "chunks":
                    work = "upsampling in chunks"
                    problem, frames = _try_chunks(folder, list(METHODS)[-1])
                else:
                    work = f"upsampling by {name}"
                    problem, frames = _try_method(folder, name, METHODS[name])
            except ExwarpError as error:
                problem, frames = str(error), 0
            spent = time.perf_counter() - start
            if problem is None:
                good.append(name)
            else:
                remarks.append(failure(f"{work} goes wrong: {problem.rstrip('.')}; {ADVICE}"))
            runs[name] = {"ok": problem is None, "seconds": round(spent, 3), "frames": frames}
            lines.append(f"{name}: {pluralise(frames, 'frame')}, {spent:.2f} s")
    seconds, compiled = time.perf_counter() - begin, compilation.compiled - compiled
    facts = {"seconds": round(seconds, 3), "compiled": compiled, "runs": runs}
    verb = "is" if len(good) == 1 else "are"
    summary = f"{enumerated(good)} {verb} right" if good else "nothing is right"
    summary += f"; {seconds:.1f} s"
    if compiled:
        summary += f", {pluralise(compiled, 'kernel')} compiled"
    return CheckResult(summary, tuple(remarks), facts, tuple(lines))


def render(slot: int) -> dict[str, np.ndarray]:
    """Return the channels of a slot by name, each [H, W].

    R, G, B, A are half, with some values above 1; depth, id, vectors, normals and positions are
    float32.
    """
    # The point of the plane that each pixel shows.
    y, x = np.mgrid[:HEIGHT, :WIDTH].astype(np.float64)
    u, v = x - RIGHT * slot, y - DOWN * slot
    waves = (
        np.sin(0.31 * u + 0.17 * v) + np.cos(0.11 * u - 0.43 * v),
        np.sin(0.23 * u - 0.29 * v + 1) + np.cos(0.09 * u + 0.19 * v),
        np.cos(0.37 * u + 0.05 * v) + np.sin(0.13 * v + 0.5),
    )
    planes = dict(zip("RGB", ((1.2 + 0.5 * w).astype(np.float16) for w in waves), strict=True))
    planes["A"] = np.ones_like(u, np.float16)
    right, up = FACTOR * RIGHT, -FACTOR * DOWN
    geometry: dict[str, float | npt.NDArray[np.float64]] = {
        "Depth.Z": DEPTH,
        "IndexOB.X": 1.0,
        # To where it was, from where it will be: the frame before minus this, this minus the next.
        "Vector.X": -right,
        "Vector.Y": -up,
        "Vector.Z": -right,
        "Vector.W": -up,
        "Normal.X": 0.0,
        "Normal.Y": 0.0,
        "Normal.Z": 1.0,
        "Position.X": u * DEPTH / FOCAL,
        "Position.Y": -v * DEPTH / FOCAL,
        "Position.Z": DEPTH,
    }
    for name, value in geometry.items():
        planes[name] = np.full((HEIGHT, WIDTH), value, np.float32)
    return planes


def _try_method(folder: Path, method: str, motion: str | None) -> tuple[str | None, int]:
    """Upsample the whole shot, and compare every frame; without a convention measure it."""
    summary = _upsample(folder, method, method, motion)
    evidence = summary.input.motion_evidence or ""
    if not evidence.startswith(CONVENTION):
        read = f"the vectors were read as {evidence or 'nothing'!r}, and they are {CONVENTION!r}"
        return read, len(summary.frames)
    wrong = []
    for slot in range(KEYS * FACTOR):
        name = f"shot.{slot + 1:04d}.exr"
        with ExrFile(folder / method / name) as file:
            part = file.parts[0]
            planes = {c.raw_name: plane for c, plane in file.read(part.channels).items()}
        written, rendered = (
            np.stack([image[channel] for channel in "RGBA"]).astype(np.float32)
            for image in (planes, render(slot))
        )
        error = np.abs(written - rendered)[:, MARGIN:-MARGIN, MARGIN:-MARGIN].max()
        allowed = 0.0 if method in EXACT or slot % FACTOR == 0 else MOST_ERROR
        if not error <= allowed:  # also for NaN
            wrong.append(name)
    problem = None
    if wrong:
        count = pluralise(len(wrong), "frame")
        problem = f"{count} of {KEYS * FACTOR} have wrong pixels, {wrong[0]} first"
    return problem, len(summary.frames)


def _try_chunks(folder: Path, method: str) -> tuple[str | None, int]:
    """Upsample the shot in two chunks, which must equal the whole that is there already."""
    _upsample(folder, "chunk0", method, CONVENTION, "1")
    _upsample(folder, "chunk1", method, CONVENTION, f"2-{KEYS}")
    chunks = _contents(folder / "chunk0") | _contents(folder / "chunk1")
    expected = _contents(folder / method)
    names = sorted(chunks.keys() | expected.keys())
    wrong = [name for name in names if chunks.get(name) != expected.get(name)]
    return f"{enumerated(wrong)} differ from those of the whole" if wrong else None, len(chunks)


def _contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def _upsample(
    folder: Path, output: str, method: str, motion: str | None, frames: str | None = None
) -> RunSummary:
    source = SourceSettings(str(folder / "keys"), motion=motion)
    output = str(folder / output)
    settings = UpsampleSettings(source, output, method=method, frames=frames, threads=1)
    return upsample(settings, Silence())
