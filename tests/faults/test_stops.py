"""A command that is stopped ends, with its sentence, wherever its main thread is."""

from __future__ import annotations

import json
import os
import random
import signal
import subprocess
import sys

import pytest

from exwarp_cli import cli
from tests.cli import shots
from tests.faults.breaking import STRUCK
from tests.faults.running import (
    BOUND_S,
    FULL,
    PLAIN,
    Outcome,
    ended,
    require_no_leftovers,
    require_whole,
    run,
)

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="needs processes of POSIX")

METHOD = ("-m", "s6")
COUNT = 400 if FULL else 16
"""Steps that are struck."""

PARTS = 8
"""Into which these are divided, for several processes of pytest."""

DELICATE = (
    "threading:Condition.__enter__", "threading:Condition.__exit__",
    "threading:Condition._release_save", "threading:Condition._acquire_restore",
    "weakref:finalize.__call__", "importlib._bootstrap:_ModuleLock",
    "exwarp_cli.domain.cores:Cores._take", "exwarp_cli.domain.cores:Cores._give",
    "contextlib:_GeneratorContextManager.__enter__",
    "llvmlite.binding.executionengine:ExecutionEngine._raw_object_cache_getbuffer",
    "llvmlite.binding.ffi:ObjectRef.__init__", "llvmlite.binding.context:ContextRef.__init__",
)  # fmt: skip
"""Where a stop once made the command hang, or was told as a defect, or was dropped."""

NEVER_ENDS = """
import os, signal, sys, time
from exwarp_cli.io import supervision

supervision.GRACE_S = supervision.TICK_S = 0.2
end = supervision.part(print)
if end is None:
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    print("works", flush=True)
    time.sleep(100)
print(end.code, end.stopped, end.is_failure)
"""


def broken(*arguments: object) -> Outcome:
    """Run a command as `tests.faults.breaking` has it."""
    process = subprocess.Popen(
        [sys.executable, "-m", "tests.faults.breaking", *map(str, arguments)],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        env=os.environ | {"EXWARP_SUPERVISE": "0"}, start_new_session=True,
    )  # fmt: skip
    return ended(process)


@pytest.fixture(scope="module")
def steps(keys, tmp_path_factory) -> dict[str, int]:
    """How often the main thread comes to a step, of an undisturbed run, whose kernels are there."""
    root = tmp_path_factory.mktemp("steps")
    run("upsample", keys, "-o", root / "compiled", *PLAIN, *METHOD).judge(0)
    told = ("upsample", keys, "-o", root / "out", *PLAIN, *METHOD)
    broken(root / "steps.json", "-", 1, *told).judge(0)
    found: dict[str, int] = json.loads((root / "steps.json").read_text())
    return found


@pytest.fixture(scope="module")
def chosen(steps) -> list[tuple[str, int]]:
    """Steps, with which time they are to be struck: a delicate one of each kind, and any others."""
    chance = random.Random(3)
    keys = sorted(steps)
    delicate = [chance.choice([key for key in keys if key.startswith(name)]) for name in DELICATE]
    others = chance.sample(keys, COUNT - len(delicate))
    return [(key, chance.randint(1, steps[key])) for key in (*delicate, *others)]


def test_there_is_what_to_look_at(steps):
    assert len(steps) > 1000
    assert all(any(key.startswith(name) for key in steps) for name in DELICATE)


def test_a_step_is_struck(keys, steps, tmp_path):
    key = next(key for key in sorted(steps) if key.startswith("exwarp_cli.pipeline.run:Run.write"))
    told = ("upsample", keys, "-o", tmp_path / "out", *PLAIN, *METHOD)
    outcome = broken(tmp_path / "steps.json", key, 1, *told)
    assert STRUCK in outcome.err and outcome.code == cli.TERMINATED


@pytest.mark.parametrize("part", range(PARTS))
def test_it_ends_wherever_it_is(keys, rendered, chosen, tmp_path, part):
    for number, (key, nth) in enumerate(chosen[part::PARTS]):
        out = tmp_path / str(number)
        told = ("upsample", keys, "-o", out, *PLAIN, *METHOD)
        outcome = broken(tmp_path / "steps.json", key, nth, *told)
        if STRUCK not in outcome.err:  # threads take turns by chance
            outcome.judge(0)
            continue
        lines = [line for line in outcome.err.splitlines(True) if STRUCK not in line]
        outcome = Outcome(outcome.code, outcome.out, "".join(lines), 0)
        assert outcome.code in (0, cli.TERMINATED), (key, nth, outcome)
        outcome.judge(outcome.code)
        if out.exists():
            require_whole(out, rendered)
            require_no_leftovers(out)
        done = out.exists() and len(shots.names(out)) == 4 * len(shots.names(keys))
        assert outcome.code != 0 or done, (key, nth)


def test_what_does_not_end_is_ended():
    words = [sys.executable, "-c", NEVER_ENDS]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "works\n"
        process.send_signal(signal.SIGTERM)
        told, _ = process.communicate(timeout=BOUND_S)
    assert told == f"{-signal.SIGKILL} {signal.SIGTERM.value} False\n"
