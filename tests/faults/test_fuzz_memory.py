"""The bound of memory that every spoilt shot has: what a case asks for, and that a breach shows."""

from __future__ import annotations

import mmap
import subprocess
import sys

import pytest

from tests.cli import shots
from tests.faults.fuzz.cases import Case
from tests.faults.fuzz.damage import STREET, planes_of
from tests.faults.fuzz.memory import GROWTH_MB, MOST_PIXELS, PROCESS_MB, pixels_of, watched
from tests.faults.running import Outcome

PLANES = {name: plane for planes in planes_of(0.0) for name, plane in planes.items()}


def write(folder, number, **windows):
    shots.write(folder / f"shot.{number:04d}.exr", {"": PLANES}, shots.header(**windows))


SMALL_TESTER = """
from tests.faults.running import run

outcome = run("doctor", "--skip-self-test", "--json")
print(outcome.code, outcome.alone, outcome.peak_mb)
"""


def padded(size):
    return -(-size // 8) * 8


def test_a_case_asks_for_what_holds_all_its_windows(tmp_path):
    assert pixels_of(tmp_path) == 0
    write(tmp_path, 1)
    assert pixels_of(tmp_path) == padded(STREET.width) * padded(STREET.height)
    write(tmp_path, 2, displayWindow=shots.window(-5, -8, 3, 4))
    assert pixels_of(tmp_path) == padded(STREET.width + 5) * padded(STREET.height + 8)
    write(tmp_path, 3, displayWindow=shots.window(100_000, 100_000, 3, 4))
    assert pixels_of(tmp_path) == MOST_PIXELS


@pytest.mark.parametrize("alone", [True, False])
def test_more_than_that_is_a_finding(tmp_path, alone):
    case = Case(tmp_path, (), 0)
    (tmp_path / "keys").mkdir()
    base = PROCESS_MB if alone else GROWTH_MB
    case.judge(Outcome(0, "", "", base, alone))
    with pytest.raises(AssertionError, match=f"{base + 1} MB for 0 pixels"):
        case.judge(Outcome(0, "", "", base + 1, alone))


@pytest.mark.skipif(sys.platform != "linux", reason="Linux alone reports the peak")
def test_the_peak_of_a_block_is_its_own():
    for size in (200, 20):
        with watched() as growth, mmap.mmap(-1, size * 2**20) as room:
            # None that the allocator has already.
            for page in range(0, len(room), mmap.PAGESIZE):
                room[page] = 1
        assert size - 10 <= growth.mb <= size + 60


def test_the_peak_of_a_command_is_that_of_the_process_that_works():
    """As a tester sees it that is small itself, as `python -m tests.faults.fuzz` is.

    Linux counts for a program what the process had that became it; one between knows nothing of
    these tests' peak.
    """
    between = ["sh", "-c", '"$@"; exit $?', "sh", sys.executable, "-c", SMALL_TESTER]
    shown = subprocess.run(between, capture_output=True, text=True, check=True).stdout.split()
    code, alone, peak = shown
    assert (code, alone) == ("0", "True") and 5 < int(peak) < PROCESS_MB
