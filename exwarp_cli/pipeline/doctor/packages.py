"""Whether the packages that ExWarp needs are installed, in versions that it works with.

What it needs is read from its own installed metadata, so that this list cannot drift.
"""

from __future__ import annotations

import importlib
import re
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from importlib.metadata import Distribution, PackageNotFoundError, distribution, version

from packaging.requirements import Requirement

from exwarp_cli import __version__
from exwarp_cli.domain.wording import enumerated, first_line
from exwarp_cli.pipeline.doctor.examine import Check, Remark, failure, warning

DISTRIBUTION = "exwarp"

MODULES = {
    "imageio-ffmpeg": "imageio_ffmpeg",
    "opencv-python-headless": "cv2",
    "openexr": "OpenEXR",
    "openimageio": "OpenImageIO",
    "pillow": "PIL",
    "pyyaml": "yaml",
}
"""What to import of a package, where it is not the package's name in lower case."""

STAND_INS = {
    "onnxruntime": ("onnxruntime-gpu",),
    "opencv-python-headless": (
        "opencv-python",
        "opencv-contrib-python",
        "opencv-contrib-python-headless",
    ),
}
"""Packages that bring the same modules, version for version."""

_LIBRARY = re.compile(r"\blib[\w.+-]+\.(?:so|dylib)[.\d]*")


@dataclass(frozen=True)
class Package:
    """A package, as asked for and as found.

    Attributes
    ----------
    name
        As the index has it; of a stand-in, where that is what is installed.
    wanted
        The versions that do; "" for any.
    installed
        The version that is there; None where none is.
    fits
        Whether that is one that does.
    error
        Why it cannot be imported; None where it can, or was not tried.
    """

    name: str
    wanted: str
    installed: str | None
    fits: bool
    error: str | None = None

    @property
    def is_good(self) -> bool:
        """Whether there is nothing to say of it."""
        return self.fits and self.error is None

    @property
    def line(self) -> str:
        """All of it in a line."""
        wanted = f" (needs {self.wanted})" if self.wanted else ""
        mark = "" if self.fits or self.installed is None else ", which is not"
        broken = "" if self.error is None else f"; cannot be imported: {self.error}"
        return f"{self.name} {self.installed or 'is not installed'}{wanted}{mark}{broken}"


def check_packages() -> Check:
    """Look at what ExWarp cannot do without."""
    try:
        own = distribution(DISTRIBUTION)
    except PackageNotFoundError:
        text = (
            "ExWarp runs from its source without being installed, so that nothing tells which "
            "versions it needs; run 'pip install .' beside its pyproject.toml"
        )
        return Check("not known", (warning(text),), {"installed": None, "packages": []})
    packages = [_tried(found(one)) for one in _requirements(own, None)]
    remarks = [failure(_advice(package)) for package in packages if not package.is_good]
    if own.version != __version__:
        remarks.append(
            warning(
                f"the package exwarp is installed as {own.version} and runs as {__version__}; "
                "install it again"
            )
        )
    good = sum(package.is_good for package in packages)
    facts = {"installed": own.version, "packages": [asdict(package) for package in packages]}
    return Check(
        f"{good} of {len(packages)} load, in versions that ExWarp works with",
        tuple(remarks),
        facts,
        tuple(package.line for package in packages),
    )


def check_extras() -> Check:
    """Look at what ExWarp can do without: an extra that is not there at all is no defect."""
    try:
        own = distribution(DISTRIBUTION)
    except PackageNotFoundError:
        return Check("not known, as ExWarp is not installed", facts={"extras": {}})
    names = sorted(own.metadata.get_all("Provides-Extra") or ())
    extras = {name: [found(one) for one in _requirements(own, name)] for name in names}
    there = [name for name, packages in extras.items() if all(p.installed for p in packages)]
    missing = [name for name, packages in extras.items() if not any(p.installed for p in packages)]
    remarks = [remark for name in names for remark in _extra_remarks(name, extras[name])]
    parts = [f"{enumerated(there)} installed"] if there else []
    if missing:
        parts.append(f"{enumerated(missing)} not ({pip_command(missing)})")
    facts = {
        "extras": {
            name: {
                "installed": name in there,
                "install": pip_command([name]),
                "packages": [asdict(package) for package in packages],
            }
            for name, packages in extras.items()
        }
    }
    lines = tuple(f"{name}: {'; '.join(p.line for p in extras[name])}" for name in names)
    return Check(", ".join(parts) or "there are none", tuple(remarks), facts, lines)


def pip_command(extras: list[str]) -> str:
    """Return what installs extras."""
    return f"pip install '{DISTRIBUTION}[{','.join(extras)}]'"


def found(requirement: Requirement) -> Package:
    """Find the package that a requirement names, or one that stands in for it."""
    for name in (requirement.name, *STAND_INS.get(requirement.name.lower(), ())):
        try:
            installed = version(name)
        except PackageNotFoundError:
            continue
        fits = requirement.specifier.contains(installed, prereleases=True)
        return Package(name, str(requirement.specifier), installed, fits)
    return Package(requirement.name, str(requirement.specifier), None, False)


def module_of(package: str) -> str:
    """Return the module to import of a package, or of what it stands in for."""
    name = package.lower()
    meant = next((real for real, others in STAND_INS.items() if name in others), name)
    return MODULES.get(meant, meant)


def _requirements(own: Distribution, extra: str | None) -> Iterator[Requirement]:
    """Yield what an extra asks for, or what ExWarp itself does, on this platform."""
    for text in own.requires or ():
        requirement = Requirement(text)
        marker = requirement.marker
        plain = marker is None or marker.evaluate({"extra": ""})
        if plain if extra is None else not plain and _holds(requirement, extra):
            yield requirement


def _holds(requirement: Requirement, extra: str) -> bool:
    return requirement.marker is not None and requirement.marker.evaluate({"extra": extra})


def _tried(package: Package) -> Package:
    """Import a package; whatever goes wrong is what its users would meet."""
    if package.installed is None:
        return package
    try:
        importlib.import_module(module_of(package.name))
    except Exception as error:  # a library of the system, numpy's ABI, a file that is missing …
        return Package(
            package.name, package.wanted, package.installed, package.fits, first_line(error)
        )
    return package


def _extra_remarks(name: str, packages: list[Package]) -> Iterator[Remark]:
    """Say what is wrong with an extra of which something is there."""
    if not any(package.installed for package in packages):
        return
    for package in packages:
        if not package.is_good:  # not imported, as PyTorch takes seconds
            yield warning(f"{_advice(package)} (the extra {name} needs it)")


def _advice(package: Package) -> str:
    """Say in a sentence what is wrong with a package, and what to do."""
    again = f"pip install '{package.name}{package.wanted}'"
    if package.installed is None:
        return f"{package.name} is not installed; run {again}"
    if not package.fits:
        return f"{package.name} is {package.installed}, and {package.wanted} does; run {again}"
    library = _LIBRARY.search(package.error or "")
    if library is not None:
        remedy = f"install the system's package that has {library[0]}"
    else:
        remedy = f"run pip install --force-reinstall '{package.name}{package.wanted}'"
    return f"{package.name} cannot be imported ({package.error}); {remedy}"
