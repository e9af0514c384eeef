"""One case: a spoilt shot, a command that reads it, and what must hold whatever comes of it."""

from __future__ import annotations

import os
import shutil
import signal
import struct
import sys
import tempfile
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout, suppress
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from types import FrameType
from typing import NoReturn

from hypothesis import strategies as st

from exwarp_cli import cli
from exwarp_cli.errors import InputError
from exwarp_cli.io.generated_frames import is_intact
from exwarp_cli.io.key_file import plan_key_file
from tests.cli import shots
from tests.faults.fuzz.damage import DAMAGES, FOLDERS, Draw, draw_shot, files
from tests.faults.fuzz.memory import (
    GROWTH_MB,
    MOST_PIXELS,
    PROCESS_MB,
    allowed_mb,
    pixels_of,
    watched,
)
from tests.faults.running import Outcome, require_no_leftovers

SECONDS = 120
"""After which a case counts as one that hangs."""

RATE = b"framesPerSecond\0rational\0" + struct.pack("<i", 8)
"""Before the rate that a key frame is written with: what a header says of it."""

VECTORS = ("--motion", "previous=X,-Y next=-Z,W")
METHODS = ("s6", "softsplat", "causal", "s3", "blend", "hold")


@dataclass(frozen=True)
class Case:
    """A command line, and the folder in which everything of it lies.

    `pixels` is how many its frames say that they have, as far as they are allowed.
    """

    root: Path
    arguments: tuple[str, ...]
    pixels: int

    @property
    def out(self) -> Path:
        """Where it writes frames."""
        return self.root / "out"

    def judge(self, outcome: Outcome) -> None:
        """Refuse what no command may do, whatever it reads."""
        outcome.judge()
        allowed = allowed_mb(self.pixels, PROCESS_MB if outcome.alone else GROWTH_MB)
        assert outcome.peak_mb <= allowed, (
            f"{outcome.peak_mb} MB for {self.pixels} pixels, more than {allowed}"
        )
        require_no_leftovers(self.out)
        keys = next(path for path in self.root.iterdir() if path.name != "out")
        rendered = [path for path in keys.glob("*.exr") if path.is_file()]
        for name, data in shots.contents(self.out).items():
            assert is_intact(data) or any(_passes(path, data) for path in rendered), name


def _passes(source: Path, data: bytes) -> bool:
    """Whether a file is a key frame, as it is or with another rate in its header."""
    if source.read_bytes() == data:
        return True
    rate = None
    at = data.find(RATE)  # text of the header need not be UTF-8, as OpenEXR's module wants it
    if at >= 0:
        rate = Fraction(*struct.unpack_from("<iI", data, at + len(RATE)))
    with suppress(InputError):
        return b"".join(plan_key_file(source, rate).pieces()) == data
    return False


@contextmanager
def drawn(draw: Draw) -> Iterator[Case]:
    """Draw a case; its files go with the block."""
    root = Path(tempfile.mkdtemp(prefix="exwarp-fuzz-"))
    try:
        keys = root / draw(st.sampled_from(FOLDERS))
        draw_shot(draw, keys)
        for damage in draw(st.lists(st.sampled_from(DAMAGES), min_size=1, max_size=2)):
            if files(keys):
                with suppress(OSError, RuntimeError):  # links, folders, what is not even written
                    damage(draw, keys)
        yield Case(root, _command(draw, keys, root / "out"), pixels_of(keys))
    finally:
        shutil.rmtree(root, ignore_errors=True)


def _command(draw: Draw, keys: Path, out: Path) -> tuple[str, ...]:
    name = draw(st.sampled_from(["upsample", "upsample", "upsample", "inspect", "features"]))
    spec = str(keys) if draw(st.booleans()) else str(keys / "shot.####.exr")
    motion = VECTORS if draw(st.booleans()) else ()
    bound = ("--max-pixels", str(MOST_PIXELS))
    if name != "upsample":
        return (name, spec, *motion, *bound)
    more = draw(
        st.sampled_from(
            [(), ("--cuts", "none"), ("--layers", "all"), ("--no-tail",), ("--skip-existing",),
             ("--threads", "1"), ("--frames", "2")]
        )
    )  # fmt: skip
    method = draw(st.sampled_from(METHODS))
    quiet = ("--progress", "none")
    return (name, spec, "-o", str(out), "-m", method, *motion, *bound, *more, *quiet)


class Hangs(BaseException):
    """A case took too long."""


def in_process(case: Case) -> Outcome:
    """Run a case's command in this process; what libraries print past Python counts as well.

    Its peak is that by which the process grew.
    """
    sys.stdout.flush()
    sys.stderr.flush()
    with tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as err, watched() as growth:
        kept = os.dup(1), os.dup(2)
        before = signal.signal(signal.SIGALRM, _hang)
        signal.alarm(SECONDS)
        try:
            os.dup2(out.fileno(), 1)
            os.dup2(err.fileno(), 2)
            with (
                open(1, "w", closefd=False, errors="replace") as stdout,
                open(2, "w", closefd=False, errors="replace") as stderr,
                redirect_stdout(stdout),
                redirect_stderr(stderr),
                warnings.catch_warnings(),
            ):
                warnings.simplefilter("ignore")  # as the command does
                code = cli.run(list(case.arguments))
        finally:
            signal.alarm(0)
            signal.signal(signal.SIGALRM, before)
            for number, stream in zip(kept, (1, 2), strict=True):
                os.dup2(number, stream)
                os.close(number)
        for file in (out, err):
            file.seek(0)
        texts = [file.read().decode("utf-8", "replace") for file in (out, err)]
    return Outcome(code, *texts, peak_mb=growth.mb)


def _hang(_number: int, _frame: FrameType | None) -> NoReturn:
    raise Hangs(f"longer than {SECONDS} s")
