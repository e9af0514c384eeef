"""What the compiler's library has resident, and that it goes on working."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from exwarp_cli.compiled import resident
from exwarp_cli.compiled.resident import LIBRARY, MAPS, let_compiler_go, unchanged

SMAPS = """\
1000-3000 r--p 00000000 08:01 77                         /opt/a b/libllvmlite.so
Rss:                   8 kB
Anonymous:             0 kB
3000-9000 r-xp 00002000 08:01 77                         /opt/a b/libllvmlite.so
Rss:                  16 kB
Anonymous:             0 kB
9000-a000 r--p 00008000 08:01 77                         /opt/a b/libllvmlite.so
Rss:                   4 kB
Anonymous:             4 kB
a000-b000 rw-p 00009000 08:01 77                         /opt/a b/libllvmlite.so
Rss:                   4 kB
Anonymous:             0 kB
b000-c000 r--s 0000a000 08:01 77                         /opt/a b/libllvmlite.so
Rss:                   4 kB
Anonymous:             0 kB
c000-d000 r-xp 00000000 08:01 78                         /opt/another-libllvmlite.so
Rss:                   4 kB
Anonymous:             0 kB
d000-e000 r-xp 00000000 08:01 77                         /opt/a b/libllvmlite.so (deleted)
Rss:                   4 kB
Anonymous:             0 kB
e000-f000 r--p 00000000 00:00 0
Rss:                   4 kB
Anonymous:             0 kB
"""

KEYS = Path(__file__).parents[2] / "examples" / "market" / "keys"

LINUX = pytest.mark.skipif(not MAPS.exists(), reason="only Linux tells what is mapped")

RESIDENT = """
import re
def resident():
    found, here = 0, False
    for line in open("/proc/self/smaps"):
        if re.match("[0-9a-f]+-", line):
            here = "/libllvmlite.so" in line and "w" not in line.split()[1]
        elif here and line.startswith("Rss:"):
            found += int(line.split()[1])
    return found / 1024
"""
"""MB of the compiler's library that lie in memory."""


def test_only_what_is_as_in_the_file_goes():
    """Not tables that were written and then made read-only, nor other files and memory."""
    assert list(unchanged(SMAPS.splitlines(keepends=True), LIBRARY)) == [
        (0x1000, 0x2000),
        (0x3000, 0x6000),
    ]


def test_where_nothing_tells_nothing_happens(monkeypatch, tmp_path):
    monkeypatch.setattr(resident, "MAPS", tmp_path / "none")
    resident._places.cache_clear()
    try:
        let_compiler_go()
        assert resident._places() == ()
    finally:
        resident._places.cache_clear()


@LINUX
def test_the_compiler_goes_on_working():
    program = f"""{RESIDENT}
import sys
from exwarp_cli.compiled import resident as module
module.let_compiler_go()
assert "llvmlite.binding" not in sys.modules and module._places.cache_info().currsize == 0
import numba
kernel = numba.njit(lambda x: x + 1)
assert kernel(2) == 3
before = resident()
module.let_compiler_go()
after = resident()
assert kernel(2) == 3 and kernel(2.5) == 3.5
module.let_compiler_go()
print(before, after, resident())
"""
    before, after, again = map(float, _said(program).split())
    assert before > 20
    assert after < 5 and again < 5


@LINUX
def test_a_run_lets_it_go(tmp_path):
    program = f"""{RESIDENT}
from exwarp_cli import cli
options = ["-m", "s6", "--progress", "none", "--threads", "2", "--frames", "1-3"]
assert cli.run(["upsample", {str(KEYS)!r}, "-o", {str(tmp_path / "out")!r}, *options]) == 0
print(resident())
"""
    assert float(_said(program).splitlines()[-1]) < 20


def _said(program: str) -> str:
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout
