"""Ended at any moment, by any signal: what is there is whole, and going on gives the same bytes."""

from __future__ import annotations

import os
import random
import signal
import time

import pytest

from tests.cli import shots
from tests.faults.running import (
    FULL,
    PLAIN,
    ended,
    require_no_leftovers,
    require_whole,
    run,
    started,
)

pytestmark = pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")

SIGNALS = (signal.SIGKILL, signal.SIGTERM, signal.SIGINT)
METHODS = ("softsplat", "s6", "exwarp")
TIMES = 72 if FULL else 2
"""Runs that are killed by each signal: 6 in all, in full 216."""


@pytest.fixture(scope="module")
def whole(keys, tmp_path_factory) -> dict[str, tuple[dict[str, bytes], float]]:
    """What undisturbed runs write, and how long they take, by method."""
    found = {}
    for method in METHODS:
        root = tmp_path_factory.mktemp(method)
        begin = time.monotonic()
        run("upsample", keys, "-o", root / "out", *PLAIN, "-m", method).judge(0)
        found[method] = shots.contents(root / "out"), time.monotonic() - begin
    return found


@pytest.mark.parametrize("number", SIGNALS, ids=lambda number: number.name)
@pytest.mark.parametrize("seed", range(TIMES))
def test_going_on_gives_the_same_bytes(keys, rendered, whole, tmp_path, number, seed):
    chance = random.Random(f"{number.name} {seed}")
    method = METHODS[seed % len(METHODS)]
    contents, seconds = whole[method]
    out = tmp_path / "out"
    command = ("upsample", keys, "-o", out, *PLAIN, "-m", method, "--skip-existing")
    for _ in range(chance.randint(1, 2)):
        process = started(*command)
        time.sleep(chance.uniform(0.05, 1.05) * seconds)
        # One process, or all that a terminal or a farm would reach.
        if chance.random() < 0.5:
            process.send_signal(number)
        else:
            os.killpg(process.pid, number)
        outcome = ended(process)
        if number is not signal.SIGKILL:
            # Before Python has begun, the system ends it, which a shell takes for the same code.
            assert outcome.code in (128 + number, -number, 0)
        if outcome.code > 0:
            outcome.judge(outcome.code)
        if out.exists():
            require_whole(out, rendered)
    run(*command).judge(0)
    assert shots.contents(out) == contents
    require_no_leftovers(out)
