"""Whether EXR can be written and read, and which formats and filters the other codecs have."""

from __future__ import annotations

import re
from collections.abc import Mapping
from fractions import Fraction
from importlib import metadata
from pathlib import Path
from typing import Any

import imageio_ffmpeg
import numpy as np
import OpenImageIO as oiio

from exwarp_cli.domain.frame import Window
from exwarp_cli.domain.wording import first_line, pluralise
from exwarp_cli.errors import ExwarpError, UsageError
from exwarp_cli.io.exr.reader import ExrFile
from exwarp_cli.io.exr.writer import COMPRESSIONS, encode_by_openexr, scanline_structure
from exwarp_cli.io.ffmpeg import FfmpegError, run_ffmpeg
from exwarp_cli.io.stills import STILLS, require_writer
from exwarp_cli.pipeline.doctor.examine import Check, failure, warning
from exwarp_cli.runtime.stop import scratch_folder

EXR_ERROR = 0.05
"""Largest error of a lossy compression on a ramp from 0 to 1."""

ENCODERS = ("libx264", "aac")
"""What videos are written with."""

FILTERS = {
    "libvmaf": "leave vmaf out of --metrics",
    "minterpolate": "leave minterpolate out of what bench compares",
}
"""What else ffmpeg is used for, and how to do without."""

READ_ONLY = (".cin",)
"""Suffixes of STILLS that OpenImageIO reads and does not write, wherever it comes from."""

_VERSION = re.compile(r"n?\d+(\.\d+)*")
_FFMPEG = "install imageio-ffmpeg again, and unset IMAGEIO_FFMPEG_EXE if it names another ffmpeg"


def check_exr() -> Check:
    """Write and read a ramp in every compression."""
    ramp = np.linspace(0, 1, 48 * 64, dtype=np.float16).reshape(48, 64)
    problems: dict[str, str | None] = {}
    with scratch_folder() as folder:
        for name in COMPRESSIONS:
            try:
                write_exr(folder / f"{name}.exr", {"R": ramp}, name)
                error = np.abs(read_exr(folder / f"{name}.exr")["R"] - ramp).max()
            except (ExwarpError, RuntimeError, ValueError, TypeError) as raised:
                problems[name] = str(raised)
            else:
                problems[name] = None if error <= EXR_ERROR else "its values come back changed"
    remarks = tuple(
        failure(f"EXR with {name} does not work: {why}; install OpenEXR and OpenImageIO again")
        for name, why in problems.items()
        if why is not None
    )
    good = [name for name, why in problems.items() if why is None]
    facts = {"compressions": {name: name in good for name in problems}}
    found = f"OpenEXR {metadata.version('OpenEXR')}: {pluralise(len(good), 'compression')} work"
    return Check(found, remarks, facts, (", ".join(good),))


def check_stills() -> Check:
    """Look for the writers of still images."""
    written, unwritten = [], []
    for suffix in STILLS:
        try:
            require_writer(Path(f"still{suffix}"))
            written.append(suffix)
        except UsageError:
            unwritten.append(suffix)
    remarks = tuple(
        warning(f"OpenImageIO has no writer of {suffix}; install it again, or use EXR")
        for suffix in unwritten
        if suffix not in READ_ONLY
    )
    facts = {"written": written, "read_only": [s for s in unwritten if s in READ_ONLY]}
    found = f"OpenImageIO {oiio.VERSION_STRING}: {pluralise(len(written), 'format')} can be written"
    return Check(found, remarks, facts, (", ".join(suffix[1:] for suffix in written),))


def check_video() -> Check:
    """Ask ffmpeg for its version, encoders and filters."""
    try:
        path = imageio_ffmpeg.get_ffmpeg_exe()
        listed, _ = run_ffmpeg(["-version"])
        encoders, filters = ffmpeg_has("encoders"), ffmpeg_has("filters")
    except (FfmpegError, OSError, RuntimeError) as error:
        text = f"videos can be neither written nor read: {first_line(error)}; {_FFMPEG}"
        return Check("ffmpeg does not run", (failure(text),), {"ffmpeg": None})
    version = listed.decode("utf-8", "replace").partition("version ")[2].split(" ")[0] or "unknown"
    remarks = [
        failure(f"{path} has no encoder {name}; {_FFMPEG}")
        for name in ENCODERS
        if name not in encoders
    ]
    remarks += [
        warning(f"{path} has no filter {name}; {_FFMPEG}, or {remedy}")
        for name, remedy in FILTERS.items()
        if name not in filters
    ]
    facts = {
        "ffmpeg": version,
        "path": path,
        "encoders": {name: name in encoders for name in ENCODERS},
        "filters": {name: name in filters for name in FILTERS},
    }
    have = [name for name in (*ENCODERS, *FILTERS) if name in encoders | filters]
    short = _VERSION.match(version)
    found = f"ffmpeg {version if short is None else short[0]} ({', '.join(have) or 'lacks all'})"
    return Check(found, tuple(remarks), facts, (f"{path}, version {version}",))


def ffmpeg_has(kind: str) -> frozenset[str]:
    """Return the names of ffmpeg's "encoders" or "filters"; raises FfmpegError."""
    listed, _ = run_ffmpeg(["-hide_banner", f"-{kind}"])
    rows = (line.split() for line in listed.decode("utf-8", "replace").splitlines())
    return frozenset(row[1] for row in rows if len(row) > 1)


def write_exr(path: Path, channels: Mapping[str, np.ndarray], compression: str) -> None:
    """Write channels [H, W], each in its own type, to a plain EXR of 24 frames a second."""
    planes = {name: np.ascontiguousarray(plane) for name, plane in channels.items()}
    height, width = next(iter(planes.values())).shape
    window = Window(0, 0, width, height)
    header: dict[str, Any] = {
        **scanline_structure(window, window),
        "compression": COMPRESSIONS[compression],
        "framesPerSecond": Fraction(24),
    }
    path.write_bytes(encode_by_openexr([(header, planes)]))


def read_exr(path: Path) -> dict[str, np.ndarray]:
    """Read all channels of an EXR's first part, [H, W], as frames are read."""
    with ExrFile(path) as file:
        part = file.parts[0]
        return {channel.raw_name: plane for channel, plane in file.read(part.channels).items()}
