"""Checks of what ExWarp computes with: kernels and their cache, networks, and ffmpeg."""

from __future__ import annotations

import hashlib
import json
import os
import re
import tempfile
from collections.abc import Iterator
from importlib import metadata
from pathlib import Path

from exwarp_cli.domain.wording import enumerated, first_line, pluralise, size_text
from exwarp_cli.errors import ExwarpError, InputError
from exwarp_cli.pipeline.doctor.checkup import CheckResult, Finding, failure, warning
from exwarp_cli.runtime.compilation import compilation
from exwarp_cli.runtime.machine import Folder, cached_files, look_at

FOLDER_VARIABLE = "NUMBA_CACHE_DIR"  # names the folder of compiled kernels
LEAST_FREE = 64 << 20  # bytes of disk, several times what compiled kernels take

ENCODERS = ("libx264", "aac")  # of the videos that ExWarp writes

# What else ffmpeg is used for, and how to do without.
FILTERS = {
    "libvmaf": "leave vmaf out of --metrics",
    "minterpolate": "leave minterpolate out of what bench compares",
}

_SHIPPED = "as shipped"  # state of a model

_VERSION = re.compile(r"n?\d+(\.\d+)*")
_FFMPEG = "install imageio-ffmpeg again, and unset IMAGEIO_FFMPEG_EXE if it names another ffmpeg"


def check_kernels() -> CheckResult:
    """Check that kernels can be compiled; the self test runs them."""
    import numba
    import numpy as np

    from exwarp_cli.kernels import _compile, _row_bands

    _row_bands.set_threads(None)
    is_compiled = not numba.config.DISABLE_JIT  # type: ignore[attr-defined]
    remarks: tuple[Finding, ...] = ()
    if not is_compiled:
        text = (
            "NUMBA_DISABLE_JIT is set, so that nothing is compiled and everything takes "
            "hundreds of times as long; unset it"
        )
        remarks = (warning(text),)
    facts = {
        "numba": numba.__version__,
        "llvmlite": metadata.version("llvmlite"),
        "jit": is_compiled,
        "cpu": _compile.processor(),
        "threads": _row_bands.threads(),
    }
    threads = pluralise(_row_bands.threads(), "thread")
    summary = f"numba {numba.__version__} on numpy {np.__version__}, {threads}"
    lines = (f"llvmlite {facts['llvmlite']}, which takes this CPU for {facts['cpu']}",)
    return CheckResult(summary, remarks, facts, lines)


def check_cache() -> CheckResult:
    """Check the folders of compiled kernels, at the end, when kernels have been used."""
    import numba

    from exwarp_cli.kernels import _compile

    if numba.config.DISABLE_JIT:  # type: ignore[attr-defined]
        return CheckResult(
            "not used, as NUMBA_DISABLE_JIT is set", facts={"folders": [], "warm": False}
        )
    loaded, compiled = compilation.loaded, compilation.compiled
    writable = _compile.writable_folder()
    folder = None if writable is None else look_at(writable)
    folders, suffix = _compile.folders(), _compile.SUFFIX
    shared = [path for path in folders if path != writable and cached_files(path, suffix)[0]]
    if folder is None and (compiled or not shared):
        text = (
            "no folder for compiled kernels can be written, so that every run compiles them; name "
            "one in NUMBA_CACHE_DIR"
        )
        facts = {"folders": [], "kernels": 0, "bytes": 0, "warm": False, "compiled": compiled}
        return CheckResult("none", (warning(text),), facts)
    paths = [*shared, *([] if writable is None else [writable])]
    sizes = [cached_files(path, suffix) for path in paths]
    kernels, size = sum(count for count, _ in sizes), sum(taken for _, taken in sizes)
    facts = {
        "folders": [{"path": str(path), "place": place_of(path)} for path in paths],
        "writable": folder is not None and folder.problem is None,
        "free": None if folder is None else folder.free,
        "kernels": kernels,
        "bytes": size,
        "warm": compiled == 0,
        "loaded": loaded,
        "compiled": compiled,
    }
    if compiled:
        state = "partly cold until now" if loaded else "cold until now"
    else:
        state = "warm" if loaded else "not used"
    places = " and ".join(dict.fromkeys(map(place_of, paths)))
    summary = f"{state}; {pluralise(kernels, 'kernel')}, {size_text(size)}, {places}"
    is_lacking = compiled > 0 or not shared
    remarks = () if folder is None else tuple(_cache_remarks(folder, is_lacking))
    return CheckResult(summary, remarks, facts, tuple(map(str, paths)))


def place_of(folder: Path) -> str:
    """Describe where a folder of compiled kernels is."""
    from exwarp_cli.kernels import _compile

    named = os.environ.get(FOLDER_VARIABLE)
    if named and Path(named).resolve() in folder.resolve().parents:
        return f"in {FOLDER_VARIABLE}"
    if Path(_compile.__file__).resolve().parents[1] in folder.resolve().parents:
        return "beside the source"
    is_temporary = Path(tempfile.gettempdir()) == folder.parent
    return "in the temporary folder" if is_temporary else "in the user's cache"


