"""Ended at any moment, by any signal: what is there is whole, and going on gives the same bytes."""

from __future__ import annotations

import os
import random
import signal
import time
from pathlib import Path

import pytest

from tests.cli import shots
from tests.faults.running import (
    PLAIN,
    ended,
    require_no_leftovers,
    require_whole,
    run,
    run_here,
    started,
)
from tests.matrix import FULL

pytestmark = pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")

SIGNALS = (signal.SIGKILL, signal.SIGTERM, signal.SIGINT)
METHODS = ("softsplat", "s6", "causal")
KILLS = [(number,) * count for number in SIGNALS for count in (1, 2)] if FULL else [SIGNALS]
"""Signals that end a run, and then those that go on with it."""
TIMES = 36 if FULL else 1


FOLDERS = ("out", "holes")


def command(keys: Path, root: Path, method: str) -> tuple[object, ...]:
    where = ("-o", root / "out", "--write-holes", root / "holes")
    return ("upsample", keys, *where, *PLAIN, "-m", method, "--skip-existing")


@pytest.fixture(scope="module")
def whole(keys, tmp_path_factory) -> dict[str, tuple[list[dict[str, bytes]], float]]:
    """What undisturbed runs write, and how long they take, by method."""
    found = {}
    for method in METHODS[:TIMES]:
        root = tmp_path_factory.mktemp(method)
        begin = time.monotonic()
        run(*command(keys, root, method)).judge(0)
        contents = [shots.contents(root / folder) for folder in FOLDERS]
        found[method] = contents, time.monotonic() - begin
    return found


@pytest.mark.parametrize("kills", KILLS)
@pytest.mark.parametrize("seed", range(TIMES))
def test_going_on_gives_the_same_bytes(keys, rendered, whole, tmp_path, kills, seed):
    chance = random.Random(f"{kills} {seed}")
    method = METHODS[seed % len(METHODS)]
    contents, seconds = whole[method]
    for number in kills:
        process = started(*command(keys, tmp_path, method))
        time.sleep(chance.uniform(0.05, 1.05) * seconds)
        # One process, or all that a terminal or a farm would reach.
        if chance.random() < 0.5:
            process.send_signal(number)
        else:
            os.killpg(process.pid, number)
        outcome = ended(process)
        # Before Python has begun, the system ends it, which a shell takes for the same code.
        assert outcome.code in (0, 128 + number, -number)
        if outcome.code > 0:
            outcome.judge(outcome.code)
        for folder in FOLDERS:
            if (tmp_path / folder).exists():
                require_whole(tmp_path / folder, rendered)
    run_here(*command(keys, tmp_path, method))
    assert [shots.contents(tmp_path / folder) for folder in FOLDERS] == contents
    for folder in FOLDERS:
        require_no_leftovers(tmp_path / folder)
