"""Making every check, whatever the others find.

Each check stands in a module that is imported for it: where a package is missing or broken, the
checks that need it fail, and the others go on.
"""

from __future__ import annotations

import importlib
import os
import time
from collections.abc import Callable

from exwarp_cli import __version__
from exwarp_cli.domain.checkup import Check, Checkup, failure
from exwarp_cli.domain.wording import first_line
from exwarp_cli.errors import ExwarpError
from exwarp_cli.pipeline.doctor.compilation import telling_of_compilation
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

PREFIXES = ("EXWARP_", "NUMBA_", "OMP_", "KMP_", "OPENIMAGEIO_", "ORT_")
VARIABLES = ("CUDA_VISIBLE_DEVICES", "IMAGEIO_FFMPEG_EXE", "LD_LIBRARY_PATH", "TMPDIR")
"""Variables of the environment that are shown, by the beginnings of their names and by name."""


def examine(
    tell: Callable[[str], None],
    self_test: bool = True,
    more: dict[str, Callable[[], Check]] | None = None,
) -> Checkup:
    """Examine this machine and this installation.

    Parameters
    ----------
    tell
        Told in one line of what takes long.
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
    makers: dict[str, str | Callable[[], Check]] = {**(more or {}), **CHECKS}
    if not self_test:
        makers[SELF_TEST] = lambda: Check("left out, as --skip-self-test asks", skipped=True)
    with telling_of_compilation(tell):
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
