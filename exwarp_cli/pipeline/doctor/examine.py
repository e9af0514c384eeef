"""Making every check, whatever the others find.

Each check stands in a module that is imported for it: where a package is missing or broken, the
checks that need it fail, and the others go on.
"""

from __future__ import annotations

import importlib
import time
from collections.abc import Callable

from exwarp_cli import __version__
from exwarp_cli.domain.checkup import Check, Checkup, failure
from exwarp_cli.domain.wording import first_line
from exwarp_cli.errors import ExwarpError
from exwarp_cli.runtime.stop import check_stop

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


def examine(self_test: bool = True, more: dict[str, Callable[[], Check]] | None = None) -> Checkup:
    """Examine this machine and this installation.

    Parameters
    ----------
    self_test
        Whether to upsample a shot.
    more
        Checks of the caller's, by name, that are made first.

    Returns
    -------
    Checkup
        Of every check, failed ones included.
    """
    checks, seconds = {}, {}
    makers = {**(more or {}), **{name: _maker(place) for name, place in CHECKS.items()}}
    if not self_test:
        makers[SELF_TEST] = _skipped
    for name, make in makers.items():
        begin = time.perf_counter()
        checks[name] = _made(make)
        seconds[name] = time.perf_counter() - begin
        check_stop()
    return Checkup(__version__, checks, seconds)


def _maker(place: str) -> Callable[[], Check]:
    """Return what imports a check's module and makes the check."""

    def make() -> Check:
        module, _, function = place.partition(":")
        check: Check = getattr(importlib.import_module(f"{__package__}.{module}"), function)()
        return check

    return make


def _made(make: Callable[[], Check]) -> Check:
    """Make a check; what keeps it from being made is its result."""
    try:
        return make()
    except ExwarpError as error:
        told = str(error)
    except ImportError as error:
        told = (
            f"a package is missing or broken ({first_line(error)}); mend what 'packages' tells, or "
            "install ExWarp again"
        )
    except OSError as error:
        told = f"files cannot be written or read ({first_line(error)}); see 'temp folder'"
    except Exception as error:  # a doctor must not fall ill of what it finds
        told = (
            f"unexpected {type(error).__name__}: {first_line(error)}; install ExWarp and its "
            "packages again"
        )
    return Check("cannot be checked", (failure(told),))


def _skipped() -> Check:
    return Check("left out, as --skip-self-test asks", skipped=True)
