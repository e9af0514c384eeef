"""Making every check, whatever the others find.

Each check stands in a module that is imported for it: where a package is missing or broken, the
checks that need it fail, and the others go on.
"""

from __future__ import annotations

import importlib
import os
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

from exwarp_cli import __version__
from exwarp_cli.domain.wording import first_line
from exwarp_cli.errors import ExwarpError
from exwarp_cli.runtime.stop import check_stop

SCHEMA = "exwarp.doctor/1"
"""Version of `Checkup.as_dict`: keys may join, none is renamed."""


class Outcome(StrEnum):
    """How a check ended."""

    OK = "ok"
    WARNING = "warning"
    FAILED = "failed"
    SKIPPED = "skipped"


_BY_WEIGHT = (Outcome.OK, Outcome.WARNING, Outcome.FAILED)


@dataclass(frozen=True)
class Remark:
    """Something that is not as it should be.

    Attributes
    ----------
    outcome
        `Outcome.WARNING` where the work can be done all the same, else `Outcome.FAILED`.
    text
        One sentence: what, where, and what to do.
    """

    outcome: Outcome
    text: str


def warning(text: str) -> Remark:
    """Remark on what does not keep ExWarp from its work."""
    return Remark(Outcome.WARNING, text)


def failure(text: str) -> Remark:
    """Remark on what does."""
    return Remark(Outcome.FAILED, text)


@dataclass(frozen=True)
class Check:
    """One thing that was looked at.

    Attributes
    ----------
    found
        What is there, in one line.
    remarks
        What is wrong with it; empty where nothing is.
    facts
        What was found for machines; JSON can hold it.
    lines
        The same for people who want to know more.
    skipped
        Whether it was left out.
    """

    found: str
    remarks: tuple[Remark, ...] = ()
    facts: Mapping[str, Any] = field(default_factory=dict)
    lines: tuple[str, ...] = ()
    skipped: bool = False

    @property
    def outcome(self) -> Outcome:
        """The worst of its remarks."""
        if self.skipped:
            return Outcome.SKIPPED
        worst = max((_BY_WEIGHT.index(remark.outcome) for remark in self.remarks), default=0)
        return _BY_WEIGHT[worst]


@dataclass(frozen=True)
class Checkup:
    """Every check of an examination.

    Attributes
    ----------
    version
        Of ExWarp.
    checks
        By name, in the order in which they were made.
    seconds
        How long each took, by name.
    """

    version: str
    checks: Mapping[str, Check]
    seconds: Mapping[str, float]

    def names(self, outcome: Outcome) -> list[str]:
        """Names of the checks that ended so."""
        return [name for name, check in self.checks.items() if check.outcome is outcome]

    @property
    def outcome(self) -> Outcome:
        """The worst of all."""
        return next(o for o in reversed(_BY_WEIGHT) if o is Outcome.OK or self.names(o))

    def as_dict(self) -> dict[str, Any]:
        """Return what `exwarp doctor --json` prints."""
        return {
            "schema": SCHEMA,
            "version": self.version,
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


CHECKS = {
    "machine": "machine:check_machine",
    "temp_folder": "machine:check_temporary",
    "packages": "packages:check_packages",
    "extras": "packages:check_extras",
    "kernels": "kernels:check_kernels",
    "models": "networks:check_models",
    "network": "networks:check_network",
    "policy": "networks:check_policy",
    "exr": "codecs:check_exr",
    "stills": "codecs:check_stills",
    "video": "codecs:check_video",
    "self_test": "self_test:check_self_test",
    "kernel_cache": "kernels:check_cache",
}
"""Every check in the order in which they are made, by module and function.

The cache comes last: only then it is known which kernels were in it.
"""

SELF_TEST = "self_test"

PREFIXES = ("EXWARP_", "NUMBA_", "OMP_", "KMP_", "OPENIMAGEIO_", "ORT_")
VARIABLES = ("CUDA_VISIBLE_DEVICES", "IMAGEIO_FFMPEG_EXE", "LD_LIBRARY_PATH", "TMPDIR")
"""Variables of the environment that are shown, by the beginnings of their names and by name."""


def examine(self_test: bool = True, more: dict[str, Callable[[], Check]] | None = None) -> Checkup:
    """Examine this machine and this installation; failed checks are part of the result.

    Parameters
    ----------
    self_test
        Whether to upsample a shot.
    more
        Checks of the caller's, by name, that are made first.
    """
    checks, seconds = {}, {}
    makers: dict[str, str | Callable[[], Check]] = {**(more or {}), **CHECKS}
    if not self_test:
        makers[SELF_TEST] = lambda: Check("left out, as --skip-self-test asks", skipped=True)
    for name, maker in makers.items():
        begin = time.perf_counter()
        checks[name] = _check(maker)
        seconds[name] = time.perf_counter() - begin
        check_stop()
    return Checkup(__version__, checks, seconds)


def variables() -> dict[str, str]:
    """Return the variables that change what ExWarp and its libraries do, by name."""
    names = sorted(name for name in os.environ if name.startswith(PREFIXES) or name in VARIABLES)
    return {name: os.environ[name] for name in names}


def _check(maker: str | Callable[[], Check]) -> Check:
    """Make a check, whose module is imported for it; an error is its result."""
    try:
        if not isinstance(maker, str):
            return maker()
        module, _, function = maker.partition(":")
        check: Check = getattr(importlib.import_module(f"{__package__}.{module}"), function)()
        return check
    except ExwarpError as error:
        text = str(error)
    except ImportError as error:
        text = (
            f"a package is missing or broken ({first_line(error)}); mend what 'packages' tells, or "
            "install ExWarp again"
        )
    except OSError as error:
        text = f"files cannot be written or read ({first_line(error)}); see 'temp folder'"
    except Exception as error:  # the other checks go on, whatever this one meets
        text = (
            f"unexpected {type(error).__name__}: {first_line(error)}; install ExWarp and its "
            "packages again"
        )
    return Check("cannot be checked", (failure(text),))
