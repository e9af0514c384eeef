"""A long run holds no more at its end than near its beginning."""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass
from pathlib import Path

import pytest

from tests.cli import shots
from tests.cli.street import Street
from tests.faults.running import ended, require_no_leftovers, started
from tests.matrix import FULL, spread

pytestmark = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="others do not tell")

KEYS, SIZE = (750, Street(96, 54)) if FULL else (14, Street(192, 108))
"""Key frames; frames are four times as many. Few of them are larger than `ALLOWED` together."""

ALLOWED = {"memory": 8 * 2**20, "handles": 4, "threads": 4}
"""How much more there may be late than early: what a report keeps of each frame, memory that the
allocator has at the moment, and files that are read and written at the moment."""

METHODS = {
    "softsplat": ("-m", "softsplat", "--write-holes", "HOLES", "--video", "VIDEO", "--report", "R"),
    "s6": ("-m", "s6", "--cuts", "none", "--report", "R"),
    "causal": ("-m", "causal"),
}


@dataclass(frozen=True)
class Sample:
    """What a process holds while so many frames are there."""

    frames: int
    memory: int
    handles: int
    threads: int

    @classmethod
    def of(cls, number: int, folder: Path) -> Sample | None:
        """Look at a process; None where it has just ended."""
        about = Path(f"/proc/{number}")
        try:
            status = dict(
                line.split(":", 1) for line in (about / "status").read_text().splitlines()
            )
            handles = len(list((about / "fd").iterdir()))
            memory = int(status["RssAnon"].split()[0]) * 1024
            return cls(len(shots.names(folder)), memory, handles, int(status["Threads"]))
        except (OSError, KeyError):
            return None


@pytest.fixture(scope="module")
def long_shot(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("long") / "keys"
    return shots.sequence(folder, shots.plain, range(1, KEYS + 1), SIZE)


@pytest.mark.parametrize("method", spread(METHODS, 2))
def test_nothing_grows(long_shot, tmp_path, method):
    out = tmp_path / "out"
    names = {"HOLES": tmp_path / "holes", "VIDEO": tmp_path / "film.mp4", "R": tmp_path / "report"}
    process = started(
        "upsample", long_shot, "-o", out, *(names.get(word, word) for word in METHODS[method]),
        "--motion", "forward", "--progress", "none", "--threads", "2",
        environment={"EXWARP_SUPERVISE": "0"},
    )  # fmt: skip
    samples: list[Sample] = []
    while process.poll() is None:
        sample = Sample.of(process.pid, out)
        # At the end the report is made, of all frames at once.
        if sample is not None and 0.2 * 4 * KEYS <= sample.frames < 4 * KEYS:
            samples.append(sample)
        time.sleep(0.02)
    ended(process).judge(0)
    assert len(list(out.iterdir())) == 4 * KEYS
    require_no_leftovers(out)
    early = [sample for sample in samples if sample.frames < 2 * KEYS]
    late = [sample for sample in samples if sample.frames >= 3 * KEYS]
    assert early and late
    for name, allowed in ALLOWED.items():
        ends = [max(getattr(sample, name) for sample in some) for some in (early, late)]
        assert ends[1] <= ends[0] + allowed, (name, ends)
