"""Running every check of an installation, whatever the others find.

Each check is a function of a module that is imported for it. Where a package is missing or broken,
the checks that need it fail, and the others go on. Nothing here needs such a package.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from pkgutil import resolve_name
from typing import Any

from exwarp_cli import __version__
from exwarp_cli.domain.wording import enumerated, first_line
from exwarp_cli.errors import ExwarpError
from exwarp_cli.runtime.stop import check_stop

# Version of `DoctorReport.as_dict`: keys may be added or removed, none is renamed.
SCHEMA = "exwarp.doctor/1"

# Every check in its order, by module and function. The cache comes last: only then it is known
# which kernels were in it.
CHECKS = {
    "machine": "environment:check_machine",
    "temp_folder": "environment:check_temporary",
    "packages": "environment:check_packages",
    "extras": "environment:check_extras",
    "kernels": "libraries:check_kernels",
    "models": "libraries:check_models",
    "network": "libraries:check_network",
    "video": "libraries:check_video",
    "self_test": "self_test:check_self_test",
    "kernel_cache": "libraries:check_cache",
}
SELF_TEST = "self_test"

# Variables of the environment that are shown, by the beginnings of their names and by name.
PREFIXES = ("EXWARP_", "NUMBA_", "OMP_", "KMP_", "OPENIMAGEIO_", "ORT_")
VARIABLES = ("CUDA_VISIBLE_DEVICES", "IMAGEIO_FFMPEG_EXE", "LD_LIBRARY_PATH", "TMPDIR")


class Outcome(StrEnum):
    """How a check ended."""

    OK = "ok"
    WARNING = "warning"
    FAILED = "failed"
    SKIPPED = "skipped"


@dataclass(frozen=True)
class Finding:
    """Something that is not as it should be."""

    # `Outcome.WARNING` where the work can be done all the same, else `Outcome.FAILED`
    outcome: Outcome
    text: str  # one sentence: what, where, and what to do


def warning(text: str) -> Finding:
    """Return a finding that does not keep ExWarp from its work."""
    return Finding(Outcome.WARNING, text)


def failure(text: str) -> Finding:
    """Return a finding that keeps ExWarp from its work."""
    return Finding(Outcome.FAILED, text)


@dataclass(frozen=True)
class CheckResult:
    """The result of one check."""

    found: str  # what is there, in one line
    remarks: tuple[Finding, ...] = ()  # what is wrong with it; empty where nothing is
    # The result for machines; JSON can hold it
    facts: Mapping[str, Any] = field(default_factory=dict)
    lines: tuple[str, ...] = ()  # more of it for people
    skipped: bool = False  # whether the check was left out

    @property
    def outcome(self) -> Outcome:
        """The worst of its remarks."""
        if self.skipped:
            return Outcome.SKIPPED
        present = {remark.outcome for remark in self.remarks}
        return next((o for o in (Outcome.FAILED, Outcome.WARNING) if o in present), Outcome.OK)


@dataclass(frozen=True)
class DoctorReport:
    """The results of all checks."""

    checks: Mapping[str, CheckResult]  # by name, in the order in which they were made
    seconds: Mapping[str, float]  # how long each took, by name

    def names(self, outcome: Outcome) -> list[str]:
        """Return the names of the checks with an outcome."""
        return [name for name, check in self.checks.items() if check.outcome is outcome]

    @property
    def outcome(self) -> Outcome:
        """The worst of all; what was left out counts as good."""
        return next((o for o in (Outcome.FAILED, Outcome.WARNING) if self.names(o)), Outcome.OK)

    def as_dict(self) -> dict[str, Any]:
        """Return what `exwarp doctor --json` prints."""
        return {
            "schema": SCHEMA,
            "version": __version__,
            "outcome": self.outcome,
            "failed": self.names(Outcome.FAILED),
            "warnings": self.names(Outcome.WARNING),
            "seconds": round(sum(self.seconds.values()), 3),
            "checks": {
                name: {
                    "outcome": check.outcome,
                    "found": check.found,
                    "remarks": [{"outcome": r.outcome, "text": r.text} for r in check.remarks],
                    "seconds": round(self.seconds[name], 3),
                    "facts": dict(check.facts),
                }
                for name, check in self.checks.items()
            },
        }

    def verdict(self) -> str:
        """Sum up the examination, whether checks failed or not."""
        failed, warnings, skipped = (
            [name.replace("_", " ") for name in self.names(outcome)]
            for outcome in (Outcome.FAILED, Outcome.WARNING, Outcome.SKIPPED)
        )
        if failed:
            what = "line under it says" if len(failed) == 1 else "lines under them say"
            return (
                f"{len(failed)} of {len(self.checks)} checks failed ({enumerated(failed)}); do "
                f"what the {what}"
            )
        if warnings:
            return f"everything that is needed works; see the warnings on {enumerated(warnings)}"
        return "everything that was tried works" if skipped else "everything works"


def run_checks(self_test: bool, more: dict[str, Callable[[], CheckResult]]) -> DoctorReport:
    """Check this machine and this installation; failed checks are part of the result.

    `self_test` says whether to upsample a shot. `more` are checks of the caller, by name, that are
    made first.
    """
    functions: dict[str, str | Callable[[], CheckResult]] = {**more, **CHECKS}
    checks, seconds = {}, {}
    for name, function in functions.items():
        begin = time.perf_counter()
        if name == SELF_TEST and not self_test:
            checks[name] = CheckResult("left out, as --skip-self-test asks", skipped=True)
        else:
            checks[name] = _run(function)
        seconds[name] = time.perf_counter() - begin
        check_stop()
    return DoctorReport(checks, seconds)


def _run(check: str | Callable[[], CheckResult]) -> CheckResult:
    """Make a check, of which any error is the result."""
    try:
        run = resolve_name(f"{__package__}.{check}") if isinstance(check, str) else check
        return run()
    except ExwarpError as error:
        text = str(error)
    except ImportError as error:
        text = (
            f"a package is missing or broken ({first_line(error)}); mend what 'packages' tells, or "
            "install ExWarp again"
        )
    except OSError as error:
        text = f"files cannot be written or read ({first_line(error)}); see 'temp folder'"
    except Exception as error:  # the other checks go on
        text = (
            f"unexpected {type(error).__name__}: {first_line(error)}; install ExWarp and its "
            "packages again"
        )
    return CheckResult("cannot be checked", (failure(text),))


def variables() -> dict[str, str]:
    """Return the variables that change what ExWarp and its libraries do, by name."""
    items = sorted(os.environ.items())
    return {name: v for name, v in items if name.startswith(PREFIXES) or name in VARIABLES}
