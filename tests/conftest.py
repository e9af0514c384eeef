"""What holds for all tests."""

from __future__ import annotations

import compileall
import os
import signal
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import settings

import exwarp_cli
from exwarp_cli.runtime import cores
from tests.matrix import DEFAULT_SUITE, FULL, MARKED

TESTS = Path(__file__).parent

# A busy machine is no defect: examples may take any time.
settings.register_profile("exwarp", deadline=None, max_examples=100 if FULL else 25)
settings.load_profile("exwarp")

# A shell ignores interruptions in what it runs in the background, and so would all that is started
# from here: the tests that interrupt a command could only wait for its end.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# Settings in the environment of the shell are no part of the tests.
for name in [name for name in os.environ if name.startswith("EXWARP_")]:
    if name not in ("EXWARP_ARTEFACTS", "EXWARP_BLENDER", "EXWARP_CHROMIUM", "EXWARP_TESTS"):
        del os.environ[name]
os.environ["EXWARP_CONFIG"] = "none"


def pytest_addoption(parser: pytest.Parser) -> None:
    """Let everything be run: without files, ``pytest`` leaves slow tests out."""
    parser.addoption("--all", action="store_true", help="run all tests, as make test does")


def pytest_xdist_auto_num_workers() -> int:
    """Use one worker more than cores: tests that wait for processes leave a core idle."""
    return (os.cpu_count() or 1) + 1


@pytest.hookimpl(tryfirst=True)  # before tests are chosen by their marks
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark the tests of whole files and folders."""
    for item in items:
        file = item.path.relative_to(TESTS)
        around = {place.as_posix() for place in (file, *file.parents)}
        for mark, places in MARKED.items():
            if not around.isdisjoint(places):
                item.add_marker(mark)


def pytest_configure(config: pytest.Config) -> None:
    """Choose the default suite, and compile the package once: processes of tests only read it.

    Where PYTHONDONTWRITEBYTECODE is set, each would compile it again, in 0.5 s.
    """
    chosen = config.option
    is_plain = config.args_source == pytest.Config.ArgsSource.TESTPATHS
    if is_plain and not (
        chosen.all or chosen.markexpr or chosen.keyword or getattr(chosen, "lf", False)
    ):
        config.option.markexpr = DEFAULT_SUITE
    if not hasattr(config, "workerinput"):
        compileall.compile_dir(Path(exwarp_cli.__file__).parent, quiet=1)


@pytest.fixture(autouse=True)
def every_core() -> Iterator[None]:
    """A test that runs a command with fewer cores leaves all of them to the next."""
    yield
    cores.set_count(None, os.cpu_count() or 1)
