"""Checks of what ExWarp runs in: the machine, the folder of temporary files, and the packages.

Packages and versions are read from ExWarp's installed metadata. This module imports no package that
the checks are about.
"""

from __future__ import annotations

import importlib
import platform
import re
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from importlib.metadata import Distribution, PackageNotFoundError, distribution, version
from pathlib import Path

from packaging.requirements import Requirement

import exwarp_cli
from exwarp_cli import __version__
from exwarp_cli.domain.wording import enumerated, first_line, size_text
from exwarp_cli.pipeline.doctor.checkup import CheckResult, Finding, failure, warning
from exwarp_cli.runtime.machine import look_at, memory, processors

LEAST_MEMORY = 4 << 30  # for 1920x1080 by a network; 3.7 GiB were measured
LEAST_MEMORY_WITHOUT_NETWORK = 1 << 30  # the same for s6 and softsplat
LEAST_FREE = 256 << 20  # bytes of disk: room for the video of a measurement

DISTRIBUTION = "exwarp"

# What to import of a package, where it is not the package's name in lower case.
MODULES = {
    "imageio-ffmpeg": "imageio_ffmpeg",
    "opencv-python-headless": "cv2",
    "openexr": "OpenEXR",
    "openimageio": "OpenImageIO",
    "pillow": "PIL",
    "pyyaml": "yaml",
}

# Packages that bring the same modules, version for version.
STAND_INS = {
    "onnxruntime": ("onnxruntime-gpu",),
    "opencv-python-headless": (
        "opencv-python",
        "opencv-contrib-python",
        "opencv-contrib-python-headless",
    ),
}

_LIBRARY = re.compile(r"\blib[\w.+-]+\.(?:so|dylib)[.\d]*")


def check_machine() -> CheckResult:
    """Check CPUs and memory."""
    cpus, room = processors(), memory()
    remarks = []
    if room.available is not None and room.available < LEAST_MEMORY:
        text = (
            f"{size_text(room.available)} of memory is free, and frames of 1920x1080 take "
            f"{size_text(LEAST_MEMORY)} with a network, {size_text(LEAST_MEMORY_WITHOUT_NETWORK)} "
            "with s6 and softsplat; close other programs, or raise the limit of the job"
        )
        remarks.append(warning(text))
    facts = {
        "executable": sys.executable,
        "package": str(Path(exwarp_cli.__file__).parent),
        "python": platform.python_version(),
        "implementation": platform.python_implementation(),
        "system": f"{platform.system()} {platform.release()}",
        "platform": platform.platform(),
        "architecture": platform.machine(),
        "cpus": {"there": cpus.there, "allowed": cpus.allowed, "quota": cpus.quota},
        "memory": {"there": room.there, "available": room.available, "limit": room.limit},
    }
    sizes = {"in the machine": room.there, "free": room.available, "by limit": room.limit}
    amounts = [f"{size_text(value)} {kind}" for kind, value in sizes.items() if value is not None]
    quota = "no quota"
    if cpus.quota is not None:
        quota = f"{cpus.quota:g} by quota of the control group"
    lines = (
        f"{facts['package']}, run by {facts['executable']}",
        f"{facts['implementation']} {facts['python']}, {facts['platform']}",
        f"CPUs: {cpus.there} in the machine, {cpus.allowed} by affinity, {quota}; {cpus.usable} "
        "are used without --threads",
        f"memory: {', '.join(amounts) or 'the system does not tell'}",
    )
    share = "" if cpus.usable == cpus.there else f" of {cpus.there}"
    summary = f"{cpus.usable}{share} CPU{'' if cpus.usable == 1 else 's'}"
    most = room.there if room.limit is None else room.limit
    if most is not None and room.available is None:
        summary += f", {size_text(most)} of memory"
    elif most is not None and room.available is not None:
        summary += f", {size_text(room.available)} of {size_text(most)} memory free"
    return CheckResult(summary, tuple(remarks), facts, lines)


def check_temporary() -> CheckResult:
    """Check the folder of temporary files."""
    try:
        path = Path(tempfile.gettempdir())
    except OSError:
        text = "no folder for temporary files can be written; name one in TMPDIR"
        return CheckResult(
            "none", (failure(text),), {"path": None, "writable": False, "free": None}
        )
    folder = look_at(path)
    remarks: tuple[Finding, ...] = ()
    summary = str(path)
    if folder.problem is not None:
        text = f"cannot write to {path}: {folder.problem}; name another folder in TMPDIR"
        remarks = (failure(text),)
    elif folder.free is not None:
        summary += f", {size_text(folder.free)} free"
        if folder.free < LEAST_FREE:
            text = f"the disk of {path} is nearly full; make room, or name another folder in TMPDIR"
            remarks = (warning(text),)
    facts = {"path": str(path), "writable": folder.problem is None, "free": folder.free}
    return CheckResult(summary, remarks, facts)


