"""Whether frames, stills and videos can be written and read back."""

from __future__ import annotations

import re
from importlib import metadata

import imageio_ffmpeg
import OpenImageIO as oiio

from exwarp_cli.domain.checkup import Check, failure, warning
from exwarp_cli.domain.wording import counted, first_line
from exwarp_cli.errors import UsageError
from exwarp_cli.io.exr.writer import COMPRESSIONS
from exwarp_cli.io.ffmpeg import FfmpegError
from exwarp_cli.io.specimens import (
    LOSSLESS,
    exr_problem,
    ffmpeg_has,
    ffmpeg_version,
    still_problem,
    video_problem,
    vmaf_problem,
)
from exwarp_cli.io.stills import STILLS
from exwarp_cli.runtime.stop import scratch_folder

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
    """Write and read EXR in every compression."""
    with scratch_folder() as folder:
        problems = {name: exr_problem(folder, name) for name in COMPRESSIONS}
    remarks = tuple(
        failure(f"EXR with {name} does not work: {why}; install OpenEXR and OpenImageIO again")
        for name, why in problems.items()
        if why is not None
    )
    good = [name for name, why in problems.items() if why is None]
    facts = {"compressions": {name: why is None for name, why in problems.items()}}
    exact = len(LOSSLESS.intersection(good))
    works = f"{counted(len(good), 'compression')} work, {exact} of them lossless"
    found = f"OpenEXR {metadata.version('OpenEXR')}: {works}"
    return Check(found, remarks, facts, (", ".join(good),))


def check_stills() -> Check:
    """Write and read every format of still images."""
    problems: dict[str, str | None] = {}
    unwritten = []
    with scratch_folder() as folder:
        for suffix in STILLS:
            try:
                problems[suffix] = still_problem(folder, suffix)
            except UsageError:
                unwritten.append(suffix)
    remarks = [
        warning(f"{suffix} images do not work: {why}; install OpenImageIO again, or use EXR")
        for suffix, why in problems.items()
        if why is not None
    ]
    remarks += [
        warning(f"OpenImageIO has no writer of {suffix}; install it again, or use EXR")
        for suffix in unwritten
        if suffix not in READ_ONLY
    ]
    good = [suffix[1:] for suffix, why in problems.items() if why is None]
    facts = {
        "written": [suffix for suffix, why in problems.items() if why is None],
        "read_only": [suffix for suffix in unwritten if suffix in READ_ONLY],
    }
    found = f"OpenImageIO {oiio.VERSION_STRING}: {counted(len(good), 'format')} written and read"
    return Check(found, tuple(remarks), facts, (", ".join(good),))


def check_video() -> Check:
    """Ask ffmpeg what it has, then write and read a video, and measure VMAF."""
    try:
        path = imageio_ffmpeg.get_ffmpeg_exe()
        version = ffmpeg_version()
        encoders, filters = ffmpeg_has("encoders"), ffmpeg_has("filters")
    except (FfmpegError, OSError, RuntimeError) as error:
        text = f"videos can be neither written nor read: {first_line(error)}; {_FFMPEG}"
        return Check("ffmpeg does not run", (failure(text),), {"ffmpeg": None})
    missing = [name for name in ENCODERS if name not in encoders]
    remarks = [failure(f"{path} has no encoder {name}; {_FFMPEG}") for name in missing]
    lacking = [name for name in FILTERS if name not in filters]
    remarks += [
        warning(f"{path} has no filter {name}; {_FFMPEG}, or {FILTERS[name]}") for name in lacking
    ]
    if not missing:
        with scratch_folder() as folder:
            why = video_problem(folder)
        remarks += [] if why is None else [failure(f"video does not work: {why}; {_FFMPEG}")]
    if "libvmaf" not in lacking:
        why = vmaf_problem()
        remarks += [] if why is None else [warning(f"VMAF does not work: {why}; {_FFMPEG}")]
    have = [name for name in (*ENCODERS, *FILTERS) if name not in (*missing, *lacking)]
    facts = {
        "ffmpeg": version,
        "path": path,
        "encoders": {name: name in encoders for name in ENCODERS},
        "filters": {name: name in filters for name in FILTERS},
    }
    short = _VERSION.match(version)
    found = f"ffmpeg {version if short is None else short[0]} ({', '.join(have) or 'lacks all'})"
    return Check(found, tuple(remarks), facts, (f"{path}, version {version}",))