def _cache_remarks(folder: Folder, is_lacking: bool) -> Iterator[Finding]:
    """Yield what is wrong; `is_lacking` is True where shared folders do not have all kernels."""
    named = os.environ.get(FOLDER_VARIABLE)
    if named and is_lacking and not place_of(folder.path).endswith(FOLDER_VARIABLE):
        yield warning(
            f"{FOLDER_VARIABLE} names {named}, which cannot be written and lacks kernels, so that "
            f"they are kept {place_of(folder.path)}; correct it, fill it from where it can "
            "be written, or unset it"
        )
    if folder.problem is not None:
        yield warning(
            f"cannot write to {folder.path} ({folder.problem}), so that kernels are compiled "
            "for every run; name another folder in NUMBA_CACHE_DIR"
        )
    elif folder.free is not None and folder.free < LEAST_FREE:
        yield warning(
            f"the disk of {folder.path} is full, and compiled kernels go there; make room, or "
            "name another folder in NUMBA_CACHE_DIR"
        )


def check_models() -> CheckResult:
    """Compare the models that come with ExWarp with their checksums."""
    from exwarp_cli.models.model_file import CHECKSUMS, shipped_folder

    folder = shipped_folder()
    try:
        checksums = dict(sorted(json.loads((folder / CHECKSUMS).read_bytes()).items()))
    except (OSError, ValueError, TypeError, AttributeError) as error:
        raise InputError(
            f"the models that come with ExWarp, or their checksums, are missing in {folder}; "
            "install ExWarp again"
        ) from error
    states = {}
    for name, checksum in checksums.items():
        try:
            with (folder / name).open("rb") as file:
                digest = hashlib.file_digest(file, "sha256").hexdigest()
            states[name] = _SHIPPED if digest == checksum else "not the one that came with ExWarp"
        except FileNotFoundError:
            states[name] = "missing"
        except OSError as error:
            states[name] = f"not to be read ({error.strerror})"
    remarks = tuple(
        failure(f"the model {folder / name} is {state}; install ExWarp again")
        for name, state in states.items()
        if state != _SHIPPED
    )
    lines = (str(folder), *(f"{name}: {state}" for name, state in states.items()))
    summary = f"{len(states) - len(remarks)} of {len(states)} files {_SHIPPED}"
    return CheckResult(summary, remarks, {"folder": str(folder), "files": states}, lines)


def check_network() -> CheckResult:
    """Load the extrapolator that comes with ExWarp on every device, and run it."""
    from exwarp_cli.models.picture_network import load_extrapolator
    from exwarp_cli.models.session import CUDA, load_runtime

    runtime = load_runtime()
    offered = runtime.get_available_providers()
    remarks, works = [], {}
    for device in ("cpu", "cuda") if CUDA in offered else ("cpu",):
        try:
            load_extrapolator(None, 1, device)
            works[device] = True
        except ExwarpError as error:
            works[device] = False
            # Without CUDA there is still the CPU.
            remarks.append(failure(str(error)) if device == "cpu" else warning(str(error)))
    good = [device.upper() for device, is_good in works.items() if is_good]
    facts = {"onnxruntime": runtime.__version__, "providers": offered, "devices": works}
    runs = (
        f"runs the extrapolator on {enumerated(good)}" if good else "does not run the extrapolator"
    )
    summary = f"onnxruntime {runtime.__version__} {runs}"
    names = {"CPUExecutionProvider": "CPU", CUDA: "CUDA"}
    lines = [f"offers {', '.join(names.get(name, name) for name in offered)}"]
    if CUDA not in offered:
        summary += "; no CUDA"
        lines.append("for CUDA put onnxruntime-gpu in the place of onnxruntime")
    return CheckResult(summary, tuple(remarks), facts, tuple(lines))


def check_video() -> CheckResult:
    """Check the version, encoders and filters of ffmpeg."""
    import imageio_ffmpeg

    from exwarp_cli.io.ffmpeg import FfmpegError, run_ffmpeg

    try:
        path = imageio_ffmpeg.get_ffmpeg_exe()
        listed, _ = run_ffmpeg(["-version"])
        encoders, filters = ffmpeg_names("encoders"), ffmpeg_names("filters")
    except (FfmpegError, OSError, RuntimeError) as error:
        text = f"videos can be neither written nor read: {first_line(error)}; {_FFMPEG}"
        return CheckResult("ffmpeg does not run", (failure(text),), {"ffmpeg": None})
    version = listed.decode("utf-8", "replace").partition("version ")[2].split(" ")[0] or "unknown"
    lacking = [name for name in (*ENCODERS, *FILTERS) if name not in encoders | filters]
    remarks = [
        failure(f"{path} has no encoder {name}; {_FFMPEG}")
        if name in ENCODERS
        else warning(f"{path} has no filter {name}; {_FFMPEG}, or {FILTERS[name]}")
        for name in lacking
    ]
    facts = {
        "ffmpeg": version,
        "path": path,
        "encoders": {name: name in encoders for name in ENCODERS},
        "filters": {name: name in filters for name in FILTERS},
    }
    have = [name for name in (*ENCODERS, *FILTERS) if name not in lacking]
    short = _VERSION.match(version)
    summary = f"ffmpeg {version if short is None else short[0]} ({', '.join(have) or 'lacks all'})"
    return CheckResult(summary, tuple(remarks), facts, (f"{path}, version {version}",))


def ffmpeg_names(kind: str) -> frozenset[str]:
    """Return the names of ffmpeg's "encoders" or "filters"; raises FfmpegError."""
    from exwarp_cli.io.ffmpeg import run_ffmpeg

    listed, _ = run_ffmpeg(["-hide_banner", f"-{kind}"])
    rows = (line.split() for line in listed.decode("utf-8", "replace").splitlines())
    return frozenset(row[1] for row in rows if len(row) > 1)