@dataclass(frozen=True)
class Package:
    """A package, as required and as installed."""

    name: str  # name in the index; of a stand-in, where that is installed
    wanted: str  # the versions that are required; "" for any
    installed: str | None  # the installed version; None where there is none
    fits: bool  # whether it is one of those required
    error: str | None = None  # why it cannot be imported; None where it can, or was not tried

    @classmethod
    def of(cls, requirement: Requirement, is_imported: bool) -> Package:
        """Find the package that a requirement names, or a stand-in; import it on request."""
        wanted, index_name = str(requirement.specifier), requirement.name.lower()
        for name in (requirement.name, *STAND_INS.get(index_name, ())):
            try:
                installed = version(name)
            except PackageNotFoundError:
                continue
            error = None
            if is_imported:
                try:
                    importlib.import_module(MODULES.get(index_name, index_name))
                except Exception as problem:  # a system library, numpy's ABI, a missing file …
                    error = first_line(problem)
            fits = requirement.specifier.contains(installed, prereleases=True)
            return cls(name, wanted, installed, fits, error)
        return cls(requirement.name, wanted, None, False)

    @property
    def line(self) -> str:
        """A description in one line."""
        wanted = f" (needs {self.wanted})" if self.wanted else ""
        misfit = "" if self.fits or self.installed is None else ", which is not"
        broken = "" if self.error is None else f"; cannot be imported: {self.error}"
        return f"{self.name} {self.installed or 'is not installed'}{wanted}{misfit}{broken}"

    @property
    def advice(self) -> str:
        """A sentence with what is wrong, and what to do; "" where nothing is."""
        if self.fits and self.error is None:
            return ""
        install = f"pip install '{self.name}{self.wanted}'"
        if self.installed is None:
            return f"{self.name} is not installed; run {install}"
        if not self.fits:
            return f"{self.name} is {self.installed}, and {self.wanted} does; run {install}"
        library = _LIBRARY.search(self.error or "")
        if library is not None:
            remedy = f"install the system's package that has {library[0]}"
        else:
            remedy = f"run pip install --force-reinstall '{self.name}{self.wanted}'"
        return f"{self.name} cannot be imported ({self.error}); {remedy}"


def check_packages() -> CheckResult:
    """Check the packages that ExWarp cannot do without."""
    try:
        own = distribution(DISTRIBUTION)
    except PackageNotFoundError:
        text = (
            "ExWarp runs from its source without being installed, so that nothing tells which "
            "versions it needs; run 'pip install .' beside its pyproject.toml"
        )
        return CheckResult("not known", (warning(text),), {"installed": None, "packages": []})
    packages = [Package.of(requirement, True) for requirement in _requirements(own, None)]
    remarks = [failure(package.advice) for package in packages if package.advice]
    if own.version != __version__:
        text = (
            f"the package exwarp is installed as {own.version} and runs as {__version__}; install "
            "it again"
        )
        remarks.append(warning(text))
    good = sum(not package.advice for package in packages)
    facts = {"installed": own.version, "packages": [asdict(package) for package in packages]}
    summary = f"{good} of {len(packages)} load, in versions that ExWarp works with"
    lines = tuple(package.line for package in packages)
    return CheckResult(summary, tuple(remarks), facts, lines)


def check_extras() -> CheckResult:
    """Check the optional packages; it is no defect if an extra is absent."""
    try:
        own = distribution(DISTRIBUTION)
    except PackageNotFoundError:
        return CheckResult("not known, as ExWarp is not installed", facts={"extras": {}})
    names = sorted(own.metadata.get_all("Provides-Extra") or ())
    # Not imported, as PyTorch takes seconds.
    extras = {name: [Package.of(r, False) for r in _requirements(own, name)] for name in names}
    installed = [name for name, packages in extras.items() if all(p.installed for p in packages)]
    absent = [name for name, packages in extras.items() if not any(p.installed for p in packages)]
    remarks = tuple(
        warning(f"{package.advice} (the extra {name} needs it)")
        for name in names
        if name not in absent
        for package in extras[name]
        if package.advice
    )
    parts = [f"{enumerated(installed)} installed"] if installed else []
    if absent:
        install = f"pip install '{DISTRIBUTION}[{','.join(absent)}]'"
        parts.append(f"{enumerated(absent)} not ({install})")
    facts = {
        "extras": {
            name: {
                "installed": name in installed,
                "install": f"pip install '{DISTRIBUTION}[{name}]'",
                "packages": [asdict(package) for package in packages],
            }
            for name, packages in extras.items()
        }
    }
    lines = tuple(f"{name}: {'; '.join(p.line for p in extras[name])}" for name in names)
    return CheckResult(", ".join(parts) or "there are none", remarks, facts, lines)


def _requirements(own: Distribution, extra: str | None) -> Iterator[Requirement]:
    """Yield what an extra requires on this platform, or ExWarp itself for None."""
    for text in own.requires or ():
        requirement = Requirement(text)
        marker = requirement.marker
        is_core = marker is None or marker.evaluate({"extra": ""})
        is_wanted = marker is None or marker.evaluate({"extra": extra or ""})
        if is_wanted and is_core == (extra is None):
            yield requirement
