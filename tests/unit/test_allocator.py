"""Where threads take memory from."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from exwarp_cli.io.allocator import CHOSEN, share_one_arena

GLIBC = sys.platform.startswith("linux") and "CS_GNU_LIBC_VERSION" in os.confstr_names


@pytest.mark.parametrize("name", CHOSEN)
def test_what_the_user_chose_stays(name):
    assert not share_one_arena({name: "2"})


@pytest.mark.skipif(not GLIBC, reason="other C libraries have one arena, or none to choose")
def test_threads_reuse_what_others_freed():
    """Many threads, one after the other and all at once, of which each frees what it took."""
    peaks = {told: _peak(told) for told in (False, True)}
    assert peaks[True] < peaks[False] - 100


def _peak(told: bool) -> float:
    """Return the memory, in MB, that stays resident in a process of its own."""
    program = f"""
import threading
from exwarp_cli.io.allocator import share_one_arena
if {told}:
    assert share_one_arena({{}})
turn, seven = threading.Barrier(8), list(range(8))
def work(mine):
    for now in seven:
        turn.wait()
        if now == mine:
            blocks = [bytearray(100_000) for _ in range(300)]
            last = bytearray(100_000)  # keeps the arena's end
            keep.append(last)
            del blocks
keep = []
threads = [threading.Thread(target=work, args=(i,)) for i in seven]
[t.start() for t in threads]
[t.join() for t in threads]
with open("/proc/self/status") as file:
    print(next(int(line.split()[1]) for line in file if line.startswith("VmRSS")) / 1024)
"""
    environment = {name: value for name, value in os.environ.items() if name not in CHOSEN}
    run = subprocess.run(
        [sys.executable, "-c", program], env=environment, capture_output=True, text=True, check=True
    )
    return float(run.stdout)
